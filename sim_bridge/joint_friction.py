"""Joint friction: viscous and smoothed Coulomb, solved implicitly, compiled."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np
from sim_bridge.puma560 import RobotData

# Columns of a friction table.
VISCOUS, COULOMB_POSITIVE, COULOMB_NEGATIVE, SPEED = range(4)
NEWTON_STEPS = 50
NEWTON_TOLERANCE = 1e-13


def friction_table(robot: RobotData, scale: float, speed: float) -> Matrix:
    """
    Return the joint-side friction of every joint.

    Parameters
    ----------
    robot
        The arm's data, friction on the motor's side of the gear.
    scale
        Factor on it.
    speed
        Speed scale of the smoothed Coulomb friction [rad/s].

    Returns
    -------
    Matrix
        Viscous [N m s/rad], Coulomb for positive and for negative speed (both >= 0) [N m], and
        speed scale [rad/s], shape (n, 4).

    """
    rows = []
    for motor in robot.motors:
        gear = abs(motor.gear)
        positive, negative = motor.coulomb
        rows.append((
            scale * motor.viscous * gear ** 2, scale * abs(positive) * gear,
            scale * abs(negative) * gear, speed))
    return np.array(rows)


@compiled
def friction_torque(speed: float, row: Vector) -> float:
    """Return the friction f(v) = b v + F tanh(v / v_0) that a joint at `speed` overcomes [N m]."""
    coulomb = row[COULOMB_POSITIVE] if speed >= 0.0 else row[COULOMB_NEGATIVE]
    return float(row[VISCOUS] * speed + coulomb * np.tanh(speed / row[SPEED]))


@compiled
def friction_slope(speed: float, row: Vector) -> float:
    """Return df/dv [N m s/rad]."""
    coulomb = row[COULOMB_POSITIVE] if speed >= 0.0 else row[COULOMB_NEGATIVE]
    tangent = np.tanh(speed / row[SPEED])
    return float(row[VISCOUS] + coulomb * (1.0 - tangent * tangent) / row[SPEED])


@compiled
def implicit_speed(free_speed: float, step: float, inertia: float, row: Vector) -> float:
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
    row
        Row of the friction table.

    Returns
    -------
    float
        The speed [rad/s].

    """
    low, high = min(0.0, free_speed), max(0.0, free_speed)
    ratio = step / inertia
    speed = free_speed
    # Small speeds stick: start where tanh is straight if the whole of the friction stops it.
    if abs(free_speed) < ratio * max(row[COULOMB_POSITIVE], row[COULOMB_NEGATIVE]):
        speed = free_speed / (1.0 + ratio * friction_slope(0.0, row))
    for _ in range(NEWTON_STEPS):
        residual = speed - free_speed + ratio * friction_torque(speed, row)
        if residual > 0.0:
            high = speed
        else:
            low = speed
        following = speed - residual / (1.0 + ratio * friction_slope(speed, row))
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - speed) <= NEWTON_TOLERANCE * (1.0 + abs(speed)):
            return following
        speed = following
    return speed
