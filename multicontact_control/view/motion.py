"""The motions that a page can ask for: to a point, and a sine around where the point is."""

from __future__ import annotations

from collections.abc import Sequence
import math

from multicontact_control.algebra import quintic_blend
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.control.motions import evaluate_sine_motion, SineConfig
from multicontact_control.control.tasks import MotionReading
from multicontact_control.control.trajectory_checks import check_position
from multicontact_control.supervision.command_limits import check_twist
import numpy as np

# m/s, of the way to a goal, or the share of the limit if that is less.
USUAL_SPEED = 0.10
USUAL_ACCELERATION = 0.5  # m/s^2, likewise
APPROACH_RATE = 4.0  # 1/s, at which the rest of the way shrinks
SPEED_RATE = 20.0  # 1/s, at which the speed becomes what it should be
ARRIVAL_TOLERANCE = 1e-5  # m from the goal, and m/s
LONGEST_STEP = 0.01  # s, in which a motion is worked out
LIMIT_SHARE = 0.5  # of the limits of a commanded motion
SINE_SAMPLES = 200  # of a sine, at which its speed is looked at
BLEND_TIME = 1.5  # s, in which a sine comes and goes


class BlendedSine:
    """
    A sine along a world axis, blended in and out in `BLEND_TIME`.

    Parameters
    ----------
    axis
        World axis: x, y or z.
    amplitude
        Largest displacement [m].
    period
        Period of the sine [s].

    Attributes
    ----------
    name
        What it is, for the user.
    reach
        Largest displacement to either side, world axes, shape (3,) [m].

    """

    def __init__(self, axis: str, amplitude: float, period: float) -> None:
        self.name = f'sine along {axis}'
        self._config = SineConfig(
            start_time=0.0, amplitude=amplitude, period=period, blend_time=BLEND_TIME
        )
        self._direction = np.eye(3)['xyz'.index(axis)]
        self.reach = amplitude * self._direction
        self._time = 0.0
        self._end = math.inf

    def fade_out(self) -> None:
        """Come back to the middle in `BLEND_TIME` from now, and end."""
        self._end = min(self._end, self._time + BLEND_TIME)

    @property
    def largest_rates(self) -> tuple[float, float]:
        """Return the largest speed [m/s] and acceleration [m/s^2] while it blends in or stays."""
        times = np.linspace(0.0, BLEND_TIME + self._config.period, SINE_SAMPLES)
        values = np.abs([evaluate_sine_motion(self._config, time) for time in times])
        _, speed, acceleration = values.max(axis=0)
        return float(speed), float(acceleration)

    @property
    def has_ended(self) -> bool:
        """Whether it has come back to the middle, so that it moves nothing any more."""
        return self._time >= self._end

    def advance(self, period: float) -> Matrix:
        """
        Go on for a period [s].

        Returns
        -------
        Matrix
            Displacement from the middle [m], its velocity [m/s] and its acceleration [m/s^2] in
            world axes, a row each, shape (3, 3).

        """
        self._time += period
        s, ds, dds = evaluate_sine_motion(self._config, self._time)
        # Of the time until the end, which runs backwards: the odd derivatives change their signs.
        b, db, ddb = quintic_blend(self._end - self._time, BLEND_TIME)
        displacement = b * s
        speed = b * ds - db * s
        acceleration = b * dds - 2.0 * db * ds + ddb * s
        return np.outer((displacement, speed, acceleration), self._direction)


class CommandedMotion:
    """
    Where the operational point is to be, period by period, on the way to goals and along sines.

    Its speed never jumps, and its acceleration is bounded, whatever is asked for when. The
    orientation stays.

    Parameters
    ----------
    limits
        Limits of the controller: it stays in their workspace, at `LIMIT_SHARE` of their speed and
        acceleration at most.

    """

    def __init__(self, limits: LimitsConfig) -> None:
        self._limits = limits
        self._largest_speed = min(USUAL_SPEED, LIMIT_SHARE * limits.operational_speed)
        self._largest_acceleration = min(
            USUAL_ACCELERATION, LIMIT_SHARE * limits.operational_acceleration
        )
        self.start(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    def start(self, position: Vector, quaternion: Vector) -> None:
        """
        Begin at rest at a pose, and ask for nothing.

        Parameters
        ----------
        position, quaternion
            Pose of the operational frame in world axes: shape (3,) [m]; scalar last, shape (4,).

        """
        self._quaternion = np.array(quaternion, dtype=float)
        # On the way to the goal, sines aside.
        self._place = np.array(position, dtype=float)
        self._velocity = np.zeros(3)
        self._goal = self._place.copy()
        self._acceleration_limit = self._largest_acceleration
        # What the last answer of `advance` was.
        self._sent_place = self._place.copy()
        self._sent_velocity = np.zeros(3)
        self._sines: list[BlendedSine] = []
        self._moving = False

    @property
    def name(self) -> str:
        """Return the name of the motion under way, empty at rest."""
        if self._sines:
            return self._sines[-1].name
        return 'going there' if self._moving else ''

    @property
    def goal(self) -> Vector | None:
        """Return where the motion leads, world axes, shape (3,) [m]; None at rest."""
        return self._goal.copy() if self._moving else None

    def go_to(self, position: Sequence[float] | Vector) -> str:
        """
        Go to a position in world axes [m], and say so in words; sines go along.

        Raises
        ------
        CommandError
            If the position, or a sine around it, is not in the workspace.

        """
        goal = np.array(position, dtype=float)
        self._check_reach(goal, [np.zeros(3), *(sine.reach for sine in self._sines)])
        self._goal = goal
        self._moving = True
        self._acceleration_limit = self._largest_acceleration
        millimetres = [f'{1e3 * coordinate:.0f}' for coordinate in goal]
        return f'going to {", ".join(millimetres)} mm'

    def _check_reach(self, middle: Vector, reaches: Sequence[Vector]) -> None:
        """Check that motions to either side of a place stay in the workspace; CommandError."""
        for reach in reaches:
            check_position(middle - reach, self._limits)
            check_position(middle + reach, self._limits)

    def jog(self, offset: Sequence[float] | Vector) -> str:
        """Go by an offset in world axes [m] from the goal; see `go_to`."""
        return self.go_to(self._goal + offset)

    def start_sine(self, axis: str, amplitude: float, period: float) -> str:
        """
        Begin a `BlendedSine` around the goal, end another, and say so in words.

        Raises
        ------
        CommandError
            If it leads out of the workspace, or is too fast for the limits together with a way to
            a goal.

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
        """
        Come to rest as near as the acceleration allows to where the point is on its way.

        A sine may be braked with its own largest acceleration, which keeps the point within its
        way.
        """
        limit = self._largest_acceleration
        for sine in self._sines:
            _, acceleration = sine.largest_rates
            limit = max(limit, acceleration)
        self._acceleration_limit = limit
        self._place = self._sent_place.copy()
        self._velocity = self._sent_velocity.copy()
        self._sines = []
        speed = float(np.linalg.norm(self._velocity))
        self._goal = self._place + self._velocity * speed / (2.0 * limit)
        return 'coming to rest'

    def halt(self) -> MotionReading:
        """Be at rest from now on where the last answer of `advance` was; return that pose."""
        self.start(self._sent_place, self._quaternion)
        at_rest = np.zeros(6)
        return MotionReading(self._place.copy(), self._quaternion, at_rest, at_rest)

    def advance(self, period: float) -> MotionReading | None:
        """
        Return what to command after a period.

        Parameters
        ----------
        period
            Time since the call before [s], worked out in steps of `LONGEST_STEP` at most.

        Returns
        -------
        MotionReading or None
            Pose, twist and acceleration of the operational frame; None at rest, when nothing
            changes.

        """
        if not self._moving:
            return None
        steps = max(1, math.ceil(period / LONGEST_STEP))
        for _ in range(steps):
            approach_acceleration = self._approach_goal(period / steps)
        displacements = np.zeros((3, 3))
        for sine in self._sines:
            displacements += sine.advance(period)
        approach = np.array([self._place, self._velocity, approach_acceleration])
        place, velocity, acceleration = approach + displacements
        self._sent_place = place
        self._sent_velocity = velocity
        self._sines = [sine for sine in self._sines if not sine.has_ended]
        is_on_its_way = np.any(self._place != self._goal) or np.any(self._velocity)
        self._moving = bool(self._sines or is_on_its_way)
        no_turn = np.zeros(3)
        twist = np.concatenate([velocity, no_turn])
        twist_rate = np.concatenate([acceleration, no_turn])
        return MotionReading(place, self._quaternion, twist, twist_rate)

    def _approach_goal(self, h: float) -> Vector:
        """Approach the goal for a short time [s]; return the acceleration, shape (3,)."""
        way = self._goal - self._place
        desired_velocity = _limit_length(APPROACH_RATE * way, self._largest_speed)
        acceleration = _limit_length(
            SPEED_RATE * (desired_velocity - self._velocity), self._acceleration_limit
        )
        self._place += h * self._velocity + 0.5 * h * h * acceleration
        self._velocity += h * acceleration
        is_near = np.abs(way).max() < ARRIVAL_TOLERANCE
        if is_near and np.abs(self._velocity).max() < ARRIVAL_TOLERANCE:
            self._place = self._goal.copy()
            self._velocity = np.zeros(3)
            return np.zeros(3)
        return acceleration


def _limit_length(vector: Vector, largest: float) -> Vector:
    length = float(np.sqrt(vector @ vector))
    if length <= largest:
        return vector
    return vector * (largest / length)
