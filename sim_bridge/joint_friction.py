"""Joint friction: viscous and smoothed Coulomb, solved implicitly, compiled."""

from __future__ import annotations

from typing import Any

from multicontact_control.compiled import compiled
from multicontact_control.records import Records
import numpy as np
from sim_bridge.arm import Arm

# Friction of one joint, joint side.
FRICTION = np.dtype([
    ('viscous', np.float64),  # [N m s/rad]
    ('coulomb_positive', np.float64),  # for positive speed, >= 0 [N m]
    ('coulomb_negative', np.float64),  # for negative speed, >= 0 [N m]
    ('speed', np.float64),  # scale of the smoothed Coulomb friction [rad/s]
])
NEWTON_STEPS = 50
NEWTON_TOLERANCE = 1e-13


def joint_friction(arm: Arm, scale: float, speed: float) -> Records:
    """
    Return the joint-side friction of every joint.

    Parameters
    ----------
    arm
        The arm, with its friction.
    scale
        Factor on it.
    speed
        Speed scale of the smoothed Coulomb friction [rad/s].

    Returns
    -------
    Records
        Records of `FRICTION`, shape (n,).

    """
    joints = np.zeros(len(arm.links), dtype=FRICTION)
    for joint, link in zip(joints, arm.links):
        for name in ('viscous', 'coulomb_positive', 'coulomb_negative'):
            joint[name] = scale * getattr(link, name)
        joint['speed'] = speed
    return joints


@compiled
def friction_torque(speed: float, joint: Any) -> float:
    """Return the friction f(v) = b v + F tanh(v / v_0) that a joint at `speed` overcomes [N m]."""
    coulomb = joint.coulomb_positive if speed >= 0.0 else joint.coulomb_negative
    return float(joint.viscous * speed + coulomb * np.tanh(speed / joint.speed))


@compiled
def friction_slope(speed: float, joint: Any) -> float:
    """Return df/dv [N m s/rad]."""
    coulomb = joint.coulomb_positive if speed >= 0.0 else joint.coulomb_negative
    tangent = np.tanh(speed / joint.speed)
    return float(joint.viscous + coulomb * (1.0 - tangent * tangent) / joint.speed)


@compiled
def implicit_speed(free_speed: float, step: float, inertia: float, joint: Any) -> float:
    """
    Solve v = free_speed - step / inertia * f(v) for the speed at the end of a step.

    The solution lies between 0 and the speed without friction; Newton's method is kept inside
    a bracket that only shrinks, since tanh is too sharp for it alone.

    Parameters
    ----------
    free_speed
        Speed at the end of the step without friction [rad/s].
    step
        Length of the step [s].
    inertia
        Inertia of the joint [kg m^2].
    joint
        Record of `FRICTION`.

    Returns
    -------
    float
        The speed [rad/s].

    """
    low, high = min(0.0, free_speed), max(0.0, free_speed)
    ratio = step / inertia
    speed = free_speed
    # Small speeds stick: start where tanh is straight if the whole of the friction stops it.
    if abs(free_speed) < ratio * max(joint.coulomb_positive, joint.coulomb_negative):
        speed = free_speed / (1.0 + ratio * friction_slope(0.0, joint))
    for _ in range(NEWTON_STEPS):
        residual = speed - free_speed + ratio * friction_torque(speed, joint)
        if residual > 0.0:
            high = speed
        else:
            low = speed
        following = speed - residual / (1.0 + ratio * friction_slope(speed, joint))
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - speed) <= NEWTON_TOLERANCE * (1.0 + abs(speed)):
            return following
        speed = following
    return speed
