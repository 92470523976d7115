"""The parameters of the push test."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Literal

from multicontact_control.arrays import Matrix
from multicontact_control.config import Config, cross_check, parameter, Real
from multicontact_control.errors import ConfigError
import numpy as np

# What a test must find: nothing, a flipped sign, a quarter turn, half the scale.
SENSOR_FAULTS = ('none', 'sign', 'rotate', 'scale')

Direction = Literal['+x', '-x', '+y', '-y', '+z', '-z']


class PushTestConfig(Config):
    """How the tool is pushed, and what is accepted as right."""

    directions: tuple[Direction, ...] = parameter(
        ('+x', '+y', '+z'), 'World axes along which the tool is pushed, each axis at least once.')
    force: Real = parameter(
        10.0, 'Force of every push, by a spring balance or a known weight.', unit='N', gt=0.0)
    detect_force: Real = parameter(
        2.0, 'Change of force that counts as the beginning of a push.', unit='N', gt=0.0)
    release_force: Real = parameter(
        1.0, 'Change of force below which the push is over.', unit='N', gt=0.0)
    rest_time: Real = parameter(
        0.3, 'Time of rest, before the pushes and after each.', unit='s', gt=0.0)
    settle_time: Real = parameter(
        0.3, 'Time of a push before it is measured.', unit='s', ge=0.0)
    hold_time: Real = parameter(0.3, 'Time over which a push is averaged.', unit='s', gt=0.0)
    timeout: Real = parameter(
        30.0, 'Longest wait for rest, for a push or for its end.', unit='s', gt=0.0)
    max_rest_std: Real = parameter(
        0.5, 'Largest standard deviation of a force axis at rest.', unit='N', gt=0.0)
    max_rest_force: Real = parameter(
        1.0, 'Largest force read with nothing touching the tool.', unit='N', gt=0.0)
    max_angle: Real = parameter(
        0.35, 'Largest angle between a push and its reading; a hand is good for 0.2.',
        unit='rad', gt=0.0, le=0.7)
    scale_tolerance: Real = parameter(
        0.2, 'Largest deviation of the scale from 1.', gt=0.0, le=0.4)
    moment_tolerance: Real = parameter(
        0.3, 'Largest deviation of a moment from that of the force, relative to it.',
        gt=0.0, le=0.9)
    min_moment: Real = parameter(
        0.5, 'Moment of a push from which its torque channels are checked.', unit='N m', gt=0.0)

    @cross_check
    def _check_across_fields(self) -> Iterator[ConfigError]:
        if {direction[1] for direction in self.directions} != set('xyz'):
            yield ConfigError(
                'push_test.directions', 'each of x, y and z at least once', list(self.directions))
        if not self.release_force <= self.detect_force < self.force:
            yield ConfigError(
                'push_test.detect_force',
                f'from release_force {self.release_force:g} N to below force {self.force:g} N',
                f'{self.detect_force:g} N')

    @property
    def directions_world(self) -> Matrix:
        """Return the unit vectors of the pushes, world axes, shape (p, 3)."""
        return np.array([
            math.copysign(1.0, float(f'{direction[0]}1')) * np.eye(3)['xyz'.index(direction[1])]
            for direction in self.directions])
