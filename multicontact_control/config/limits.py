"""What must never be exceeded."""

from __future__ import annotations

from multicontact_control.config.base import Config, parameter, Real, Vector
from multicontact_control.errors import ConfigError
from pydantic import model_validator


class LimitsConfig(Config):
    """What no command and no motion may exceed; an empty list is no limit."""

    joint_lower: Vector = parameter((), 'Lower stop of each joint.', unit='rad')
    joint_upper: Vector = parameter((), 'Upper stop of each joint.', unit='rad')
    joint_margin: Real = parameter(
        0.02, 'How far before its stop a joint is to stand still.', unit='rad', ge=0.0, le=1.0)
    joint_speed: Vector = parameter((), 'Largest speed of each joint.', unit='rad/s')
    joint_braking: Real = parameter(
        5.0, 'Deceleration counted on before a stop.', unit='rad/s^2', gt=0.0, le=500.0)
    torque_rate: Vector = parameter((), 'Largest rate of each torque.', unit='N m/s')
    operational_speed: Real = parameter(
        0.5, 'Largest speed of the operational point.', unit='m/s', gt=0.0, le=10.0)
    operational_turn: Real = parameter(
        2.0, 'Largest angular speed of the operational frame.', unit='rad/s', gt=0.0, le=50.0)
    workspace_lower: Vector = parameter(
        (), 'Lower corner of the box the operational point stays in.', unit='m')
    workspace_upper: Vector = parameter((), 'Upper corner of that box.', unit='m')
    singular_mobility: Real = parameter(
        0.004, 'Smallest eigenvalue of J M^-1 J^T up to which Lambda is damped, 0 for never.',
        unit='1/kg', ge=0.0, le=1.0)

    @model_validator(mode='after')
    def _check_across_fields(self) -> LimitsConfig:
        for kind in ('joint', 'workspace'):
            lower, upper = getattr(self, f'{kind}_lower'), getattr(self, f'{kind}_upper')
            if len(lower) != len(upper) or any(a >= b for a, b in zip(lower, upper)):
                raise ConfigError(
                    f'limits.{kind}_lower', f'one value below each of {kind}_upper', list(lower))
        if len(self.workspace_lower) not in (0, 3):
            raise ConfigError('limits.workspace_lower', '3 values', len(self.workspace_lower))
        for name in ('joint_speed', 'torque_rate'):
            if min(getattr(self, name), default=1.0) <= 0.0:
                raise ConfigError(f'limits.{name}', 'values above 0', min(getattr(self, name)))
        return self
