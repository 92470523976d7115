"""
Paths of the operational point through timed poses, kept within limits by slowing down.

A trajectory has pieces, one between each pair of neighbouring points. Position and turn of a
piece are polynomials of degree 5 in its own time, so that speed and acceleration go on from piece
to piece; to evaluate one takes the polynomials of one piece.
"""

from __future__ import annotations

from bisect import bisect_right
import math
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.control.trajectory_checks import (
    AXES,
    TimedPoses,
    turns_between,
)
from multicontact_control.dynamics.rotation_vectors import (
    find_rotation_vector_rates,
    turn_by_rotation_vector,
)
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

# Peaks of b' and b'' of a quintic over a duration of 1.
QUINTIC_SPEED = 15.0 / 8.0
QUINTIC_ACCELERATION = 10.0 / math.sqrt(3.0)
# s, in which a path that does not begin or end at rest is started or stopped.
RAMP_TIME = 0.5
# The largest rate of a ramp's speed, over a duration and to a speed of 1.
RAMP_RATE = 1.5
# Of the limits, with which the arm goes to a first point without a time.
LEAD_IN_SHARE = 0.2
# m beyond the workspace box, that a spline may swing between its points.
BOX_MARGIN = 1e-3
# s, in which a trajectory stops, or goes on, where the arm cannot follow.
PACE_TIME = 0.2
REST_SPEED = 1e-9  # m/s or rad/s, below which an end of a path is at rest
NO_WAY = 1e-9  # m or rad, up to which the arm is at the first point already
# How much longer than asked for a path may take; beyond, its times are taken for a mistake.
LARGEST_SLOWDOWN = 100.0
LIMIT_SHARE = 0.99  # of a limit, for what lies between the instants that are looked at
INSTANTS = 13  # of each piece, that are looked at
RAMP_INSTANTS = 301  # of a ramp, between which its inverse is interpolated


class PathState(NamedTuple):
    """Where a path is at one time, in world axes, and how it moves there."""

    pose: Pose
    twist_world: Vector  # linear first, shape (6,) [m/s, rad/s]
    acceleration_world: Vector  # shape (6,) [m/s^2, rad/s^2]


class RampedTime(NamedTuple):
    """
    The time along a path that is started and stopped smoothly.

    It advances by 0 to 1 seconds in each second. A start that lasts t_r takes it t_r / 2 forwards,
    with the rate 3 x^2 - 2 x^3, x = t / t_r; the stop is its mirror image.
    """

    length: float  # of the path, in its own time [s]
    start: float  # duration of the start, at most `length` [s]
    stop: float  # duration of the stop [s]

    @property
    def duration(self) -> float:
        """Return how long it takes along the whole path [s]."""
        return self.length + 0.5 * (self.start + self.stop)

    def advance(self, time: float) -> tuple[float, float, float]:
        """Return the time along the path [s], its rate, and how fast this changes [1/s]."""
        if time <= 0.0:
            return 0.0, 0.0, 0.0
        remaining = self.duration - time
        if remaining <= 0.0:
            return self.length, 0.0, 0.0
        if time < self.start:
            way, rate, change = _advance_ramp(time, self.start)
            return way, rate, change
        if remaining < self.stop:
            way, rate, change = _advance_ramp(remaining, self.stop)
            return self.length - way, rate, -change
        return time - 0.5 * self.start, 1.0, 0.0

    def find_times(self, path_times: Vector) -> Vector:
        """Return when times along the path are reached, shape (k,) [s]."""
        shares = np.linspace(0.0, 1.0, RAMP_INSTANTS)
        stops = self.duration - self.stop * shares[::-1]
        times = np.concatenate([self.start * shares, stops])
        reached = [self.advance(time)[0] for time in times.tolist()]
        return np.interp(path_times, reached, times)


def _advance_ramp(time: float, duration: float) -> tuple[float, float, float]:
    """Return way, rate and its change of a start after a time; see `RampedTime`."""
    x = time / duration
    way = duration * x**3 * (1.0 - 0.5 * x)
    return way, x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / duration


class Trajectory:
    """
    A way from a pose at rest to the first of some timed poses, and through all of them to rest.

    The arm goes straight to the first point and rests there: in the time of this point, or longer
    where the limits ask for it; at time 0, with a fifth of the limits. From there on the points
    are passed at their times. Between them goes a cubic spline of natural ends; where twists are
    given, a quintic with these twists, whose accelerations at inner points are the means of what
    cubics on both sides have, and 0 at the ends. An end that is not at rest is ramped over half a
    second, which the points after the first are passed half of that later. A path that is too fast
    for the limits is slowed down as a whole.

    Parameters
    ----------
    start
        Pose of the operational frame at rest that it begins from.
    points
        Which `check_points` accepts.
    limits
        Those of the operational point.

    Attributes
    ----------
    duration
        From start to rest [s].
    passing_times
        When each point is passed, shape (k,) [s].
    slowdown
        How many times longer the path takes than was asked for, at least 1.

    Raises
    ------
    CommandError
        If the path would have to be slowed down a hundredfold; it names the point.

    """

    def __init__(self, start: Pose, points: TimedPoses, limits: LimitsConfig) -> None:
        self._beginnings: list[float] = []  # of the pieces, in path time [s]
        # Of the powers 0 to 5, for position and rotation vector.
        self._coefficients: list[Matrix] = []
        self._rotations: list[Matrix] = []  # at the beginning of each piece
        first_time = float(points.times[0])
        first_pose = Pose.from_quaternion(
            points.positions_world[0], points.quaternions_xyzw[0]
        )
        self._lead_in = self._add_lead_in(start, first_pose, first_time, limits)
        self._clock = RampedTime(0.0, 0.0, 0.0)
        self.slowdown = 1.0
        if len(points.times) > 1:
            self._add_path(points, limits)
        self._turning = [bool(piece[:, 3:].any()) for piece in self._coefficients]
        self._polynomials = [_add_derivatives(piece) for piece in self._coefficients]
        self.duration = self._lead_in + self.slowdown * self._clock.duration
        passed = self._clock.find_times(points.times - first_time)
        self.passing_times: Vector = self._lead_in + self.slowdown * passed

    def _add_lead_in(
        self, start: Pose, goal: Pose, time: float, limits: LimitsConfig
    ) -> float:
        """Add the way to the first point as the first piece; return how long it takes [s]."""
        way = start.displacement_to(goal)
        duration = max(time, shortest_motion_duration(way, limits))
        if time == 0.0:
            duration /= LEAD_IN_SHARE
        if np.abs(way).max() <= NO_WAY:
            duration = time
        duration = max(duration, NO_WAY)
        turn = way[3:] @ start.rotation_world  # in the frame that it begins in
        rest = np.zeros((1, 6))
        coefficients = quintic_coefficients(
            np.array([duration]),
            (
                np.concatenate([start.position_world, np.zeros(3)])[np.newaxis],
                rest,
                rest,
            ),
            (np.concatenate([goal.position_world, turn])[np.newaxis], rest, rest),
        )
        self._beginnings.append(-duration)
        self._coefficients.append(coefficients[0])
        self._rotations.append(start.rotation_world)
        return duration

    def _add_path(self, points: TimedPoses, limits: LimitsConfig) -> None:
        """Add the pieces between the points, and find how slow the limits ask for."""
        times = points.times - points.times[0]
        durations = np.diff(times)
        rotations = Rotation.from_quat(points.quaternions_xyzw)
        matrices = rotations.as_matrix()
        turns = turns_between(rotations)
        ways = np.empty((len(durations), 6))
        ways[:, :3] = np.diff(points.positions_world, axis=0)
        ways[:, 3:] = rotations[:-1].apply(turns)
        if points.twists_world is None:
            twists, accelerations = _spline_derivatives(times, points, rotations)
        else:
            twists = points.twists_world
            accelerations = _mean_accelerations(durations, ways, twists)
        start_rates = _turn_into_frames(twists[:-1], matrices[:-1])
        start_changes = _turn_into_frames(accelerations[:-1], matrices[:-1])
        end_rates = _turn_into_frames(twists[1:], matrices[:-1])
        end_changes = _turn_into_frames(accelerations[1:], matrices[:-1])
        for turn, rate, change in zip(turns, end_rates[:, 3:], end_changes[:, 3:]):
            if turn.any():
                rate[:], change[:] = find_rotation_vector_rates(turn, rate, change)
        starts = np.zeros_like(ways)
        starts[:, :3] = points.positions_world[:-1]
        ends = np.hstack([points.positions_world[1:], turns])
        coefficients = quintic_coefficients(
            durations,
            (starts, start_rates, start_changes),
            (ends, end_rates, end_changes),
        )
        self._beginnings += times[:-1].tolist()
        self._coefficients += list(coefficients)
        self._rotations += list(matrices[:-1])
        length = float(times[-1])
        ramps = []
        for twist in (twists[0], twists[-1]):
            at_rest = np.abs(twist).max() <= REST_SPEED
            if at_rest:
                ramps.append(0.0)
            else:
                ramps.append(min(RAMP_TIME, length))
        self._clock = RampedTime(length, *ramps)
        self.slowdown = self._find_slowdown(coefficients, times, limits)

    def _find_slowdown(
        self, coefficients: Matrix, times: Vector, limits: LimitsConfig
    ) -> float:
        """Return by how much the path is to be slowed down for the limits, at least 1."""
        durations = np.diff(times)
        shares = np.linspace(0.0, 1.0, INSTANTS)
        x = durations[:, np.newaxis] * shares  # shape (k - 1, INSTANTS)
        powers = np.stack([x**power for power in range(6)], axis=-1)
        polynomials = np.array([_add_derivatives(piece) for piece in coefficients])
        values, rates, changes = np.split(powers @ polynomials, 3, axis=-1)
        clock = self._clock
        path_times = times[:-1, np.newaxis] + x
        ramp_rates = np.zeros_like(x)
        for duration, is_ramped in (
            (clock.start, path_times < 0.5 * clock.start),
            (clock.stop, clock.length - path_times < 0.5 * clock.stop),
        ):
            if duration > 0.0:
                ramp_rates[is_ramped] = RAMP_RATE / duration
        speed, turn = _sizes(rates)
        acceleration, turn_acceleration = _sizes(changes)
        acceleration += ramp_rates * speed
        # The Jacobian of a rotation vector is none longer than 1, and its rate is bounded.
        angle = _sizes(values)[1]
        turn_acceleration += ramp_rates * turn + 0.5 * angle * turn**2
        needed = np.maximum(
            np.maximum(
                speed / limits.operational_speed, turn / limits.operational_turn
            ),
            np.sqrt(
                np.maximum(
                    acceleration / limits.operational_acceleration,
                    turn_acceleration / limits.operational_turn_acceleration,
                )
            ),
        )
        piece_needs = needed.max(axis=1) / LIMIT_SHARE
        worst = int(np.argmax(piece_needs))
        slowdown = float(piece_needs[worst])
        if slowdown > LARGEST_SLOWDOWN:
            raise CommandError(
                f'point {worst + 1}: time',
                f'at least {durations[worst] * slowdown / LARGEST_SLOWDOWN:.3g} s after the '
                'point before',
                f'{durations[worst]:.3g} s',
                hint='a path that is too fast is slowed down as a whole, at most a hundredfold',
            )
        _check_box(values[..., :3], limits)
        return max(1.0, slowdown)

    def evaluate(self, time: float) -> PathState:
        """Return where the path is at a time since its start [s]: at rest before and after it."""
        since_lead_in = time - self._lead_in
        slow_rate = 1.0 / self.slowdown
        if since_lead_in < 0.0:
            path_time = max(since_lead_in, -self._lead_in)
            rate = 1.0
            change = 0.0
        else:
            path_time, rate, change = self._clock.advance(since_lead_in * slow_rate)
            rate *= slow_rate
            change *= slow_rate * slow_rate
        piece = bisect_right(self._beginnings, path_time) - 1
        x = path_time - self._beginnings[piece]
        x2 = x * x
        x3 = x2 * x
        x4 = x2 * x2
        powers = np.array((1.0, x, x2, x3, x4, x4 * x))
        values = powers @ self._polynomials[piece]
        value = values[:6]
        first = values[6:12]
        second = values[12:]
        twist = rate * first
        acceleration = rate * rate * second + change * first
        rotation = self._rotations[piece]
        if self._turning[piece]:
            in_frame = turn_by_rotation_vector(
                value[3:].tolist(), first[3:].tolist(), second[3:].tolist()
            )
            in_world = rotation @ np.array(in_frame)
            rotation = in_world[:, :3]
            turn_rate = in_world[:, 3]
            twist[3:] = rate * turn_rate
            acceleration[3:] = rate * rate * in_world[:, 4] + change * turn_rate
        return PathState(Pose(value[:3], rotation), twist, acceleration)


class TrajectoryFollower:
    """
    The way along a trajectory whose time may stand still.

    Its pace is 1 where the arm follows, and goes to 0 and back by 1 in `PACE_TIME`.

    Parameters
    ----------
    trajectory
        Which is followed from its start on.

    Attributes
    ----------
    time, pace
        Its own time [s], and by how much that advances in a second.
    waits
        Whether it is to come to a stop, or to stay there.

    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.time = 0.0
        self.pace = 1.0  # a trajectory begins at rest
        self.waits = False

    def advance(self, period: float) -> PathState:
        """Go on for a period [s], and return where the operational point is to be."""
        before = self.pace
        change = period / PACE_TIME
        if self.waits:
            pace = max(before - change, 0.0)
        else:
            pace = min(before + change, 1.0)
        pace_rate = 0.0
        if period > 0.0:
            pace_rate = (pace - before) / period
        self.pace = pace
        self.time += 0.5 * (before + pace) * period
        state = self.trajectory.evaluate(self.time)
        if pace == 1.0 and pace_rate == 0.0:
            return state
        acceleration = pace * pace * state.acceleration_world
        acceleration += pace_rate * state.twist_world
        return PathState(state.pose, pace * state.twist_world, acceleration)

    @property
    def stopping_pose(self) -> Pose:
        """Return where the operational point is once it has come to a stop from now on."""
        way = 0.5 * self.pace * self.pace * PACE_TIME
        return self.trajectory.evaluate(self.time + way).pose

    @property
    def progress(self) -> TrajectoryProgress:
        """Return how far it is."""
        duration = self.trajectory.duration
        time = min(self.time, duration)
        return TrajectoryProgress(time / duration, duration - time, self.waits)


class TrajectoryProgress(NamedTuple):
    """How far a trajectory is."""

    share: float  # of its time, that is over
    remaining: float  # [s] until it ends, if it does not wait
    waits: bool  # whether its time stands still, as the arm cannot follow


def quintic_coefficients(
    durations: Vector,
    starts: tuple[Matrix, Matrix, Matrix],
    ends: tuple[Matrix, Matrix, Matrix],
) -> Matrix:
    """
    Return polynomials of degree 5 from values and two derivatives at both ends of each piece.

    Parameters
    ----------
    durations
        Of the k pieces, shape (k,) [s].
    starts, ends
        Values, rates and their changes, each of shape (k, m).

    Returns
    -------
    Matrix
        Coefficients of the powers 0 to 5 of the time since a piece began, shape (k, 6, m).

    """
    h = durations[:, np.newaxis]
    value, rate, change = starts
    end_value, end_rate, end_change = ends
    missing = (end_value - value - rate * h - 0.5 * change * h**2) / h**3
    missing_rate = (end_rate - rate - change * h) / h**2
    missing_change = (end_change - change) / h
    return np.stack(
        [
            value,
            rate,
            0.5 * change,
            10.0 * missing - 4.0 * missing_rate + 0.5 * missing_change,
            (-15.0 * missing + 7.0 * missing_rate - missing_change) / h,
            (6.0 * missing - 3.0 * missing_rate + 0.5 * missing_change) / h**2,
        ],
        axis=1,
    )


def _add_derivatives(coefficients: Matrix) -> Matrix:
    """Return coefficients, (6, m), with those of the two derivatives beside them, (6, 3 m)."""
    first = np.zeros_like(coefficients)
    second = np.zeros_like(coefficients)
    powers = np.arange(1.0, 6.0)[:, np.newaxis]
    first[:-1] = powers * coefficients[1:]
    second[:-1] = powers * first[1:]
    return np.hstack([coefficients, first, second])


def _spline_derivatives(
    times: Vector, points: TimedPoses, rotations: Rotation
) -> tuple[Matrix, Matrix]:
    """Return twists and accelerations of splines at their points, world axes, shape (k, 6)."""
    positions = CubicSpline(times, points.positions_world, bc_type='natural')
    # Its rates are those of the body, in the axes of the body.
    turning = RotationSpline(times, rotations)
    twists = np.hstack([positions(times, 1), rotations.apply(turning(times, 1))])
    accelerations = np.hstack([positions(times, 2), rotations.apply(turning(times, 2))])
    return twists, accelerations


def _mean_accelerations(durations: Vector, ways: Matrix, twists: Matrix) -> Matrix:
    """Return means of what cubics on both sides of inner points have, 0 at the ends, (k, 6)."""
    h = durations[:, np.newaxis]
    at_starts = (6.0 * ways / h - 4.0 * twists[:-1] - 2.0 * twists[1:]) / h
    at_ends = (-6.0 * ways / h + 2.0 * twists[:-1] + 4.0 * twists[1:]) / h
    accelerations = np.zeros_like(twists)
    accelerations[1:-1] = 0.5 * (at_ends[:-1] + at_starts[1:])
    return accelerations


def _turn_into_frames(rates_world: Matrix, rotations: Matrix) -> Matrix:
    """Return twists or accelerations, (k, 6), with the turning in the axes of k rotations."""
    rates = rates_world.copy()
    rates[:, 3:] = np.einsum('kji,kj->ki', rotations, rates_world[:, 3:])
    return rates


def _check_box(positions_world: Matrix, limits: LimitsConfig) -> None:
    """Refuse pieces that swing out of the workspace box between their points: CommandError."""
    for axis, lower, upper in zip(
        range(3), limits.workspace_lower, limits.workspace_upper
    ):
        places = positions_world[..., axis]
        beyond = np.maximum(lower - places, places - upper).max(axis=1)
        if beyond.max() > BOX_MARGIN:
            index = int(np.argmax(beyond > BOX_MARGIN))
            raise CommandError(
                f'point {index + 1}: {AXES[axis]} on the way from the point before',
                f'{lower:g} to {upper:g} m',
                f'{1e3 * beyond[index]:.3g} mm beyond',
                hint='set points closer together where the path turns',
            )


def _sizes(rates: Matrix) -> tuple[Matrix, Matrix]:
    """Return the lengths of linear and angular parts, from shape (..., 6) to two of (...)."""
    linear = np.linalg.norm(rates[..., :3], axis=-1)
    angular = np.linalg.norm(rates[..., 3:], axis=-1)
    return linear, angular


def shortest_motion_duration(change: Vector, limits: LimitsConfig) -> float:
    """Return the least time of a `quintic_blend` within limits [s] over a way, (6,) [m, rad]."""
    distance = float(np.linalg.norm(change[:3]))
    angle = float(np.linalg.norm(change[3:]))
    return max(
        _shortest_duration(
            distance, limits.operational_speed, limits.operational_acceleration
        ),
        _shortest_duration(
            angle, limits.operational_turn, limits.operational_turn_acceleration
        ),
    )


def _shortest_duration(way: float, speed: float, acceleration: float) -> float:
    """Return the least time of a `quintic_blend` over a way [s] with bounded derivatives."""
    by_speed = QUINTIC_SPEED * way / speed
    by_acceleration = math.sqrt(QUINTIC_ACCELERATION * way / acceleration)
    return max(by_speed, by_acceleration)
