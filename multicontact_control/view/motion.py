"""The motions that a page can ask for: to a point, and a sine around where the point is."""

from __future__ import annotations

from collections.abc import Sequence
import math

from multicontact_control.algebra import quintic_blend
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.control.tasks import (
    evaluate_sine_motion,
    MotionReading,
    SineConfig,
)
from multicontact_control.supervision.command_limits import check_position, check_twist
import numpy as np

SPEED = 0.10  # m/s, of the way to a goal, or the share of the limit if that is less
ACCELERATION = 0.5  # m/s^2, likewise
APPROACH_RATE = 4.0  # 1/s, at which the rest of the way shrinks
SPEED_RATE = 20.0  # 1/s, at which the speed becomes what it should be
ARRIVED = 1e-5  # m, m/s
LONGEST_STEP = 0.01  # s, in which a motion is worked out
SHARE = 0.5  # of the limits of a commanded motion
SAMPLES = 200  # of a sine, at which its speed is looked at
BLEND_TIME = 1.5  # s, in which a sine comes and goes


class BlendedSine:
    """A sine along a world axis, of an amplitude [m] and a period [s], blended in and out."""

    def __init__(self, axis: str, amplitude: float, period: float) -> None:
        self.name = f'sine along {axis}'
        self._config = SineConfig(
            start_time=0.0, amplitude=amplitude, period=period, blend_time=BLEND_TIME
        )
        self._direction = np.eye(3)['xyz'.index(axis)]
        self.reach = amplitude * self._direction  # to either side [m]
        self._time = 0.0
        self._end = math.inf

    def fade_out(self) -> None:
        """Come to the middle again, and end."""
        self._end = min(self._end, self._time + BLEND_TIME)

    @property
    def largest_rates(self) -> tuple[float, float]:
        """Return its largest speed [m/s] and acceleration [m/s^2], while it comes or stays."""
        times = np.linspace(0.0, BLEND_TIME + self._config.period, SAMPLES)
        values = np.abs([evaluate_sine_motion(self._config, time) for time in times])
        _, speed, acceleration = values.max(axis=0)
        return float(speed), float(acceleration)

    @property
    def has_ended(self) -> bool:
        """Whether it has come to the middle and ended."""
        return self._time >= self._end

    def advance(self, period: float) -> Matrix:
        """Go on for a period [s]; return displacement, velocity and acceleration, shape (3, 3)."""
        self._time += period
        s, ds, dds = evaluate_sine_motion(self._config, self._time)
        # Of the time until the end, which runs backwards.
        b, db, ddb = quintic_blend(self._end - self._time, BLEND_TIME)
        blended = (b * s, b * ds - db * s, b * dds - 2.0 * db * ds + ddb * s)
        return np.outer(blended, self._direction)


class CommandedMotion:
    """
    Where the operational point is to be, period by period, within the workspace of `limits`.

    Its speed never jumps, and its acceleration is bounded, whatever is asked for when.
    """

    def __init__(self, limits: LimitsConfig) -> None:
        self._limits = limits
        self._largest_speed = min(SPEED, SHARE * limits.operational_speed)
        self._largest_acceleration = min(
            ACCELERATION, SHARE * limits.operational_acceleration
        )
        self.start(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    def start(self, position: Vector, quaternion: Vector) -> None:
        """Begin at rest at a pose [m], and ask for nothing."""
        self._quaternion = np.array(quaternion, dtype=float)
        self._place = np.array(position, dtype=float)
        self._goal = self._place.copy()
        self._speed = np.zeros(3)
        self._acceleration = self._largest_acceleration  # at most, of the approach
        # What the last answer of `advance` was.
        self._sent = self._place.copy()
        self._sent_speed = np.zeros(3)
        self._sines: list[BlendedSine] = []
        self._moving = False

    @property
    def what(self) -> str:
        """Return the name of the motion under way, nothing for none."""
        if self._sines:
            return self._sines[-1].name
        return 'going there' if self._moving else ''

    @property
    def goal(self) -> Vector | None:
        """Return where it leads, None where it does not."""
        return self._goal.copy() if self._moving else None

    def go_to(self, position: Sequence[float] | Vector) -> str:
        """Go to a position [m]; CommandError if it is not in the workspace."""
        goal = np.array(position, dtype=float)
        self._check_reach(goal, [np.zeros(3), *(sine.reach for sine in self._sines)])
        self._goal = goal
        self._moving = True
        self._acceleration = self._largest_acceleration
        millimetres = [f'{1e3 * coordinate:.0f}' for coordinate in goal]
        return f'going to {", ".join(millimetres)} mm'

    def _check_reach(self, middle: Vector, reaches: Sequence[Vector]) -> None:
        """Check that motions to either side of a place stay in the workspace; CommandError."""
        for reach in reaches:
            check_position(middle - reach, self._limits)
            check_position(middle + reach, self._limits)

    def jog(self, offset: Sequence[float] | Vector) -> str:
        """Go so far [m] from the goal, or from here; CommandError if that is not allowed."""
        return self.go_to(self._goal + np.array(offset, dtype=float))

    def start_sine(self, axis: str, amplitude: float, period: float) -> str:
        """
        Begin a `BlendedSine` around the goal, and end another.

        CommandError if it reaches too far, or is too fast for the limits beside a way to a goal.
        """
        sine = BlendedSine(axis, amplitude, period)
        speed, acceleration = sine.largest_rates
        twist = np.zeros(6)
        twist[0] = speed + self._largest_speed
        rate = np.zeros(6)
        rate[0] = acceleration + self._largest_acceleration
        check_twist(twist, rate, self._limits)
        self._check_reach(self._goal, [sine.reach])
        for other in self._sines:
            other.fade_out()
        self._sines.append(sine)
        self._moving = True
        return f'{sine.name}, {1e3 * amplitude:g} mm, {period:g} s'

    def stop(self) -> str:
        """Come to rest as near as the acceleration allows to where the point is on its way."""
        self._acceleration = self._largest_acceleration
        for sine in self._sines:
            _, acceleration = sine.largest_rates  # keeps it within the way of the sine
            self._acceleration = max(self._acceleration, acceleration)
        self._place = self._sent.copy()
        self._speed = self._sent_speed.copy()
        self._sines = []
        speed = float(np.linalg.norm(self._speed))
        self._goal = self._place + self._speed * speed / (2.0 * self._acceleration)
        return 'coming to rest'

    def halt(self) -> MotionReading:
        """Be at rest from now on where the last answer of `advance` was; return what says so."""
        self.start(self._sent, self._quaternion)
        return MotionReading(
            self._place.copy(), self._quaternion, np.zeros(6), np.zeros(6)
        )

    def advance(self, period: float) -> MotionReading | None:
        """Return what to command after a period [s], None if nothing changes."""
        if not self._moving:
            return None
        steps = max(1, math.ceil(period / LONGEST_STEP))
        for _ in range(steps):
            change = self._step(period / steps)
        now = np.array([self._place, self._speed, change])
        displacement = np.zeros((3, 3))
        for sine in self._sines:
            displacement += sine.advance(period)
        now += displacement
        self._sines = [sine for sine in self._sines if not sine.has_ended]
        is_on_its_way = np.any(self._place != self._goal) or np.any(self._speed)
        self._moving = bool(self._sines or is_on_its_way)
        self._sent, self._sent_speed, acceleration = now
        at_rest = np.zeros(3)  # the orientation stays
        return MotionReading(
            self._sent,
            self._quaternion,
            np.concatenate([self._sent_speed, at_rest]),
            np.concatenate([acceleration, at_rest]),
        )

    def _step(self, h: float) -> Vector:
        """Approach the goal for a short time [s]; return the acceleration."""
        way = self._goal - self._place
        speed = _limit_length(APPROACH_RATE * way, self._largest_speed)
        change = _limit_length(SPEED_RATE * (speed - self._speed), self._acceleration)
        self._place += h * self._speed + 0.5 * h * h * change
        self._speed += h * change
        if np.abs(way).max() < ARRIVED and np.abs(self._speed).max() < ARRIVED:
            self._place = self._goal.copy()
            self._speed = np.zeros(3)
            return np.zeros(3)
        return change


def _limit_length(vector: Vector, largest: float) -> Vector:
    size = float(np.sqrt(vector @ vector))
    return vector if size <= largest else vector * (largest / size)
