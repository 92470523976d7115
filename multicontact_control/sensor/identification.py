"""
Payload and bias of the wrist sensor from readings at rest in a few poses.

At rest the sensor reads f = -m g_s + b_f and tau = g_s x (m c) + b_tau, with g_s = R^T g gravity
in its axes: linear in mass m, first moment m c and biases b. The bias stays as the sensor turns,
the weight does not, which is what tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.config import Config, parameter, Real, ToolConfig
from multicontact_control.errors import CalibrationError
import numpy as np

UNKNOWNS = 10
MIN_POSES = 4
MAX_CONDITION = 30.0  # of the equations; a tilt of some 6 degrees
NOTHING_HANGS = 3.0  # standard errors below which a mass is none


class IdentificationConfig(Config):
    """Limits within which an identification is accepted."""

    max_force_residual: Real = parameter(
        0.5, 'Largest rms of what the fit leaves of a force axis.', unit='N', gt=0.0)
    max_torque_residual: Real = parameter(
        0.05, 'Largest rms of what the fit leaves of a torque axis.', unit='N m', gt=0.0)


@dataclass(frozen=True, slots=True)
class PoseReading:
    """
    What the sensor reads at rest in one pose.

    Attributes
    ----------
    rotation_world
        Orientation of the sensor, shape (3, 3).
    wrench_sensor
        Mean reading, sensor axes, force first, shape (6,) [N, N m].

    """

    rotation_world: Matrix
    wrench_sensor: Vector


@dataclass(frozen=True, slots=True)
class Identification:
    """
    What hangs on the sensor and what it reads of itself.

    Attributes
    ----------
    mass, mass_std
        Mass beyond the sensor and its standard error [kg].
    com_sensor
        Its centre of mass, sensor frame, shape (3,) [m]; 0 if nothing hangs there.
    com_std
        Standard error of each axis, shape (3,) [m]; 0 if nothing hangs there.
    bias_sensor
        Reading under no load, force first, shape (6,) [N, N m].
    force_residual, torque_residual
        Rms per axis of what the fit leaves [N], [N m].
    condition
        Condition number of the equations, gravity taken as 1: small if the poses differ much.
    poses
        How many poses it rests on.

    """

    mass: float
    mass_std: float
    com_sensor: Vector
    com_std: Vector
    bias_sensor: Vector
    force_residual: float
    torque_residual: float
    condition: float
    poses: int

    def tool(self) -> ToolConfig:
        """Return it as the controller's configuration has it."""
        x, y, z = self.com_sensor.tolist()
        return ToolConfig(
            mass=self.mass, com_sensor=(x, y, z), bias_sensor=tuple(self.bias_sensor.tolist()))


def identify_tool(
    readings: Sequence[PoseReading], gravity_world: Vector,
    config: IdentificationConfig | None = None,
) -> Identification:
    """
    Identify mass, centre of mass and bias by linear least squares.

    Parameters
    ----------
    readings
        One mean reading per pose, at rest, nothing touching the tool.
    gravity_world
        g, shape (3,) [m/s^2].
    config
        When to accept the result.

    Returns
    -------
    Identification
        The estimates with residual, standard errors and condition number.

    Raises
    ------
    CalibrationError
        If there are too few poses or they are too similar, or if no tool makes such readings.
    ShapeError
        If a reading is not of shape (6,).

    """
    config = config or IdentificationConfig()
    if len(readings) < MIN_POSES:
        raise CalibrationError(f'poses: expected at least {MIN_POSES}, found {len(readings)}')
    scale = float(np.sqrt(gravity_world @ gravity_world))
    down_world: Vector = gravity_world / scale
    A, b = _equations(readings, down_world)
    condition = float(np.linalg.cond(A))
    if not condition <= MAX_CONDITION:
        raise CalibrationError(
            f'poses: expected orientations that tilt the tool differently (condition number at '
            f'most {MAX_CONDITION:g}), found {condition:.3g}')
    x: Vector = np.linalg.lstsq(A, b, rcond=None)[0].astype(float)
    return _accepted(x, A, b, condition, scale, len(readings), config)


def _equations(readings: Sequence[PoseReading], down_world: Vector) -> tuple[Matrix, Vector]:
    """Return A, shape (6 p, 10), and b of A [m, m c, b_f, b_tau] = b; gravity is 1."""
    A = np.zeros((len(readings), 6, UNKNOWNS))
    b = np.zeros((len(readings), 6))
    for i, reading in enumerate(readings):
        require_shape('wrench_sensor', reading.wrench_sensor, (6,))
        if not np.isfinite(reading.wrench_sensor).all():
            raise CalibrationError(
                f'reading of pose {i}: expected finite numbers, found '
                f'{reading.wrench_sensor.tolist()}')
        x, y, z = down = reading.rotation_world.T @ down_world
        A[i, :3, 0] = -down
        A[i, 3:, 1:4] = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
        A[i, :, 4:] = np.eye(6)
        b[i] = reading.wrench_sensor
    return A.reshape(-1, UNKNOWNS), b.ravel()


def _accepted(
    x: Vector, A: Matrix, b: Vector, condition: float, scale: float, poses: int,
    config: IdentificationConfig,
) -> Identification:
    left = (b - A @ x).reshape(-1, 2, 3)
    force_residual, torque_residual = np.sqrt(np.mean(left ** 2, axis=(0, 2))).tolist()
    # Force and torque equations share no unknown: 4 and 6 of them, 3 equations each per pose.
    variance = np.sum(left ** 2, axis=(0, 2)) / (3 * poses - np.array([4, 6]))
    spread = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    mass, mass_std = x[0] / scale, spread[0] * np.sqrt(variance[0]) / scale
    if mass < -NOTHING_HANGS * mass_std:
        raise CalibrationError(
            f'mass: expected at least 0 kg, found {mass:.3g} kg; is the sign of the sensor '
            'flipped?')
    for what, found, limit, unit in (
            ('force', force_residual, config.max_force_residual, 'N'),
            ('torque', torque_residual, config.max_torque_residual, 'N m')):
        if found > limit:
            raise CalibrationError(
                f'residual {what}: expected at most {limit:g} {unit}, found {found:.3g} {unit}; '
                'is the frame of the sensor right, and was the arm at rest?')
    com, com_std = np.zeros(3), np.zeros(3)
    if mass > NOTHING_HANGS * mass_std:
        com = x[1:4] / (mass * scale)
        com_std = np.hypot(spread[1:4] * np.sqrt(variance[1]) / scale, com * mass_std) / mass
    return Identification(
        mass=max(float(mass), 0.0), mass_std=float(mass_std), com_sensor=com, com_std=com_std,
        bias_sensor=x[4:].copy(), force_residual=force_residual, torque_residual=torque_residual,
        condition=condition, poses=poses)
