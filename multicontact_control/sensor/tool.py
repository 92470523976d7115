"""
What hangs on the wrist sensor, and what the sensor reads of itself: weight, tare, identification.

Wrenches are what the arm does to what it holds or touches: a hanging tool reads upwards. At rest
the sensor reads f = -m g_s + b_f and tau = g_s x (m c) + b_tau, with g_s = R^T g gravity in its
axes: linear in mass m, first moment m c and biases b. The bias stays as the sensor turns, the
weight turns with gravity, which is what tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ToolConfig
from multicontact_control.errors import CalibrationError
import numpy as np

# The mean of as many readings of the largest deviation is known to 0.1 N.
MIN_SAMPLES = 25
# Largest standard deviation of the readings of an axis at rest: ten times the noise of a wrist
# sensor, less than what a moving arm or a hand on the tool makes.
MAX_FORCE_STD = 0.5  # N
MAX_TORQUE_STD = 0.05  # N m
# Of any joint of an arm at rest, so that no inertia counts as bias.
MAX_REST_SPEED = 0.02  # rad/s
MIN_POSES = 4  # three determine a tool, the fourth confirms it
# Condition number: at 30, four of the five poses of `calibrate` suffice from a tilt of 9 degrees.
MAX_POSES_CONDITION = 30.0
SIGNIFICANT_ERRORS = 3.0  # standard errors from which a mass is told from none
# Largest rms of the residuals of an axis: a wrong frame leaves about the weight of the tool.
MAX_FORCE_RESIDUAL = 0.5  # N
MAX_TORQUE_RESIDUAL = 0.05  # N m


class PoseReading(NamedTuple):
    """
    A reading at rest in one pose of the sensor, of which an identification takes several.

    The mean over a second or so, whose noise is small against the weight of the tool.
    """

    rotation_world: Matrix  # orientation of the sensor, shape (3, 3)
    wrench_sensor: Vector  # in sensor axes, force first, shape (6,) [N, N m]


@dataclass(frozen=True, slots=True)
class Identification:
    """What hangs on the sensor and what it reads of itself, with what the fit says of both."""

    mass: float  # beyond the sensor [kg]
    mass_std: float  # its standard error [kg]
    # Centre of mass, sensor frame, shape (3,) [m]; 0 where the mass is not significant.
    com_sensor: Vector
    com_std: Vector  # its standard error, shape (3,) [m]
    bias_sensor: Vector  # reading under no load, force first, shape (6,) [N, N m]
    force_residual: float  # rms per axis of what the fit leaves [N]
    torque_residual: float  # the same [N m]
    condition: float  # number of the equations, weights [N] as unknowns
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


def average_rest_readings(wrenches_sensor: Matrix) -> Vector:
    """
    Return the mean of readings of a sensor at rest, force first, shape (6,) [N, N m].

    The readings are in sensor axes, shape (k, 6) [N, N m].

    Raises
    ------
    CalibrationError
        If there are too few readings, if they vary as those of a moving arm, or if one is not
        finite.

    """
    if len(wrenches_sensor) < MIN_SAMPLES:
        raise CalibrationError(
            f'tare: expected at least {MIN_SAMPLES} readings, got {len(wrenches_sensor)}'
        )
    if not np.isfinite(wrenches_sensor).all():
        raise CalibrationError('tare: expected finite readings, got NaN or infinity')
    deviations = np.std(wrenches_sensor, axis=0)
    force_std = deviations[:3].max()
    torque_std = deviations[3:].max()
    if force_std > MAX_FORCE_STD or torque_std > MAX_TORQUE_STD:
        raise CalibrationError(
            f'tare: expected readings at rest (standard deviation at most '
            f'{MAX_FORCE_STD:g} N and {MAX_TORQUE_STD:g} N m), got '
            f'{force_std:.3g} N and {torque_std:.3g} N m'
        )
    mean: Vector = wrenches_sensor.mean(axis=0)
    return mean


def compute_tare_bias(
    wrenches_sensor: Matrix,
    rotation_world: Matrix,
    tool: ToolConfig,
    gravity_world: Vector,
) -> Vector:
    """
    Return the bias for `ToolConfig.bias_sensor`, by which the compensated reading is zero.

    The bias holds in every pose if mass and centre of `tool` are right, else in this one alone;
    the bias that `tool` has does not matter. What touches the tool meanwhile is taken for bias.

    Parameters
    ----------
    wrenches_sensor
        Readings at rest, sensor axes, force first, shape (k, 6) [N, N m].
    rotation_world, tool, gravity_world
        As for `predict_weight_reading`.

    Raises
    ------
    CalibrationError
        As `average_rest_readings`.

    """
    mean = average_rest_readings(wrenches_sensor)
    return mean - predict_weight_reading(rotation_world, tool, gravity_world)


def identify_tool(
    readings: Sequence[PoseReading], gravity_world: Vector
) -> Identification:
    """
    Identify mass, centre of mass and bias by linear least squares.

    The standard errors are those of the fit's own residuals. A mass of less than
    `SIGNIFICANT_ERRORS` standard errors gets no centre.

    Parameters
    ----------
    readings
        One mean reading per pose, at rest, nothing touching the tool.
    gravity_world
        g, shape (3,) [m/s^2].

    Raises
    ------
    CalibrationError
        If there are too few poses or they are too similar, if a reading is not finite, if the mass
        is negative, or if the residuals are larger than noise makes them.

    """
    poses = len(readings)
    if poses < MIN_POSES:
        raise CalibrationError(f'poses: expected at least {MIN_POSES}, got {poses}')
    gravity = float(np.sqrt(gravity_world @ gravity_world))
    A, y = _build_equations(readings, gravity_world / gravity)
    condition = float(np.linalg.cond(A))
    if not condition <= MAX_POSES_CONDITION:
        raise CalibrationError(
            f'poses: expected orientations that tilt the tool differently (condition number at '
            f'most {MAX_POSES_CONDITION:g}), got {condition:.3g}'
        )
    solution: Vector = np.linalg.lstsq(A, y, rcond=None)[0].astype(float)
    residuals = (y - A @ solution).reshape(-1, 2, 3)
    squares = np.sum(residuals**2, axis=(0, 2))
    # Force and torque equations share no unknown: 4 and 6 of them, 3 equations each per pose.
    force_variance = squares[0] / (3 * poses - 4)
    torque_variance = squares[1] / (3 * poses - 6)
    error_gains = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    mass = solution[0] / gravity
    mass_std = error_gains[0] * np.sqrt(force_variance) / gravity
    if mass < -SIGNIFICANT_ERRORS * mass_std:
        raise CalibrationError(
            f'mass: expected at least 0 kg, got {mass:.3g} kg; is the sign of the sensor '
            'flipped?'
        )
    force_residual, torque_residual = np.sqrt(squares / (3 * poses)).tolist()
    if force_residual > MAX_FORCE_RESIDUAL or torque_residual > MAX_TORQUE_RESIDUAL:
        raise CalibrationError(
            f'residual: expected at most {MAX_FORCE_RESIDUAL:g} N and {MAX_TORQUE_RESIDUAL:g} '
            f'N m, got {force_residual:.3g} N and {torque_residual:.3g} N m; is the frame of the '
            'sensor right, and was the arm at rest?'
        )
    com = np.zeros(3)
    com_std = np.zeros(3)
    if mass > SIGNIFICANT_ERRORS * mass_std:
        com = solution[1:4] / (mass * gravity)
        moment_std = error_gains[1:4] * np.sqrt(torque_variance) / gravity
        com_std = np.hypot(moment_std, com * mass_std) / mass
    return Identification(
        mass=max(float(mass), 0.0),
        mass_std=float(mass_std),
        com_sensor=com,
        com_std=com_std,
        bias_sensor=solution[4:].copy(),
        force_residual=force_residual,
        torque_residual=torque_residual,
        condition=condition,
        poses=poses,
    )


def _build_equations(
    readings: Sequence[PoseReading], down_world: Vector
) -> tuple[Matrix, Vector]:
    """Return A, shape (6 p, 10), and y of A [w, w c, b_f, b_tau] = y, with w = m |g| [N]."""
    A = np.zeros((len(readings), 6, 10))
    y = np.zeros((len(readings), 6))
    for i, reading in enumerate(readings):
        if not np.isfinite(reading.wrench_sensor).all():
            raise CalibrationError(
                f'reading of pose {i}: expected finite numbers, got '
                f'{reading.wrench_sensor.tolist()}'
            )
        down = reading.rotation_world.T @ down_world
        A[i, :3, 0] = -down
        A[i, 3:, 1:4] = np.cross(down, np.eye(3)).T  # columns: down x each axis
        A[i, :, 4:] = np.eye(6)
        y[i] = reading.wrench_sensor
    return A.reshape(-1, 10), y.ravel()
