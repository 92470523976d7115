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

DETECT_FORCE = 2.0  # N, change of force that counts as the beginning of a push
RELEASE_FORCE = 1.0  # N, change of force below which a push is over
MAX_ANGLE = 0.35  # rad between a push and its reading; a hand is good for 0.2

Direction = Literal['+x', '-x', '+y', '-y', '+z', '-z']


class PushTestConfig(Config):
    """How the tool is pushed, and what is accepted as right."""

    directions: tuple[Direction, ...] = parameter(
        ('+x', '+y', '+z'), 'World axes along which the tool is pushed, each axis at least once.')
    force: Real = parameter(
        10.0, 'Force of every push, by a spring balance or a known weight.', unit='N',
        gt=DETECT_FORCE)
    rest_time: Real = parameter(
        0.3, 'Time of rest, before the pushes and after each.', unit='s', gt=0.0)
    settle_time: Real = parameter(
        0.3, 'Time of a push before it is measured.', unit='s', ge=0.0)
    hold_time: Real = parameter(0.3, 'Time over which a push is averaged.', unit='s', gt=0.0)
    timeout: Real = parameter(
        30.0, 'Longest wait for rest, for a push or for its end.', unit='s', gt=0.0)
    max_rest_std: Real = parameter(
        0.5, 'Largest standard deviation of a force axis at rest.', unit='N', gt=0.0)
    scale_tolerance: Real = parameter(
        0.2, 'Largest deviation of the scale from 1.', gt=0.0, le=0.4)

    @cross_check
    def _check_across_fields(self) -> Iterator[ConfigError]:
        if {direction[1] for direction in self.directions} != set('xyz'):
            yield ConfigError(
                'push_test.directions', 'each of x, y and z at least once', list(self.directions))

    @property
    def directions_world(self) -> Matrix:
        """Return the unit vectors of the pushes, world axes, shape (p, 3)."""
        return np.array([
            math.copysign(1.0, float(f'{direction[0]}1')) * np.eye(3)['xyz'.index(direction[1])]
            for direction in self.directions])
