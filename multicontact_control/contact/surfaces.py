"""Surfaces that move or are tilted: their speeds and normals, estimated while they are pressed."""

from __future__ import annotations

from multicontact_control.algebra import (
    divide_vector,
    dot,
    linear_combination,
    rotate_vector,
    vector_between,
    vector_length,
    velocity_at,
)
from multicontact_control.compiled import compiled
from multicontact_control.config.contact import FORCE
from multicontact_control.records import Contact, Frame, Records
import numpy as np

# m/s, from which on sliding has a direction; approaches are slower.
SLIDING_SPEED = 0.03
PRESSED = 3.0  # N, from which on the direction of a force is
STEEP = 0.32  # squared sine of 34 degrees to the surface as told, up to which it is slid along


@compiled
def follow_surfaces(frame: Frame, contacts: Records[Contact]) -> None:
    """
    Take a sample into the estimated speeds and normals of the surfaces.

    The force changes at k times the speed v of the contact point relative to the surface, so the
    surface moves at v - (d alpha / dt) / k, low-passed and bounded. Of contacts that are answered
    `surface_speed_est` and `normal` are changed.
    """
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        config = contact.config
        limit = config.surface_speed_limit
        if limit > 0.0:
            seen = 0.0
            if contact.answer.active:
                seen = (
                    dot(contact.N, frame.twist)
                    - config.surface_speed
                    - (contact.answer.alpha_rate_est / contact.stiffness)
                )
            speed = contact.surface_speed_est + config.surface_gain * (
                seen - contact.surface_speed_est
            )
            contact.surface_speed_est = min(max(speed, -limit), limit)
        if config.kind == FORCE and config.turn_limit > 0.0 and contact.answer.active:
            follow_normal(frame, contact)


@compiled
def follow_normal(frame: Frame, contact: Contact) -> None:
    """
    Turn a normal to where the contact force says that it is.

    Friction lies along the sliding velocity v, so that the rest of the force at the contact is
    along the normal. What goes into the surface, (d alpha / dt) / k, is no sliding: where drives
    or tool give way before the tip slides, it would lead the normal, and by it the reference,
    farther and farther into the surface. The normal goes there as a low-pass does, no faster than
    a declared speed, and stays within a declared angle. A velocity steeper than that angle, and
    than 34 degrees, is that of a bounce.
    """
    config, normal = contact.config, contact.normal
    if contact.alpha_meas < PRESSED:
        return
    velocity = velocity_at(frame.twist, rotate_vector(frame.rotation, config.point))
    into_surface = contact.answer.alpha_rate_est / contact.stiffness
    velocity = linear_combination(1.0, velocity, -into_surface, normal)
    squared_speed = dot(velocity, velocity)
    if squared_speed < SLIDING_SPEED * SLIDING_SPEED:
        return
    steep = dot(velocity, config.normal)
    if steep * steep > max(STEEP, 1.0 - config.smallest_cosine**2) * squared_speed:
        return
    force = linear_combination(contact.alpha_meas, normal, 1.0, contact.friction)
    seen = linear_combination(
        1.0, force, -dot(force, velocity) / squared_speed, velocity
    )
    size = vector_length(seen)
    if size < PRESSED:
        return
    missing = vector_between(normal, divide_vector(seen, size))
    way = config.normal_gain * vector_length(missing)
    gain = config.normal_gain
    if way > config.turn_limit:
        gain *= config.turn_limit / way
    turned = linear_combination(1.0, normal, gain, missing)
    normal[:] = divide_vector(turned, vector_length(turned))
    cosine = dot(normal, config.normal)
    if cosine < config.smallest_cosine:
        side = linear_combination(1.0, normal, -cosine, config.normal)
        sine = np.sqrt(1.0 - config.smallest_cosine * config.smallest_cosine)
        normal[:] = linear_combination(
            config.smallest_cosine, config.normal, sine / vector_length(side), side
        )
