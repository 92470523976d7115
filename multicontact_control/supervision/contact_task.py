"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    add_vector,
    component_across,
    cross,
    diagonalise,
    divide_vector,
    dot,
    linear_combination,
    rotate_vector,
    Triple,
    turn_rotation_by_vector,
    vector_between,
    vector_length,
    velocity_at,
)
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.control.controller import Controller
from multicontact_control.control.tasks import TaskSource, WantedTask
from multicontact_control.dynamics.rotations import Pose, rotation_vector_between
from multicontact_control.records import (
    Contact,
    Control,
    Frame,
    MAX_COLUMNS,
    Record,
    record_dtype,
    Records,
    Task,
)
from multicontact_control.supervision import contacts
from multicontact_control.supervision.contacts import (
    CONTACT_STATE,
    ContactSettings,
    ContactState,
)
import numpy as np

# The measured force is fed forward below this share of the force held...
GUARD_SHARE = 0.3
# ...from so many s of holding on; before, this would prolong bounces.
GUARD_TIME = 0.3
# An error of the averaged force that lasts is none of noise: N and share of the force asked for,
# and how long that must have been the same [s].
LASTING_ERROR = 1.5
LASTING_SHARE = 0.25
LASTING_TIME = 0.3
LASTING_STD = 0.5  # of such an error, the standard deviation of the noise at most
# How a task is caught up with: beyond its own speed by so much of the way that remains [1/s] and
# of the largest speeds.
RETURN_RATE = 3.5
RETURN_SHARE = 0.2
# How far the reference may be ahead of an arm at rest that cannot follow.
LEAST_LEAD = 0.002  # m
LEAST_TURN = 0.005  # rad
CAUGHT_UP = 5e-5  # m or rad from the task, where it is caught up with
BRAKING_SHARE = 4.0  # times the largest acceleration: how it slows down with the arm
# s, for which an arm counts as bounded: what holds back hardly changes.
BOUNDED_TIME = 0.02
# A task is a step away that is farther than the largest speeds lead in so long [s] (a stream of
# 100 Hz is none), or faster than before by so much of them.
TASK_STEP_TIME = 0.01
TASK_STEP_SHARE = 0.15
# m and rad that the task is ahead of the arm, off normals, from where a trajectory waits for it.
WAITING_DISTANCE = 0.02
WAITING_ANGLE = 0.1
PARALLEL = 1e-6  # length that remains of a normal that the others span already
# rad/s, of the critically damped system as which the tool turns with a normal: well below the 30
# rad/s of the motion law that it leads, and three times as slow as the normal is estimated.
TURNING_FREQUENCY = 6.0


class TaskLimitsConfig(Record, Protocol):
    """What bounds a task: the contacts, the lead of the reference, and the box."""

    # Whether these, and contact states, apply; if not, the task is as wanted.
    guarded: bool

    contacts: ContactSettings
    lead: float  # k_v / k_p: an error of v k_v / k_p makes the motion law move at v [s]

    # Corners of the workspace [m].
    lower: Annotated[Vector, 3]
    upper: Annotated[Vector, 3]


class ReferencePart(Record, Protocol):
    """The position or the orientation of the reference: [m], or as a rotation vector [rad]."""

    reach: float  # greatest way of the reference from the arm
    ramp: float  # its largest acceleration [1/s^2]
    least_lead: float  # by which it may be ahead of an arm at rest that is bounded
    velocity: Annotated[Vector, 3]  # while it catches up [1/s]
    ahead: Annotated[Vector, 3]  # its way from the arm, a tick ago, off normals
    way: Annotated[Vector, 3]  # worked with: what it goes in this tick


class TaskLimits(Record, Protocol):
    """Bounds of a task, and the reference that follows it; one."""

    config: TaskLimitsConfig
    locked: bool  # whether the arm is to stay where it is, without contact
    held: bool  # whether it is, and to press as it does
    time: float  # of the task, since the start [s]

    # That time when stops, speeds or reach bounded the arm's motion last [s].
    bounded_at: float

    bounded: bool  # whether they have just done so
    catching_up: bool  # whether the reference has still to catch up with the task
    returning: bool  # whether it sets out from where the arm is, after a pause

    # The reference, before contacts move it [m].
    position: Annotated[Vector, 3]
    rotation: Annotated[Matrix, 3, 3]
    linear: ReferencePart
    angular: ReferencePart

    has_free_readings: bool  # whether something is read that no touch explains

    # Whether contacts have changed their states since `state_names` were told.
    changed: bool

    free_contact: ContactState  # one of which nothing is known

    # Worked with: normals of active contacts, orthogonal.
    axes: Annotated[Matrix, MAX_COLUMNS, 3]

    # Worked with: sum of n n^T of all contacts, its eigenvectors, and a vector [m].
    spread: Annotated[Matrix, 3, 3]
    directions: Annotated[Matrix, 3, 3]
    gap: Annotated[Vector, 3]


TASK_LIMITS = record_dtype(TaskLimits)


class ContactTask:
    """
    A task as far as contacts and limits allow it, in the records of a controller.

    In a tick `update_wanted_task` writes what the source wants into `wanted` of the records, of
    which `limit_task` makes the `task` and what is asked of each contact. A hold keeps the arm
    where it is and pressing as it does, a lock keeps it where it is without contact; the time of
    the source stands still meanwhile. If not `guarded`, neither contact states nor limits apply:
    the source makes the contacts.

    Attributes
    ----------
    limits, states
        One record of `TASK_LIMITS`, and records of `CONTACT_STATE`, shape (r,). `tick` sets
        `bounded_at`.

    """

    def __init__(
        self,
        config: ControllerConfig,
        source: TaskSource,
        controller: Controller,
        *,
        guarded: bool = True,
    ) -> None:
        self._source = source
        self._guarded = guarded
        self._controls = controller.controls
        self._columns = controller.contacts
        wanted = self._controls['wanted'][0]
        wanted['rotation'] = np.eye(3)
        self._places = (
            wanted['position'],
            wanted['rotation'],
            wanted['twist'],
            wanted['acceleration'],
            self._columns['wanted'],
            self._columns['alpha_wanted'],
        )
        self._active = self._columns['answer']['active']
        self._names = config.column_names
        self._leaders = np.array(config.force_columns)
        self.states: Records[ContactState] = np.zeros(
            len(config.columns), dtype=CONTACT_STATE
        )
        self._codes = self.states['state']
        self.limits: Records[TaskLimits] = np.zeros(1, dtype=TASK_LIMITS)
        self._held = self.limits['held']
        self._locked = self.limits['locked']
        self._changed = self.limits['changed']
        self._linear_ahead = self.limits['linear']['ahead'][0]
        self._angular_ahead = self.limits['angular']['ahead'][0]
        limits = self.limits['config']
        limits['guarded'] = guarded
        approach = {**config.contact_state.model_dump(), **source.contact_state}
        limits['contacts'] = contacts.contact_settings(
            validate(ContactStateConfig, approach, 'reference.approach'),
            config.period,
            config.measuring_delay,
        )
        limits['lower'] = config.limits.workspace_lower or -np.inf
        limits['upper'] = config.limits.workspace_upper or np.inf
        self.limits['linear']['least_lead'] = LEAST_LEAD
        self.limits['angular']['least_lead'] = LEAST_TURN
        self.apply_config(config)
        self.limits['free_contact'] = contacts.FREE_CONTACT
        self.limits['locked'] = config.sensor.require_push_test  # at first
        self.reset()

    def apply_config(self, config: ControllerConfig) -> None:
        """
        Let the task be so far ahead of the arm that the motion law asks for its limits.

        The momentum observer knows of the tool's inertia; what a wrist sensor feels has it.
        """
        mass = config.tool.mass
        if config.wrench_input == 'momentum':
            mass = 0.0
        motion, limits = config.motion, config.limits
        lead = 2.0 * motion.damping_ratio / motion.natural_frequency  # k_v / k_p
        self.limits['config']['contacts']['tool_mass'] = mass
        self.limits['config']['lead'] = lead
        self.limits['linear']['reach'] = lead * limits.operational_speed
        self.limits['linear']['ramp'] = limits.operational_acceleration
        self.limits['angular']['reach'] = lead * limits.operational_turn
        self.limits['angular']['ramp'] = limits.operational_turn_acceleration

    def reset(self) -> None:
        """Let all contacts start anew, free; a hold ends."""
        restart_task(self.limits[0], self._controls[0], self._columns, self.states)
        self.forget_source()

    def forget_source(self) -> None:
        """Take what stands in the records for what is wanted; the source's time begins."""
        self._lost_time = 0.0
        self._source_time = 0.0
        self.forget_written()

    def forget_written(self) -> None:
        """Write all that the source wants anew: the records ask for something else."""
        self._task: WantedTask | None = None
        self._written: tuple[object, ...] = (None,) * len(self._places)

    def start_source(self, pose: Pose) -> None:
        """Let the source begin from a pose at rest, after the task has been restarted."""
        self.forget_source()
        self._source.start(pose, self._columns['normal'].copy())

    def start_task(self, pose: Pose) -> None:
        """Begin from a pose at rest; a hold ends, a lock does not."""
        self.reset()
        self.start_source(pose)

    def update_wanted_task(self, time: float) -> None:
        """Get what is wanted at a time since the start [s]; see `limit_task`."""
        if self.held or self.locked:
            self._lost_time += time - self._source_time
        else:
            measured = None
            if not self._guarded:
                measured = self._columns['alpha_meas']
            elif self._source.follower is not None:
                self._source.follower.waits = self._is_behind()
            task = self._source.task_at(time - self._lost_time, measured)
            if task is not self._task:
                self._write_wanted(task)
        self._source_time = time

    def _is_behind(self) -> bool:
        """Return whether the arm cannot follow: behind, bounded, or a contact is lost."""
        linear = self._linear_ahead
        angular = self._angular_ahead
        if (
            self.catching_up
            or linear @ linear > WAITING_DISTANCE**2
            or angular @ angular > WAITING_ANGLE**2
        ):
            return True
        losses = self.states['losses']
        if not losses.any():
            return False
        pressed = (self._codes == contacts.IMPACT) | (self._codes == contacts.HOLDING)
        lost = self._columns['wanted'] & (losses > 0) & ~pressed
        return bool(lost[self._leaders].any())

    def reference_pose(self) -> Pose:
        """Return where the reference is, which may be behind the task, without its contacts."""
        if not self._guarded:
            reference: Task | TaskLimits = self._controls['wanted'][0]
        else:
            reference = self.limits[0]
        return Pose(reference['position'].copy(), reference['rotation'].copy())

    @property
    def catching_up(self) -> bool:
        """Whether the reference has still to catch up with the task."""
        return bool(self.limits['catching_up'][0])

    def _write_wanted(self, task: WantedTask) -> None:
        """Write what is new in a task into the records; what is the same object stands there."""
        self._task = task
        parts = (*task.pose_des, *task[1:])
        for place, part, written in zip(self._places, parts, self._written):
            if part is not written:
                place[:] = part
        self._written = parts

    @property
    def seeks(self) -> bool:
        """Whether the source makes contacts of the forces of this sample: it is seen first."""
        return not self._guarded and self._source.seeks

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the state of each contact's normal force."""
        if self._changed[0]:
            self._changed[0] = False
            codes = self._codes[self._leaders].tolist()
            self._state_names = tuple([contacts.STATE_NAMES[code] for code in codes])
        return self._state_names

    @property
    def read_before(self) -> tuple[str, ...]:
        """Return a sentence for each force or couple that was read before anything was touched."""
        readings = self.states['untared'] + self.states['resting_force']
        return tuple(
            f'{name} reads {reading:+.1f} N before it touches: nothing should press, tare'
            for name, reading in zip(self._names, readings.tolist())
            if reading
        )

    @property
    def held(self) -> bool:
        """Whether there is a hold: pose and forces stay."""
        return bool(self._held[0])

    @property
    def locked(self) -> bool:
        """Whether there is a lock: the arm stays where it is without contact."""
        return bool(self._locked[0])

    def set_hold(self, wanted: bool) -> None:
        """Stay where the arm is and press as it does, or go on from there."""
        hold_task(self.limits[0], self._controls[0], self._columns, self.states, wanted)
        if wanted:
            self.forget_written()
        else:
            self.go_on()

    def set_lock(self, wanted: bool) -> None:
        """Stay without contact where the arm is, or starts next; or go on if it is not held."""
        lock_task(self.limits[0], self._controls[0], self._columns, self.states, wanted)
        if wanted or self.held:
            self.forget_written()
        else:
            self.go_on()

    def go_on(self) -> None:
        """Ask the source anew, after a pause; what it follows was stopped with the arm."""
        self.forget_written()
        if self._source.follower is not None:
            self._source.follower.pace = 0.0

    def sought_normals(self) -> Matrix:
        """Return normals of what is sought or held, couples with 0, shape (k, 3)."""
        normals: Matrix = self._columns['normal'][self._codes != contacts.FREE]
        return normals

    def placing_columns(self) -> dict[str, Vector]:
        """Return N_i of what is sought or held, shape (6,), by the force's or couple's name."""
        return self._name_columns((self._codes != contacts.FREE) | self._active)

    def pressed_columns(self) -> dict[str, Vector]:
        """Return N_i of what is pressed, shape (6,), by the force's or couple's name."""
        return self._name_columns(self._active)

    def _name_columns(self, chosen: Mask) -> dict[str, Vector]:
        """Return N_i of some forces and couples, shape (6,), by their names."""
        return {
            name: column['N'].copy()
            for name, column, is_chosen in zip(self._names, self._columns, chosen)
            if is_chosen
        }


@compiled
def restart_reference(limit: TaskLimits, catching_up: bool) -> None:
    """Let the reference start at rest from where it has been put."""
    for part in (limit.linear, limit.angular):
        part.velocity[:] = 0.0
        part.ahead[:] = 0.0
    limit.bounded_at = -np.inf
    limit.catching_up = catching_up
    limit.changed = True


@compiled
def take_turns_off(
    frame: Frame,
    columns: Records[Contact],
    states: Records[ContactState],
    position: Vector,
    rotation: Matrix,
) -> None:
    """Fill in the arm's pose without the turns of contacts that are `kept`; end the others."""
    position[:] = frame.position
    rotation[:] = frame.rotation
    for i in range(columns.shape[0] - 1, -1, -1):
        state = states[i]
        state.turn_rate[:] = 0.0
        if not state.kept:
            state.turn[:] = 0.0
        if dot(state.turn, state.turn) > 0.0:
            point = columns[i].config.point
            add_vector(position, rotate_vector(rotation, point))
            back = linear_combination(-1.0, state.turn, 0.0, state.turn)
            turn_rotation_by_vector(back, rotation)
            add_scaled_vector(position, -1.0, rotate_vector(rotation, point))


@compiled
def stay_in_place(
    limit: TaskLimits,
    control: Control,
    columns: Records[Contact],
    states: Records[ContactState],
    pressing: bool,
) -> None:
    """Stay where the arm is, pressing as it does or without contact; seek no contacts."""
    wanted = control.wanted
    for i in range(columns.shape[0]):
        column = columns[i]
        states[i].kept = pressing and column.answer.active
        column.wanted = states[i].kept
        if not states[i].kept:
            column.alpha_wanted = 0.0
    take_turns_off(control.frame, columns, states, wanted.position, wanted.rotation)
    wanted.twist[:] = 0.0
    wanted.acceleration[:] = 0.0
    for i in range(columns.shape[0]):
        column, state = columns[i], states[i]
        if column.answer.active:
            told = column.config.normal
            add_scaled_vector(wanted.position, -state.displacement, told)
        else:
            states[i] = limit.free_contact
            column.untared = 0.0
            column.speed_bound = 0.0
    limit.position[:] = wanted.position
    limit.rotation[:] = wanted.rotation
    limit.returning = False
    restart_reference(limit, False)


@compiled
def restart_task(
    limit: TaskLimits,
    control: Control,
    columns: Records[Contact],
    states: Records[ContactState],
) -> None:
    """Let all contacts start anew, free, from where the arm is; a hold ends, a lock does not."""
    limit.held = False
    limit.time = 0.0
    limit.has_free_readings = False
    for i in range(columns.shape[0]):
        columns[i].answer.active = False
    stay_in_place(limit, control, columns, states, False)


@compiled
def hold_task(
    limit: TaskLimits,
    control: Control,
    columns: Records[Contact],
    states: Records[ContactState],
    wanted: bool,
) -> None:
    """Stay where the arm is and press as it does, or go on from there."""
    limit.held = wanted
    if wanted:
        stay_in_place(limit, control, columns, states, True)
    else:
        resume_task(limit, columns, states)


@compiled
def lock_task(
    limit: TaskLimits,
    control: Control,
    columns: Records[Contact],
    states: Records[ContactState],
    wanted: bool,
) -> None:
    """Stay without contact where the arm is, or starts next; or go on if it is not held."""
    limit.locked = wanted
    if wanted:
        stay_in_place(limit, control, columns, states, False)
    elif not limit.held:
        resume_task(limit, columns, states)


@compiled
def resume_task(
    limit: TaskLimits, columns: Records[Contact], states: Records[ContactState]
) -> None:
    """Go on from where the arm is; contacts are `kept` that are pressed and felt."""
    threshold = limit.config.contacts.contact_threshold
    for i in range(columns.shape[0]):
        leader = columns[columns[i].config.leader]
        states[i].kept = leader.answer.active and leader.alpha_meas > threshold
    limit.returning = True


@compiled
def _return_to_task(
    limit: TaskLimits,
    control: Control,
    columns: Records[Contact],
    states: Records[ContactState],
) -> None:
    """
    Let the reference go from where the arm is to the task; contacts go along their normals.

    The gap g between them is shared out by the displacements d of least |d|, sum d_i n_i = P g:
    d_i = n_i (sum n n^T)^+ g.
    """
    settings = limit.config.contacts
    gap, spread, directions = limit.gap, limit.spread, limit.directions
    take_turns_off(control.frame, columns, states, limit.position, limit.rotation)
    between = vector_between(control.wanted.position, limit.position)
    spread[:] = 0.0
    for i in range(columns.shape[0]):
        normal = columns[i].config.normal
        for j in range(3):
            add_scaled_vector(spread[j], normal[j], normal)
    diagonalise(spread, directions)
    gap[:] = 0.0
    for j in range(3):
        if spread[j, j] > PARALLEL:
            direction = directions[:, j]
            add_scaled_vector(gap, dot(direction, between) / spread[j, j], direction)
    for i in range(columns.shape[0]):
        column, state = columns[i], states[i]
        place = dot(column.config.normal, gap)
        if state.kept:
            contacts.resume_contact(state, column.alpha_meas, place)
        else:
            contacts.release_contact(state, place, 0.0)
            contacts.restart_free_reading(state, settings, column.alpha_meas)
            subtract_free_reading(column, state)
        add_scaled_vector(limit.position, -place, column.config.normal)
    limit.returning = False
    restart_reference(limit, True)


@compiled
def limit_task(
    limit: TaskLimits,
    control: Control,
    columns: Records[Contact],
    states: Records[ContactState],
) -> bool:
    """
    Bring a task that is wanted to one that may be followed; return whether it was limited.

    Parameters
    ----------
    limit
        A record of `TASK_LIMITS`, changed.
    control
        One of `CONTROL`, whose `task` is filled in.
    columns
        Records of `CONTACT`, shape (r,): what of each is answered is said there.
    states
        Records of `CONTACT_STATE`, shape (r,), changed; couples are in that of their force.

    """
    frame, wanted, task = control.frame, control.wanted, control.task
    task.position[:] = wanted.position
    task.rotation[:] = wanted.rotation
    task.twist[:] = wanted.twist
    task.acceleration[:] = wanted.acceleration
    if not limit.config.guarded:
        for i in range(columns.shape[0]):
            columns[i].answer.active = columns[i].wanted
            columns[i].answer.alpha_des = columns[i].alpha_wanted
        return False
    if limit.returning:
        _return_to_task(limit, control, columns, states)
    limit.bounded = limit.time - limit.bounded_at < BOUNDED_TIME
    catching_up = _advance_reference(limit, frame, task)
    for i in range(columns.shape[0]):
        turn = states[i].turn
        if columns[i].config.tool_turn_limit > 0.0 or dot(turn, turn) > 0.0:
            _turn_tool(limit, columns[i], states[i], task)
    away = vector_between(task.position, frame.position)
    rate = vector_between(task.twist[:3], frame.twist[:3])
    shift = (0.0, 0.0, 0.0)
    limit.has_free_readings = False
    for i in range(columns.shape[0]):
        states[i].displacement_before = states[i].displacement
    for i in range(columns.shape[0]):
        column, state = columns[i], states[i]
        before, first = state.state, column.config.leader
        settings = limit.config.contacts
        if first == i:
            others = 0.0
            for j in range(columns.shape[0]):
                if j != i:
                    along = dot(column.normal, columns[j].config.normal)
                    others += along * states[j].displacement_before
            # The reference is displaced along the normal as told, so that a surface that is
            # tilted moves the tool to no side.
            along = dot(column.normal, column.config.normal)
            place = (dot(column.normal, away) - others) / along
            speed = dot(column.normal, rate) / along
            _advance_force(settings, frame, column, state, place, speed)
        else:  # its normal force comes before
            _advance_couple(settings, column, state, columns[first], states[first])
        subtract_free_reading(column, state)
        limit.changed = limit.changed or state.state != before
        if state.untared != 0.0 or state.resting_force != 0.0:
            limit.has_free_readings = True
        told = column.config.normal
        shift = linear_combination(1.0, shift, state.displacement, told)
        if not column.answer.active:
            column.answer.alpha_des = 0.0
            add_scaled_vector(task.twist[:3], state.speed, told)
            add_scaled_vector(task.acceleration[:3], state.acceleration, told)
    add_vector(task.position, shift)
    for i in range(columns.shape[0]):
        if columns[i].answer.active and columns[i].config.turn_limit > 0.0:
            _lead_along_surface(columns[i], frame, task)
    return _limit_reference(limit, frame, task, columns) or catching_up


@compiled
def _turn_tool(
    limit: TaskLimits, column: Contact, state: ContactState, task: Task
) -> None:
    """
    Turn a task about the contact point, so that the tool is square on the estimated normal.

    The turn goes there as a critically damped system does, no farther than a declared angle, and
    back where the contact is not pressed. During a hold it stays. The task's own angular speed is
    not turned along: what that leaves out is the product of a small angle and a small speed.
    """
    config, turn, rate = column.config, state.turn, state.turn_rate
    wanted = (0.0, 0.0, 0.0)
    if column.answer.active:
        axis = rotate_vector(task.rotation, config.tool_axis)
        across = cross(axis, column.normal)
        sine = vector_length(across)
        angle = np.arctan2(sine, dot(axis, column.normal))
        allowed = min(angle, config.tool_turn_limit)
        wanted = linear_combination(allowed / max(sine, PARALLEL), across, 0.0, across)
    if not limit.held:
        h = limit.config.contacts.period
        missing = vector_between(turn, wanted)
        # Beyond that it would turn faster than a task is caught up with.
        fastest = RETURN_SHARE * limit.angular.reach / limit.config.lead
        farthest = 2.0 * fastest / TURNING_FREQUENCY
        share = farthest / max(vector_length(missing), farthest)
        add_scaled_vector(rate, share * h * TURNING_FREQUENCY**2, missing)
        rate[:] = divide_vector(rate, 1.0 + 2.0 * h * TURNING_FREQUENCY)
        add_scaled_vector(turn, h, rate)
    lever = rotate_vector(task.rotation, config.point)
    velocity = velocity_at(task.twist, lever)
    turn_rotation_by_vector(turn, task.rotation)
    turned = rotate_vector(task.rotation, config.point)
    add_vector(task.position, vector_between(turned, lever))
    add_vector(task.twist[3:], rate)
    moved = velocity_at(task.twist, turned)
    add_vector(task.twist[:3], vector_between(moved, velocity))


@compiled
def _lead_along_surface(column: Contact, frame: Frame, task: Task) -> None:
    """
    Lead a task along a surface whose normal is estimated, moved along its normal as told.

    The projection of the law would move it along the estimated normal: on a slope of angle a the
    tool then lags behind its path by sin^2 a of the way.
    """
    told = column.config.normal
    along = dot(column.normal, told)
    gap = dot(column.normal, vector_between(frame.position, task.position))
    add_scaled_vector(task.position, -gap / along, told)
    for rate in (task.twist[:3], task.acceleration[:3]):
        add_scaled_vector(rate, -dot(column.normal, rate) / along, told)


@compiled
def _advance_reference(limit: TaskLimits, frame: Frame, task: Task) -> bool:
    """
    Let the reference catch up with the task where the arm could not; return if it still does.

    Once the motion of the arm is bounded, after a pause, and where the task makes a step, the
    reference goes straight to the task, but no farther ahead of the arm than `least_lead`: so it
    slows down with the arm, does not run away, and does not pull the arm along the bound.
    """
    linear, angular, lead = limit.linear, limit.angular, limit.config.lead
    linear.way[:] = vector_between(limit.position, task.position)
    angular.way[:] = rotation_vector_between(task.rotation, limit.rotation)
    if not limit.catching_up:
        moves_on = _is_task_step(linear, task.twist[:3], lead)
        turns_on = _is_task_step(angular, task.twist[3:], lead)
        if not (limit.bounded or moves_on or turns_on):
            limit.position[:] = task.position
            limit.rotation[:] = task.rotation
            linear.velocity[:] = task.twist[:3]
            angular.velocity[:] = task.twist[3:]
            return False
        limit.catching_up = True
    is_there = _advance_towards(
        limit, linear, frame.twist[:3], task.twist[:3], task.acceleration[:3]
    )
    is_turned = _advance_towards(
        limit, angular, frame.twist[3:], task.twist[3:], task.acceleration[3:]
    )
    add_vector(limit.position, linear.way)
    turn_rotation_by_vector(angular.way, limit.rotation)
    task.position[:] = limit.position
    task.rotation[:] = limit.rotation
    catching_up = not (is_there and is_turned)
    limit.catching_up = limit.bounded or catching_up
    return catching_up


@compiled
def _is_task_step(part: ReferencePart, velocity_des: Vector, lead: float) -> bool:
    """Return whether a task is a step away from the reference, or suddenly faster."""
    fastest = part.reach / lead
    missing = vector_between(part.velocity, velocity_des)
    if dot(part.way, part.way) > (TASK_STEP_TIME * fastest) ** 2:
        return True
    faster = dot(velocity_des, velocity_des) > dot(part.velocity, part.velocity)
    return faster and dot(missing, missing) > (TASK_STEP_SHARE * fastest) ** 2


@compiled
def _advance_towards(
    limit: TaskLimits,
    part: ReferencePart,
    arm_velocity: Vector,
    velocity_des: Vector,
    acceleration: Vector,
) -> bool:
    """
    Shorten a way to what the reference goes in a tick; return whether it has caught up.

    Its velocity v_r becomes the desired one, `velocity_des`. It goes as fast as the task and on
    towards it, never away from it, and changes by `ramp` at most [m/s^2, rad/s^2]. While the
    motion of the arm is bounded, v_r is at most v + (l - e) k_p / k_v, at a distance e ahead of an
    arm of speed v, with l the `least_lead`: the motion law then pulls the arm by k_p l at most.
    """
    h, lead, ramp = limit.config.contacts.period, limit.config.lead, part.ramp
    way, velocity = part.way, part.velocity
    distance = vector_length(way)
    fastest = part.reach / lead
    wanted = (velocity_des[0], velocity_des[1], velocity_des[2])
    slowed = False
    if distance > 0.0:
        direction = divide_vector(way, distance)
        closing = min(RETURN_RATE * distance, RETURN_SHARE * fastest)
        along = max(0.0, dot(wanted, direction) + closing)
        margin = part.least_lead - dot(part.ahead, direction)
        allowed = dot(arm_velocity, direction) + margin / lead
        slowed = limit.bounded and along > allowed
        if slowed:
            along = max(allowed, 0.0)
            ramp *= BRAKING_SHARE
        beyond = along - dot(wanted, direction)
        wanted = linear_combination(1.0, wanted, beyond, direction)
        share = min(1.0, fastest / max(vector_length(wanted), CAUGHT_UP))
        wanted = (share * wanted[0], share * wanted[1], share * wanted[2])
    change = vector_between(velocity, wanted)
    share = min(1.0, h * ramp / max(vector_length(change), CAUGHT_UP))
    add_scaled_vector(velocity, share, change)
    missing = vector_between(velocity, velocity_des)
    as_fast = dot(missing, missing) < (2.0 * h * ramp) ** 2
    if distance < CAUGHT_UP and as_fast and not slowed:
        velocity[:] = velocity_des
        return True
    if share < 1.0:
        acceleration[:] = 0.0
    for k in range(3):
        way[k] = h * velocity[k] - 0.5 * h * h * acceleration[k]
        velocity_des[k] = velocity[k]
    return False


@compiled
def _advance_force(
    settings: ContactSettings,
    frame: Frame,
    column: Contact,
    state: ContactState,
    place: float,
    speed: float,
) -> None:
    """Advance a contact whose tip is at a place [m, m/s]; say what the force law does with it."""
    answer = column.answer
    state.alpha_task_age += settings.period
    if state.alpha_task != column.alpha_wanted:
        state.alpha_task_age = 0.0
    state.wanted = column.wanted
    state.alpha_task = column.alpha_wanted
    state.stiffness = column.stiffness
    state.approach_speed = contacts.limit_approach_speed(
        state, settings, column.mobility
    )
    # Of the surface, as far as it is known: what is as fast does not leave it.
    state.surface_speed = column.config.surface_speed + column.surface_speed_est
    if contacts.refute_contact(state, settings, place, speed):
        subtract_free_reading(column, state)
    escape = min(speed, dot(column.N, frame.twist)) - state.surface_speed
    contacts.advance_contact(state, settings, column.alpha_meas, place, speed, escape)
    answer.active = state.state in contacts.PRESSED
    column.sought = state.state in contacts.SOUGHT
    answer.alpha_des = contacts.desired_force(state, settings)
    fall_speed = _allow_for_sliding(settings.period, frame, column, state)
    held = state.state == contacts.HOLDING and state.time_in_state > GUARD_TIME
    column.use_measured_force = held and column.alpha_meas < GUARD_SHARE * min(
        state.mean_force, state.alpha_task
    )
    column.speed_bound = contacts.bound_contact_speed(state, fall_speed)


@compiled
def _advance_couple(
    settings: ContactSettings,
    column: Contact,
    couple: ContactState,
    force: Contact,
    leader: ContactState,
) -> None:
    """
    Let a couple act while its contact does; `force` and `leader` are the records of that.

    What it reads before the touch is taken off, as of its normal force.
    """
    couple.state, couple.time_in_state = leader.state, leader.time_in_state
    bound = LARGEST_OFFSET * force.answer.alpha_des
    column.answer.alpha_des = min(max(column.alpha_wanted, -bound), bound)
    column.use_measured_force = force.use_measured_force
    # What turns the tool in free space is no couple.
    column.answer.active = leader.state in contacts.PRESSED and (
        leader.answered or leader.resumed
    )
    if leader.state == contacts.FREE:
        couple.untared = 0.0
    if leader.state == contacts.FREE or leader.state == contacts.GIVEN_UP:
        contacts.average_free_reading(couple, settings, column.alpha_meas)
    elif leader.state == contacts.APPROACHING:
        contacts.follow_free_reading(
            couple, settings, column.alpha_meas, leader.speed * settings.period
        )
    elif leader.state == contacts.IMPACT and leader.free_way < contacts.FREE_WAY:
        couple.untared = 0.0


@compiled
def subtract_free_reading(column: Contact, state: ContactState) -> None:
    """Take what is read without a touch off the measured force from now on."""
    column.alpha_meas += column.untared - state.untared
    column.untared = state.untared


@compiled
def _allow_for_sliding(
    period: float, frame: Frame, column: Contact, state: ContactState
) -> float:
    """
    Allow for a surface that is not as told where the tip slides on it.

    Its force changes all the time, which counts as noise, R grows to hundreds of N^2, and the law
    is blind while the surface falls away. The error e of the averaged force that lasts bounds it:
    R <= (e / 2)^2. After a loss the surface is sought as much deeper as it may be within
    `normal_range`. Returns how fast it falls away within that at most [m/s].
    """
    config = column.config
    slope = np.sqrt(1.0 - config.smallest_cosine**2) / config.smallest_cosine
    sliding = component_across(frame.twist[:3], config.normal)
    fall_speed = slope * vector_length(sliding)
    error = abs(state.mean_force - state.alpha_task)
    lasts = min(state.time_in_state, state.alpha_task_age) > LASTING_TIME
    is_large = error > max(LASTING_ERROR, LASTING_SHARE * state.alpha_task)
    if state.state == contacts.HOLDING and lasts and is_large:
        bound = (LASTING_STD * error) ** 2
        column.noise_variance = min(column.noise_variance, bound)
    state.surface_fall += fall_speed * period
    if state.state in contacts.PRESSED:
        state.surface_fall = 0.0
    return fall_speed


@compiled
def _limit_reference(
    limit: TaskLimits,
    frame: Frame,
    task: Task,
    columns: Records[Contact],
) -> bool:
    """
    Bring a task within the box and, off active normals, within reach; return if it changed.

    The arm goes at v_des + (k_p / k_v) (x_des - x): the limit's speed at an error of one reach.
    """
    position, twist, acceleration = task.position, task.twist, task.acceleration
    config, linear, angular = limit.config, limit.linear, limit.angular
    lead = config.lead
    limited = False
    for k in range(3):
        inside = min(max(position[k], config.lower[k]), config.upper[k])
        if inside != position[k]:
            limited = True
            position[k] = inside
            twist[k] = 0.0
            acceleration[k] = 0.0
    gap = vector_between(frame.position, position)
    way = (lead * twist[0], lead * twist[1], lead * twist[2])
    count = 0
    for i in range(columns.shape[0]):
        if not columns[i].answer.active or columns[i].config.leader != i:
            continue
        normal = columns[i].normal
        axis = (normal[0], normal[1], normal[2])
        for j in range(count):  # made orthogonal to those before (Gram-Schmidt)
            axis = component_across(axis, limit.axes[j])
        remaining = vector_length(axis)
        if remaining > PARALLEL:
            axis = divide_vector(axis, remaining)
            limit.axes[count] = axis
            count += 1
            gap = component_across(gap, axis)
            way = component_across(way, axis)
    linear.ahead[:] = gap
    share = _limit_to_reach(linear, way, twist[:3], acceleration[:3])
    if share < 1.0:
        add_scaled_vector(position, share - 1.0, gap)
    angular.ahead[:] = rotation_vector_between(task.rotation, frame.rotation)
    way = (lead * twist[3], lead * twist[4], lead * twist[5])
    turn_share = _limit_to_reach(angular, way, twist[3:], acceleration[3:])
    if turn_share < 1.0:
        for k in range(3):
            angular.way[k] = turn_share * angular.ahead[k]
        task.rotation[:] = frame.rotation
        turn_rotation_by_vector(angular.way, task.rotation)
    return limited or share <= 1.0 or turn_share <= 1.0


@compiled
def _limit_to_reach(
    part: ReferencePart,
    way: Triple,
    velocity: Vector,
    acceleration: Vector,
) -> float:
    """
    Return the share of the gap `ahead` of the arm that is within reach, 2 if all is.

    The velocity is reduced so that the gap and the `way` that it adds are within reach together:
    an arm that is fast already is not braked by more than the reach asks for.
    """
    gap, reach = part.ahead, part.reach
    squared = dot(gap, gap)
    along = dot(gap, way)
    square = dot(way, way)
    distance = np.sqrt(squared)
    together = squared + 2.0 * along + square
    if not (distance > reach or together > reach * reach):
        return 2.0
    acceleration[:] = 0.0
    if distance >= reach:
        velocity[:] = 0.0
        return reach / distance
    # |gap + s way| = reach
    root = np.sqrt(along * along + square * (reach * reach - squared))
    share = (root - along) / square
    for k in range(3):
        velocity[k] *= share
    return 1.0
