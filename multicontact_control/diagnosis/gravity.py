"""Gravity that is another than configured: a base that is mounted at another angle."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.diagnosis.fitting import fit_over_joints
from multicontact_control.records import Joint, Records
import numpy as np

SMALLEST_MASS = 0.2  # kg; a lighter tool does not tell it
SMALLEST_LEAN = 0.5  # m/s^2 by which gravity leans, at least
# Least cosine of the angle between the leans that tool and arm show.
SAME_SIDE = 0.9
SAME_STRENGTH = 0.05  # share of its strength that may be missing or too much


@np.errstate(all='ignore')  # of impossible efforts
def explain_gravity(
    joints: Records[Joint],
    shares: Matrix,
    force_world: Vector,
    mass: float,
    gravity_world: Vector,
) -> str:
    """
    Return what says that gravity is another than configured on an arm that stands; else empty.

    What the sensor carries, of a mass m, then reads -m times the change of gravity, which must
    leave its strength as it is; and so must the residuals lean to the same side. A push does
    neither.

    Parameters
    ----------
    joints
        Records of `JOINT`, shape (n,).
    shares
        Of `RobotModel.compute_gravity_shares`, shape (n, 3) [kg m].
    force_world
        What the sensor reads without the tool's weight, world axes, shape (3,) [N].
    mass
        Of the tool [kg].
    gravity_world
        As configured, shape (3,) [m/s^2].

    """
    if mass < SMALLEST_MASS:
        return ''
    strength = np.linalg.norm(gravity_world)
    down = gravity_world / strength
    change_read = -force_world / mass
    watch = joints['watch']
    change_fitted = fit_over_joints(shares, watch['residual'], watch['threshold'])
    lean_read = change_read - (change_read @ down) * down
    lean_fitted = change_fitted - (change_fitted @ down) * down
    size_read = float(np.linalg.norm(lean_read))
    size_fitted = float(np.linalg.norm(lean_fitted))
    true_gravity = gravity_world + change_read
    if min(size_read, size_fitted) < SMALLEST_LEAN:
        return ''
    if lean_read @ lean_fitted < SAME_SIDE * size_read * size_fitted:
        return ''
    if abs(np.linalg.norm(true_gravity) - strength) > SAME_STRENGTH * strength:
        return ''
    angle = np.degrees(np.arctan2(size_read, true_gravity @ down))
    x, y, z = true_gravity
    return (
        f'arm and tool weigh as if gravity were [{x:.1f}, {y:.1f}, {z:.1f}] m/s^2, '
        f'{angle:.0f} deg off robot.gravity_world: check how the base is mounted'
    )
