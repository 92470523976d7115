"""Axes of the wrench sensor that are exchanged or turned round, as the torques show them."""

from __future__ import annotations

from itertools import permutations, product

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.control.arm import WRENCH
from multicontact_control.diagnosis.fitting import fit_over_joints
from multicontact_control.records import Joint, Momentum, Records
import numpy as np

LEAST_FORCE = 3.0  # N, that tells it
# Difference of what is read from what the torques show, over its size: at most in other axes, and
# at least in its own.
ALIKE = 0.2
UNLIKE = 0.5
AXES = 'xyz'


def all_exchanges() -> Matrix:
    """Return every exchange of axes, each of them in either direction, shape (48, 3, 3)."""
    exchanges = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            exchanges.append(np.diag(signs)[:, list(order)])
    return np.array(exchanges)


EXCHANGES = all_exchanges()
# How many axes are others in each exchange.
EXCHANGED = (EXCHANGES != np.eye(3)).any(axis=2).sum(axis=1)


@np.errstate(all='ignore')  # of impossible efforts
def explain_axes(
    joints: Records[Joint],
    momentum: Momentum,
    jacobian: Matrix,
    rotation_world: Matrix,
    weight: Vector,
) -> str:
    """
    Return what says that axes of the sensor are exchanged or turned round; else empty.

    What the torques show is compared with what is read in all other axes.

    Parameters
    ----------
    joints, momentum
        Records of `JOINT`, shape (n,), and the observer's in `CONTROL`.
    jacobian
        Of the operational point, world axes, linear rows first, shape (6, n).
    rotation_world
        The sensor's axes as columns, shape (3, 3).
    weight
        Of what hangs on the sensor, m g, world axes, shape (3,) [N].

    """
    read, shown = _forces_at_the_sensor(
        joints, momentum, jacobian, rotation_world, weight
    )
    size = np.linalg.norm(shown)
    if not size > LEAST_FORCE or not np.linalg.norm(read - shown) > UNLIKE * size:
        return ''
    errors = np.linalg.norm(EXCHANGES @ shown - read, axis=1)
    if errors.min() > ALIKE * size:
        return ''
    # Of exchanges that are alike, as of two equal forces, the least.
    likeliest = np.argmin(errors + 0.5 * ALIKE * size * EXCHANGED)
    findings = []
    for axis, force, row in zip(AXES, read, EXCHANGES[likeliest]):
        other = int(np.argmax(np.abs(row)))
        true_axis = AXES[other]
        if row[other] < 0.0:
            true_axis = f'-{true_axis}'
        if abs(force) > 0.5 * UNLIKE * size and true_axis != axis:
            findings.append(f'its {axis} is {true_axis}')
    if not findings:
        return ''
    x, y, z = shown
    return (
        f'the wrench sensor reads [{read[0]:.1f}, {read[1]:.1f}, {read[2]:.1f}] N where the '
        f'torques show [{x:.1f}, {y:.1f}, {z:.1f}] N: {", ".join(findings)}; check '
        'robot.sensor_frame and the axes of its driver'
    )


def _forces_at_the_sensor(
    joints: Records[Joint],
    momentum: Momentum,
    jacobian: Matrix,
    rotation_world: Matrix,
    weight: Vector,
) -> tuple[Vector, Vector]:
    """Return the force that is read and the one that the torques show, sensor axes [N]."""
    watch = joints['watch']
    felt = watch['residual_statistics']['regressor'][:, WRENCH]
    rested = watch['residual_statistics']['time_at_rest'].max()
    settled = 1.0 - np.exp(-momentum['config']['bandwidth'] * rested)
    torques = np.column_stack([felt, felt + watch['residual']]) / settled
    wrenches = fit_over_joints(jacobian.T, torques, watch['threshold'])
    read_world, shown_world = wrenches[:3].T
    read = rotation_world.T @ (read_world - weight)
    shown = rotation_world.T @ (shown_world - weight)
    return read, shown
