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
RETURN_RATE = 2.0  # 1/s, of the way left, at which the task is caught up with after a pause
RETURN_SHARE = 0.2  # of the largest speeds, at which it is at most
PARALLEL = 1e-6  # length that is left of a normal that the others span already


class ContactTask:
    """
    A task as far as contacts and limits allow it, written into the records of a controller.

    Contacts that the task wants are approached along their normals, handed to the force law from
    touch to loss, and sought again; see `supervision.contacts`. Position and twist stay within
    the limits. A hold keeps the arm where it is and pressing as it does, a lock keeps it where it
    is without contact; the time of the source stands still meanwhile.

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
        self._frame, task = self._controls['frame'][0], self._controls['task'][0]
        self._position, self._rotation = task['position'], task['rotation']
        self._twist, self._acceleration = task['twist'], task['acceleration']
        self._active, self._alpha_des = (
            self._columns['answer'][name] for name in ('active', 'alpha_des'))
        self.states: Any = np.zeros(len(config.columns), dtype=CONTACT_STATE)
        self._codes, self._named = self.states['state'], b''
        self._names: tuple[str, ...] = ()
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
        # No tick waits for numba.
        let_go(self.states[0], 0.0, 0.0)
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
        self.states[:] = FREE_CONTACT
        self._offset[:] = self._turned[:] = 0.0
        self.limited = self._holds = False
        self._last: Task | None = None  # of the source
        self._rest: Task | None = None  # while it is held or locked
        self._kept: Mask | None = None  # contacts, from the end of a pause to the next tick
        self._time = self._lost_time = 0.0

    def start(self, pose: Pose) -> None:
        """Begin from a pose at rest; a hold ends, a lock does not."""
        self.reset()
        self._source.start(pose, self._columns['normal'].copy())
        if self.locked:
            self._rest = _standing(pose, *self._no_contact)

    def ask(self, time: float) -> None:
        """Write what is wanted at a time since the start [s] into the controller's records."""
        task = self._rest
        if task is None:
            task = self._last = self._source.task(
                time - self._lost_time, None if self._guarded else self._columns['alpha_meas'])
        else:
            self._lost_time += time - self._time
        self._time = time
        pose = task.pose_des
        self._position[:], self._rotation[:] = pose
        self._twist[:], self._acceleration[:] = task.twist_des, task.acceleration_des
        self._active[:], self._alpha_des[:] = task.active, task.alpha_des
        if self._guarded:
            if self._kept is not None:
                self._return_to(pose, self._kept)
            self.limited = _limit_task(self._limits, self._controls, self._columns, self.states)

    @property
    def begun(self) -> bool:
        """Whether there was a task of the source since the start, which can be held."""
        return self._last is not None

    @property
    def held(self) -> bool:
        """Whether it is held on command."""
        return self._holds and not self.locked

    def hold(self) -> None:
        """Stay where the arm is and press as it does; not before it has begun."""
        if self._last is not None:
            pressed, self._holds = self.pressed, True
            self._rest = _standing(
                self._stand(), pressed, np.where(pressed, self._last.alpha_des, 0.0))

    def release(self) -> None:
        """End a hold: go on with the source from where the arm is."""
        if self.held:
            self._holds, self._rest = False, None
            self.resume()

    def lock(self) -> None:
        """Stay where the arm is, or at the pose of the next start, without contact."""
        self.locked = True
        if self.begun or self._rest is not None:
            self._rest = _standing(self._stand(), *self._no_contact)

    def unlock(self) -> None:
        """End a lock: go on with the source, or, if it was held before, stay without contact."""
        self.locked = False
        if not self._holds:
            self._rest = None
            self.resume()

    def _stand(self) -> Pose:
        """Stop looking for contacts; return the pose of a task that leaves the arm where it is."""
        pressed = self.pressed
        position, rotation = self._frame['position'].copy(), self._frame['rotation'].copy()
        for state, normal in zip(self.states[pressed], self._columns['normal'][pressed]):
            position -= state['displacement'] * normal
        self.states[~pressed] = FREE_CONTACT
        self._offset[:] = self._turned[:] = 0.0
        self._kept = None
        return Pose(position, rotation)

    def resume(self) -> Mask:
        """Go on from where the arm is; return which contacts are kept: pressed and felt, (r,)."""
        felt = self._columns['alpha_meas'] > self._limits['contacts']['contact_threshold']
        self._kept = (self.pressed & felt)[self._columns['leader']]
        return self._kept

    def _return_to(self, pose: Pose, kept: Mask) -> None:
        """Go from where the arm is back to a pose: along the normals by means of the contacts."""
        self._kept, normals = None, self._columns['normal']
        gap = self._frame['position'] - pose.position_world
        along = np.linalg.lstsq(normals.T, gap, rcond=None)[0]
        for state, place, is_kept in zip(self.states, along.tolist(), kept):
            if is_kept:
                state['displacement'] = place
            else:
                let_go(state, place, 0.0)
        self._offset[:] = gap - along @ normals
        self._turned[:] = turn_between(self._frame['rotation'], pose.rotation_world)

    @property
    def pressed(self) -> Mask:
        """Which forces and couples the force law drives, also while a reaction acts, (r,)."""
        if not self._guarded:
            return self._columns['answer']['active'].astype(bool)
        pressed: Mask = (self._codes == IMPACT) | (self._codes == HOLDING)
        return pressed

    @property
    def state_names(self) -> tuple[str, ...]:
        """State of each contact, which is that of its normal force."""
        codes = self._codes.tobytes()
        if codes != self._named:
            self._named = codes
            self._names = tuple(NAMES[code] for code in self._codes[self._leaders].tolist())
        return self._names

    def sought_normals(self) -> Matrix:
        """Return the normals of the contacts that are sought or held, shape (k, 3)."""
        normals: Matrix = self._columns['normal'][
            self._leaders[self._codes[self._leaders] != FREE]]
        return normals

    def seek_again(self) -> bool:
        """Seek the contacts that were given up; return whether there are any."""
        given_up = self._codes == GIVEN_UP
        self.states['again'] |= given_up
        return bool(given_up.any())

    def lead_back(self) -> None:
        """Leave the contacts that are pressed: they lead the arm out of its workspace."""
        self.states['left'] |= self.pressed


def _standing(pose: Pose, active: Mask, alpha_des: Vector) -> Task:
    """Return the task to stand still at a pose and to press."""
    return Task(pose, np.zeros(6), np.zeros(6), active, alpha_des)


@compiled
def _limit_task(limits: Any, controls: Any, columns: Any, states: Any) -> bool:
    """
    Bring a task that is wanted to one that may be followed; return whether a limit was enforced.

    `active` and `alpha_des` of the columns say what is wanted, and then what the force law does.
    """
    limit, frame, task = limits[0], controls[0].frame, controls[0].task
    for gap, largest in ((limit.offset, limit.reach), (limit.turned, limit.turn)):
        fastest = RETURN_SHARE * largest / limit.lead
        length = np.sqrt(dot(gap, gap))
        for k in range(3):
            gap[k] *= 1.0 - limit.contacts.period * min(RETURN_RATE, fastest / length)
    _follow_contacts(limit, frame, task, columns, states)
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
    _rotate_by(limit.turned, task.rotation, task.rotation)
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
    return _bound_task(limit, frame, columns, task)


@compiled
def _follow_contacts(limit: Any, frame: Any, task: Any, columns: Any, states: Any) -> None:
    """Advance the state machine of every contact."""
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
def _rotate_by(vector: Vector, rotation: Matrix, turned: Matrix) -> None:
    """Fill in `turned`, a rotation turned by a rotation vector [rad] (Rodrigues), shape (3, 3)."""
    angle = np.sqrt(dot(vector, vector))
    if angle < 1e-12:
        for i in range(3):
            for j in range(3):
                turned[i, j] = rotation[i, j]
        return
    axis, once, twice = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        axis[k] = vector[k] / angle
    for j in range(3):
        column = rotation[:, j].copy()
        cross(axis, column, once)
        cross(axis, once, twice)
        for i in range(3):
            turned[i, j] = column[i] + np.sin(angle) * once[i] + (1.0 - np.cos(angle)) * twice[i]


@compiled
def _bound_task(limit: Any, frame: Any, columns: Any, task: Any) -> bool:
    """
    Bring a task within the box and within reach of the arm; return whether it was changed.

    The motion law makes the arm go at v_des + (k_p / k_v) (x_des - x), which is the limit's speed
    for an error of one reach. What lies along the normals of active contacts is left to these.
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
    _leave_to_contacts(columns, gap, way)
    share = _share_within(gap, way, limit.reach, task, 0)
    for k in range(3):
        position[k] -= gap[k] * (1.0 - min(share, 1.0))
        way[k] = limit.lead * task.twist[3 + k]
    rotation_vector(task.rotation, frame.rotation, turn)
    turn_share = _share_within(turn, way, limit.turn, task, 3)
    if turn_share < 1.0:
        for k in range(3):
            turn[k] *= turn_share
        _rotate_by(turn, frame.rotation, task.rotation)
    return limited or share <= 1.0 or turn_share <= 1.0


@compiled
def _share_within(gap: Vector, way: Vector, reach: float, task: Any, first: int) -> float:
    """Return the share of a gap in reach, 2 if all is well; a twist beyond does not count."""
    length = np.sqrt(dot(gap, gap))
    together = dot(gap, gap) + 2.0 * dot(gap, way) + dot(way, way)
    if not (length > reach or together > reach * reach):
        return 2.0
    for k in range(first, 6):
        task.twist[k] = 0.0
        task.acceleration[k] = 0.0
    return min(reach / length, 1.0)


@compiled
def _leave_to_contacts(columns: Any, gap: Vector, way: Vector) -> None:
    """Take off two vectors what lies along the normals of the active contacts (Gram-Schmidt)."""
    axes, count = np.empty((3, 3)), 0
    for i in range(columns.shape[0]):
        if count == 3 or not columns[i].answer.active or columns[i].leader != i:
            continue
        axis = axes[count]
        for k in range(3):
            axis[k] = columns[i].normal[k]
        for j in range(count):
            along = dot(axis, axes[j])
            for k in range(3):
                axis[k] -= along * axes[j, k]
        length = np.sqrt(dot(axis, axis))
        if length > PARALLEL:
            count += 1
            for k in range(3):
                axis[k] /= length
    for vector in (gap, way):
        for j in range(count):
            along = dot(vector, axes[j])
            for k in range(3):
                vector[k] -= along * axes[j, k]
