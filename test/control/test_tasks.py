"""Scenario and commanded tasks: times, derivatives, refusals."""

from multicontact_control.control.tasks import (
    ApproachConfig,
    CommandedTask,
    evaluate_sine_motion,
    ForceStepConfig,
    MotionReading,
    ReferenceConfig,
    ScenarioTask,
    SineConfig,
)
from multicontact_control.dynamics.rotations import Pose
import numpy as np
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
    np.testing.assert_allclose(touched[450].twist_des[:3], [0.0, 0.02, -0.02])
    np.testing.assert_allclose(touched[-1].twist_des[:3], [0.0, 0.02, 0.0])
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
    np.testing.assert_array_equal(
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
    np.testing.assert_allclose(
        values[1:, 1:], ((ahead - behind) / (2 * h))[1:, :2], atol=1e-5
    )
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
        np.testing.assert_array_equal(late.pose_des.position_world, POSE.position_world)
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
