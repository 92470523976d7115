"""Surfaces that move or are tilted: their speeds and normals, estimated while they are pressed."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import dot, multiply, velocity_at
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

    The force changes at k times the speed v of the contact point relative to the surface, so the
    surface moves at v - (d alpha / dt) / k, low-passed and bounded. Of contacts that are answered
    `surface_speed_est` and `normal` are changed.
    """
    for i in range(contacts.shape[0]):
        contact, config = contacts[i], contacts[i].config
        limit = config.surface_speed_limit
        if limit > 0.0:
            seen = 0.0
            if contact.answer.active:
                seen = dot(contact.N, frame.twist) - config.surface_speed - (
                    contact.answer.alpha_rate_est / contact.stiffness)
            speed = contact.surface_speed_est + config.surface_gain * (
                seen - contact.surface_speed_est)
            contact.surface_speed_est = min(max(speed, -limit), limit)
        if config.kind == FORCE and config.turn_limit > 0.0 and contact.answer.active:
            follow_normal(frame, contact)


@compiled
def follow_normal(frame: Any, contact: Any) -> None:
    """
    Turn a normal to where the contact force says that it is.

    Friction lies along the sliding velocity v, so that the rest of the force at the contact is
    along the normal. The normal goes there as a low-pass does, no faster than a declared speed,
    and stays within a declared angle. A velocity steeper than that angle, and than 34 degrees, is
    that of a bounce.
    """
    config = contact.config
    if contact.alpha_meas < PRESSED:
        return
    point, velocity = np.empty(3), np.empty(3)
    multiply(frame.rotation, config.point, point)
    velocity_at(frame.twist, point, velocity)
    seen, speed = contact.alpha_meas * contact.normal + contact.friction, dot(velocity, velocity)
    if speed < SLIDING_SPEED * SLIDING_SPEED:
        return
    steep = dot(velocity, config.normal)
    if steep * steep > max(STEEP, 1.0 - config.smallest_cosine ** 2) * speed:
        return
    seen -= dot(seen, velocity) / speed * velocity
    length = np.sqrt(dot(seen, seen))
    if length < PRESSED:
        return
    turn = config.normal_gain * (seen / length - contact.normal)
    way = np.sqrt(dot(turn, turn))
    seen = contact.normal + (min(1.0, config.turn_limit / way) if way > 0.0 else 0.0) * turn
    length = np.sqrt(dot(seen, seen))
    cosine = dot(seen, config.normal) / length
    if cosine >= config.smallest_cosine:
        contact.normal[:] = seen / length
        return
    side = seen / length - cosine * config.normal
    scale = np.sqrt(1.0 - config.smallest_cosine * config.smallest_cosine) / np.sqrt(
        dot(side, side))
    contact.normal[:] = config.smallest_cosine * config.normal + scale * side
