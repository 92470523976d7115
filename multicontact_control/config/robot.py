"""Where the arm comes from, and what hangs on it."""

from __future__ import annotations

from multicontact_control.config.base import Config, parameter, Real, Vector, Vector3, WRENCH_SIZE
from multicontact_control.errors import ConfigError
from pydantic import model_validator


class RobotConfig(Config):
    """Where the robot's model comes from and what its joints and frames are called."""

    urdf: str = parameter(
        ..., 'URDF of the arm with its tool: a path, or a path relative to the parameter file.')
    joint_names: tuple[str, ...] = parameter(
        ..., 'Joints in the order of every joint vector.', min_length=1)
    armature: Vector = parameter(
        (), 'Rotor inertia seen at each joint; empty for none.', unit='kg m^2')
    operational_frame: str = parameter(
        ..., 'URDF link that carries the operational point and its axes.')
    sensor_frame: str = parameter(
        ..., 'URDF link in whose axes and at whose origin the wrist sensor reads.')
    gravity_world: Vector3 = parameter((0.0, 0.0, -9.81), 'Gravity.', unit='m/s^2')


class ToolConfig(Config):
    """What hangs on the sensor and is weighed by it, for subtraction from its readings."""

    mass: Real = parameter(0.0, 'Mass beyond the sensor.', unit='kg', ge=0.0)
    com_sensor: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Centre of mass of that, in the sensor frame.', unit='m')
    bias_sensor: Vector = parameter(
        (0.0,) * 6, 'Reading of the sensor under no load, force first, subtracted from every one.',
        unit='N, N m', live=True)

    @model_validator(mode='after')
    def _check_length(self) -> ToolConfig:
        if len(self.bias_sensor) != WRENCH_SIZE:
            raise ConfigError('tool.bias_sensor', '6 values', len(self.bias_sensor))
        return self
