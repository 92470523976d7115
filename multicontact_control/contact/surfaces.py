"""
Surfaces that move or are tilted: their speeds and normals, estimated.

Both are learnt from what is measured anyway, slowly and within declared bounds, while a contact is
force controlled.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import cross, dot, multiply
from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config.contact import FORCE
import numpy as np

SLIDING_SPEED = 0.03  # m/s, from which on sliding has a direction; above that of approaches
PRESSED = 3.0  # N, from which on the direction of a force is
STEEP = 0.32  # squared sine of 34 degrees to the surface as told, up to which it is slid along


@compiled
def follow_surfaces(frame: Any, contacts: Any) -> None:
    """
    Take a sample into the estimated speeds and normals of the surfaces.

    Parameters
    ----------
    frame
        Record of `FRAME`.
    contacts
        Records of `CONTACT`, shape (r,), answered; `surface_speed_est` and `normal` are changed.

    """
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        if contact.surface_speed_limit > 0.0:
            follow_speed(frame, contact)
        if contact.kind == FORCE and contact.turn_limit > 0.0 and contact.active:
            follow_normal(frame, contact)


@compiled
def follow_speed(frame: Any, contact: Any) -> None:
    """
    Estimate how fast a surface moves along its normal.

    The force changes at k times the speed of the contact point relative to the surface, so the
    surface moves at v - (d alpha / dt) / k, low-passed and bounded.
    """
    seen = 0.0
    if contact.active:
        seen = dot(contact.N, frame.twist) - contact.surface_speed - (
            contact.alpha_rate_est / contact.stiffness)
    limit = contact.surface_speed_limit
    speed = contact.surface_speed_est + contact.surface_gain * (seen - contact.surface_speed_est)
    contact.surface_speed_est = min(max(speed, -limit), limit)


@compiled
def follow_normal(frame: Any, contact: Any) -> None:
    """
    Turn a normal to where the contact force says that it is.

    Friction lies along the sliding velocity v, which lies in the surface. So what is left of the
    force at the contact after v is taken out of it is along the normal. The normal goes there as
    a low-pass does, no faster than a declared speed, and stays within a declared angle. A
    velocity that is steeper than that angle, and than 34 degrees, is that of a bounce.
    """
    if contact.alpha_meas < PRESSED:
        return
    point, velocity, seen = np.empty(3), np.empty(3), np.empty(3)
    twist = frame.twist
    multiply(frame.rotation, contact.point, point)
    cross(twist[3:], point, velocity)
    speed = 0.0
    for k in range(3):
        velocity[k] += twist[k]
        speed += velocity[k] * velocity[k]
        seen[k] = contact.alpha_meas * contact.normal[k] + contact.friction[k]
    if speed < SLIDING_SPEED * SLIDING_SPEED:
        return
    steep = dot(velocity, contact.normal_told)
    if steep * steep > max(STEEP, 1.0 - contact.smallest_cosine ** 2) * speed:
        return
    along = dot(seen, velocity) / speed
    length = 0.0
    for k in range(3):
        seen[k] -= along * velocity[k]
        length += seen[k] * seen[k]
    length = np.sqrt(length)
    if length < PRESSED:
        return
    for k in range(3):
        seen[k] = contact.normal_gain * (seen[k] / length - contact.normal[k])
    way = np.sqrt(dot(seen, seen))
    share = min(1.0, contact.turn_limit / way) if way > 0.0 else 0.0
    for k in range(3):
        seen[k] = contact.normal[k] + share * seen[k]
    keep_near(seen, contact.normal_told, contact.smallest_cosine)
    for k in range(3):
        contact.normal[k] = seen[k]


@compiled
def keep_near(direction: Vector, centre: Vector, smallest_cosine: float) -> None:
    """Make a direction a unit vector, shape (3,), at most so far from another, in place."""
    length = np.sqrt(dot(direction, direction))
    cosine = dot(direction, centre) / length
    if cosine < smallest_cosine:
        side = np.empty(3)
        across = 0.0
        for k in range(3):
            side[k] = direction[k] / length - cosine * centre[k]
            across += side[k] * side[k]
        scale = np.sqrt(1.0 - smallest_cosine * smallest_cosine) / np.sqrt(across)
        for k in range(3):
            direction[k] = smallest_cosine * centre[k] + scale * side[k]
        return
    for k in range(3):
        direction[k] /= length
