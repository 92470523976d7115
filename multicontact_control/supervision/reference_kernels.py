"""
From a task to a reference that may be followed, compiled.

Everything but the contacts is in one record of `REFERENCE_LIMITS`; `ContactReference` says what it
is for.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_matrix, cross, multiply
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.control.kernels import ACCELERATION, POSITION, TWIST
from multicontact_control.dynamics.kernels import rotation_vector
from multicontact_control.supervision.contact_kernels import (
    advance_contact,
    is_active,
    watch_energy,
)
import numpy as np

# What the task asks for; what a pause has left of the way to the task, and
# whether contacts must not be force controlled in this tick; how far from the arm the reference
# may be [m, rad]; corners of the box.
REFERENCE_LIMITS = np.dtype([
    ('pose_task', np.float64, (4, 3)), ('motion_task', np.float64, (2, 6)),
    ('offset', np.float64, 3), ('held_back', np.bool_), ('reach', np.float64),
    ('turn', np.float64), ('box', np.float64, (2, 3))])


@compiled
def follow_contacts(
    following: Any, posture: Any, contacts: Any, settings: Any, normals: Matrix, points: Matrix,
    overlap: Matrix, wanted: Mask, desired: Vector, alpha: Vector, damping: Vector,
) -> None:
    """
    Advance the state machine and the passivity observer of every contact.

    Parameters
    ----------
    following, posture, contacts, settings
        Records of `REFERENCE_LIMITS`, `POSTURE`, `CONTACT` (changed) and `CONTACT_SETTINGS`.
    normals, points
        Contact normals in world axes and points in the operational frame, shape (r, 3).
    overlap
        n_i^T n_j, shape (r, r).
    wanted, desired, alpha
        Which contacts the task asks for, desired and measured forces, shape (r,) [N].
    damping
        Filled with the forces that passivity takes from the command, shape (r,) [N].

    """
    count = contacts.shape[0]
    twist = posture.twist
    moved = np.empty(count)
    for i in range(count):
        moved[i] = contacts[i].displacement
    lever = np.empty(3)
    for i in range(count):
        place, speed = 0.0, 0.0
        for k in range(3):
            gap = (posture.position[k] - following.pose_task[POSITION, k]
                   - following.offset[k])
            place += normals[i, k] * gap
            speed += normals[i, k] * (twist[k] - following.motion_task[TWIST, k])
        others = 0.0
        for j in range(count):
            if j != i:
                others += overlap[i, j] * moved[j]
        multiply(posture.rotation, points[i], lever)
        # v + w x l, along the normal
        point_speed = (
            normals[i, 0] * (twist[0] + twist[4] * lever[2] - twist[5] * lever[1])
            + normals[i, 1] * (twist[1] + twist[5] * lever[0] - twist[3] * lever[2])
            + normals[i, 2] * (twist[2] + twist[3] * lever[1] - twist[4] * lever[0]))
        damping[i] = watch_energy(contacts[i], settings, alpha[i], point_speed)
        advance_contact(
            contacts[i], settings, wanted[i], alpha[i], desired[i], place - others, speed)


@compiled
def add_displacements(
    following: Any, contacts: Any, normals: Matrix, pose_des: Matrix, motion_des: Matrix,
) -> None:
    """Fill in the task with the contacts' displacements and motions added to it."""
    for k in range(3):
        shift, velocity, change = following.offset[k], 0.0, 0.0
        for i in range(contacts.shape[0]):
            shift += contacts[i].displacement * normals[i, k]
            if not is_active(contacts[i]):
                velocity += contacts[i].speed * normals[i, k]
                change += contacts[i].acceleration * normals[i, k]
        pose_des[POSITION, k] = following.pose_task[POSITION, k] + shift
        motion_des[TWIST, k] = following.motion_task[TWIST, k] + velocity
        motion_des[ACCELERATION, k] = following.motion_task[ACCELERATION, k] + change
        for j in range(3):
            pose_des[k, j] = following.pose_task[k, j]
        motion_des[TWIST, 3 + k] = following.motion_task[TWIST, 3 + k]
        motion_des[ACCELERATION, 3 + k] = following.motion_task[ACCELERATION, 3 + k]


@compiled
def rotate_by(vector: Vector, rotation: Matrix, turned: Matrix) -> None:
    """
    Fill in a rotation turned by a rotation vector (Rodrigues).

    Parameters
    ----------
    vector
        World axes, shape (3,) [rad].
    rotation, turned
        Before and after, shape (3, 3); not the same array.

    """
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
def bound_reference(following: Any, posture: Any, pose_des: Matrix, motion_des: Matrix) -> bool:
    """
    Bring a reference within the box and within reach of the arm.

    Parameters
    ----------
    following, posture
        Records of `REFERENCE_LIMITS` and `POSTURE`.
    pose_des, motion_des
        As for `motion_law`, changed if need be.

    Returns
    -------
    bool
        Whether anything was changed.

    """
    limited = False
    position = pose_des[POSITION]
    for k in range(3):
        inside = min(max(position[k], following.box[0, k]), following.box[1, k])
        if inside != position[k]:
            position[k] = inside
            motion_des[TWIST, k] = 0.0
            motion_des[ACCELERATION, k] = 0.0
            limited = True
    length = 0.0
    for k in range(3):
        length += (position[k] - posture.position[k]) ** 2
    length = np.sqrt(length)
    if length > following.reach:
        for k in range(3):
            position[k] = posture.position[k] + (position[k] - posture.position[k]) * (
                following.reach / length)
        for i in range(2):
            for k in range(6):
                motion_des[i, k] = 0.0
        limited = True
    turn = np.empty(3)
    rotation_vector(pose_des, posture.rotation, turn)
    angle = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    if angle > following.turn:
        for k in range(3):
            turn[k] *= following.turn / angle
        rotate_by(turn, posture.rotation, pose_des[:POSITION])
        limited = True
    return limited


@compiled
def limit_reference(
    followings: Any, postures: Any, contacts: Any, all_settings: Any, normals: Matrix,
    points: Matrix, overlap: Matrix, wanted: Mask, desired: Vector, alpha: Vector,
    pose_des: Matrix, motion_des: Matrix, active: Mask, alpha_des: Vector,
) -> bool:
    """
    Work out the reference of one tick; see `ContactReference.update`.

    Parameters
    ----------
    followings, postures, all_settings
        One record each of `REFERENCE_LIMITS`, `POSTURE` and `CONTACT_SETTINGS`.
    contacts, normals, points, overlap, wanted, desired, alpha
        As for `follow_contacts`.
    pose_des, motion_des, active, alpha_des
        Filled, see `control_law`; apart from all other arrays.

    Returns
    -------
    bool
        Whether a limit of the motion was enforced.

    """
    following, posture, settings = followings[0], postures[0], all_settings[0]
    damping = np.empty(contacts.shape[0])
    follow_contacts(following, posture, contacts, settings, normals, points, overlap, wanted,
                    desired, alpha, damping)
    for i in range(contacts.shape[0]):
        active[i] = is_active(contacts[i]) and not following.held_back
        alpha_des[i] = 0.0
        if active[i]:
            alpha_des[i] = max(min(desired[i], contacts[i].force_limit) - damping[i], 0.0)
    following.held_back = False
    add_displacements(following, contacts, normals, pose_des, motion_des)
    return bound_reference(following, posture, pose_des, motion_des)
