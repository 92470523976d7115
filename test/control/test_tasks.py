"""Scenario and commanded tasks: times, derivatives, refusals."""

from multicontact_control.algebra import quintic_blend
from multicontact_control.config import LimitsConfig
from multicontact_control.control.tasks import (
    ApproachConfig,
    CommandedTask,
    evaluate_sine_motion,
    ForceStepConfig,
    MotionReading,
    ReferenceConfig,
    ScenarioTask,
    shortest_motion_duration,
    SineConfig,
)
from multicontact_control.dynamics.rotations import Pose
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

RATE = 500.0
NORMALS = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
FREE = np.zeros((0, 3))  # normals of no contact
POSE = Pose(np.array([0.0, 0.5, 0.6]), np.eye(3))


def _scenario(**values):
    source = ScenarioTask(
        ReferenceConfig(**values),
        rate=RATE,
        names=('table', 'board'),
        leading_columns=(0, 1),
    )
    source.start(POSE, NORMALS)
    return source


def _run(source, seconds, alpha):
    return [
        source.task_at(k / RATE, alpha(k / RATE)) for k in range(int(seconds * RATE))
    ]


def test_approach_moves_towards_every_untouched_surface():
    """0.02 m/s along both normals after the ramp; a touched contact is no longer approached."""
    source = _scenario(approach=ApproachConfig(start_time=0.0))
    touched = _run(source, 3.0, lambda t: np.array([2.0 if t > 1.0 else 0.0, 0.0]))
    position = np.array([r.pose_des.position_world for r in touched])
    assert_allclose(touched[450].twist_des[:3], [0.0, 0.02, -0.02])
    assert_allclose(touched[-1].twist_des[:3], [0.0, 0.02, 0.0])
    assert position[-1, 2] == pytest.approx(position[505, 2])
    assert position[-1, 1] > position[505, 1] + 0.039
    assert [list(r.active) for r in (touched[400], touched[-1])] == [
        [False, False],
        [True, False],
    ]


def test_force_steps_apply_to_touched_contacts_and_a_force_of_0_wants_none():
    source = _scenario(
        approach=ApproachConfig(start_time=0.0, preload=2.0),
        force_steps=(
            ForceStepConfig(time=0.2, forces={'table': 10.0, 'board': 10.0}),
            ForceStepConfig(time=0.4, forces={'board': 15.0}),
            ForceStepConfig(time=0.8, forces={'board': 0.0}),
            ForceStepConfig(time=1.2, forces={'board': 6.0}),
        ),
    )
    run = _run(source, 0.6, lambda t: np.array([3.0, 3.0 if t > 0.3 else 0.0]))
    assert_array_equal(
        [run[k].alpha_des for k in (50, 100, 160, 200)],
        [[2.0, 0.0], [10.0, 0.0], [10.0, 10.0], [10.0, 15.0]],
    )
    assert [source.task_at(t).active.tolist() for t in (0.1, 0.6, 1.0, 1.4)] == [
        [True, True],
        [True, True],
        [True, False],
        [True, True],
    ]


def test_sine_motion_derivatives_agree_with_differences():
    config = SineConfig(start_time=1.0)
    times = np.linspace(1.0, 6.0, 400)
    h = 1e-5
    values = np.array([evaluate_sine_motion(config, t) for t in times])
    ahead = np.array([evaluate_sine_motion(config, t + h) for t in times])
    behind = np.array([evaluate_sine_motion(config, t - h) for t in times])
    assert_allclose(values[1:, 1:], ((ahead - behind) / (2 * h))[1:, :2], atol=1e-5)
    assert evaluate_sine_motion(config, 1.0) == (0.0, 0.0, 0.0)
    assert max(abs(v) for v in evaluate_sine_motion(config, 1.0 + 1e-4)) < 1e-4


def test_twist_of_a_motion_expires_when_none_follows():
    source = CommandedTask(('table', 'board'), (0, 1))
    source.start(POSE, NORMALS)
    motion = MotionReading(
        POSE.position_world, np.array([0, 0, 0, 1.0]), np.ones(6), np.ones(6)
    )
    for start in (0.0, 1.0):
        source.set_motion(motion, FREE, lasting=0.2)
        for time in (start, start + 0.19):
            assert source.task_at(time).twist_des.all()
        late = source.task_at(start + 0.21)
        assert not late.twist_des.any() and not late.acceleration_des.any()
        assert_array_equal(late.pose_des.position_world, POSE.position_world)
    source.set_motion(motion, FREE)
    assert source.task_at(2.0).twist_des.all() and source.task_at(1e6).twist_des.all()


def test_commanded_task_is_the_same_object_until_something_else_is_commanded():
    source = CommandedTask(('table', 'board'), (0, 1))
    source.start(POSE, NORMALS)
    first = source.task_at(0.0)
    assert source.task_at(0.1) is first
    source.set_forces({'table': 5.0})
    pressing = source.task_at(0.2)
    assert pressing.active.tolist() == [True, False]
    assert pressing.pose_des is first.pose_des
    source.set_motion(
        MotionReading(
            POSE.position_world, np.array([0, 0, 0, 1.0]), np.ones(6), np.ones(6)
        ),
        FREE,
        lasting=0.2,
    )
    moving = source.task_at(0.3)
    assert moving is not pressing and moving.alpha_des is pressing.alpha_des
    assert source.task_at(0.49) is moving
    expired = source.task_at(0.51)
    assert expired is not moving and source.task_at(1.0) is expired


def test_parts_of_a_scenario_are_the_same_objects_while_they_do_not_change():
    source = _scenario(
        motion=SineConfig(start_time=1.0), approach=ApproachConfig(start_time=0.0)
    )
    at_rest, later, moving = (source.task_at(time) for time in (0.2, 0.4, 1.5))
    for part in ('twist_des', 'acceleration_des', 'active', 'alpha_des'):
        assert getattr(at_rest, part) is getattr(later, part)
    assert at_rest.pose_des.position_world is later.pose_des.position_world
    assert moving.pose_des.rotation_world is later.pose_des.rotation_world
    assert moving.pose_des.position_world is not later.pose_des.position_world


def commanded_task(names=('table', 'board'), leading_columns=(0, 1)):
    """Return a commanded task that has begun at `POSE`."""
    source = CommandedTask(names, leading_columns)
    source.start(POSE, NORMALS)
    return source


def test_commanded_motion_has_no_effect_along_taken_normals():
    """Of two oblique contacts: only what is across both of their normals is left."""
    source = commanded_task()
    oblique = np.array([[0.0, 0.0, -1.0], [0.0, 0.6, -0.8]])
    change = np.array([0.01, 0.02, 0.03])
    motion = MotionReading(
        POSE.position_world + change,
        np.array([0.0, 0.0, 0.0, 1.0]),
        np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
        np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
    )
    source.set_motion(motion, oblique)
    task = source.task_at(0.0)
    assert_allclose(
        task.pose_des.position_world, POSE.position_world + [0.01, 0.0, 0.0], atol=1e-12
    )
    assert_allclose(task.twist_des, [0.1, 0.0, 0.0, 0.4, 0.5, 0.6], atol=1e-12)
    assert_allclose(task.acceleration_des, [1.0, 0.0, 0.0, 4.0, 5.0, 6.0], atol=1e-12)


def test_new_start_forgets_commands():
    source = commanded_task()
    source.set_forces({'table': 5.0})
    source.start(POSE, NORMALS)
    task = source.task_at(0.0)
    assert not task.active.any()
    assert not task.alpha_des.any()


EDGE = ('edge', 'edge_couple', 'board')
EDGE_COLUMNS = (0, 0, 2)


def test_couple_acts_while_its_contact_does_whatever_its_sign():
    source = commanded_task(EDGE, EDGE_COLUMNS)
    source.set_forces({'edge': 10.0, 'edge_couple': -2.0})
    assert source.task_at(0.0).active.tolist() == [True, True, False]
    source.set_forces({'edge': 0.0})
    assert source.task_at(0.1).active.tolist() == [False, False, False]


def test_share_of_a_couple_follows_the_force_of_its_contact_until_it_is_commanded():
    source = commanded_task(EDGE, EDGE_COLUMNS)
    source.set_forces({'edge': 10.0, 'board': 4.0}, {'edge_couple': 0.2})
    assert source.forces == {'edge': 10.0, 'edge_couple': 2.0, 'board': 4.0}
    source.set_forces({'edge': 20.0})
    assert source.forces['edge_couple'] == 4.0
    assert source.shares == {'edge_couple': 0.2}
    source.set_forces({'edge_couple': 1.0})
    source.set_forces({'edge': 30.0})
    assert source.forces['edge_couple'] == 1.0
    assert source.shares == {}


def test_command_is_new_if_one_force_is():
    source = commanded_task()
    assert source.set_forces({'table': 5.0, 'board': 6.0})
    assert not source.set_forces({'table': 5.0, 'board': 6.0})
    assert source.set_forces({'table': 5.0, 'board': 7.0})


def test_preload_of_a_scenario_is_of_forces_alone():
    source = ScenarioTask(
        ReferenceConfig(approach=ApproachConfig(start_time=0.0, preload=3.0)),
        rate=RATE,
        names=EDGE,
        leading_columns=EDGE_COLUMNS,
    )
    source.start(POSE, NORMALS)
    task = source.task_at(1.0)
    assert task.alpha_des.tolist() == [3.0, 0.0, 3.0]
    assert task.active.all()


def test_approach_accelerates_as_its_twist_changes():
    source = _scenario(approach=ApproachConfig(start_time=0.2))
    tasks = _run(source, 1.0, lambda _: np.zeros(2))
    twist = np.array([task.twist_des for task in tasks])
    acceleration = np.array([task.acceleration_des for task in tasks])
    ramp = slice(int(0.3 * RATE), int(0.6 * RATE))
    assert_allclose(
        acceleration[ramp], np.gradient(twist, 1.0 / RATE, axis=0)[ramp], atol=1e-9
    )
    assert acceleration[ramp].any()


@pytest.mark.parametrize(
    'limit',
    [
        'operational_speed',
        'operational_acceleration',
        'operational_turn',
        'operational_turn_acceleration',
    ],
)
def test_shortest_motion_reaches_the_limit_that_is_tightest(limit):
    """Speed and acceleration of a quintic over the way, by differences."""
    values = dict.fromkeys(
        (
            'operational_speed',
            'operational_acceleration',
            'operational_turn',
            'operational_turn_acceleration',
        ),
        100.0,
    )
    values[limit] = 0.3
    change = np.array([0.3, 0.0, 0.4, 0.0, 1.2, 0.0])
    duration = shortest_motion_duration(change, LimitsConfig.model_construct(**values))
    times = np.linspace(0.0, duration, 4001)
    blend = np.array([quintic_blend(time, duration)[0] for time in times])
    step = times[1]
    speed = np.gradient(blend, step)
    way = 1.2 if 'turn' in limit else 0.5
    reached = speed
    if 'acceleration' in limit:
        reached = np.gradient(speed, step)
    assert way * np.abs(reached[2:-2]).max() == pytest.approx(0.3, rel=1e-3)
