"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

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
from scipy.spatial.transform import Rotation

GUARD_SHARE = 0.3  # of the force held, below which the measured force is fed forward
GUARD_TIME = 0.3  # s after holding has begun; before, a guard would prolong bounces
# An error of the averaged force that lasts is none of noise: N and share of the force asked for,
# and how long that must have been the same [s].
LASTING_ERROR, LASTING_SHARE, LASTING_TIME = 1.5, 0.25, 0.3
RETURN_RATE = 2.0  # 1/s, of the way left, at which the task is caught up with after a pause
RETURN_SHARE = 0.2  # of the largest speeds, at which it is at most
PARALLEL = 1e-6  # length that is left of a normal that the others span already


class ContactTask:
    """
    A task as far as contacts and limits allow it, written into the records of a controller.

    A hold keeps the arm where it is and pressing as it does, a lock keeps it where it is without
    contact; the time of the source stands still meanwhile. If not `guarded`, neither contact
    states nor limits apply: the source makes the contacts. `states` are records of
    `CONTACT_STATE`, shape (r,); `limited` is whether a limit was enforced at the last tick.
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
        self._codes, self._leaders = self.states['state'], np.array(config.leaders)
        self._limits: Any = np.zeros(1, dtype=TASK_LIMITS)
        self._limits['contacts'] = contacts.contact_settings(validate(
            ContactStateConfig, {**config.contact_state.model_dump(), **source.contact_state},
            'reference.approach'), config.period)
        self._limits['box'] = [config.limits.workspace_lower or [-np.inf] * 3,
                               config.limits.workspace_upper or [np.inf] * 3]
        self.retune(config)
        self.locked = config.sensor.require_push_test  # at first
        contacts.let_go(self.states[0], 0.0, 0.0)  # no tick waits for numba
        _limit_task(self._limits, self._controls, self._columns, self.states)
        self.reset()

    def retune(self, config: ControllerConfig) -> None:
        """Let the task be so far ahead of the arm that the motion law asks for its limits."""
        lead = 2.0 * config.motion.damping_ratio / config.motion.natural_frequency  # k_v / k_p
        self._limits['lead'] = lead
        self._limits['reach'] = lead * config.limits.operational_speed
        self._limits['turn'] = lead * config.limits.operational_turn

    def reset(self) -> None:
        """Let all contacts start anew, free; a hold ends."""
        self.limited = self.held = False
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
        self._limits['offset'] = self._limits['turned'] = 0.0
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
            self.limited = _limit_task(self._limits, self._controls, self._columns, self.states)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the state of each contact's normal force."""
        return tuple([contacts.NAMES[code] for code in self._codes[self._leaders].tolist()])

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
        """Go from where the arm is back to the task: along normals by means of the contacts."""
        self._kept, normals, pose = None, self._columns['normal'], self._task.pose_des
        gap = self._frame['position'] - pose.position_world
        along = np.linalg.lstsq(normals.T, gap, rcond=None)[0]
        for state, place, is_kept in zip(self.states, along.tolist(), kept):
            if is_kept:
                state['displacement'] = place
            else:
                contacts.let_go(state, place, 0.0)
        self._limits['offset'] = gap - along @ normals
        self._limits['turned'] = Rotation.from_matrix(
            self._frame['rotation'] @ pose.rotation_world.T).as_rotvec()

    def sought_normals(self) -> Any:
        """Return normals of what is sought or held, couples with 0, shape (k, 3)."""
        return self._columns['normal'][self._codes != contacts.FREE]


@compiled
def _limit_task(limits: Any, controls: Any, columns: Any, states: Any) -> bool:
    """Bring a task that is wanted to one that may be followed; return whether it was limited."""
    limit, frame, task = limits[0], controls[0].frame, controls[0].task
    for gap, largest in ((limit.offset, limit.reach), (limit.turned, limit.turn)):
        fastest = RETURN_SHARE * largest / limit.lead / np.sqrt(dot(gap, gap))
        gap *= 1.0 - limit.contacts.period * min(RETURN_RATE, fastest)
    _follow_contacts(limit, frame, task, columns, states)
    rotate_by(limit.turned, task.rotation)
    return _bound_task(limit, frame, task, columns)


@compiled
def _follow_contacts(limit: Any, frame: Any, task: Any, columns: Any, states: Any) -> None:
    """Advance all contacts: say what the force law does, move the task by their displacements."""
    position, twist, acceleration = task.position, task.twist, task.acceleration
    away, rate = frame.position - position - limit.offset, frame.twist[:3] - twist[:3]
    moved, shift = states['displacement'].copy(), limit.offset.copy()
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
        else:
            state.stiffness = column.stiffness
            # Of the surface, as far as it is known: what is as fast does not leave it.
            state.surface_speed = column.config.surface_speed + column.surface_speed_est
            others, speed = 0.0, dot(normal, rate)
            for j in range(columns.shape[0]):
                if j != i:
                    others += dot(normal, columns[j].normal) * moved[j]
            # Turning about the tool moves the operational point, and a surface that is not where
            # the task has it moves the contact point: what escapes does both.
            contacts.advance_contact(
                state, limit.contacts, column.alpha_meas, dot(normal, away) - others, speed,
                min(speed, dot(column.N, frame.twist)) - state.surface_speed)
            answer.alpha_des = min(state.asked, state.force_limit)
            _follow_slide(limit.contacts.period, frame, column, state)
            column.guarded = state.state == contacts.HOLDING and state.in_state > GUARD_TIME and (
                column.alpha_meas < GUARD_SHARE * min(state.level, state.asked))
        shift += state.displacement * normal
        answer.active = contacts.is_active(state)
        if not answer.active:
            answer.alpha_des = 0.0
            twist[:3] += state.speed * normal
            acceleration[:3] += state.acceleration * normal
    position += shift


@compiled
def _follow_slide(period: float, frame: Any, column: Any, state: Any) -> None:
    """
    Allow for a surface that is not as told where the tip slides on it.

    Its force changes all the time, which counts as noise, R grows to hundreds of N^2, and the law
    is blind while the surface falls away. The error e of the averaged force that lasts bounds it:
    R <= e^2. After a loss the surface is sought as much deeper as it may be within `normal_range`.
    """
    config = column.config
    error = abs(state.level - state.asked)
    if state.state == contacts.HOLDING and min(state.in_state, state.asked_for) > LASTING_TIME:
        if error > max(LASTING_ERROR, LASTING_SHARE * state.asked):
            column.noise_variance = min(column.noise_variance, error * error)
    if contacts.is_active(state):
        state.fall = 0.0
        return
    velocity = frame.twist[:3] - dot(frame.twist[:3], config.normal) * config.normal
    slope = np.sqrt(1.0 - config.smallest_cosine ** 2) / config.smallest_cosine
    state.fall += slope * np.sqrt(dot(velocity, velocity)) * period


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
    rotation_vector(task.rotation, frame.rotation, turn)
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
    Return the share of a gap within reach, with the motion shortened as much; 2 if all is within.

    Gap and way ahead are then together as long as the reach: what the motion law is asked for
    comes to the largest speed without a jump. Of a gap that alone is longer nothing is left but
    the reach.
    """
    length = np.sqrt(dot(gap, gap))
    together = dot(gap, gap) + 2.0 * dot(gap, way) + dot(way, way)
    if not (length > reach or together > reach * reach):
        return 2.0
    if length > reach:
        twist[:] = 0.0
        acceleration[:] = 0.0
        return reach / length
    share = reach / np.sqrt(together)
    twist *= share
    acceleration *= share
    return share
