"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import cross, dot
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ContactStateConfig, ControllerConfig, validate
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.control.controller import Controller
from multicontact_control.control.tasks import Task, TaskSource
from multicontact_control.dynamics.robot import turn_between
from multicontact_control.dynamics.rotations import Pose, rotation_vector
from multicontact_control.records import CONTACT_STATE, TASK_LIMITS
from multicontact_control.supervision.contacts import (
    advance_contact,
    contact_settings,
    FREE,
    FREE_CONTACT,
    GIVEN_UP,
    HOLDING,
    IMPACT,
    is_active,
    let_go,
    NAMES,
)
import numpy as np

GUARD_SHARE = 0.3  # of the force held; below it the measured force is fed forward, so that the
# other contacts are not pressed with what a surface that has gone does not bear
GUARD_TIME = 0.3  # s after holding has begun; before, a guard would prolong bounces
NEAR = 2e-4  # m of displacement without a contact, that count as none
CLOSE, ALIGNED = 1e-6, 1e-5  # m and rad from the task, that count as none
NEW_TURN = 1e-3  # rad in one period beyond its twist: an orientation that is commanded anew
RETURN_RATE = 2.0  # 1/s, of the way left, at which the task is caught up with after a pause
RETURN_SHARE = 0.2  # of the largest speeds, at which it is at most
PARALLEL = 1e-6  # length that is left of a normal that the others span already


class ContactTask:
    """
    A task as far as contacts and limits allow it, written into the records of a controller.

    Contacts that the task wants are approached along their normals, handed to the force law from
    touch to loss, and sought again; see `supervision.contacts`. Position and twist stay within
    the limits; see `limit_task`. A hold keeps the arm where it is and pressing as it does, a lock
    keeps it where it is without contact; the time of the source stands still meanwhile.

    Parameters
    ----------
    config
        Contacts, motion law, limits.
    source
        What is to be done.
    controller
        Its records of the arm and the contacts are read, and the task is written into them.
    guarded
        Whether contact states and limits apply. If not, the source makes the contacts, and its
        task is written as it is.

    Attributes
    ----------
    states
        Records of `CONTACT_STATE`, shape (r,).
    limited
        Whether a limit of the motion was enforced at the last tick.
    locked
        Whether it is locked; from the start where a push test is required.

    """

    def __init__(
        self, config: ControllerConfig, source: TaskSource, controller: Controller, *,
        guarded: bool = True,
    ) -> None:
        self._source, self._guarded = source, guarded
        self._leaders = np.array(config.leaders)
        self._controls, self._columns = controller.controls, controller.contacts
        wanted, self._frame = (self._controls[name][0] for name in ('task', 'frame'))
        # Views are kept: to look up a field takes as long as to copy its numbers.
        self._places = tuple(wanted[name] for name in (
            'position', 'rotation', 'twist', 'acceleration')) + tuple(
            self._columns['answer'][name] for name in ('active', 'alpha_des'))
        self.states: Any = np.zeros(len(config.columns), dtype=CONTACT_STATE)
        self._no_contact = np.zeros(len(config.columns), dtype=bool), np.zeros(len(config.columns))
        self._limits: Any = np.zeros(1, dtype=TASK_LIMITS)
        self._offset: Vector = self._limits['offset'][0]
        self._turned: Vector = self._limits['turned'][0]
        self._limits['contacts'] = contact_settings(validate(
            ContactStateConfig, {**config.contact_state.model_dump(), **source.contact_state},
            'reference.approach'), config.period)
        self._limits['box'] = [config.limits.workspace_lower or [-np.inf] * 3,
                               config.limits.workspace_upper or [np.inf] * 3]
        self.retune(config)
        self.locked = config.sensor.require_push_test
        self.reset()
        # No tick waits for numba.
        let_go(self.states[0], 0.0, 0.0)
        limit_task(self._limits, self._controls, self._columns, self.states)
        self.reset()

    def retune(self, config: ControllerConfig) -> None:
        """Let the task be so far ahead of the arm that the motion law asks for its limits."""
        self._config = config
        lead = 2.0 * config.motion.damping_ratio / config.motion.natural_frequency  # k_v / k_p
        self._limits['lead'] = lead
        self._limits['reach'] = lead * config.limits.operational_speed
        self._limits['turn'] = lead * config.limits.operational_turn

    def reset(self) -> None:
        """Let all contacts start anew, free; a hold ends."""
        self.states[:] = FREE_CONTACT
        self._offset[:] = self._turned[:] = 0.0
        self.limited = self._catching_up = False
        self._last: Task | None = None  # of the source
        self._held: Task | None = None  # while it is held
        self._rest: Task | None = None  # while it is locked
        self._time = self._lost_time = 0.0

    def start(self, pose: Pose) -> None:
        """Begin from a pose at rest; a hold ends, a lock does not."""
        self.reset()
        self._source.start(pose, self._columns['normal'].copy())
        if self.locked:
            self._rest = _still(pose, *self._no_contact)

    def ask(self, time: float) -> None:
        """Write what is wanted at a time since the start [s] into the controller's records."""
        task = self._held if self._rest is None else self._rest
        if task is None:
            task = self._last = self._source.task(
                time - self._lost_time, None if self._guarded else self._columns['alpha_meas'])
        else:
            self._lost_time += time - self._time
        self._time = time
        position, rotation, twist, acceleration, active, alpha_des = self._places
        position[:], rotation[:] = task.pose_des
        twist[:], acceleration[:] = task.twist_des, task.acceleration_des
        active[:], alpha_des[:] = task.active, task.alpha_des
        if self._guarded:
            if self._catching_up:
                self._catch_up(task)
            self._asked = task.pose_des
            self.limited = limit_task(self._limits, self._controls, self._columns, self.states)

    @property
    def begun(self) -> bool:
        """Whether there was a task of the source since the start, which can be held."""
        return self._last is not None

    @property
    def held(self) -> bool:
        """Whether it is held on command."""
        return self._held is not None and not self.locked

    def hold(self) -> None:
        """Stay where the arm is and press as it does; not before it has begun."""
        if self._last is not None:
            pressed = self.pressed
            self._held = _still(
                self._stand(), pressed, np.where(pressed, self._last.alpha_des, 0.0))

    def release(self) -> None:
        """End a hold: go on with the source from where the arm is."""
        if self.held:
            self._held = None
            self.resume()

    def lock(self) -> None:
        """Stay where the arm is, or at the pose of the next start, without contact."""
        self.locked = True
        if self.begun or self._rest is not None:
            self._rest = _still(self._stand(), *self._no_contact)
            if self._held is not None:
                self._held = self._rest

    def unlock(self) -> None:
        """End a lock: go on with the source, or, if it was held before, stay without contact."""
        self.locked, self._rest = False, None
        if self._held is None:
            self.resume()

    def _stand(self) -> Pose:
        """Stop looking for contacts; return the pose of a task that leaves the arm where it is."""
        pressed = self.pressed
        position, rotation = self._frame['position'].copy(), self._frame['rotation'].copy()
        for state, normal in zip(self.states[pressed], self._columns['normal'][pressed]):
            position -= state['displacement'] * normal
        self.states[~pressed] = FREE_CONTACT
        self._offset[:] = self._turned[:] = 0.0
        self._catching_up = False
        return Pose(position, rotation)

    def resume(self) -> Mask:
        """Go on from where the arm is; return which contacts are kept: pressed and felt, (r,)."""
        self._offset[:] = self._turned[:] = np.nan  # set at the next tick
        self._catching_up = True
        felt = self._columns['alpha_meas'] > self._limits['contacts']['contact_threshold']
        self._kept: Mask = (self.pressed & felt)[self._columns['leader']]
        return self._kept

    @property
    def pressed(self) -> Mask:
        """Which forces and couples the force law drives, also while a reaction acts, (r,)."""
        if not self._guarded:
            return self._columns['answer']['active'].astype(bool)
        codes = self.states['state']
        pressed: Mask = (codes == IMPACT) | (codes == HOLDING)
        return pressed

    @property
    def state_names(self) -> tuple[str, ...]:
        """State of each contact, which is that of its normal force."""
        return tuple(NAMES[code] for code in self.states['state'][self._leaders].tolist())

    def sought_normals(self) -> Matrix:
        """Return the normals of the contacts that are sought or held, shape (k, 3)."""
        sought = [i for i in self._leaders if self.states['state'][i] != FREE]
        normals: Matrix = self._columns['normal'][sought]
        return normals

    def seek_again(self) -> bool:
        """Seek the contacts that were given up; return whether there are any."""
        given_up = self.states['state'] == GIVEN_UP
        self.states['again'] |= given_up
        return bool(given_up.any())

    def lead_back(self) -> None:
        """Leave the contacts that are pressed: they lead the arm out of its workspace."""
        self.states['left'] |= self.pressed

    def _catch_up(self, task: Task) -> None:
        """Let what a pause has left go to zero, from where the arm is."""
        # A pose that is commanded anew is a jump; the way that the task goes is none.
        moved = self._config.period * task.twist_des
        jump = task.pose_des.position_world - self._asked.position_world - moved[:3]
        normals, offset, turned = self._columns['normal'], self._offset, self._turned
        if np.isnan(offset[0]):
            # What lies along the normals belongs to the contacts, only the rest is caught up.
            gap = self._frame['position'] - task.pose_des.position_world
            along = np.linalg.lstsq(normals.T, gap, rcond=None)[0]
            for state, place, kept in zip(self.states, along, self._kept):
                if kept:
                    state['displacement'] = place
                else:
                    let_go(state, float(place), 0.0)
            offset[:] = gap - along @ normals
            jump = np.zeros(3)
        elif jump.any():
            # A jump towards where the arm is takes as much off what is left: the arm goes from
            # there to what is commanded, not by the whole offset beyond it.
            along = np.linalg.lstsq(normals.T, jump, rcond=None)[0]
            for state, step in zip(self.states, along.tolist()):
                if state['state'] == FREE:
                    state['displacement'] = _closer(float(state['displacement']), step)
            jump = jump - along @ normals
        rotation = task.pose_des.rotation_world
        turn = turn_between(rotation, self._asked.rotation_world) - moved[3:]
        if np.isnan(turned[0]) or turned.any() and float(np.abs(turn).max()) > NEW_TURN:
            turned[:] = turn_between(self._frame['rotation'], rotation)
        limits = self._config.limits
        self._fade(offset, jump, limits.operational_speed, CLOSE)
        self._fade(turned, np.zeros(3), limits.operational_turn, ALIGNED)
        free = self.states['displacement'][self.states['state'] == FREE]
        self._catching_up = bool(offset.any() or turned.any() or (np.abs(free) > NEAR).any())

    def _fade(self, gap: Vector, jump: Vector, fastest: float, least: float) -> None:
        """Shorten a gap by a period's way and by a jump of its far end."""
        length = float(np.sqrt(gap @ gap))
        if length < least:
            gap[:] = 0.0
            return
        left = _closer(length, float(jump @ gap) / length)
        speed = min(RETURN_RATE * left, RETURN_SHARE * fastest)
        gap *= max(left - speed * self._config.period, 0.0) / length


def _still(pose: Pose, active: Mask, alpha_des: Vector) -> Task:
    """Return the task to stand still at a pose and to press."""
    return Task(pose, np.zeros(6), np.zeros(6), active, alpha_des)


def _closer(gap: float, step: float) -> float:
    """Return what is left of a gap when its far end comes towards the near one by a step."""
    return gap - min(max(step, min(gap, 0.0)), max(gap, 0.0))


@compiled
def limit_task(limits: Any, controls: Any, columns: Any, states: Any) -> bool:
    """
    Bring a task that is wanted to one that may be followed; return whether a limit was enforced.

    Parameters
    ----------
    limits, controls
        One record of `TASK_LIMITS` and one of `CONTROL`, the task of which is changed.
    columns, states
        Records of `CONTACT` and `CONTACT_STATE`, shape (r,): `active` and `alpha_des` say what is
        wanted, and then what the force law is to do.

    """
    limit, frame, task = limits[0], controls[0].frame, controls[0].task
    follow_contacts(limit, frame, task, columns, states)
    for i in range(columns.shape[0]):
        column, state = columns[i], states[i]
        column.answer.active = is_active(state)
        if column.leader != i:
            leader = columns[column.leader]  # which comes before
            bound = LARGEST_OFFSET * leader.answer.alpha_des
            column.guarded = leader.guarded
            column.answer.alpha_des = min(max(state.asked, -bound), bound)
        else:
            column.guarded = state.state == HOLDING and state.in_state > GUARD_TIME and (
                column.alpha_meas < GUARD_SHARE * min(state.level, state.asked))
            column.answer.alpha_des = min(state.asked, state.force_limit)
        if not column.answer.active:
            column.answer.alpha_des = 0.0
    # What a pause has left, and the displacements of the contacts.
    rotate_by(limit.turned, task.rotation, task.rotation)
    for k in range(3):
        shift, velocity, change = limit.offset[k], 0.0, 0.0
        for i in range(columns.shape[0]):
            shift += states[i].displacement * columns[i].normal[k]
            if not is_active(states[i]):
                velocity += states[i].speed * columns[i].normal[k]
                change += states[i].acceleration * columns[i].normal[k]
        task.position[k] += shift
        task.twist[k] += velocity
        task.acceleration[k] += change
    return bound_task(limit, frame, columns, task)


@compiled
def follow_contacts(limit: Any, frame: Any, task: Any, columns: Any, states: Any) -> None:
    """Advance the state machine of every contact; the records are those of `limit_task`."""
    count, twist = columns.shape[0], frame.twist
    moved = np.empty(count)
    for i in range(count):
        moved[i] = states[i].displacement
    for i in range(count):
        column, state = columns[i], states[i]
        state.wanted, state.asked = column.answer.active, column.answer.alpha_des
        if column.leader != i:  # a couple is in the state of its normal force
            leader = states[column.leader]
            state.state, state.in_state = leader.state, leader.in_state
            continue
        state.stiffness = column.stiffness
        # Of the surface, as far as it is known: what is as fast does not leave it.
        state.surface_speed = column.surface_speed + column.surface_speed_est
        normal = column.normal
        place, speed = 0.0, 0.0
        for k in range(3):
            place += normal[k] * (frame.position[k] - task.position[k] - limit.offset[k])
            speed += normal[k] * (twist[k] - task.twist[k])
        others = 0.0
        for j in range(count):
            if j != i:
                others += dot(normal, columns[j].normal) * moved[j]
        # Turning about the tool moves the operational point, and a surface that is not where the
        # task has it moves the contact point: what escapes does both.
        advance_contact(
            state, limit.contacts, column.alpha_meas, place - others, speed,
            min(speed, dot(column.N, twist)) - state.surface_speed)


@compiled
def rotate_by(vector: Vector, rotation: Matrix, turned: Matrix) -> None:
    """Fill in `turned`, a rotation turned by a rotation vector [rad] (Rodrigues), shape (3, 3)."""
    angle = np.sqrt(dot(vector, vector))
    if angle < 1e-12:
        for i in range(3):
            for j in range(3):
                turned[i, j] = rotation[i, j]
        return
    axis, column, once, twice = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        axis[i] = vector[i] / angle
    for j in range(3):
        for i in range(3):
            column[i] = rotation[i, j]
        cross(axis, column, once)
        cross(axis, once, twice)
        for i in range(3):
            turned[i, j] = column[i] + np.sin(angle) * once[i] + (1.0 - np.cos(angle)) * twice[i]


@compiled
def bound_task(limit: Any, frame: Any, columns: Any, task: Any) -> bool:
    """
    Bring a task within the box and within reach of the arm; return whether it was changed.

    The motion law makes the arm go at v_des + (k_p / k_v) (x_des - x), which is the limit's speed
    for an error of one reach. A twist with which it is more does not count. What lies along the
    normals of active contacts is left to these: the motion law does not go there.
    """
    limited = False
    position = task.position
    for k in range(3):
        inside = min(max(position[k], limit.box[0, k]), limit.box[1, k])
        if inside != position[k]:
            position[k] = inside
            task.twist[k] = 0.0
            task.acceleration[k] = 0.0
            limited = True
    gap, way, turn = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        gap[k] = position[k] - frame.position[k]
        way[k] = limit.lead * task.twist[k]
    leave_to_contacts(columns, gap, way)
    share = share_within(gap, way, limit.reach)
    if share <= 1.0:
        stop(task, 0)
        limited = True
    if share < 1.0:
        for k in range(3):
            position[k] -= gap[k] * (1.0 - share)
    rotation_vector(task.rotation, frame.rotation, turn)
    for k in range(3):
        way[k] = limit.lead * task.twist[3 + k]
    share = share_within(turn, way, limit.turn)
    if share <= 1.0:
        stop(task, 3)
        limited = True
    if share < 1.0:
        for k in range(3):
            turn[k] *= share
        rotate_by(turn, frame.rotation, task.rotation)
    return limited


@compiled
def share_within(gap: Vector, way: Vector, reach: float) -> float:
    """Return which share of a gap is within reach, 1 if its way leads beyond, 2 if all is well."""
    length = np.sqrt(dot(gap, gap))
    if length > reach:
        return reach / length
    together = dot(gap, gap) + 2.0 * dot(gap, way) + dot(way, way)
    return 1.0 if together > reach * reach else 2.0


@compiled
def stop(task: Any, first: int) -> None:
    """Let the twist and the acceleration of a task not count, from an axis on."""
    for k in range(first, 6):
        task.twist[k] = 0.0
        task.acceleration[k] = 0.0


@compiled
def leave_to_contacts(columns: Any, gap: Vector, way: Vector) -> None:
    """Take off two vectors what lies along the normals of the active contacts (Gram-Schmidt)."""
    axes, count = np.empty((3, 3)), 0
    for i in range(columns.shape[0]):
        if count == 3 or not columns[i].answer.active or columns[i].leader != i:
            continue
        axis = axes[count]
        for k in range(3):
            axis[k] = columns[i].normal[k]
        for j in range(count):
            take_off(axis, axes[j])
        length = np.sqrt(dot(axis, axis))
        if length > PARALLEL:
            for k in range(3):
                axis[k] /= length
            take_off(gap, axis)
            take_off(way, axis)
            count += 1


@compiled
def take_off(vector: Vector, axis: Vector) -> None:
    """Take off a vector what lies along a unit vector."""
    along = dot(vector, axis)
    for k in range(3):
        vector[k] -= along * axis[k]
