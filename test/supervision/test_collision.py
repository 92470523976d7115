"""Collisions of the arm before its wrist sensor: seen, named and reacted to."""

from contextlib import closing

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.situation import with_obstacles
from multicontact_control.experiment.faults.vocabulary import ELBOW_WALL, FAR
from multicontact_control.experiment.scenario import resolve
from multicontact_control.paths import config_dir
from multicontact_control.supervision.findings import undeclared_friction
import numpy as np
import pytest
import yaml

DEPTH = 2.5e-3  # m, at once: 15 N on the obstacle of 6000 N/m
FRICTION = 1.2  # N m, of a UR5's first wrist joint


def standing(plant, ticks=150, *, commanded=True, **controller):
    """Return a loop that stands still, an obstacle far from its elbow, to be closed."""
    overrides = with_obstacles('quick', plant, 0).plant.model_dump(
        include={'obstacle_names', 'surfaces'})
    loop = ClosedLoop(resolve('quick', plant=plant, plant_overrides=overrides,
                              controller=controller), commanded=commanded)
    advance(loop, ticks)
    assert not loop.control.events.collisions
    return closing(loop)


def without_effort(inputs):
    return inputs._replace(joints=inputs.joints._replace(effort=None))


def with_effort(change):
    return lambda inputs: inputs._replace(
        joints=inputs.joints._replace(effort=change(inputs.joints.effort)))


def half_the_wrench(inputs):
    return inputs._replace(wrench=inputs.wrench._replace(wrench=0.5 * inputs.wrench.wrench))


def rubbing(folder, **controller):
    """Return a UR5 whose first wrist joint has friction that only the plant knows of."""
    robot = yaml.safe_load((config_dir() / 'robots' / 'ur5.yaml').read_text())
    robot |= {'coulomb': [0.0, 0.0, 0.0, FRICTION, 0.0, 0.0],
              'plants': {'rigid': {'plant': {'joint_friction_scale': 1.0}}}}
    path = folder / 'rubbing.yaml'
    path.write_text(yaml.safe_dump(robot))
    return ClosedLoop(resolve('quick', robot=str(path), controller=controller))


def advance(loop, ticks, corrupt=None):
    """Advance; return the statuses and the forces on the obstacle."""
    statuses, forces = [], []
    for _ in range(ticks):
        loop.advance(corrupt)
        statuses.append(loop.status)
        forces.append(loop.plant.contacts.pressed[ELBOW_WALL])
    return statuses, np.array(forces)


@pytest.mark.parametrize(('plant', 'corrupt', 'joints'), [
    ('rigid', None, ('joint1', 'joint2')), ('rigid', without_effort, ('joint1', 'joint2')),
    ('panda/rigid', None, ('panda_joint2',)), ('iiwa/rigid', None, ('lbr_iiwa_joint_2',))])
def test_collision_of_15_newtons_is_seen_within_20_ms_and_held_against(
        plant, corrupt, joints):
    """On rigid drives, from measured torques and from commanded ones."""
    with standing(plant, collision={'command_delay': 1}) as loop:
        advance(loop, 10, corrupt)
        loop.plant.contacts.put_before_tip(ELBOW_WALL, -DEPTH)
        statuses, forces = advance(loop, 300, corrupt)
        seen = [bool(status.causes) for status in statuses].index(True)
        assert 10.0 < forces[0] <= 15.0
        assert seen <= 10
        # What is on the elbow's axis loads the joints before it alone.
        assert {cause for status in statuses for cause in status.causes} <= {
            *(f'collision_{joint}' for joint in joints), 'recovering'}
        assert statuses[seen].reaction == 'hold'
        assert forces.max() < 20.0
        assert loop.control.events.collisions.total() >= 1
        loop.plant.contacts.shift(ELBOW_WALL, FAR)
        statuses, _ = advance(loop, 1500, corrupt)
    assert (statuses[-1].reaction, statuses[-1].causes) == ('none', ())


@pytest.mark.parametrize('reaction', ['none', 'float', 'damp'])
def test_collision_reaction_is_the_declared_one(reaction):
    with standing('rigid', collision={'reaction': reaction}) as loop:
        loop.plant.contacts.put_before_tip(ELBOW_WALL, -DEPTH)
        statuses, _ = advance(loop, 20)
    assert {status.reaction for status in statuses if any(
        cause.startswith('collision') for cause in status.causes)} == {reaction}


def test_no_collision_is_named_in_forces_motion_and_pushes_of_5_newtons():
    """Friction, flexible drives and a hand at the wrist stay below the thresholds."""
    with closing(ClosedLoop(resolve('disturbance', plant='puma', duration=16.0))) as loop:
        largest, joints = 0.0, loop.control.supervisor.controller.arm.joints
        for _ in range(loop.setup.ticks):
            loop.advance()
            largest = max(largest, (np.abs(joints['residual']) / joints['threshold']).max())
    assert not loop.control.events.collisions
    assert 0.1 < largest < 0.9


def test_forces_are_controlled_without_a_wrist_sensor():
    """10 N on both surfaces, by the joint torques alone, on rigid drives without friction."""
    with closing(ClosedLoop(resolve('quick', plant='rigid', controller={
            'wrench_input': 'momentum', 'robot': {'sensor_frame': ''}}), commanded=True)) as loop:
        loop.advance()
        loop.control.set_forces({'table': 10.0, 'board': 10.0})
        forces = []
        for _ in range(2000):
            loop.advance()
            forces.append(loop.true_forces)
    assert loop.status.contact_states == ('holding',) * 2
    assert np.max(forces) < 25.0
    np.testing.assert_allclose(np.mean(forces[-500:], axis=0), 10.0, atol=0.3)
    assert np.std(forces[-500:], axis=0).max() < 0.5
    for changes in ({'wrench_input': 'momentum'}, {'robot': {'sensor_frame': ''}}):
        with pytest.raises(ConfigError, match='robot.sensor_frame'):  # both, or neither
            resolve('quick', controller=changes)


def test_undeclared_friction_is_learnt_and_named(tmp_path):
    """The wall is reached, and a joint without friction stays as it is."""
    with closing(rubbing(tmp_path)) as loop:
        joints, names = (loop.control.supervisor.controller.arm.joints,
                         loop.setup.controller.robot.joint_names)
        advance(loop, 3500)
        assert not loop.control.events.collisions
        assert loop.status.contact_states == ('holding', 'holding')
        friction = joints['evidence']['friction']
        np.testing.assert_allclose(friction, [0.0, 0.0, 0.0, FRICTION, 0.0, 0.0], atol=0.1)
        named, = undeclared_friction(joints, names)
        assert named.startswith(names[3])
        loop.control.supervisor.reset()
        assert not joints['evidence']['friction'].any()


@pytest.mark.parametrize(('corrupt', 'controller', 'ticks', 'what'), [
    (with_effort(lambda effort: 1000.0 * effort), {}, 20, 'unit and sign'),
    (with_effort(lambda effort: effort * [1, 1, 1, -1, 1, 1, 1]), {}, 20, 'joint alone'),
    (None, {'tool': {'mass': 1.5}}, 20, 'mass'), (half_the_wrench, {}, 1300, 'robot.sensor_frame'),
    (None, {'collision': {'threshold': [4.5, 4.5, 4.5, 1.0, 1.0, 1.0]}}, 220, 'friction.coulomb'),
    (None, {}, 400, 'touches')])
def test_cause_of_a_collision_is_named(tmp_path, corrupt, controller, ticks, what):
    """Units, sign of one joint, weight, wrench, friction, and an obstacle."""
    with closing(rubbing(tmp_path, **controller)) if what == 'friction.coulomb' else (
            standing('panda/rigid', 0, commanded=False, **controller)) as loop:
        advance(loop, ticks - 20, corrupt)
        if what == 'touches':
            loop.plant.contacts.put_before_tip(ELBOW_WALL, -DEPTH)
        findings = []
        for _ in range(20):
            advance(loop, 1, corrupt)
            findings += loop.control.supervisor.findings
    assert what in findings[0]
