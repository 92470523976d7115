"""
From a task to a reference that may be followed, compiled; `ContactReference` says what it is for.

In every function `limits` is a record of `REFERENCE_LIMITS`, `wanted` (what the task asks for) and
`task` (what may be followed) are records of `TASK`, `frame` is one of `FRAME`; `contacts` and
`states` are records of `CONTACT` and `CONTACT_STATE`, shape (r,). Vectors are of shape (3,).
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_matrix, copy_vector, cross, dot, multiply
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.dynamics.rotations import rotation_vector
from multicontact_control.supervision.contacts import (
    advance_contact,
    follow_leader,
    is_active,
    is_falling,
)
import numpy as np

PARALLEL = 1e-6  # length that is left of a normal that the others span already


@compiled
def follow_contacts(
    limits: Any, wanted: Any, frame: Any, contacts: Any, states: Any, settings: Any,
) -> None:
    """Advance the state machine of every contact."""
    count = contacts.shape[0]
    twist = frame.twist
    moved = np.empty(count)
    for i in range(count):
        moved[i] = states[i].displacement
    lever = np.empty(3)
    for i in range(count):
        if states[i].couple:
            follow_leader(states[i], states[contacts[i].leader])
            continue
        # That of the surface, as far as it is known: what is as fast does not leave it.
        away = contacts[i].surface_speed + contacts[i].surface_speed_est
        normal = contacts[i].normal
        place, speed = 0.0, 0.0
        for k in range(3):
            gap = frame.position[k] - wanted.position[k] - limits.offset[k]
            place += normal[k] * gap
            speed += normal[k] * (twist[k] - wanted.twist[k])
        others = 0.0
        for j in range(count):
            if j != i:
                others += dot(normal, contacts[j].normal) * moved[j]
        multiply(frame.rotation, contacts[i].point, lever)
        # v + w x l, along the normal
        point_speed = (
            normal[0] * (twist[0] + twist[4] * lever[2] - twist[5] * lever[1])
            + normal[1] * (twist[1] + twist[5] * lever[0] - twist[3] * lever[2])
            + normal[2] * (twist[2] + twist[3] * lever[1] - twist[4] * lever[0]))
        # Turning about the tool moves the operational point, and a surface that is not where the
        # task has it moves the contact point: what escapes does both.
        states[i].surface_speed = away
        advance_contact(
            states[i], settings, contacts[i].alpha_meas, place - others, speed,
            min(speed, point_speed) - away)


@compiled
def rotate_by(vector: Vector, rotation: Matrix, turned: Matrix) -> None:
    """Fill in `turned`, a rotation turned by a rotation vector [rad] (Rodrigues), shape (3, 3)."""
    angle = np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    if angle < 1e-12:
        copy_matrix(rotation, turned)
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
def add_displacements(limits: Any, wanted: Any, contacts: Any, states: Any, task: Any) -> None:
    """Fill in the task: what is wanted, what a pause has left, and the contacts' displacements."""
    rotate_by(limits.turned, wanted.rotation, task.rotation)
    for k in range(3):
        shift, velocity, change = limits.offset[k], 0.0, 0.0
        for i in range(contacts.shape[0]):
            shift += states[i].displacement * contacts[i].normal[k]
            if not is_active(states[i]):
                velocity += states[i].speed * contacts[i].normal[k]
                change += states[i].acceleration * contacts[i].normal[k]
        task.position[k] = wanted.position[k] + shift
        task.twist[k] = wanted.twist[k] + velocity
        task.acceleration[k] = wanted.acceleration[k] + change
        task.twist[3 + k] = wanted.twist[3 + k]
        task.acceleration[3 + k] = wanted.acceleration[3 + k]


@compiled
def beyond(gap: Vector, way: Vector, reach: float) -> bool:
    """Return whether a gap and a way are longer together than the reach."""
    return dot(gap, gap) + 2.0 * dot(gap, way) + dot(way, way) > reach * reach


@compiled
def pressed_directions(contacts: Any, axes: Matrix) -> int:
    """
    Span the normals of the active contacts by unit vectors (Gram-Schmidt).

    Fills in one of them in each row of `axes`, shape (3, 3), and returns how many there are.
    """
    count = 0
    for i in range(contacts.shape[0]):
        if count == 3 or not contacts[i].active or contacts[i].leader != i:
            continue
        axis = axes[count]
        copy_vector(contacts[i].normal, axis)
        for j in range(count):
            take_off(axis, axes[j])
        length = np.sqrt(dot(axis, axis))
        if length > PARALLEL:
            for k in range(3):
                axis[k] /= length
            count += 1
    return count


@compiled
def take_off(vector: Vector, axis: Vector) -> None:
    """Take off a vector what lies along a unit vector."""
    along = dot(vector, axis)
    for k in range(3):
        vector[k] -= along * axis[k]


@compiled
def bound_task(limits: Any, frame: Any, contacts: Any, task: Any) -> bool:
    """
    Bring a task within the box and within reach of the arm; return whether it was changed.

    The motion law makes the arm go at v_des + (k_p / k_v) (x_des - x), which is the limit's speed
    for an error of one reach. A twist with which it is more does not count. What lies along the
    normals of active contacts is left to these: the motion law does not go there.
    """
    limited = False
    position = task.position
    for k in range(3):
        inside = min(max(position[k], limits.box[0, k]), limits.box[1, k])
        if inside != position[k]:
            position[k] = inside
            task.twist[k] = 0.0
            task.acceleration[k] = 0.0
            limited = True
    gap, way, axes = np.empty(3), np.empty(3), np.empty((3, 3))
    for k in range(3):
        gap[k] = position[k] - frame.position[k]
        way[k] = limits.lead * task.twist[k]
    for i in range(pressed_directions(contacts, axes)):
        take_off(gap, axes[i])
        take_off(way, axes[i])
    length = np.sqrt(dot(gap, gap))
    if length > limits.reach or beyond(gap, way, limits.reach):
        for k in range(6):
            task.twist[k] = 0.0
            task.acceleration[k] = 0.0
        limited = True
    if length > limits.reach:
        for k in range(3):
            position[k] -= gap[k] * (1.0 - limits.reach / length)
    turn = np.empty(3)
    rotation_vector(task.rotation, frame.rotation, turn)
    for k in range(3):
        way[k] = limits.lead * task.twist[3 + k]
    if beyond(turn, way, limits.turn):
        for k in range(3, 6):
            task.twist[k] = 0.0
            task.acceleration[k] = 0.0
        limited = True
    angle = np.sqrt(dot(turn, turn))
    if angle > limits.turn:
        for k in range(3):
            turn[k] *= limits.turn / angle
        rotate_by(turn, frame.rotation, task.rotation)
        limited = True
    return limited


@compiled
def limit_reference(references: Any, controls: Any, contacts: Any, states: Any) -> bool:
    """
    Work out the reference of one tick; see `ContactReference.update`.

    Parameters
    ----------
    references, controls
        One record of `CONTACT_REFERENCE` and one of `CONTROL`, the task of which is filled in.
    contacts, states
        Records of `CONTACT`, `active` and `alpha_des` of which are filled in, and
        `CONTACT_STATE`, changed, shape (r,).

    Returns
    -------
    bool
        Whether a limit of the motion was enforced.

    """
    reference, control = references[0], controls[0]
    limits, wanted, settings = reference.limits, reference.wanted, reference.settings
    frame, task = control.frame, control.task
    for i in range(contacts.shape[0]):
        states[i].stiffness = contacts[i].stiffness
    follow_contacts(limits, wanted, frame, contacts, states, settings)
    for i in range(contacts.shape[0]):
        contact, state = contacts[i], states[i]
        contact.active = is_active(state)
        contact.alpha_des = 0.0
        if state.couple:
            leader = contacts[contact.leader]  # which comes before
            contact.guarded = leader.guarded
            bound = LARGEST_OFFSET * leader.alpha_des
            wanted_force = min(max(state.asked, -bound), bound)
        else:
            contact.guarded = is_falling(state, contact.alpha_meas)
            wanted_force = min(state.asked, state.force_limit)
        if contact.active:
            contact.alpha_des = wanted_force
    add_displacements(limits, wanted, contacts, states, task)
    return bound_task(limits, frame, contacts, task)
