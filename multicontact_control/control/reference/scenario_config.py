"""The parts of a scenario: approach, force steps, motion."""

from __future__ import annotations

from multicontact_control.config import Config, parameter, Real, UnitVector3
from multicontact_control.errors import ConfigError
from pydantic import model_validator


class ApproachConfig(Config):
    """Guarded contact: towards every surface until it is felt."""

    start_time: Real = parameter(0.5, 'When the approach starts.', unit='s', ge=0.0)
    speed: Real = parameter(0.02, 'Approach speed.', unit='m/s', gt=0.0, le=0.25)
    ramp_time: Real = parameter(0.5, 'Time to reach that speed.', unit='s', gt=0.0)
    contact_threshold: Real = parameter(
        1.5, 'Measured force that counts as contact.', unit='N', gt=0.0)
    preload: Real = parameter(2.0, 'Desired force from contact to first step.', unit='N', gt=0.0)


class ForceStepConfig(Config):
    """A step of the desired forces."""

    time: Real = parameter(..., 'When.', unit='s', ge=0.0)
    forces: dict[str, Real] = parameter(..., 'Desired force per contact.', unit='N')


class SineConfig(Config):
    """A sinusoid along one direction, blended in."""

    start_time: Real = parameter(..., 'When the motion starts.', unit='s', ge=0.0)
    direction_world: UnitVector3 = parameter((1.0, 0.0, 0.0), 'Unit direction, world axes.')
    amplitude: Real = parameter(0.15, 'Amplitude.', unit='m', ge=0.0)
    period: Real = parameter(8.0, 'Period.', unit='s', gt=0.0)
    blend_time: Real = parameter(2.0, 'Duration of the quintic blend-in.', unit='s', gt=0.0)


class ReferenceConfig(Config):
    """Approach, force steps at rest, motion (P04 sec. 5.2)."""

    approach: ApproachConfig = ApproachConfig()
    force_steps: tuple[ForceStepConfig, ...] = ()
    motion: SineConfig | None = None

    @model_validator(mode='after')
    def _check_order(self) -> ReferenceConfig:
        times = [step.time for step in self.force_steps]
        if times != sorted(times):
            raise ConfigError('reference.force_steps', 'times in rising order', times)
        return self
