"""What a residual is said to come of: units, weights, friction, a wrench, an obstacle."""

from contextlib import closing

from multicontact_control.diagnosis.friction import undeclared_friction
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from supervision.test_recovery import (
    DEPTH,
    elbow_forces,
    ELBOW_WALL,
    standing,
    with_effort,
    with_wrench,
)
import yaml

FRICTION = 1.2  # N m, of a UR5's first wrist joint


def rubbing(folder, **controller):
    """Return a UR5 whose first wrist joint has friction that only the plant knows of."""
    robot = yaml.safe_load((find_config_folder() / 'robots' / 'ur5.yaml').read_text())
    robot |= {
        'coulomb': [0.0, 0.0, 0.0, FRICTION, 0.0, 0.0],
        'plants': {'rigid': {'plant': {'joint_friction_scale': 1.0}}},
    }
    path = folder / 'rubbing.yaml'
    path.write_text(yaml.safe_dump(robot))
    return ClosedLoop(resolve('quick', robot=str(path), controller=controller))


def test_undeclared_friction_is_learnt_and_named(tmp_path):
    """The wall is reached, and a joint without friction stays as it is."""
    with closing(rubbing(tmp_path)) as loop:
        joints = loop.control.supervisor.controller.arm.joints
        names = loop.setup.controller.robot.joint_names
        elbow_forces(loop, 3500)
        assert not loop.control.events.collisions
        assert loop.status.contact_states == ('holding', 'holding')
        friction = joints['watch']['residual_statistics']['friction']
        np.testing.assert_allclose(
            friction, [0.0, 0.0, 0.0, FRICTION, 0.0, 0.0], atol=0.1
        )
        (named,) = undeclared_friction(joints, names)
        assert named.startswith(names[3])
        loop.control.supervisor.reset()
        assert not joints['watch']['residual_statistics']['friction'].any()


FLIPPED = np.array([1, 1, 1, -1, 1, 1, 1])


def first_finding(loop, corrupt=None):
    """Advance by 20 ticks, and return what is found first."""
    findings = []
    for _ in range(20):
        elbow_forces(loop, 1, corrupt)
        findings += loop.control.supervisor.findings
    return findings[0]


@pytest.mark.parametrize(
    ('corrupt', 'controller', 'ticks', 'what'),
    [
        (with_effort(lambda effort: 1000.0 * effort), {}, 20, 'unit and sign'),
        (with_effort(lambda effort: effort * FLIPPED), {}, 20, 'joint alone'),
        (None, {'tool': {'mass': 1.5}}, 20, 'mass'),
        (with_wrench(lambda wrench: 0.5 * wrench), {}, 1300, 'robot.sensor_frame'),
    ],
)
def test_cause_of_a_collision_is_named(corrupt, controller, ticks, what):
    """Units, sign of one joint, weight, and wrench."""
    with standing('panda/rigid', 0, commanded=False, **controller) as loop:
        elbow_forces(loop, ticks - 20, corrupt)
        assert what in first_finding(loop, corrupt)


def test_obstacle_is_named_as_the_cause_of_a_collision():
    with standing('panda/rigid', 0, commanded=False) as loop:
        elbow_forces(loop, 380)
        loop.plant.contacts.put_before_tip(ELBOW_WALL, -DEPTH)
        assert 'touches' in first_finding(loop)


def test_friction_is_named_as_the_cause_of_a_collision(tmp_path):
    collision = {'threshold': [4.5, 4.5, 4.5, 1.0, 1.0, 1.0]}
    with closing(rubbing(tmp_path, collision=collision)) as loop:
        elbow_forces(loop, 200)
        assert 'friction.coulomb' in first_finding(loop)
