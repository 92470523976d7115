"""Tare: the bias that makes the compensated reading zero in the pose where the arm is."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.config import Config, parameter, Real, ToolConfig
from multicontact_control.errors import CalibrationError
from multicontact_control.sensor.weight import weight_reading
import numpy as np

MIN_SAMPLES = 25
MAX_JOINT_SPEED = 0.02  # rad/s, mean meanwhile: what slows the tool down would be taken for bias


class TareConfig(Config):
    """When readings are quiet enough for a tare."""

    max_force_std: Real = parameter(
        0.5, 'Largest standard deviation of a force axis.', unit='N', gt=0.0)
    max_torque_std: Real = parameter(
        0.05, 'Largest standard deviation of a torque axis.', unit='N m', gt=0.0)


def tare_bias(
    wrenches_sensor: Matrix, rotation_world: Matrix, tool: ToolConfig, gravity_world: Vector,
    config: TareConfig | None = None,
) -> Vector:
    """
    Return the bias for `ToolConfig.bias_sensor`, in any pose.

    The weight of the tool is kept apart, so that the bias holds in every other pose too. What
    touches the tool meanwhile is taken for bias: one pose cannot tell them apart.

    Parameters
    ----------
    wrenches_sensor
        Readings at rest, sensor axes, force first, shape (n, 6) [N, N m].
    rotation_world
        Orientation of the sensor, shape (3, 3).
    tool
        Mass and centre of mass; an old bias in it is not used.
    gravity_world
        g, shape (3,) [m/s^2].
    config
        What counts as quiet.

    Returns
    -------
    Vector
        Bias, sensor axes, force first, shape (6,) [N, N m].

    Raises
    ------
    CalibrationError
        If there are too few readings, or they are restless or not finite.
    ShapeError
        If the readings are not of shape (n, 6).

    """
    config = config or TareConfig()
    require_shape('wrenches_sensor', wrenches_sensor, (len(wrenches_sensor), 6))
    if len(wrenches_sensor) < MIN_SAMPLES:
        raise CalibrationError(
            f'tare: expected at least {MIN_SAMPLES} readings, found {len(wrenches_sensor)}')
    if not np.isfinite(wrenches_sensor).all():
        raise CalibrationError('tare: expected finite readings, found others')
    restless = np.std(wrenches_sensor, axis=0).reshape(2, 3).max(axis=1)
    if restless[0] > config.max_force_std or restless[1] > config.max_torque_std:
        raise CalibrationError(
            f'tare: expected readings at rest (standard deviation at most '
            f'{config.max_force_std:g} N and {config.max_torque_std:g} N m), found '
            f'{restless[0]:.3g} N and {restless[1]:.3g} N m')
    mean: Vector = wrenches_sensor.mean(axis=0)
    return mean - weight_reading(rotation_world, tool, gravity_world)
