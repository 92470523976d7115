"""Motions of a scenario: derivatives, rest, where they lead, what their files may hold."""

import math

from multicontact_control.config import LimitsConfig, validate
from multicontact_control.control.motions import (
    CircleConfig,
    plan_motion,
    read_waypoints,
    surface_axes,
    WaypointConfig,
    WaypointsConfig,
    with_waypoints_of_file,
)
from multicontact_control.control.tasks import ReferenceConfig, ScenarioTask
from multicontact_control.errors import ConfigError
from multicontact_control.runs.scenario import ScenarioConfig
import numpy as np
from numpy.testing import assert_allclose
import pytest

LIMITS = LimitsConfig()
START = np.array([0.3, 0.1, 0.4])
TABLE = np.array([0.2, 0.0, -math.sqrt(0.96)])  # into it
NORMALS = {'table': TABLE}
STEP = 1e-5  # s, of finite differences
CIRCLE = CircleConfig(start_time=1.0, radius=0.07, speed=0.1, turns=1.5)


def waypoints(*positions, **values):
    """Return the configuration of waypoints at some positions on the table."""
    points = tuple(WaypointConfig(position=position) for position in positions)
    return WaypointsConfig(
        start_time=1.0, lead_time=1.0, points=points, contact='table', **values
    )


SURFACE_PATH = waypoints((0.0, 0.02), (0.1, 0.02), (0.1, 0.05), (0.0, 0.05))
WORLD_PATH = waypoints((0.3, 0.1, 0.42), (0.35, 0.1, 0.43), (0.35, 0.2, 0.4))


@pytest.mark.parametrize('config', [CIRCLE, SURFACE_PATH, WORLD_PATH])
def test_a_motion_has_its_derivatives_and_begins_and_ends_at_rest(config):
    motion = plan_motion(config, LIMITS)
    motion.start(START, NORMALS)
    for time in np.linspace(1.0, motion.end, 300)[1:-1]:
        before, twist_before, _ = motion.displace(time - STEP)
        after, twist_after, _ = motion.displace(time + STEP)
        _, twist, acceleration = motion.displace(time)
        assert_allclose(twist[:3], (after - before) / (2.0 * STEP), atol=1e-7)
        change = (twist_after - twist_before) / (2.0 * STEP)
        assert_allclose(acceleration, change, atol=1e-4)
    place, twist, _ = motion.displace(1.0)
    assert_allclose(place, 0.0, atol=1e-12)
    assert_allclose(twist, 0.0, atol=1e-12)
    for time in (motion.end, motion.end + 3.0):
        assert_allclose(np.concatenate(motion.displace(time)[1:]), 0.0, atol=1e-9)


def test_a_circle_has_its_radius_speed_and_end():
    motion = plan_motion(CIRCLE, LIMITS)
    centre = 0.07 * np.array(CIRCLE.centre_direction_world)
    for time in np.linspace(1.0, motion.end, 50):
        assert np.linalg.norm(motion.displace(time)[0] - centre) == pytest.approx(0.07)
    assert np.linalg.norm(motion.displace(5.0)[1]) == pytest.approx(0.1)
    assert_allclose(motion.displace(motion.end)[0], 2.0 * centre, atol=1e-12)
    assert motion.end == pytest.approx(1.0 + 1.5 * math.tau * 0.07 / 0.1 + 1.0)


def test_a_circle_is_slowed_down_for_the_limits():
    limits = LimitsConfig(operational_acceleration=0.1)
    motion = plan_motion(CIRCLE, limits)
    speed = np.linalg.norm(motion.displace(5.0)[1])
    assert speed == pytest.approx(math.sqrt(0.1 * 0.07))


def test_waypoints_along_a_surface_stay_in_it():
    motion = plan_motion(SURFACE_PATH, LIMITS)
    motion.start(START, NORMALS)
    for time in np.linspace(1.0, motion.end, 50):
        assert abs(TABLE @ motion.displace(time)[0]) < 1e-12
    u, v, outwards = surface_axes(TABLE)
    assert_allclose(motion.displace(motion.end)[0], 0.05 * v, atol=1e-9)
    assert_allclose(np.cross(u, v), outwards, atol=1e-12)
    assert_allclose(outwards, -TABLE)


def test_waypoints_in_the_world_are_where_they_say():
    motion = plan_motion(WORLD_PATH, LIMITS)
    motion.start(START, NORMALS)
    for time, point in ((2.0, 0), (motion.end, -1)):
        position = START + motion.displace(time)[0]
        assert_allclose(position, WORLD_PATH.points[point].position, atol=1e-9)


def test_forces_of_waypoints_are_steps_where_they_are_passed():
    points = [{'position': [0.0, 0.0], 'force': 5.0}, {'position': [0.1, 0.0]}]
    points.append({'position': [0.2, 0.0], 'force': 9.0})
    motion = {
        'kind': 'waypoints',
        'start_time': 1.0,
        'contact': 'table',
        'points': points,
    }
    reference = validate(
        ReferenceConfig,
        {'motion': motion, 'force_steps': [{'time': 0.5, 'forces': {'table': 3}}]},
    )
    task = ScenarioTask(reference, 500.0, ('table',), (0,))
    assert_allclose(task.forces[:, 0], [2.0, 3.0, 5.0, 9.0])
    assert_allclose(task.step_times, [0.5, 3.0, 3.0 + 0.2 / 0.05 + 0.5])
    assert task.motion_end == pytest.approx(task.step_times[-1])


def test_a_file_of_waypoints_takes_the_place_of_points(tmp_path):
    (tmp_path / 'path.csv').write_text(
        '# a path\nx, y, z, speed\n0,0,1,\n0.1,0,1,0.02\n'
    )
    motion = {'kind': 'waypoints', 'start_time': 1.0, 'file': 'path.csv'}
    values = with_waypoints_of_file({'motion': motion}, tmp_path)
    reference = validate(ReferenceConfig, values)
    assert reference.motion.points[1].position == (0.1, 0.0, 1.0)
    assert [point.speed for point in reference.motion.points] == [None, 0.02]
    again = validate(ReferenceConfig, reference.model_dump(mode='json'))
    assert again == reference


@pytest.mark.parametrize(
    'text, message',
    [
        ('', 'columns x, y, z or u, v'),
        ('x,y\n0,0\n', 'columns x, y, z or u, v, and .* got x, y'),
        ('u,v,colour\n', 'got u, v, colour'),
        ('u,v\n0,0\n0,one\n', "point 1: v: expected a number, got 'one'"),
        ('u,v\n0\n', "point 0: v: expected a number, got ''"),
    ],
)
def test_a_file_that_has_no_waypoints_is_refused(tmp_path, text, message):
    path = tmp_path / 'path.csv'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_waypoints(path)
    with pytest.raises(ConfigError, match='missing.csv: expected a CSV file'):
        read_waypoints(tmp_path / 'missing.csv')


ON_TABLE = {'kind': 'waypoints', 'start_time': 1.0, 'contact': 'table'}


@pytest.mark.parametrize(
    'motion, message',
    [
        ({'kind': 'square'}, "reference.motion.kind: expected one of .*, got 'square'"),
        (
            {'kind': 'circle', 'start_time': 1.0, 'radus': 1.0},
            'reference.motion.radus: expected a known key .*radius',
        ),
        (
            {'kind': 'circle', 'start_time': 1.0, 'direction_world': [1.0, 0.0, 0.0]},
            'direction_world: expected a direction at right angles',
        ),
        (
            {'kind': 'circle', 'start_time': 1.0, 'turns': 0.1},
            'blend_time: expected at most the 0.44 s',
        ),
        (ON_TABLE, 'reference.motion.points: expected at least 2, or a file, got 0'),
        (
            {**ON_TABLE, 'points': [{'position': [0.0, 0.0]}, {'position': [0.0]}]},
            'reference.motion.points.1.position: expected at least 2',
        ),
        (
            {**ON_TABLE, 'points': 2 * [{'position': [0.0, 0.0]}]},
            'points.1.position: expected another than before',
        ),
        (
            {
                **ON_TABLE,
                'contact': '',
                'points': [{'position': [0, 0]}, {'position': [0, 1]}],
            },
            'reference.motion.contact: expected the contact',
        ),
    ],
)
def test_values_that_are_no_motion_are_refused(motion, message):
    with pytest.raises(ConfigError, match=message):
        validate(
            ScenarioConfig,
            {'name': 'x', 'duration': 9, 'reference': {'motion': motion}},
        )


def test_a_first_waypoint_that_is_too_far_is_refused():
    motion = plan_motion(WORLD_PATH, LIMITS)
    with pytest.raises(ConfigError, match='lead_time: expected at least .* got 1 s'):
        motion.start(START + 2.0, NORMALS)


def test_waypoints_outside_the_box_are_refused():
    limits = LimitsConfig(workspace_lower=(-1, -1, -1), workspace_upper=(1, 0.15, 1))
    with pytest.raises(ConfigError, match='point 2: position y: expected -1 to 0.15 m'):
        plan_motion(WORLD_PATH, limits)
