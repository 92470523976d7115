"""Trajectories through timed poses: points, derivatives, limits, rest, refusals, cost."""

import re
import time

from multicontact_control.config import LimitsConfig
from multicontact_control.control.trajectory import RampedTime, Trajectory
from multicontact_control.control.trajectory_checks import (
    check_points,
    check_surfaces,
    TimedPoses,
)
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

LIMITS = LimitsConfig()
BOX = LimitsConfig(workspace_lower=(-1.0, -1.0, -1.0), workspace_upper=(1.0, 1.0, 1.0))
START = Pose(
    np.array([0.01, 0.0, 0.02]), Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix()
)
STEP = 1e-5  # s, of finite differences
TICKS = 5000


def random_points(count=12, *, twists=False, seed=0):
    """Return a path that wanders and turns, about 4 cm and 0.1 rad from point to point."""
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0.0, 0.06, (count, 3)), axis=0)
    return TimedPoses(
        np.cumsum(rng.uniform(0.4, 0.8, count)),
        np.cumsum(rng.normal(0.0, 0.02, (count, 3)), axis=0),
        Rotation.from_rotvec(turns).as_quat(),
        rng.normal(0.0, 0.03, (count, 6)) if twists else None,
    )


def straight_points(times, distance=0.1):
    """Return a straight path along x from `START`, as far as the share of the last time."""
    times = np.array(times, dtype=float)
    positions = np.tile(START.position_world, (len(times), 1))
    positions[:, 0] += distance * (times - times[0]) / max(np.ptp(times), 1.0)
    return TimedPoses(times, positions, np.tile(START.quaternion_xyzw, (len(times), 1)))


@pytest.fixture(params=[False, True], ids=['spline', 'twists'])
def trajectory(request):
    """Return a trajectory through `random_points`, and these."""
    points = random_points(twists=request.param)
    return Trajectory(START, points, LIMITS), points


def test_passes_its_points_at_their_times(trajectory):
    path, points = trajectory
    for passing, position, quaternion in zip(path.passing_times, *points[1:3]):
        pose = path.evaluate(passing).pose
        assert_allclose(pose.position_world, position, atol=1e-6)
        expected = Rotation.from_quat(quaternion).as_matrix()
        assert_allclose(pose.rotation_world, expected, atol=1e-6)
    assert path.slowdown == 1.0
    gaps = np.diff(path.passing_times)
    assert_allclose(gaps[1:-1], np.diff(points.times)[1:-1], atol=1e-6)


def test_its_motion_is_the_derivative_of_its_pose(trajectory):
    path, _ = trajectory
    for instant in np.linspace(0.0, path.duration, 301)[1:-1]:
        before = path.evaluate(instant - STEP)
        state = path.evaluate(instant)
        after = path.evaluate(instant + STEP)
        twist = before.pose.displacement_to(after.pose) / (2.0 * STEP)
        assert_allclose(state.twist_world, twist, atol=1e-7)
        acceleration = (after.twist_world - before.twist_world) / (2.0 * STEP)
        assert_allclose(state.acceleration_world, acceleration, atol=1e-5)


def test_begins_and_ends_at_rest_where_it_is(trajectory):
    path, points = trajectory
    for instant in (-1.0, 0.0, path.duration, path.duration + 5.0):
        state = path.evaluate(instant)
        assert_allclose(state.twist_world, 0.0, atol=1e-12)
        assert_allclose(state.acceleration_world, 0.0, atol=1e-9)
    assert_allclose(path.evaluate(-1.0).pose.displacement_to(START), 0.0, atol=1e-12)
    end = path.evaluate(path.duration + 5.0).pose
    assert_allclose(end.position_world, points.positions_world[-1], atol=1e-12)


def test_has_the_twists_that_were_given():
    points = random_points(twists=True)
    path = Trajectory(START, points, LIMITS)
    for passing, twist in zip(path.passing_times[2:-2], points.twists_world[2:-2]):
        assert_allclose(path.evaluate(passing).twist_world, twist, atol=1e-5)


def test_goes_along_the_natural_spline_of_its_points():
    points = random_points()
    path = Trajectory(START, points, LIMITS)
    spline = CubicSpline(points.times, points.positions_world, bc_type='natural')
    delay = path.passing_times[5] - points.times[5]
    for instant in np.linspace(points.times[2], points.times[-2], 50):
        position = path.evaluate(instant + delay).pose.position_world
        assert_allclose(position, spline(instant), atol=1e-6)


def test_two_points_with_twists_of_zero_are_a_quintic():
    """Half-way at half the time, with 15/8 of the mean speed."""
    points = straight_points([0.0, 2.0])._replace(twists_world=np.zeros((2, 6)))
    path = Trajectory(START, points, LIMITS)
    middle = path.evaluate(0.5 * path.duration)
    assert path.duration == pytest.approx(2.0)
    assert middle.pose.position_world[0] == pytest.approx(
        START.position_world[0] + 0.05
    )
    assert middle.twist_world[0] == pytest.approx(15.0 / 8.0 * 0.1 / 2.0)


@pytest.mark.parametrize('twists', [False, True])
@pytest.mark.parametrize('speed', [1.0, 6.0])
def test_limits_are_kept_by_slowing_down(twists, speed):
    points = random_points(twists=twists)
    points = points._replace(times=points.times / speed)
    limits = LimitsConfig(
        operational_speed=0.12,
        operational_turn=0.4,
        operational_acceleration=1.0,
        operational_turn_acceleration=2.0,
    )
    path = Trajectory(START, points, limits)
    assert path.slowdown > 1.0 or speed == 1.0
    states = [path.evaluate(t) for t in np.linspace(0.0, path.duration, 3000)]
    twist = np.array([state.twist_world for state in states])
    acceleration = np.array([state.acceleration_world for state in states])
    assert np.linalg.norm(twist[:, :3], axis=1).max() <= 0.12
    assert np.linalg.norm(twist[:, 3:], axis=1).max() <= 0.4
    assert np.linalg.norm(acceleration[:, :3], axis=1).max() <= 1.0
    assert np.linalg.norm(acceleration[:, 3:], axis=1).max() <= 2.0


def test_goes_to_a_first_point_at_time_zero_with_a_fifth_of_the_limits():
    points = straight_points([0.0, 2.0])
    points.positions_world[:, 1] += 0.1
    path = Trajectory(START, points, LIMITS)
    ways = [path.evaluate(t) for t in np.linspace(0.0, path.passing_times[0], 500)]
    fastest = max(np.linalg.norm(state.twist_world[:3]) for state in ways)
    assert 0.9 * 0.1 < fastest < 0.1001
    first = path.evaluate(path.passing_times[0])
    assert_allclose(first.pose.position_world, points.positions_world[0], atol=1e-9)
    assert_allclose(first.twist_world, 0.0, atol=1e-9)


def test_a_single_point_is_reached_in_its_time():
    points = straight_points([1.5])
    points.positions_world[0] += 0.05
    path = Trajectory(START, points, LIMITS)
    assert path.duration == pytest.approx(1.5)
    end = path.evaluate(1.5).pose
    assert_allclose(end.position_world, points.positions_world[0], atol=1e-12)


def test_ramped_time_goes_on_smoothly():
    clock = RampedTime(3.0, 0.5, 1.0)
    times = np.linspace(0.0, clock.duration, 2001)
    way, rate, change = np.array([clock.advance(t) for t in times]).T
    assert way[-1] == 3.0 and clock.duration == 3.75
    assert_allclose(np.gradient(way, times)[1:-1], rate[1:-1], atol=1e-4)
    assert_allclose(np.gradient(rate, times)[1:-1], change[1:-1], atol=2e-2)
    assert_allclose(
        clock.advance(clock.find_times(np.array([1.2]))[0])[0], 1.2, atol=1e-6
    )


@pytest.mark.parametrize(
    'change, message',
    [
        ({'times': np.zeros(0)}, 'points: expected at least one, got none'),
        (
            {'times': [0.5, 2.0, 1.0]},
            'point 2: time: expected more than 2 s, .*, got 1 s',
        ),
        ({'times': [0.5, 0.5, 1.0]}, 'point 1: time: expected more than 0.5 s'),
        (
            {'times': [-0.5, 0.5, 1.0]},
            'point 0: time: expected at least 0 s, got -0.5 s',
        ),
        ({'times': [0.5, np.nan, 1.0]}, 'point 1: expected finite numbers'),
        (
            {'positions_world': (1, [np.inf, 0.0, 0.0])},
            'point 1: expected finite numbers',
        ),
        (
            {'quaternions_xyzw': (2, [0, 0, 0, 0])},
            'point 2: quaternion: expected a length of 1',
        ),
        (
            {'quaternions_xyzw': (2, [0, 0, 2, 0])},
            'point 2: quaternion: expected a length of 1',
        ),
        (
            {'quaternions_xyzw': (1, [0, 0, 1, 0])},
            'point 1: turn .* at most 2.9 rad, got 3.1',
        ),
        (
            {'positions_world': (2, [0.0, 1.5, 0.0])},
            'point 2: position y: .* got 1.5 m',
        ),
        ({'twists_world': np.full((3, 6), np.nan)}, 'point 0: expected finite numbers'),
    ],
)
def test_points_that_are_no_path_are_refused_in_one_line(change, message):
    points = straight_points([0.0, 1.0, 2.0])
    for name, value in change.items():
        if isinstance(value, tuple):
            array = getattr(points, name).copy()
            array[value[0]] = value[1]
            value = array
        points = points._replace(**{name: np.array(value, dtype=float)})
    with pytest.raises(CommandError) as refused:
        check_points(points, BOX)
    assert re.match(message, str(refused.value))
    assert '\n' not in str(refused.value)


def test_points_that_are_accepted_make_a_trajectory():
    points = random_points(twists=True)
    check_points(points, BOX)
    assert len(Trajectory(START, points, BOX).passing_times) == len(points.times)


def test_a_path_without_room_to_slow_down_is_refused():
    with pytest.raises(CommandError, match='point 2: time: expected at least .* after'):
        Trajectory(
            START,
            straight_points([0.0, 1.0, 1.0 + 1e-9, 2.0])._replace(
                positions_world=np.array(
                    [[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]]
                )
            ),
            LIMITS,
        )


def test_a_spline_that_swings_out_of_the_box_is_refused():
    positions = np.array([[0.0, 0, 0], [0.999, 0, 0], [0.999, 0.02, 0], [0.0, 0.02, 0]])
    points = straight_points([0.0, 5.0, 5.5, 10.0])._replace(positions_world=positions)
    check_points(points, BOX)
    with pytest.raises(
        CommandError, match='point 2: position x on the way .* mm beyond'
    ):
        Trajectory(START, points, BOX)


@pytest.mark.parametrize('height, direction', [(-0.05, 'through'), (0.05, 'off')])
def test_a_path_through_a_pressed_surface_or_off_it_is_refused(height, direction):
    table = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    points = straight_points([0.0, 1.0, 2.0], distance=0.2)
    check_surfaces(points, START, {'table': table})
    points.positions_world[1, 2] += height  # 27 degrees
    check_surfaces(points, START, {'table': table})
    points.positions_world[2, 2] += 3.0 * height
    with pytest.raises(
        CommandError, match=f'point 2: .* of table, got 37 .* {direction} them'
    ):
        check_surfaces(points, START, {'table': table})
    check_surfaces(points, START, {})


def test_evaluation_fits_a_tick_of_2_ms_and_never_raises():
    path = Trajectory(START, random_points(60), LIMITS)
    times = np.linspace(0.0, path.duration, TICKS).tolist()
    begun = time.perf_counter()
    for instant in times:
        path.evaluate(instant)
    mean = (time.perf_counter() - begun) / TICKS
    assert mean < 2e-4  # 16 us on a quiet core
    for instant in (-np.inf, np.inf, np.nan, 1e300):
        path.evaluate(instant)
