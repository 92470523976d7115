"""The motions that a page can ask for: to a point, and a sine around where the point is."""

from __future__ import annotations

from collections.abc import Sequence
import math

from multicontact_control.arrays import Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.control.tasks import MotionReading, quintic
from multicontact_control.errors import CommandError
from multicontact_control.supervision.command_limits import check_position
import numpy as np

SPEED = 0.10  # m/s, of the way to a goal
ACCELERATION = 0.5  # m/s^2
APPROACH_RATE = 4.0  # 1/s, at which the rest of the way shrinks
SPEED_RATE = 20.0  # 1/s, at which the speed becomes what it should be
ARRIVED = 1e-5  # m, m/s
BLEND_TIME = 1.5  # s, in which a sine comes and goes
LONGEST, SHORTEST = 60.0, 2.0  # s, of the period of a sine
AXES = {'x': (1.0, 0.0, 0.0), 'y': (0.0, 1.0, 0.0), 'z': (0.0, 0.0, 1.0)}


class Sine:
    """
    A sine along a world axis, blended in and out.

    Parameters
    ----------
    axis
        One of x, y, z.
    amplitude
        [m].
    period
        [s].

    Raises
    ------
    CommandError
        If a value is out of its range.

    """

    def __init__(self, axis: str, amplitude: float, period: float) -> None:
        if axis not in AXES:
            raise CommandError('axis', 'x, y or z', f"'{axis}'")
        if not 0.0 < amplitude <= 0.3:
            raise CommandError('amplitude', 'above 0 to 0.3 m', f'{amplitude:g} m')
        if not SHORTEST <= period <= LONGEST:
            raise CommandError('period', f'{SHORTEST:g} to {LONGEST:g} s', f'{period:g} s')
        self.name = f'sine along {axis}'
        self._w, self._way = 2.0 * math.pi / period, amplitude * np.array(AXES[axis])
        self._time = 0.0
        self._fading: float | None = None

    @property
    def ends(self) -> tuple[Vector, Vector]:
        """Return both ends, relative to its middle [m]."""
        return -self._way, self._way

    def fade(self) -> None:
        """Come to the middle again, and end."""
        if self._fading is None:
            self._fading = 0.0

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self._fading is not None and self._fading >= BLEND_TIME

    def advance(self, period: float) -> tuple[Vector, Vector, Vector]:
        """Go on for a period [s]; return displacement, velocity and acceleration, shape (3,)."""
        self._time += period
        b, db, ddb = quintic(self._time, BLEND_TIME)
        if self._fading is not None:
            self._fading += period
            rise, rate, change = quintic(self._fading, BLEND_TIME)
            f, df, ddf = 1.0 - rise, -rate, -change
            b, db, ddb = b * f, db * f + b * df, ddb * f + 2.0 * db * df + b * ddf
        w = self._w
        p, dp = math.sin(w * self._time), w * math.cos(w * self._time)
        return (b * p * self._way, (db * p + b * dp) * self._way,
                (ddb * p + 2.0 * db * dp - b * w * w * p) * self._way)


class Motion:
    """
    Where the operational point is to be, period by period.

    Its speed never jumps, and its acceleration is bounded, whatever is asked for when.

    Parameters
    ----------
    limits
        With the workspace box.
    period
        Between two calls of `advance` [s].

    """

    def __init__(self, limits: LimitsConfig, period: float) -> None:
        self._limits, self._period = limits, period
        self.start(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    def start(self, position: Vector, quaternion: Vector) -> None:
        """Begin at rest at a pose [m], and ask for nothing."""
        self._quaternion = np.array(quaternion, dtype=float)
        self._place = np.array(position, dtype=float)
        self._goal, self._speed = self._place.copy(), np.zeros(3)
        self._sent = self._place.copy()
        self._patterns: list[Sine] = []
        self._moving = False

    @property
    def what(self) -> str:
        """Say what motion is being made, nothing for none."""
        if self._patterns:
            return self._patterns[-1].name
        return 'going there' if self._moving else ''

    @property
    def goal(self) -> Vector | None:
        """Return where it leads, None where it does not."""
        return self._goal.copy() if self._moving else None

    def go_to(self, position: Sequence[float]) -> str:
        """Go to a position [m]; CommandError if it is not in the workspace."""
        goal = np.array(position, dtype=float)
        if goal.shape != (3,) or not np.isfinite(goal).all():
            raise CommandError('position', 'three finite numbers', list(position))
        for offset in self._reach():
            check_position(goal + offset, self._limits)
        self._goal, self._moving = goal, True
        return f'going to {", ".join(f"{1e3 * x:.0f}" for x in goal)} mm'

    def jog(self, offset: Sequence[float]) -> str:
        """Go so far [m] from the goal, or from here; CommandError if that is not allowed."""
        return self.go_to((self._goal + np.array(offset, dtype=float)).tolist())

    def start_pattern(self, axis: str, amplitude: float, period: float) -> str:
        """Begin a `Sine` around the goal, and end another; CommandError as for that and `jog`."""
        pattern = Sine(axis, amplitude, period)
        for end in pattern.ends:
            check_position(self._goal + end, self._limits)
        for other in self._patterns:
            other.fade()
        self._patterns.append(pattern)
        self._moving = True
        return f'{pattern.name}, {1e3 * amplitude:g} mm, {period:g} s'

    def stop(self) -> str:
        """Come to rest: at the middle of a sine, or where the point is on its way."""
        for pattern in self._patterns:
            pattern.fade()
        brake = self._speed / (2.0 * APPROACH_RATE)
        self._goal = self._place + brake
        return 'coming to rest'

    def halt(self) -> MotionReading:
        """Be at rest from now on where the last answer of `advance` was; return what says so."""
        self.start(self._sent, self._quaternion)
        return MotionReading(self._place.copy(), self._quaternion, np.zeros(6), np.zeros(6))

    def accepted(self, position: Vector) -> None:
        """Take note of what became of the last answer: contacts keep the point along normals."""
        gap = position - self._sent
        size = float(np.sqrt(gap @ gap))
        if size < 1e-9:
            return
        along = gap / size
        self._place += gap
        self._goal -= along * (along @ (self._goal - self._place))
        self._speed -= along * (along @ self._speed)
        self._sent = np.array(position)

    def advance(self) -> MotionReading | None:
        """Return what to command for the next period, None if nothing changes."""
        if not self._moving:
            return None
        h = self._period
        way = self._goal - self._place
        wanted = _bounded(APPROACH_RATE * way, SPEED)
        change = _bounded(SPEED_RATE * (wanted - self._speed), ACCELERATION)
        self._place += h * self._speed + 0.5 * h * h * change
        self._speed += h * change
        if np.abs(way).max() < ARRIVED and np.abs(self._speed).max() < ARRIVED:
            self._place, self._speed, change = self._goal.copy(), np.zeros(3), np.zeros(3)
        position, speed, rate = self._place.copy(), self._speed.copy(), change
        for pattern in self._patterns:
            p, dp, ddp = pattern.advance(h)
            position, speed, rate = position + p, speed + dp, rate + ddp
        self._patterns = [pattern for pattern in self._patterns if not pattern.over]
        self._moving = bool(self._patterns) or bool(np.any(self._place != self._goal)) or (
            bool(np.any(self._speed)))
        self._sent = position
        none = np.zeros(3)
        return MotionReading(position, self._quaternion, np.concatenate([speed, none]),
                             np.concatenate([rate, none]))

    def _reach(self) -> list[Vector]:
        """Return how far patterns go from the goal."""
        return [end for pattern in self._patterns for end in pattern.ends] or [np.zeros(3)]


def _bounded(vector: Vector, largest: float) -> Vector:
    size = float(np.sqrt(vector @ vector))
    return vector if size <= largest else vector * (largest / size)
