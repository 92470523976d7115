"""
What hangs on the wrist sensor, and what the sensor reads of itself: weight, tare, identification.

At rest the sensor reads f = -m g_s + b_f and tau = g_s x (m c) + b_tau, with g_s = R^T g gravity
in its axes: linear in mass m, first moment m c and biases b. The bias stays as the sensor turns,
the weight does not, which is what tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ToolConfig
from multicontact_control.errors import CalibrationError
import numpy as np

MIN_SAMPLES = 25  # readings of a tare
MAX_FORCE_STD = 0.5  # N, of these readings, in an axis
MAX_TORQUE_STD = 0.05  # N m
MAX_JOINT_SPEED = 0.02  # rad/s, mean during a tare, so that no inertia counts as bias
MIN_POSES = 4
MAX_POSES_CONDITION = 30.0  # of the equations; a tilt of some 6 degrees
NOTHING_HANGS = 3.0  # standard errors below which a mass is none
MAX_FORCE_RESIDUAL = 0.5  # N, rms of what a fit leaves of an axis
MAX_TORQUE_RESIDUAL = 0.05  # N m


class PoseReading(NamedTuple):
    """
    A reading at rest in one pose of the sensor, of which an identification takes several.

    Its mean over a while, so that noise is small against the weight of the tool.
    """

    rotation_world: Matrix  # orientation of the sensor, shape (3, 3)
    wrench_sensor: Vector  # in sensor axes, force first, shape (6,) [N, N m]


@dataclass(frozen=True, slots=True)
class Identification:
    """What hangs on the sensor and what it reads of itself, with what the fit says of both."""

    mass: float  # beyond the sensor [kg]
    mass_std: float  # its standard error [kg]
    com_sensor: Vector  # centre of mass, sensor frame, 0 without mass, shape (3,) [m]
    com_std: Vector  # its standard error, shape (3,) [m]
    bias_sensor: Vector  # reading under no load, force first, shape (6,) [N, N m]
    force_residual: float  # rms per axis of what the fit leaves [N]
    torque_residual: float  # the same [N m]
    condition: float  # number of the equations, gravity taken as 1
    poses: int

    def tool(self) -> ToolConfig:
        """Return the tool and the bias as the controller's configuration has them."""
        x, y, z = self.com_sensor.tolist()
        return ToolConfig(
            mass=self.mass,
            com_sensor=(x, y, z),
            bias_sensor=tuple(self.bias_sensor.tolist()),
        )


def predict_weight_reading(
    rotation_world: Matrix, tool: ToolConfig, gravity_world: Vector
) -> Vector:
    """
    Return what an unbiased sensor reads at rest with nothing touching the tool: -m R^T g.

    R is the orientation of the sensor, shape (3, 3), g gravity, shape (3,) [m/s^2]; the reading is
    in sensor axes, force first, shape (6,) [N, N m].
    """
    force = -tool.mass * (rotation_world.T @ gravity_world)
    return np.concatenate((force, np.cross(tool.com_sensor, force)))


def compute_tare_bias(
    wrenches_sensor: Matrix,
    rotation_world: Matrix,
    tool: ToolConfig,
    gravity_world: Vector,
) -> Vector:
    """
    Return the bias for `ToolConfig.bias_sensor`, by which the compensated reading is zero.

    It holds in every pose. What touches the tool meanwhile is taken for bias.

    Parameters
    ----------
    wrenches_sensor
        Readings at rest, sensor axes, force first, shape (k, 6) [N, N m].
    rotation_world, tool, gravity_world
        As for `predict_weight_reading`.

    Raises
    ------
    CalibrationError
        If there are too few readings, or they are restless or not finite.

    """
    if len(wrenches_sensor) < MIN_SAMPLES:
        raise CalibrationError(
            f'tare: expected at least {MIN_SAMPLES} readings, got {len(wrenches_sensor)}'
        )
    if not np.isfinite(wrenches_sensor).all():
        raise CalibrationError('tare: expected finite readings, got NaN or infinity')
    restless = np.std(wrenches_sensor, axis=0).reshape(2, 3).max(axis=1)
    if restless[0] > MAX_FORCE_STD or restless[1] > MAX_TORQUE_STD:
        raise CalibrationError(
            f'tare: expected readings at rest (standard deviation at most '
            f'{MAX_FORCE_STD:g} N and {MAX_TORQUE_STD:g} N m), got '
            f'{restless[0]:.3g} N and {restless[1]:.3g} N m'
        )
    mean: Vector = wrenches_sensor.mean(axis=0)
    return mean - predict_weight_reading(rotation_world, tool, gravity_world)


def identify_tool(
    readings: Sequence[PoseReading], gravity_world: Vector
) -> Identification:
    """
    Identify mass, centre of mass and bias by linear least squares.

    The standard errors are those of the fit's own residuals. A mass below `NOTHING_HANGS` of its
    standard error has no centre.

    Parameters
    ----------
    readings
        One mean reading per pose, at rest, nothing touching the tool.
    gravity_world
        g, shape (3,) [m/s^2].

    Raises
    ------
    CalibrationError
        If there are too few poses or they are too similar, or if no tool makes such readings.

    """
    poses = len(readings)
    if poses < MIN_POSES:
        raise CalibrationError(f'poses: expected at least {MIN_POSES}, got {poses}')
    scale = float(np.sqrt(gravity_world @ gravity_world))
    A, b = _equations(readings, gravity_world / scale)
    condition = float(np.linalg.cond(A))
    if not condition <= MAX_POSES_CONDITION:
        raise CalibrationError(
            f'poses: expected orientations that tilt the tool differently (condition number at '
            f'most {MAX_POSES_CONDITION:g}), got {condition:.3g}'
        )
    x: Vector = np.linalg.lstsq(A, b, rcond=None)[0].astype(float)
    left = (b - A @ x).reshape(-1, 2, 3)
    # Force and torque equations share no unknown: 4 and 6 of them, 3 equations each per pose.
    variance = np.sum(left**2, axis=(0, 2)) / (3 * poses - np.array([4, 6]))
    spread = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    mass = x[0] / scale
    mass_std = spread[0] * np.sqrt(variance[0]) / scale
    if mass < -NOTHING_HANGS * mass_std:
        raise CalibrationError(
            f'mass: expected at least 0 kg, got {mass:.3g} kg; is the sign of the sensor '
            'flipped?'
        )
    force_residual, torque_residual = np.sqrt(np.mean(left**2, axis=(0, 2))).tolist()
    if force_residual > MAX_FORCE_RESIDUAL or torque_residual > MAX_TORQUE_RESIDUAL:
        raise CalibrationError(
            f'residual: expected at most {MAX_FORCE_RESIDUAL:g} N and {MAX_TORQUE_RESIDUAL:g} '
            f'N m, got {force_residual:.3g} N and {torque_residual:.3g} N m; is the frame of the '
            'sensor right, and was the arm at rest?'
        )
    com = np.zeros(3)
    com_std = np.zeros(3)
    if mass > NOTHING_HANGS * mass_std:
        com = x[1:4] / (mass * scale)
        moment_std = spread[1:4] * np.sqrt(variance[1]) / scale
        com_std = np.hypot(moment_std, com * mass_std) / mass
    return Identification(
        mass=max(float(mass), 0.0),
        mass_std=float(mass_std),
        com_sensor=com,
        com_std=com_std,
        bias_sensor=x[4:].copy(),
        force_residual=force_residual,
        torque_residual=torque_residual,
        condition=condition,
        poses=poses,
    )


def _equations(
    readings: Sequence[PoseReading], down_world: Vector
) -> tuple[Matrix, Vector]:
    """Return A, shape (6 p, 10), and b of A [m, m c, b_f, b_tau] = b; gravity is 1."""
    A = np.zeros((len(readings), 6, 10))
    b = np.zeros((len(readings), 6))
    for i, reading in enumerate(readings):
        if not np.isfinite(reading.wrench_sensor).all():
            raise CalibrationError(
                f'reading of pose {i}: expected finite numbers, got '
                f'{reading.wrench_sensor.tolist()}'
            )
        x, y, z = down = reading.rotation_world.T @ down_world
        A[i, :3, 0] = -down
        A[i, 3:, 1:4] = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
        A[i, :, 4:] = np.eye(6)
        b[i] = reading.wrench_sensor
    return A.reshape(-1, 10), b.ravel()
