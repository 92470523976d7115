"""
A guided test that proves the sensor's sign, frame and scale before force control is enabled.

Rest, then one push per direction: the user is told which, pushes, holds, lets go. No command to
the arm comes from here; hold it still meanwhile, by anything but force control.
"""

from __future__ import annotations

from enum import Enum

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.sensor.push_config import DETECT_FORCE, PushTestConfig, RELEASE_FORCE
from multicontact_control.sensor.push_verdict import failed, judge_pushes, PushTestResult
import numpy as np


class PushPhase(Enum):
    """What the test waits for."""

    REST = 'rest'
    PUSH = 'push'
    RELEASE = 'release'
    DONE = 'done'


class PushTest:
    """
    The state of a push test, advanced by one compensated wrench per tick.

    Parameters
    ----------
    config
        Directions, force, times and tolerances.
    rate
        Rate of the wrenches [Hz].
    sensor_rotation_world
        Orientation of the sensor, shape (3, 3), so that the result is in its axes.
    lever_world
        From the operational point to where the tool is pushed, world axes, shape (3,) [m], so
        that the torque channels are checked as well; None to check forces only.

    Attributes
    ----------
    phase
        What it waits for.
    result
        The verdict, None until it is done.

    """

    def __init__(
        self, config: PushTestConfig, rate: float, *,
        sensor_rotation_world: Matrix | None = None, lever_world: Vector | None = None,
    ) -> None:
        self._config = config
        self._sensor_rotation, self._lever = sensor_rotation_world, lever_world
        self._rest_ticks = max(2, round(config.rest_time * rate))
        self._settle_ticks = round(config.settle_time * rate)
        self._hold_ticks = max(1, round(config.hold_time * rate))
        self._timeout_ticks = max(1, round(config.timeout * rate))
        self._rest = np.zeros(6)
        self._pushes: list[Vector] = []
        self.result: PushTestResult | None = None
        self._samples: list[Vector] = []
        self._enter(PushPhase.REST)

    @property
    def direction(self) -> str | None:
        """Direction to push in now, e.g. ``+x``; None if it is not time to push."""
        if self.phase is PushPhase.PUSH:
            return self._config.directions[len(self._pushes)]
        return None

    @property
    def instruction(self) -> str:
        """Say what the user should do now."""
        if self.result is not None:
            return self.result.message
        if self.phase is PushPhase.PUSH:
            return (f'push the tool along world {self.direction} with {self._config.force:g} N '
                    'and hold')
        return 'let go of the tool' if self.phase is PushPhase.RELEASE else (
            'keep off the tool')

    def update(self, wrench_world: Vector) -> PushPhase:
        """
        Take the next wrench, and return what the test waits for from now on.

        Parameters
        ----------
        wrench_world
            What `contact_wrench` makes of a reading: bias and weight taken off, world axes, at
            the operational point, force first, shape (6,) [N, N m].

        """
        require_shape('wrench_world', wrench_world, (6,))
        if self.result is not None:
            return self.phase
        self._ticks += 1
        if not np.isfinite(wrench_world).all():
            self._finish(failed('a reading that is not a finite number'))
        elif self._ticks > self._timeout_ticks:
            self._finish(failed(self._missed()))
        elif self.phase is PushPhase.REST:
            self._wait_for_rest(wrench_world)
        elif self.phase is PushPhase.PUSH:
            self._wait_for_push(wrench_world)
        else:
            self._wait_for_release(wrench_world)
        return self.phase

    def _wait_for_rest(self, wrench: Vector) -> None:
        self._samples.append(wrench.copy())
        if len(self._samples) < self._rest_ticks:
            return
        if np.std(self._samples, axis=0)[:3].max() <= self._config.max_rest_std:
            self._rest = np.mean(self._samples, axis=0)
            self._enter(PushPhase.PUSH)
        self._samples = []

    def _wait_for_push(self, wrench: Vector) -> None:
        if self._change(wrench) < DETECT_FORCE:
            self._samples = []  # not yet, or let go too soon
            return
        self._samples.append(wrench.copy())
        if len(self._samples) == self._settle_ticks + self._hold_ticks:
            self._pushes.append(np.mean(self._samples[self._settle_ticks:], axis=0))
            self._enter(PushPhase.RELEASE)

    def _wait_for_release(self, wrench: Vector) -> None:
        self._samples.append(wrench.copy())
        if self._change(wrench) >= RELEASE_FORCE:
            self._samples = []
        elif len(self._samples) == self._rest_ticks:
            if len(self._pushes) < len(self._config.directions):
                self._enter(PushPhase.PUSH)
                return
            self._finish(judge_pushes(
                np.array(self._pushes), self._rest, self._config,
                sensor_rotation_world=self._sensor_rotation, lever_world=self._lever))

    def _change(self, wrench: Vector) -> float:
        """Return by how much the force differs from that at rest [N]."""
        return float(np.linalg.norm(wrench[:3] - self._rest[:3]))

    def _missed(self) -> str:
        """Return what did not come in time."""
        seconds = f'within {self._config.timeout:g} s'
        if self.phase is PushPhase.REST:
            return f'no rest {seconds}: the force never kept still'
        if self.phase is PushPhase.PUSH:
            return (f'no push along {self.direction} of more than {DETECT_FORCE:g} N felt '
                    f'{seconds}')
        return f'the force did not return to that at rest {seconds} after the push'

    def _enter(self, phase: PushPhase) -> None:
        self.phase = phase
        self._ticks = 0
        self._samples = []

    def _finish(self, result: PushTestResult) -> None:
        self.result = result
        self._enter(PushPhase.DONE)
