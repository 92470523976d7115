"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

import math
from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    add_vector,
    component_across,
    divide_vector,
    dot,
    linear_combination,
    Triple,
    turn_rotation_by_vector,
    vector_between,
    vector_length,
)
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.control.controller import Controller
from multicontact_control.control.tasks import TaskSource, WantedTask, ZERO_TWIST
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
CAUGHT_UP = 5e-5  # m or rad from the task, where it is caught up with
BRAKING_SHARE = (
    4.0  # times the largest acceleration, by which it slows down with the arm
)
BOUNDED_TIME = (
    0.02  # s, for which an arm counts as bounded: what holds back hardly changes
)
# A task is a step away that is farther than the largest speeds lead in so long [s] (a stream of
# 100 Hz is none), or faster than before by so much of them.
TASK_STEP_TIME, TASK_STEP_SHARE = 0.01, 0.15
PARALLEL = 1e-6  # length that is left of a normal that the others span already


class TaskLimitsConfig(Record, Protocol):
    """Bounds of a task."""

    # Whether these, and contact states, apply; if not, the task is as wanted.
    guarded: bool

    contacts: ContactSettings
    lead: float  # k_v / k_p: an error of v k_v / k_p makes the motion law move at v [s]

    # Greatest way and angle of the reference from the arm [m], [rad].
    reach: float
    turn: float

    # Largest accelerations of the reference [m/s^2], [rad/s^2].
    ramp: float
    turn_ramp: float

    # Corners of the workspace [m].
    lower: Annotated[Vector, 3]
    upper: Annotated[Vector, 3]


TASK_LIMITS_CONFIG = record_dtype(TaskLimitsConfig)


class TaskLimits(Record, Protocol):
    """Bounds of a task, and the reference that follows it; one."""

    config: TaskLimitsConfig
    locked: bool  # whether the arm is to stay where it is, without contact
    time: float  # of the task, since the start [s]

    # That time when stops, speeds or reach bounded the arm's motion last [s].
    bounded_at: float

    bounded: bool  # whether they have just done so
    catching_up: bool  # whether the reference has still to catch up with the task

    # The reference, before contacts move it [m].
    position: Annotated[Vector, 3]
    rotation: Annotated[Matrix, 3, 3]

    twist: Annotated[Vector, 6]  # its velocity while it catches up [m/s, rad/s]

    # Of the arm, a tick ago, off normals [m], [rad].
    ahead: Annotated[Vector, 3]
    turned_ahead: Annotated[Vector, 3]

    has_free_readings: bool  # whether something is read that no touch explains

    # Whether contacts have changed their states since `state_names` were told.
    changed: bool

    # Worked with: what the reference goes [m], [rad].
    way: Annotated[Vector, 3]
    turned_way: Annotated[Vector, 3]

    # Worked with: normals of active contacts, orthogonal.
    axes: Annotated[Matrix, MAX_COLUMNS, 3]


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
    held, locked
        Whether there is a hold, or a lock.

    """

    def __init__(
        self,
        config: ControllerConfig,
        source: TaskSource,
        controller: Controller,
        *,
        guarded: bool = True,
    ) -> None:
        self._source, self._guarded = source, guarded
        self._controls, self._columns = controller.controls, controller.contacts
        self._frame, wanted = self._controls['frame'][0], self._controls['wanted'][0]
        wanted['rotation'] = np.eye(3)
        self._places = (
            wanted['position'],
            wanted['rotation'],
            wanted['twist'],
            wanted['acceleration'],
            self._columns['wanted'],
            self._columns['alpha_wanted'],
        )
        self._written: tuple[object, ...] = (None,) * len(self._places)
        self._active = self._columns['answer']['active']
        self.states: Records[ContactState] = np.zeros(
            len(config.columns), dtype=CONTACT_STATE
        )
        self._names, self._leaders = config.column_names, np.array(config.force_columns)
        self._codes = self.states['state']
        self.limits: Records[TaskLimits] = np.zeros(1, dtype=TASK_LIMITS)
        self._time, self._changed = self.limits['time'], self.limits['changed']
        self._reads_before = self.limits['has_free_readings']
        limits = self.limits['config']
        limits['guarded'] = guarded
        limits['contacts'] = contacts.contact_settings(
            validate(
                ContactStateConfig,
                {**config.contact_state.model_dump(), **source.contact_state},
                'reference.approach',
            ),
            config.period,
            config.measuring_delay,
        )
        limits['lower'] = config.limits.workspace_lower or -np.inf
        limits['upper'] = config.limits.workspace_upper or np.inf
        self.apply_config(config)
        self._set_locked(config.sensor.require_push_test)  # at first
        first = self.states[0], limits['contacts'][0]  # no tick waits for numba
        contacts.release_contact(first[0], 0.0, 0.0)
        contacts.resume_contact(first[0], 0.0, 0.0)
        contacts.restart_free_reading(*first, 0.0)
        subtract_free_reading(self._columns[0], first[0])
        self.reset()

    def apply_config(self, config: ControllerConfig) -> None:
        """Let the task be so far ahead of the arm that the motion law asks for its limits."""
        felt = config.wrench_input != 'momentum'  # whose observer knows of the tool
        limits = self.limits['config']
        limits['contacts']['tool_mass'] = config.tool.mass if felt else 0.0
        lead = (
            2.0 * config.motion.damping_ratio / config.motion.natural_frequency
        )  # k_v / k_p
        limits['lead'] = lead
        limits['reach'] = lead * config.limits.operational_speed
        limits['turn'] = lead * config.limits.operational_turn
        limits['ramp'] = config.limits.operational_acceleration
        limits['turn_ramp'] = config.limits.operational_turn_acceleration

    def reset(self) -> None:
        """Let all contacts start anew, free; a hold ends."""
        self.held = False
        self._lost_time = 0.0
        self._time[0] = 0.0
        self.limits['has_free_readings'] = False
        self._active[:] = False
        self._stay_in_place(pressing=False)

    def _stay_in_place(self, *, pressing: bool) -> None:
        """Stay where the arm is, pressing as it does or without contact; seek no contacts."""
        pressed, forces = self._active.copy(), np.zeros(len(self.states))
        position, rotation = (
            self._frame['position'].copy(),
            self._frame['rotation'].copy(),
        )
        for state, normal in zip(
            self.states[pressed], self._columns['normal'][pressed]
        ):
            position -= state['displacement'] * normal
        if pressing:
            forces[pressed] = self._task.alpha_des[pressed]
        pose = Pose(position, rotation)
        active = pressed & pressing
        self._write_wanted(WantedTask(pose, ZERO_TWIST, ZERO_TWIST, active, forces))
        self.states[~pressed] = contacts.FREE_CONTACT
        self._columns['untared'][~pressed] = self._columns['speed_bound'][~pressed] = (
            0.0
        )
        self.limits['changed'] = True
        self.limits['bounded_at'], self.limits['catching_up'] = -math.inf, False
        self.limits['position'], self.limits['rotation'] = position, rotation
        self.limits['twist'] = 0.0
        self._kept: Mask | None = (
            None  # contacts, from the end of a pause to the next tick
        )

    def start_task(self, pose: Pose) -> None:
        """Begin from a pose at rest; a hold ends, a lock does not."""
        self.reset()
        self._source.start(pose, self._columns['normal'].copy())

    def update_wanted_task(self, time: float) -> None:
        """Get what is wanted at a time since the start [s]; see `limit_task`."""
        if self.held or self.locked:
            self._lost_time += time - float(self._time[0])
        else:
            task = self._source.task_at(
                time - self._lost_time,
                None if self._guarded else self._columns['alpha_meas'],
            )
            if task is not self._task:
                self._write_wanted(task)
        self._time[0] = time
        if self._guarded and self._kept is not None:
            self._return_to_task(self._kept)

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
    def has_free_readings(self) -> bool:
        """Return whether there is anything in `read_before`."""
        return bool(self._reads_before[0])

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

    def set_hold(self, wanted: bool) -> None:
        """Stay where the arm is and press as it does, or go on from there."""
        self.held = wanted
        if wanted:
            self._stay_in_place(pressing=True)
        else:
            self.resume_task()

    def set_lock(self, wanted: bool) -> None:
        """Stay without contact where the arm is, or starts next; or go on if it is not held."""
        self._set_locked(wanted)
        if wanted:
            self._stay_in_place(pressing=False)
        elif not self.held:
            self.resume_task()

    def _set_locked(self, wanted: bool) -> None:
        self.locked = wanted
        self.limits['locked'] = wanted

    def resume_task(self) -> Mask:
        """Go on from where the arm is; return which contacts are kept: pressed and felt, (r,)."""
        threshold = self.limits['config']['contacts']['contact_threshold']
        felt = self._columns['alpha_meas'] > threshold
        self._kept = (self._active & felt)[self._columns['config']['leader']]
        return self._kept

    def _return_to_task(self, kept: Mask) -> None:
        """Let the reference go from where the arm is to the task; contacts go along normals."""
        self._kept, normals, pose = None, self._columns['normal'], self._task.pose_des
        gap = self._frame['position'] - pose.position_world
        along = np.linalg.lstsq(normals.T, gap, rcond=None)[0]
        settings = self.limits['config']['contacts'][0]
        for state, column, place, is_kept in zip(
            self.states, self._columns, along.tolist(), kept
        ):
            if is_kept:
                contacts.resume_contact(state, column['alpha_meas'], place)
            else:
                contacts.release_contact(state, place, 0.0)
                contacts.restart_free_reading(state, settings, column['alpha_meas'])
                subtract_free_reading(column, state)
        limits = self.limits
        limits['position'] = self._frame['position'] - along @ normals
        limits['rotation'] = self._frame['rotation']
        limits['twist'] = limits['ahead'] = limits['turned_ahead'] = 0.0
        limits['bounded_at'], limits['catching_up'] = -math.inf, True
        limits['changed'] = True

    def sought_normals(self) -> Matrix:
        """Return normals of what is sought or held, couples with 0, shape (k, 3)."""
        normals: Matrix = self._columns['normal'][self._codes != contacts.FREE]
        return normals

    def placing_columns(self) -> dict[str, Vector]:
        """Return N_i of what is sought or held, shape (6,), by the force's or couple's name."""
        places = (self._codes != contacts.FREE) | self._active
        return {
            name: column['N'].copy()
            for name, column, does in zip(self._names, self._columns, places)
            if does
        }


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
    task.position[:], task.rotation[:] = wanted.position, wanted.rotation
    task.twist[:], task.acceleration[:] = wanted.twist, wanted.acceleration
    if not limit.config.guarded:
        for i in range(columns.shape[0]):
            answer = columns[i].answer
            answer.active, answer.alpha_des = columns[i].wanted, columns[i].alpha_wanted
        return False
    limit.bounded = limit.time - limit.bounded_at < BOUNDED_TIME
    catching_up = _advance_reference(limit, frame, task)
    away = vector_between(task.position, frame.position)
    rate = vector_between(task.twist[:3], frame.twist[:3])
    shift = (0.0, 0.0, 0.0)
    limit.has_free_readings = False
    for i in range(columns.shape[0]):
        states[i].displacement_before = states[i].displacement
    for i in range(columns.shape[0]):
        column, state = columns[i], states[i]
        before, first = state.state, column.config.leader
        if first == i:
            others = 0.0
            for j in range(columns.shape[0]):
                if j != i:
                    others += (
                        dot(column.normal, columns[j].normal)
                        * states[j].displacement_before
                    )
            # Turning about the tool moves the operational point, and a surface that is not where
            # the task has it moves the contact point: what escapes does both.
            _advance_force(
                limit.config.contacts,
                frame,
                column,
                state,
                dot(column.normal, away) - others,
                dot(column.normal, rate),
            )
        else:  # its normal force comes before
            _advance_couple(
                limit.config.contacts, column, state, columns[first], states[first]
            )
        subtract_free_reading(column, state)
        limit.changed = limit.changed or state.state != before
        if state.untared != 0.0 or state.resting_force != 0.0:
            limit.has_free_readings = True
        shift = linear_combination(1.0, shift, state.displacement, column.normal)
        if not column.answer.active:
            column.answer.alpha_des = 0.0
            add_scaled_vector(task.twist[:3], state.speed, column.normal)
            add_scaled_vector(task.acceleration[:3], state.acceleration, column.normal)
    add_vector(task.position, shift)
    return _limit_reference(limit, frame, task, columns) or catching_up


@compiled
def _advance_reference(limit: TaskLimits, frame: Frame, task: Task) -> bool:
    """
    Let the reference catch up with the task where the arm could not; return if it is behind.

    Once the motion of the arm is bounded, after a pause, and where the task makes a step, the
    reference goes straight to the task, but no farther ahead of the arm than `LEAST_LEAD`: so it
    slows down with the arm, does not run away, and does not pull the arm along the bound.
    """
    config, way, turn = limit.config, limit.way, limit.turned_way
    way[:] = vector_between(limit.position, task.position)
    turn[:] = rotation_vector_between(task.rotation, limit.rotation)
    if not limit.catching_up:
        steps = _is_task_step(
            way, task.twist[:3], limit.twist[:3], config.reach / config.lead
        ) or (
            _is_task_step(
                turn, task.twist[3:], limit.twist[3:], config.turn / config.lead
            )
        )
        if not (limit.bounded or steps):
            limit.position[:], limit.rotation[:] = task.position, task.rotation
            limit.twist[:] = task.twist
            return False
        limit.catching_up = True
    there = _advance_towards(
        way,
        task.twist[:3],
        task.acceleration[:3],
        limit,
        limit.twist[:3],
        frame.twist[:3],
        limit.ahead,
        LEAST_LEAD,
        config.reach,
        config.ramp,
    )
    add_vector(limit.position, way)
    task.position[:] = limit.position
    there_turned = _advance_towards(
        turn,
        task.twist[3:],
        task.acceleration[3:],
        limit,
        limit.twist[3:],
        frame.twist[3:],
        limit.turned_ahead,
        LEAST_TURN,
        config.turn,
        config.turn_ramp,
    )
    turn_rotation_by_vector(turn, limit.rotation)
    task.rotation[:] = limit.rotation
    catching_up = not (there and there_turned)
    limit.catching_up = limit.bounded or catching_up
    return catching_up


@compiled
def _is_task_step(
    way: Vector, speed_des: Vector, speed: Vector, fastest: float
) -> bool:
    """Return whether a task is a step away from the reference, or suddenly faster."""
    missing = vector_between(speed, speed_des)
    jumps = dot(way, way) > (TASK_STEP_TIME * fastest) ** 2
    faster = dot(speed_des, speed_des) > dot(speed, speed)
    return jumps or (
        faster and dot(missing, missing) > (TASK_STEP_SHARE * fastest) ** 2
    )


@compiled
def _advance_towards(
    way: Vector,
    speed_des: Vector,
    acceleration: Vector,
    limit: TaskLimits,
    speed: Vector,
    speed_of_arm: Vector,
    ahead: Vector,
    least_lead: float,
    reach: float,
    ramp: float,
) -> bool:
    """
    Shorten a way to what the reference goes in a tick; return whether it has caught up.

    Its velocity `speed` v_r becomes the desired one, `speed_des`. It goes as fast as the task and
    on towards it, never away from it, and changes by `ramp` at most [m/s^2, rad/s^2]. While the
    motion of the arm is bounded, v_r is at most v + (l - e) k_p / k_v, at a distance e ahead of an
    arm of speed v: the motion law then pulls the arm by k_p l at most.
    """
    h, lead, distance = (
        limit.config.contacts.period,
        limit.config.lead,
        vector_length(way),
    )
    fastest = reach / lead
    wanted, slower = (speed_des[0], speed_des[1], speed_des[2]), False
    if distance > 0.0:
        direction = divide_vector(way, distance)
        closing = min(RETURN_RATE * distance, RETURN_SHARE * fastest)
        along = max(0.0, dot(wanted, direction) + closing)
        allowed = (
            dot(speed_of_arm, direction) + (least_lead - dot(ahead, direction)) / lead
        )
        slower = limit.bounded and along > allowed
        if slower:
            along = max(allowed, 0.0)
        wanted = linear_combination(
            1.0, wanted, along - dot(wanted, direction), direction
        )
        share = min(1.0, fastest / max(vector_length(wanted), CAUGHT_UP))
        wanted = (share * wanted[0], share * wanted[1], share * wanted[2])
        if slower:
            ramp *= BRAKING_SHARE
    change = vector_between(speed, wanted)
    add_scaled_vector(
        speed, min(1.0, h * ramp / max(vector_length(change), CAUGHT_UP)), change
    )
    missing = vector_between(speed, speed_des)
    if (
        distance < CAUGHT_UP
        and not slower
        and dot(missing, missing) < (2.0 * h * ramp) ** 2
    ):
        speed[:] = speed_des
        return True
    for k in range(3):
        way[k] = h * speed[k]
        speed_des[k], acceleration[k] = speed[k], 0.0
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
    state.wanted, state.alpha_task = column.wanted, column.alpha_wanted
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
    fall_speed = slope * vector_length(component_across(frame.twist[:3], config.normal))
    error = abs(state.mean_force - state.alpha_task)
    if (
        state.state == contacts.HOLDING
        and min(state.time_in_state, state.alpha_task_age) > LASTING_TIME
    ):
        if error > max(LASTING_ERROR, LASTING_SHARE * state.alpha_task):
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
    """Bring a task within the box and, off active normals, within reach; return if it changed."""
    # The arm goes at v_des + (k_p / k_v) (x_des - x): the limit's speed at an error of one reach.
    position, twist, acceleration = task.position, task.twist, task.acceleration
    config, limited = limit.config, False
    for k in range(3):
        inside = min(max(position[k], config.lower[k]), config.upper[k])
        if inside != position[k]:
            position[k], twist[k], acceleration[k], limited = inside, 0.0, 0.0, True
    gap = vector_between(frame.position, position)
    way = (config.lead * twist[0], config.lead * twist[1], config.lead * twist[2])
    axes, count = limit.axes, 0
    for i in range(columns.shape[0]):
        if not columns[i].answer.active or columns[i].config.leader != i:
            continue
        normal = columns[i].normal
        axis = (normal[0], normal[1], normal[2])
        for j in range(count):  # made orthogonal to those before (Gram-Schmidt)
            axis = component_across(axis, axes[j])
        left = vector_length(axis)
        if left > PARALLEL:
            axis = divide_vector(axis, left)
            axes[count] = axis
            count += 1
            gap, way = component_across(gap, axis), component_across(way, axis)
    limit.ahead[:] = gap
    share = _limit_to_reach(limit.ahead, way, config.reach, twist[:3], acceleration[:3])
    if share < 1.0:
        add_scaled_vector(position, share - 1.0, gap)
    turn, turned_way = limit.turned_way, twist[3:]
    limit.turned_ahead[:] = rotation_vector_between(task.rotation, frame.rotation)
    way = (
        config.lead * turned_way[0],
        config.lead * turned_way[1],
        config.lead * turned_way[2],
    )
    turn_share = _limit_to_reach(
        limit.turned_ahead, way, config.turn, twist[3:], acceleration[3:]
    )
    if turn_share < 1.0:
        for k in range(3):
            turn[k] = turn_share * limit.turned_ahead[k]
        task.rotation[:] = frame.rotation
        turn_rotation_by_vector(turn, task.rotation)
    return limited or share <= 1.0 or turn_share <= 1.0


@compiled
def _limit_to_reach(
    gap: Vector,
    way: Triple,
    reach: float,
    twist: Vector,
    acceleration: Vector,
) -> float:
    """
    Return the share of a gap within reach, 2 if all is, with the way that its speed adds.

    The speed, `twist`, is reduced so that gap and way together are within reach: an arm that is
    fast already is not braked by more than the reach asks for.
    """
    squared = dot(gap, gap)
    distance = np.sqrt(squared)
    together = squared + 2.0 * dot(gap, way) + dot(way, way)
    if not (distance > reach or together > reach * reach):
        return 2.0
    acceleration[:] = 0.0
    if distance >= reach:
        twist[:] = 0.0
        return reach / distance
    # |gap + s way| = reach
    along, square = dot(gap, way), dot(way, way)
    share = (
        np.sqrt(along * along + square * (reach * reach - squared)) - along
    ) / square
    for k in range(3):
        twist[k] *= share
    return 1.0
