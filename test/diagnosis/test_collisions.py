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


@pytest.mark.parametrize(
    ('corrupt', 'controller', 'ticks', 'what'),
    [
        (with_effort(lambda effort: 1000.0 * effort), {}, 20, 'unit and sign'),
        (
            with_effort(lambda effort: effort * [1, 1, 1, -1, 1, 1, 1]),
            {},
            20,
            'joint alone',
        ),
        (None, {'tool': {'mass': 1.5}}, 20, 'mass'),
        (
            lambda inputs: inputs._replace(
                wrench=inputs.wrench._replace(wrench=0.5 * inputs.wrench.wrench)
            ),
            {},
            1300,
            'robot.sensor_frame',
        ),
        (
            None,
            {'collision': {'threshold': [4.5, 4.5, 4.5, 1.0, 1.0, 1.0]}},
            220,
            'friction.coulomb',
        ),
        (None, {}, 400, 'touches'),
    ],
)
def test_cause_of_a_collision_is_named(tmp_path, corrupt, controller, ticks, what):
    """Units, sign of one joint, weight, wrench, friction, and an obstacle."""
    with (
        closing(rubbing(tmp_path, **controller))
        if what == 'friction.coulomb'
        else (standing('panda/rigid', 0, commanded=False, **controller)) as loop
    ):
        elbow_forces(loop, ticks - 20, corrupt)
        if what == 'touches':
            loop.plant.contacts.put_before_tip(ELBOW_WALL, -DEPTH)
        findings = []
        for _ in range(20):
            elbow_forces(loop, 1, corrupt)
            findings += loop.control.supervisor.findings
    assert what in findings[0]
