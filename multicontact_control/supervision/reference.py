"""The reference of the motion: it follows a task, catches up with it, and stays within reach."""

from __future__ import annotations

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
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.dynamics.rotations import rotation_vector_between
from multicontact_control.records import (
    Contact,
    Frame,
    MAX_COLUMNS,
    Record,
    record_dtype,
    Records,
    Task,
)
from multicontact_control.supervision.contacts import ContactSettings, ContactState
import numpy as np

# How a task is caught up with: beyond its own speed by so much of the way that remains [1/s] and
# of the largest speeds.
RETURN_RATE = 3.5
RETURN_SHARE = 0.2
CAUGHT_UP = 5e-5  # m or rad from the task, where it is caught up with
BRAKING_SHARE = 4.0  # times the largest acceleration: how it slows down with the arm
# A task is a step away that is farther than the largest speeds lead in so long [s] (a stream of
# 100 Hz is none), or faster than before by so much of them.
TASK_STEP_TIME = 0.01
TASK_STEP_SHARE = 0.15
PARALLEL = 1e-6  # length that remains of a normal that the others span already


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
def advance_reference(limit: TaskLimits, frame: Frame, task: Task) -> bool:
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
def limit_reference(
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
