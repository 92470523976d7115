"""A task made safe to follow: contacts are found first, and held only while they are there."""

from __future__ import annotations

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
    turn_rotation_by_vector,
    vector_between,
    vector_length,
    velocity_at,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.records import Contact, Control, Frame, Records, Task
from multicontact_control.supervision import contacts
from multicontact_control.supervision.contacts import ContactSettings, ContactState
from multicontact_control.supervision.reference import (
    advance_reference,
    limit_reference,
    PARALLEL,
    restart_reference,
    RETURN_SHARE,
    TaskLimits,
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
# s, for which an arm counts as bounded: what holds back hardly changes.
BOUNDED_TIME = 0.02
# rad/s, of the critically damped system as which the tool turns with a normal: well below the 30
# rad/s of the motion law that it leads, and three times as slow as the normal is estimated.
TURNING_FREQUENCY = 6.0


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
    catching_up = advance_reference(limit, frame, task)
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
    return limit_reference(limit, frame, task, columns) or catching_up


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
