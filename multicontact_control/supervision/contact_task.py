"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

import math
from typing import Any

from multicontact_control.algebra import dot, rotate_by
from multicontact_control.arrays import Mask, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.control.controller import Controller
from multicontact_control.control.tasks import STILL, Task, TaskSource
from multicontact_control.dynamics.rotations import Pose, rotation_vector
from multicontact_control.records import CONTACT_STATE, TASK_LIMITS
from multicontact_control.supervision import contacts
import numpy as np

GUARD_SHARE = 0.3  # of the force held, below which the measured force is fed forward
GUARD_TIME = 0.3  # s after holding has begun; before, a guard would prolong bounces
# An error of the averaged force that lasts is none of noise: N and share of the force asked for,
# and how long that must have been the same [s].
LASTING_ERROR, LASTING_SHARE, LASTING_TIME = 1.5, 0.25, 0.3
LASTING_STD = 0.5  # of such an error, the standard deviation of the noise at most
# How a task is caught up with: beyond its own speed by so much of the way left [1/s] and of the
# largest speeds.
RETURN_RATE, RETURN_SHARE = 3.5, 0.2
# How far the reference may be ahead of an arm at rest that cannot follow [m], [rad].
LEAST_LEAD, LEAST_TURN = 0.002, 0.005
THERE = 5e-5  # m or rad from the task, where it is caught up with
BRAKING_SHARE = 4.0  # times the largest acceleration, by which it slows down with the arm
BOUNDED_TIME = 0.02  # s, for which an arm counts as bounded: what holds back hardly changes
# A task is a step away that is farther than the largest speeds lead in so long [s] (a stream of
# 100 Hz is none), or faster than before by so much of them.
STEP_TIME, STEP_SHARE = 0.01, 0.15
PARALLEL = 1e-6  # length that is left of a normal that the others span already


class ContactTask:
    """
    A task as far as contacts and limits allow it, written into the records of a controller.

    A hold keeps the arm where it is and pressing as it does, a lock keeps it where it is without
    contact; the time of the source stands still meanwhile. If not `guarded`, neither contact
    states nor limits apply: the source makes the contacts. `states` are records of
    `CONTACT_STATE`, shape (r,); `limited` is whether a limit was enforced at the last tick,
    `bounded_at` when the motion of the arm was bounded last [s], which its user sets, and
    `reads_before` whether there is anything in `read_before`.
    """

    def __init__(
        self, config: ControllerConfig, source: TaskSource, controller: Controller, *,
        guarded: bool = True,
    ) -> None:
        self._source, self._guarded = source, guarded
        self._controls, self._columns = controller.controls, controller.contacts
        self._frame, answer = self._controls['frame'][0], self._columns['answer']
        self._places = [self._controls['task'][0][name] for name in (
            'position', 'rotation', 'twist', 'acceleration')]
        self._active, self._alpha_des = answer['active'], answer['alpha_des']
        self.states: Any = np.zeros(len(config.columns), dtype=CONTACT_STATE)
        self._names = config.column_names
        self._codes, self._leaders = self.states['state'], np.array(config.leaders)
        self._limits: Any = np.zeros(1, dtype=TASK_LIMITS)
        self._limits['contacts'] = contacts.contact_settings(validate(
            ContactStateConfig, {**config.contact_state.model_dump(), **source.contact_state},
            'reference.approach'), config.period, config.measuring_delay)
        self._limits['box'] = [config.limits.workspace_lower or [-np.inf] * 3,
                               config.limits.workspace_upper or [np.inf] * 3]
        self.retune(config)
        self.locked = config.sensor.require_push_test  # at first
        first = self.states[0], self._limits['contacts'][0]  # no tick waits for numba
        contacts.let_go(first[0], 0.0, 0.0)
        contacts.go_on(first[0], 0.0, 0.0)
        contacts.read_anew(*first, 0.0)
        take_off(self._columns[0], first[0])
        _limit_task(self._limits, self._controls, self._columns, self.states)
        self.reset()

    def retune(self, config: ControllerConfig) -> None:
        """Let the task be so far ahead of the arm that the motion law asks for its limits."""
        felt = config.wrench_input != 'momentum'  # whose observer knows of the tool
        self._limits['contacts']['tool_mass'] = config.tool.mass if felt else 0.0
        lead = 2.0 * config.motion.damping_ratio / config.motion.natural_frequency  # k_v / k_p
        self._limits['lead'] = lead
        self._limits['reach'] = lead * config.limits.operational_speed
        self._limits['turn'] = lead * config.limits.operational_turn
        self._limits['ramp'] = config.limits.operational_acceleration
        self._limits['turn_ramp'] = config.limits.operational_turn_acceleration

    def reset(self) -> None:
        """Let all contacts start anew, free; a hold ends."""
        self.limited = self.held = self.reads_before = False
        self._time = self._lost_time = 0.0
        self._active[:] = False
        self._stand(pressing=False)

    def _stand(self, *, pressing: bool) -> None:
        """Stay where the arm is, pressing as it does or without contact; seek no contacts."""
        pressed, forces = self._active.copy(), np.zeros(len(self.states))
        position, rotation = self._frame['position'].copy(), self._frame['rotation'].copy()
        for state, normal in zip(self.states[pressed], self._columns['normal'][pressed]):
            position -= state['displacement'] * normal
        if pressing:
            forces[pressed] = self._task.alpha_des[pressed]
        self._task: Task = Task(Pose(position, rotation), STILL, STILL, pressed & pressing, forces)
        self.states[~pressed] = contacts.FREE_CONTACT
        self._columns['untared'][~pressed] = self._columns['speed_bound'][~pressed] = 0.0
        self.bounded_at, self._limits['behind'] = -math.inf, False
        self._limits['position'], self._limits['rotation'] = position, rotation
        self._limits['twist'] = 0.0
        self._kept: Mask | None = None  # contacts, from the end of a pause to the next tick

    def start(self, pose: Pose) -> None:
        """Begin from a pose at rest; a hold ends, a lock does not."""
        self.reset()
        self._source.start(pose, self._columns['normal'].copy())

    def ask(self, time: float) -> None:
        """Write what is wanted at a time since the start [s] into the controller's records."""
        if self.held or self.locked:
            self._lost_time += time - self._time
        else:
            self._task = self._source.task(
                time - self._lost_time, None if self._guarded else self._columns['alpha_meas'])
        self._time, task = time, self._task
        for place, wanted in zip(
                self._places, (*task.pose_des, task.twist_des, task.acceleration_des)):
            place[:] = wanted
        self._active[:], self._alpha_des[:] = task.active, task.alpha_des
        if self._guarded:
            if self._kept is not None:
                self._return(self._kept)
            self._limits['bounded'] = time - self.bounded_at < BOUNDED_TIME
            self.limited = _limit_task(self._limits, self._controls, self._columns, self.states)
            self.reads_before = bool(self._limits['reads_before'][0])

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the state of each contact's normal force."""
        return tuple([contacts.NAMES[code] for code in self._codes[self._leaders].tolist()])

    @property
    def read_before(self) -> tuple[str, ...]:
        """Return a sentence for each force or couple that was read before anything was touched."""
        readings = self.states['untared'] + self.states['resting']
        return tuple(
            f'{name} reads {reading:+.1f} N before it touches: nothing should press, tare'
            for name, reading in zip(self._names, readings.tolist()) if reading)

    def hold(self, wanted: bool) -> None:
        """Stay where the arm is and press as it does, or go on from there."""
        self.held = wanted
        if wanted:
            self._stand(pressing=True)
        else:
            self.resume()

    def lock(self, wanted: bool) -> None:
        """Stay without contact where the arm is, or starts next; or go on if it is not held."""
        self.locked = wanted
        if wanted:
            self._stand(pressing=False)
        elif not self.held:
            self.resume()

    def resume(self) -> Mask:
        """Go on from where the arm is; return which contacts are kept: pressed and felt, (r,)."""
        felt = self._columns['alpha_meas'] > self._limits['contacts']['contact_threshold']
        self._kept = (self._active & felt)[self._columns['config']['leader']]
        return self._kept

    def _return(self, kept: Mask) -> None:
        """Let the reference go from where the arm is to the task; contacts go along normals."""
        self._kept, normals, pose = None, self._columns['normal'], self._task.pose_des
        gap = self._frame['position'] - pose.position_world
        along = np.linalg.lstsq(normals.T, gap, rcond=None)[0]
        for state, column, place, is_kept in zip(
                self.states, self._columns, along.tolist(), kept):
            if is_kept:
                contacts.go_on(state, column['alpha_meas'], place)
            else:
                contacts.let_go(state, place, 0.0)
                contacts.read_anew(state, self._limits['contacts'][0], column['alpha_meas'])
                take_off(column, state)
        limits = self._limits
        limits['position'] = self._frame['position'] - along @ normals
        limits['rotation'] = self._frame['rotation']
        limits['twist'] = limits['ahead'] = limits['turned_ahead'] = 0.0
        self.bounded_at, limits['behind'] = -math.inf, True

    def sought_normals(self) -> Any:
        """Return normals of what is sought or held, couples with 0, shape (k, 3)."""
        return self._columns['normal'][self._codes != contacts.FREE]

    def placing_columns(self) -> dict[str, Vector]:
        """Return N_i of what is sought or held, shape (6,), by the force's or couple's name."""
        places = (self._codes != contacts.FREE) | self._active
        return {name: column['N'].copy()
                for name, column, does in zip(self._names, self._columns, places) if does}


@compiled
def _limit_task(limits: Any, controls: Any, columns: Any, states: Any) -> bool:
    """Bring a task that is wanted to one that may be followed; return whether it was limited."""
    limit, frame, task = limits[0], controls[0].frame, controls[0].task
    behind = _follow_task(limit, frame, task)
    _follow_contacts(limit, frame, task, columns, states)
    return _bound_task(limit, frame, task, columns) or behind


@compiled
def _follow_task(limit: Any, frame: Any, task: Any) -> bool:
    """
    Let the reference catch up with the task where the arm could not; return if it is behind.

    Once the motion of the arm is bounded, after a pause, and where the task makes a step, the
    reference goes straight to the task, but no farther ahead of the arm than `LEAST_LEAD`: so it
    slows down with the arm, does not run away, and does not pull the arm along the bound.
    """
    way, turn = task.position - limit.position, np.empty(3)
    turn[:] = rotation_vector(task.rotation, limit.rotation)
    if not limit.behind:
        steps = _is_step(way, task.twist[:3], limit.twist[:3], limit.reach / limit.lead) or (
            _is_step(turn, task.twist[3:], limit.twist[3:], limit.turn / limit.lead))
        if not (limit.bounded or steps):
            limit.position[:], limit.rotation[:] = task.position, task.rotation
            limit.twist[:] = task.twist
            return False
        limit.behind = True
    there = _catch_up(way, task.twist[:3], task.acceleration[:3], limit, limit.twist[:3],
                      frame.twist[:3], limit.ahead, LEAST_LEAD, limit.reach, limit.ramp)
    limit.position += way
    task.position[:] = limit.position
    there_turned = _catch_up(turn, task.twist[3:], task.acceleration[3:], limit, limit.twist[3:],
                             frame.twist[3:], limit.turned_ahead, LEAST_TURN, limit.turn,
                             limit.turn_ramp)
    rotate_by(turn, limit.rotation)
    task.rotation[:] = limit.rotation
    behind = not (there and there_turned)
    limit.behind = limit.bounded or behind
    return behind


@compiled
def _is_step(way: Vector, speed_des: Vector, speed: Vector, fastest: float) -> bool:
    """Return whether a task is a step away from the reference, or suddenly faster."""
    missing = speed_des - speed
    jumps = dot(way, way) > (STEP_TIME * fastest) ** 2
    faster = dot(speed_des, speed_des) > dot(speed, speed)
    return jumps or (faster and dot(missing, missing) > (STEP_SHARE * fastest) ** 2)


@compiled
def _catch_up(
    way: Vector, speed_des: Vector, acceleration: Vector, limit: Any, speed: Vector,
    speed_of_arm: Vector, ahead: Vector, least_lead: float, reach: float, ramp: float,
) -> bool:
    """
    Shorten a way to what the reference goes in a tick; return whether it has caught up.

    Its velocity `speed` v_r becomes the desired one, `speed_des`. It goes as fast as the task and
    on towards it, never away from it, and changes by `ramp` at most [m/s^2, rad/s^2]. While the
    motion of the arm is bounded, v_r is at most v + (l - e) k_p / k_v, at a distance e ahead of an
    arm of speed v: the motion law then pulls the arm by k_p l at most.
    """
    h, length, fastest = limit.contacts.period, np.sqrt(dot(way, way)), reach / limit.lead
    wanted, slower = speed_des.copy(), False
    if length > 0.0:
        direction = way / length
        along = max(0.0, dot(wanted, direction) + min(
            RETURN_RATE * length, RETURN_SHARE * fastest))
        allowed = dot(speed_of_arm, direction) + (least_lead - dot(ahead, direction)) / limit.lead
        slower = limit.bounded and along > allowed
        if slower:
            along = max(allowed, 0.0)
        wanted += direction * (along - dot(wanted, direction))
        wanted *= min(1.0, fastest / max(np.sqrt(dot(wanted, wanted)), THERE))
        if slower:
            ramp *= BRAKING_SHARE
    change = wanted - speed
    speed += change * min(1.0, h * ramp / max(np.sqrt(dot(change, change)), THERE))
    missing = speed_des - speed
    if length < THERE and not slower and dot(missing, missing) < (2.0 * h * ramp) ** 2:
        speed[:] = speed_des
        return True
    way[:] = h * speed
    speed_des[:], acceleration[:] = speed, 0.0
    return False


@compiled
def _follow_contacts(limit: Any, frame: Any, task: Any, columns: Any, states: Any) -> None:
    """Advance all contacts: say what the force law does, move the task by their displacements."""
    position, twist, acceleration = task.position, task.twist, task.acceleration
    away, rate = frame.position - position, frame.twist[:3] - twist[:3]
    moved, shift = states['displacement'].copy(), np.zeros(3)
    limit.reads_before = False
    for i in range(columns.shape[0]):
        column, state = columns[i], states[i]
        answer, normal = column.answer, column.normal
        state.asked_for += limit.contacts.period
        if state.asked != answer.alpha_des:
            state.asked_for = 0.0
        state.wanted, state.asked = answer.active, answer.alpha_des
        first = column.config.leader
        if first != i:  # a couple is in the state of its normal force, which comes before
            leader, force = states[first], columns[first]
            state.state, state.in_state = leader.state, leader.in_state
            bound = LARGEST_OFFSET * force.answer.alpha_des
            answer.alpha_des = min(max(state.asked, -bound), bound)
            column.guarded = force.guarded
            # What turns the tool in free space is no couple.
            answer.active = contacts.is_active(leader) and (leader.answered or leader.resumed)
            contacts.follow_couple(state, leader, limit.contacts, column.alpha_meas)
        else:
            state.stiffness = column.stiffness
            state.approach_speed = contacts.approach_speed(
                state, limit.contacts, column.mobility)
            # Of the surface, as far as it is known: what is as fast does not leave it.
            state.surface_speed = column.config.surface_speed + column.surface_speed_est
            others, speed = 0.0, dot(normal, rate)
            for j in range(columns.shape[0]):
                if j != i:
                    others += dot(normal, columns[j].normal) * moved[j]
            # Turning about the tool moves the operational point, and a surface that is not where
            # the task has it moves the contact point: what escapes does both.
            place = dot(normal, away) - others
            if contacts.is_refuted(state, limit.contacts, place):
                contacts.refute(state, limit.contacts, place, speed)
                take_off(column, state)
            contacts.advance_contact(
                state, limit.contacts, column.alpha_meas, place, speed,
                min(speed, dot(column.N, frame.twist)) - state.surface_speed)
            answer.alpha_des = contacts.desired_force(state, limit.contacts)
            fall_speed = _fall_speed(frame, column.config)
            _follow_slide(limit.contacts.period, fall_speed, column, state)
            column.guarded = state.state == contacts.HOLDING and state.in_state > GUARD_TIME and (
                column.alpha_meas < GUARD_SHARE * min(state.level, state.asked))
            answer.active = contacts.is_active(state)
            column.speed_bound = contacts.speed_bound(state, fall_speed)
        shift += state.displacement * normal
        take_off(column, state)
        if state.untared != 0.0 or state.resting != 0.0:
            limit.reads_before = True
        if not answer.active:
            answer.alpha_des = 0.0
            twist[:3] += state.speed * normal
            acceleration[:3] += state.acceleration * normal
    position += shift


@compiled
def take_off(column: Any, state: Any) -> None:
    """Take what is read without a touch off the measured force from now on."""
    column.alpha_meas += column.untared - state.untared
    column.untared = state.untared


@compiled
def _fall_speed(frame: Any, config: Any) -> float:
    """Return how fast a surface within `normal_range` falls away at most while sliding [m/s]."""
    velocity = frame.twist[:3] - dot(frame.twist[:3], config.normal) * config.normal
    slope = np.sqrt(1.0 - config.smallest_cosine ** 2) / config.smallest_cosine
    return slope * np.sqrt(dot(velocity, velocity))


@compiled
def _follow_slide(period: float, fall_speed: float, column: Any, state: Any) -> None:
    """
    Allow for a surface that is not as told where the tip slides on it.

    Its force changes all the time, which counts as noise, R grows to hundreds of N^2, and the law
    is blind while the surface falls away. The error e of the averaged force that lasts bounds it:
    R <= (e / 2)^2. After a loss the surface is sought as much deeper as it may be within
    `normal_range`.
    """
    error = abs(state.level - state.asked)
    if state.state == contacts.HOLDING and min(state.in_state, state.asked_for) > LASTING_TIME:
        if error > max(LASTING_ERROR, LASTING_SHARE * state.asked):
            bound = (LASTING_STD * error) ** 2
            column.noise_variance = min(column.noise_variance, bound)
    if contacts.is_active(state):
        state.fall = 0.0
        return
    state.fall += fall_speed * period


@compiled
def _bound_task(limit: Any, frame: Any, task: Any, columns: Any) -> bool:
    """Bring a task within the box and, off active normals, within reach; return if it changed."""
    # The arm goes at v_des + (k_p / k_v) (x_des - x): the limit's speed at an error of one reach.
    position, twist, acceleration = task.position, task.twist, task.acceleration
    limited = False
    for k in range(3):
        inside = min(max(position[k], limit.box[0, k]), limit.box[1, k])
        if inside != position[k]:
            position[k], twist[k], acceleration[k], limited = inside, 0.0, 0.0, True
    gap, way, turn = position - frame.position, limit.lead * twist[:3], np.empty(3)
    axes, count = np.empty((columns.shape[0], 3)), 0
    for i in range(columns.shape[0]):
        if not columns[i].answer.active or columns[i].config.leader != i:
            continue
        axis = axes[count]  # made orthogonal to those before (Gram-Schmidt)
        axis[:] = columns[i].normal
        for j in range(count):
            axis -= dot(axis, axes[j]) * axes[j]
        length = np.sqrt(dot(axis, axis))
        if length > PARALLEL:
            axis /= length
            count += 1
            along, ahead = dot(gap, axis), dot(way, axis)
            gap -= along * axis
            way -= ahead * axis
    share = _share_within(gap, way, limit.reach, twist[:3], acceleration[:3])
    if share < 1.0:
        position -= gap * (1.0 - share)
    turn[:] = rotation_vector(task.rotation, frame.rotation)
    limit.ahead[:], limit.turned_ahead[:] = gap, turn
    turn_share = _share_within(
        turn, limit.lead * twist[3:], limit.turn, twist[3:], acceleration[3:])
    if turn_share < 1.0:
        turn *= turn_share
        task.rotation[:] = frame.rotation
        rotate_by(turn, task.rotation)
    return limited or share <= 1.0 or turn_share <= 1.0


@compiled
def _share_within(
    gap: Vector, way: Vector, reach: float, twist: Vector, acceleration: Vector,
) -> float:
    """
    Return the share of a gap within reach, 2 if all is, with the way that its speed adds.

    The speed, `twist`, is reduced so that gap and way together are within reach: an arm that is
    fast already is not braked by more than the reach asks for.
    """
    squared = dot(gap, gap)
    length = np.sqrt(squared)
    together = squared + 2.0 * dot(gap, way) + dot(way, way)
    if not (length > reach or together > reach * reach):
        return 2.0
    acceleration[:] = 0.0
    if length >= reach:
        twist[:] = 0.0
        return reach / length
    # |gap + s way| = reach
    along, square = dot(gap, way), dot(way, way)
    twist *= (np.sqrt(along * along + square * (reach * reach - squared)) - along) / square
    return 1.0


