"""Which inputs are valid, and the reactions to those that are not."""

from __future__ import annotations

from typing import Literal

from multicontact_control.config.base import Config, parameter, Real, Vector
from multicontact_control.errors import ConfigError
from pydantic import model_validator

Reaction = Literal['hold', 'float', 'damp']


class WatchdogConfig(Config):
    """Limits of valid inputs, and the reactions beyond them."""

    joint_max_age: Real = parameter(
        0.003, 'Largest age of a joint state.', unit='s', gt=0.0, le=1.0)
    wrench_max_age: Real = parameter(0.003, 'Largest age of a wrench.', unit='s', gt=0.0, le=1.0)
    variance_max_age: Real = parameter(
        0.005, 'Largest age of R, which is one period old when all is well.', unit='s', gt=0.0,
        le=10.0)
    variance_growth: Real = parameter(
        1.1, 'Factor per period on an R that is not renewed.', ge=1.0, le=10.0)
    variance_floor: Real = parameter(
        0.1, 'Smallest R that is used: a smaller one makes the observer faster than the drives.',
        unit='N^2', gt=0.0)
    variance_ceiling: Real = parameter(
        1e3, 'Where that growth ends, and the largest R that is used.', unit='N^2', gt=0.0)
    on_joint_fault: Reaction = parameter(
        'float', 'Reaction to a joint state that is missing, stale or invalid.')
    on_wrench_fault: Reaction = parameter(
        'hold', 'Reaction to a wrench that is missing, stale or invalid.')
    on_clock_fault: Reaction = parameter(
        'hold', 'Reaction to time that runs backwards or at a wrong rate.')
    on_motion_fault: Reaction = parameter(
        'hold', 'Reaction to a speed beyond its limit.')
    on_law_fault: Reaction = parameter(
        'damp', 'Reaction to a control law that raises or gives no finite torque.')
    rate_band: Real = parameter(
        2.5, 'Twice in a row a period beyond 1 / rate_band to rate_band times the right one is '
        'a fault.', gt=1.0, le=100.0)
    frozen_samples: int = parameter(
        2, 'Repetitions, bit by bit, that make a reading frozen; 0 for a sensor without noise.',
        ge=0, le=1000)
    wrench_full_scale: Vector = parameter(
        (), 'Reading of each axis at which the sensor saturates; empty if unknown.',
        unit='N, N m')
    pull_threshold: Real = parameter(
        4.0, 'Measured pull of a surface beyond which the wrench is refused.', unit='N', gt=0.0)
    loss_acceleration: Real = parameter(
        20.0, 'Acceleration of the tool, braked after a contact is lost, whose inertia may be '
        'read as a pull of that contact beyond pull_threshold.', unit='m/s^2', ge=0.0, le=200.0)
    friction_bound: Real = parameter(
        0.8, 'Largest accepted ratio of sideways to normal forces.', gt=0.0, le=10.0)
    friction_offset: Real = parameter(
        5.0, 'Sideways force that is always accepted.', unit='N', gt=0.0)
    position_jump: Real = parameter(
        0.01, 'Largest accepted difference between a joint angle and the one its speeds lead '
        'to.', unit='rad', gt=0.0)
    hold_frequency: Real = parameter(
        10.0, 'Natural frequency of the joints while the posture is held.', unit='rad/s',
        gt=0.0, le=100.0)
    damping_rate: Real = parameter(
        5.0, 'Damping of the joints over their inertia, of the reaction `damp`.', unit='1/s',
        gt=0.0, le=100.0)
    recovery_time: Real = parameter(
        0.05, 'How long all inputs must be good before control resumes.', unit='s', ge=0.0,
        le=60.0)

    @model_validator(mode='after')
    def _check_lengths(self) -> WatchdogConfig:
        if len(self.wrench_full_scale) not in (0, 6):
            raise ConfigError(
                'watchdog.wrench_full_scale', '6 values', len(self.wrench_full_scale))
        return self
