"""Scenario and commanded tasks: times, derivatives, refusals."""

from multicontact_control.algebra import quintic_blend
from multicontact_control.config import LimitsConfig
from multicontact_control.control.motions import evaluate_sine_motion, SineConfig
from multicontact_control.control.tasks import (
    ApproachConfig,
    CommandedTask,
    ForceStepConfig,
    MotionReading,
    ReferenceConfig,
    ScenarioTask,
)
from multicontact_control.control.trajectory import shortest_motion_duration
from multicontact_control.dynamics.rotations import Pose
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

RATE = 500.0
NORMALS = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
FREE = np.zeros((0, 3))  # normals of no contact
POSE = Pose(np.array([0.0, 0.5, 0.6]), np.eye(3))


NAMES = ('table', 'board')
EDGE = ('edge', 'edge_couple', 'board')
EDGE_COLUMNS = (0, 0, 2)
MOTION = MotionReading(
    POSE.position_world, np.array([0.0, 0.0, 0.0, 1.0]), np.ones(6), np.ones(6)
)


def scenario_task(names=NAMES, leading_columns=(0, 1), **values):
    """Return the task of a scenario that has begun at `POSE`."""
    source = ScenarioTask(
        ReferenceConfig(**values),
        rate=RATE,
        names=names,
        leading_columns=leading_columns,
    )
    source.start(POSE, NORMALS)
    return source


def commanded_task(names=NAMES, leading_columns=(0, 1)):
    """Return a commanded task that has begun at `POSE`."""
    source = CommandedTask(names, leading_columns)
    source.start(POSE, NORMALS)
    return source


def run_task(source, seconds, measure_forces):
    """Return the tasks at all samples of some seconds, whose forces depend on the time."""
    times = np.arange(int(seconds * RATE)) / RATE
    return [source.task_at(time, measure_forces(time)) for time in times]


def feel_nothing(time):
    return np.zeros(2)


def test_approach_moves_towards_every_untouched_surface():
    """0.02 m/s along both normals after the ramp; a touched contact is no longer approached."""

    def touch_table(time):
        return np.array([2.0 * (time > 1.0), 0.0])

    source = scenario_task(approach=ApproachConfig(start_time=0.0))
    tasks = run_task(source, 3.0, touch_table)
    at_touch = tasks[505].pose_des.position_world
    last = tasks[-1]
    assert_allclose(tasks[450].twist_des[:3], [0.0, 0.02, -0.02])
    assert_allclose(last.twist_des[:3], [0.0, 0.02, 0.0])
    assert last.pose_des.position_world[2] == pytest.approx(at_touch[2])
    assert last.pose_des.position_world[1] > at_touch[1] + 0.039
    assert tasks[400].active.tolist() == [False, False]
    assert last.active.tolist() == [True, False]


def pressing_task():
    """Return a task of preloads at once, 10 N from 0.2 s, the board's changed later."""
    return scenario_task(
        approach=ApproachConfig(start_time=0.0, preload=2.0),
        force_steps=(
            ForceStepConfig(time=0.2, forces={'table': 10.0, 'board': 10.0}),
            ForceStepConfig(time=0.4, forces={'board': 15.0}),
            ForceStepConfig(time=0.8, forces={'board': 0.0}),
            ForceStepConfig(time=1.2, forces={'board': 6.0}),
        ),
    )


def test_force_steps_apply_to_touched_contacts():
    def touch_board_later(time):
        return np.array([3.0, 3.0 * (time > 0.3)])

    tasks = run_task(pressing_task(), 0.6, touch_board_later)
    assert tasks[50].alpha_des.tolist() == [2.0, 0.0]
    assert tasks[100].alpha_des.tolist() == [10.0, 0.0]
    assert tasks[160].alpha_des.tolist() == [10.0, 10.0]
    assert tasks[200].alpha_des.tolist() == [10.0, 15.0]


def test_step_to_a_force_of_0_wants_no_contact_until_the_next():
    source = pressing_task()
    for time, board in ((0.1, True), (0.6, True), (1.0, False), (1.4, True)):
        assert source.task_at(time).active.tolist() == [True, board]


def test_sine_motion_derivatives_agree_with_differences():
    config = SineConfig(start_time=1.0)
    times = np.linspace(1.0, 6.0, 400)[1:]
    h = 1e-5
    values = np.array([evaluate_sine_motion(config, t) for t in times])
    ahead = np.array([evaluate_sine_motion(config, t + h) for t in times])
    behind = np.array([evaluate_sine_motion(config, t - h) for t in times])
    rates = (ahead - behind) / (2 * h)
    assert_allclose(values[:, 1:], rates[:, :2], atol=1e-5)


def test_sine_motion_starts_at_rest():
    config = SineConfig(start_time=1.0)
    assert evaluate_sine_motion(config, 1.0) == (0.0, 0.0, 0.0)
    assert np.abs(evaluate_sine_motion(config, 1.0 + 1e-4)).max() < 1e-4


@pytest.mark.parametrize('start', [0.0, 1.0])
def test_twist_of_a_motion_expires_when_none_follows(start):
    source = commanded_task()
    source.set_motion(MOTION, FREE, lasting=0.2)
    for time in (start, start + 0.19):
        assert source.task_at(time).twist_des.all()
    late = source.task_at(start + 0.21)
    assert not late.twist_des.any()
    assert not late.acceleration_des.any()
    assert_array_equal(late.pose_des.position_world, POSE.position_world)


def test_twist_of_a_motion_without_an_end_never_expires():
    source = commanded_task()
    source.set_motion(MOTION, FREE)
    assert source.task_at(2.0).twist_des.all()
    assert source.task_at(1e6).twist_des.all()


def test_commanded_task_is_the_same_object_until_something_else_is_commanded():
    source = commanded_task()
    first = source.task_at(0.0)
    assert source.task_at(0.1) is first
    source.set_forces({'table': 5.0})
    pressing = source.task_at(0.2)
    assert pressing.active.tolist() == [True, False]
    assert pressing.pose_des is first.pose_des
    source.set_motion(MOTION, FREE, lasting=0.2)
    moving = source.task_at(0.3)
    assert moving is not pressing
    assert moving.alpha_des is pressing.alpha_des
    assert source.task_at(0.49) is moving
    expired = source.task_at(0.51)
    assert expired is not moving
    assert source.task_at(1.0) is expired


def test_parts_of_a_scenario_are_the_same_objects_while_they_do_not_change():
    source = scenario_task(
        motion=SineConfig(start_time=1.0), approach=ApproachConfig(start_time=0.0)
    )
    at_rest = source.task_at(0.2)
    later = source.task_at(0.4)
    moving = source.task_at(1.5)
    for part in ('twist_des', 'acceleration_des', 'active', 'alpha_des'):
        assert getattr(at_rest, part) is getattr(later, part)
    assert at_rest.pose_des.position_world is later.pose_des.position_world
    assert moving.pose_des.rotation_world is later.pose_des.rotation_world
    assert moving.pose_des.position_world is not later.pose_des.position_world


def test_commanded_motion_has_no_effect_along_taken_normals():
    """Of two oblique contacts: only what is across both of their normals is left."""
    source = commanded_task()
    oblique = np.array([[0.0, 0.0, -1.0], [0.0, 0.6, -0.8]])
    twist = np.arange(1.0, 7.0)
    position = POSE.position_world + [0.01, 0.02, 0.03]
    motion = MotionReading(position, MOTION.quaternion_xyzw, 0.1 * twist, twist)
    source.set_motion(motion, oblique)
    task = source.task_at(0.0)
    across = POSE.position_world + [0.01, 0.0, 0.0]
    assert_allclose(task.pose_des.position_world, across, atol=1e-12)
    acceleration = np.array([1.0, 0.0, 0.0, 4.0, 5.0, 6.0])
    assert_allclose(task.twist_des, 0.1 * acceleration, atol=1e-12)
    assert_allclose(task.acceleration_des, acceleration, atol=1e-12)


def test_new_start_forgets_commands():
    source = commanded_task()
    source.set_forces({'table': 5.0})
    source.start(POSE, NORMALS)
    task = source.task_at(0.0)
    assert not task.active.any()
    assert not task.alpha_des.any()


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
    approach = ApproachConfig(start_time=0.0, preload=3.0)
    source = scenario_task(EDGE, EDGE_COLUMNS, approach=approach)
    task = source.task_at(1.0)
    assert task.alpha_des.tolist() == [3.0, 0.0, 3.0]
    assert task.active.all()


def test_approach_accelerates_as_its_twist_changes():
    source = scenario_task(approach=ApproachConfig(start_time=0.2))
    tasks = run_task(source, 1.0, feel_nothing)
    twist = np.array([task.twist_des for task in tasks])
    acceleration = np.array([task.acceleration_des for task in tasks])
    rate = np.gradient(twist, 1.0 / RATE, axis=0)
    ramp = slice(150, 300)
    assert_allclose(acceleration[ramp], rate[ramp], atol=1e-9)
    assert acceleration[ramp].any()


MOTION_LIMITS = (
    'operational_speed',
    'operational_acceleration',
    'operational_turn',
    'operational_turn_acceleration',
)


@pytest.mark.parametrize('limit', MOTION_LIMITS)
def test_shortest_motion_reaches_the_limit_that_is_tightest(limit):
    """Speed and acceleration of a quintic over the way, by differences."""
    values = dict.fromkeys(MOTION_LIMITS, 100.0)
    values[limit] = 0.3
    change = np.array([0.3, 0.0, 0.4, 0.0, 1.2, 0.0])
    duration = shortest_motion_duration(change, LimitsConfig.model_construct(**values))
    times = np.linspace(0.0, duration, 4001)
    blend = np.array([quintic_blend(time, duration)[0] for time in times])
    step = times[1]
    speed = np.gradient(blend, step)
    way = 0.5
    if 'turn' in limit:
        way = 1.2
    reached = speed
    if 'acceleration' in limit:
        reached = np.gradient(speed, step)
    assert way * np.abs(reached[2:-2]).max() == pytest.approx(0.3, rel=1e-3)
