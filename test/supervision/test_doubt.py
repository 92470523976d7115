"""Velocities that were refuted, holds that are stiff, and joint torques that are of no use."""

from contextlib import closing

from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.supervision.causes import TO_FLOAT, TO_HOLD
from multicontact_control.supervision.recovery import (
    HYSTERESIS,
    reset_hysteresis,
    steady_reaction,
)
import numpy as np
import pytest
from robots import robot_parameters
from supervision.test_recovery import (
    causes_of,
    command_pose,
    count_changes,
    DEPTH,
    elbow_forces,
    ELBOW_WALL,
    press,
    quick_loop,
    reactions_of,
    standing,
    with_effort,
    with_joints,
    with_wrench,
    WITHOUT_SENSOR,
    without_wrench,
)

H = 0.002
PUSH = np.array([10.0, 0.0, 0.0])
FARTHEST = 0.005  # m
ARMS = robot_parameters(['puma', 'panda', 'iiwa', 'ur5', 'kinova', 'fr3'])
WRONG = {
    'three times': lambda qd: 3.0 * qd,
    'flipped': lambda qd: -qd,
    'degrees': np.degrees,
    'frozen': lambda qd: 0.0 * qd + 0.08,
    'offset': lambda qd: qd + 0.2,
    'of another joint': lambda qd: np.roll(qd, 1),
}


def make_loop(plant, **options):
    """Return a commanded loop, to be closed, after 0.1 s at rest."""
    loop = quick_loop(plant, **options)
    advance(loop, 0.1)
    return closing(loop)


def advance(loop, seconds, corrupt=None):
    """Advance; return the places of the tool [m], shape (ticks, 3), and the statuses."""
    model = RobotModel(loop.setup.controller.robot, loop.setup.urdf_dir)
    places = []
    statuses = []
    for _ in range(round(seconds / H)):
        loop.advance(corrupt)
        q = loop.plant.arm.q
        places.append(model.update(q, 0.0 * q).pose.position_world)
        statuses.append(loop.status)
    return np.array(places), statuses


def with_velocity(change):
    return with_joints('qd', change)


def distances(places, first):
    """Return how far a place and those after it are from it [m]."""
    return np.linalg.norm(places[first:] - places[first], axis=1)


def assert_held_from(places, statuses):
    """Assert that an arm that is held stays, and ends, where its first hold began."""
    away = distances(places, reactions_of(statuses).index('hold'))
    assert away.max() < FARTHEST
    assert away[-1] < 1e-3


def refute(loop):
    """Push an arm whose velocities have the opposite sign, until it is held, at rest again."""
    loop.plant.push(PUSH, 0.2, tool=True)
    _, statuses = advance(loop, 0.7, with_velocity(np.negative))
    assert 'joints_velocity' in statuses[-1].causes


@pytest.mark.slow
@pytest.mark.parametrize('name', ARMS)
@pytest.mark.parametrize('wrong', list(WRONG))
def test_hold_of_refuted_velocities_keeps_the_place_of_every_arm(name, wrong):
    """A push on an arm: it is held where that began, also at rest if they are refuted."""
    with make_loop(f'{name}/rigid') as loop:
        loop.plant.push(PUSH, 1.5, tool=True)
        places, statuses = advance(loop, 3.0, with_velocity(WRONG[wrong]))
        refuted = loop.control.supervisor.inputs.velocities_refuted
    assert_held_from(places, statuses)
    assert refuted == ('joints_velocity' in statuses[-1].causes)
    if refuted:
        assert statuses[-1].reaction == 'hold'


@pytest.mark.parametrize('plant', ['flexible', 'panda/flexible', 'iiwa/flexible'])
@pytest.mark.parametrize('wrong', ['three times', 'offset'])
def test_hold_by_estimates_calms_down_behind_flexible_drives(plant, wrong):
    """As stiff as the law it swings there: it softens."""
    with make_loop(plant) as loop:
        loop.plant.push(PUSH, 1.0, tool=True)
        places, statuses = advance(loop, 3.0, with_velocity(WRONG[wrong]))
        speeds = np.abs(loop.plant.arm.qd).max()
    away = distances(places, 0)
    assert away.max() < 0.025
    assert away[-1] < 2e-3
    assert speeds < 1e-3
    assert set(reactions_of(statuses)) <= {'none', 'hold'}


def press_by_coarse_encoders(seed):
    """Return the largest forces of both surfaces once they are ten times stiffer [N]."""
    step = 2.0 * np.pi / 4096

    def read_encoders(inputs):
        q = step * np.round(inputs.joints.q / step)
        return inputs._replace(wrench=None, joints=inputs.joints._replace(qd=None, q=q))

    with make_loop('rigid', seed=seed) as loop:
        press(loop, 10.0, 10.0)
        advance(loop, 1.8)
        for surface in (0, 1):
            loop.plant.contacts.scale_stiffness(surface, 10.0)
        forces = []
        for _ in range(1000):
            loop.advance(read_encoders)
            forces.append(loop.sample.contact_force.max())
        assert loop.status.reaction == 'hold'
    return np.array(forces)


def test_hold_by_estimates_from_coarse_encoders_presses_on_a_stiff_surface():
    """12 bits per turn, no velocities, and 60 N/mm: where the steps fall decides how much."""
    forces = np.array([press_by_coarse_encoders(seed) for seed in range(11)])
    assert np.median(forces.max(axis=1)) < 30.0
    assert forces[:, -200:].max() < 10.0


@pytest.mark.parametrize('name', ARMS)
def test_hold_is_as_stiff_as_the_motion_law(name):
    """Lambda w^2 at the tool, with the wrench missing; in either way it gives in as much."""
    ways = []
    for corrupt in (None, without_wrench):
        with make_loop(f'{name}/rigid') as loop:
            before, _ = advance(loop, 0.2, corrupt)
            loop.plant.push(PUSH, 1.0)  # before the sensor
            after, statuses = advance(loop, 0.9, corrupt)
        held = statuses[-1].reaction == 'hold'
        for_a_collision = 'collision' in ' '.join(statuses[-1].causes)
        assert for_a_collision or held == (corrupt is not None)
        way = after[-1] - before[-1]
        ways.append(np.linalg.norm(way))
    assert ways[1] == pytest.approx(ways[0], rel=0.15)


def test_holds_one_soon_after_another_return_to_where_the_first_began():
    """The wrench is missing for 0.3 s every 0.5 s, and a hand pushes all the time."""

    def drop_wrenches(inputs):
        if loop.tick % 250 > 100:
            return without_wrench(inputs)
        return inputs

    with make_loop('rigid') as loop:
        loop.plant.push(PUSH, 4.0)
        places, statuses = advance(loop, 5.0, drop_wrenches)
    assert count_changes(reactions_of(statuses)) >= 4
    assert_held_from(places, statuses)


def test_hold_after_a_commanded_motion_does_not_return_to_the_one_before():
    with make_loop('rigid') as loop:
        advance(loop, 0.1, without_wrench)
        advance(loop, 0.3)
        pose = loop.control.output.pose
        for _ in range(2):
            command_pose(
                loop, pose.position_world + [0.02, 0.0, 0.0], pose.quaternion_xyzw
            )
            places, _ = advance(loop, 0.3)
        held, statuses = advance(loop, 1.0, without_wrench)
    assert statuses[-1].reaction == 'hold'
    np.testing.assert_allclose(held[-1], places[-1], atol=1e-3)


def shake(loop, corrupt=None):
    """Move an arm by hand, to and fro in every direction, until its velocities are proven."""
    for k in range(24):
        if not loop.control.supervisor.inputs.velocities_refuted:
            break
        push = np.zeros(3)
        push[k // 2 % 3] = 30.0 * (-1) ** k
        loop.plant.push(push, 0.15, tool=k // 6 % 2 == 0)
        advance(loop, 0.2, corrupt)
    advance(loop, 3.0, corrupt)


@pytest.mark.slow
@pytest.mark.parametrize('plant', ['rigid', 'kinova/rigid'])
def test_velocities_that_were_refuted_are_proven_by_hand_alone(plant):
    """At rest nothing proves them, in motion only right ones."""
    changes = {'collision': {'reaction': 'none'}, 'watchdog': {'friction_bound': 10.0}}
    with make_loop(plant, controller=changes) as loop:
        refute(loop)
        _, statuses = advance(loop, 2.0)
        assert set(reactions_of(statuses)) == {'hold'}
        shake(loop, with_velocity(np.negative))
        assert loop.status.causes == ('joints_velocity',)
        shake(loop)
        assert loop.status.reaction == 'none'
        assert not loop.control.supervisor.inputs.velocities_refuted


@pytest.mark.parametrize('way', ['retry', 'hold', 'force'])
def test_operator_resumes_control_on_estimates_until_they_are_refuted_again(way):
    with make_loop('rigid') as loop:
        refute(loop)
        if way == 'retry':
            assert loop.control.retry() == 'trying again'
        elif way == 'hold':
            loop.control.hold(False)
        else:
            loop.control.set_forces({'table': 10.0})
        _, statuses = advance(loop, 0.5)
        assert statuses[-1].reaction == 'none'
        assert loop.control.supervisor.inputs.velocities_refuted
        loop.plant.push(3.0 * PUSH, 0.2)
        _, statuses = advance(loop, 1.0, with_velocity(np.negative))
        assert statuses[-1].reaction == 'hold'


def test_velocities_that_are_no_numbers_for_a_moment_refute_nothing():
    without_first = with_velocity(lambda qd: np.append(np.nan, qd[1:]))
    with make_loop('rigid') as loop:
        _, statuses = advance(loop, 0.1, without_first)
        assert statuses[-1].causes == ('joints_velocity',)
        _, statuses = advance(loop, 0.3)
    assert statuses[-1].reaction == 'none'


def test_push_test_neither_begins_nor_goes_on_while_velocities_are_in_doubt():
    with make_loop('rigid', controller={'sensor': {'require_push_test': True}}) as loop:
        loop.control.push_test(PushTestConfig())
        advance(loop, 0.5)
        assert loop.control.push_gate.phase == 'push'
        refute(loop)
        gate = loop.control.push_gate
        assert not gate.running
        assert not gate.open
        assert 'velocities are in doubt' in gate.instruction
        with pytest.raises(CommandError, match='velocities are in doubt'):
            loop.control.push_test(PushTestConfig())
        loop.control.retry()
        advance(loop, 0.5)
        assert loop.control.push_test(PushTestConfig()).startswith('keep off')


def broken(joint, number):
    """Return a change of the effort of a joint."""

    def change(effort):
        changed = np.array(effort)
        changed[joint] = number
        return changed

    return with_effort(change)


@pytest.mark.parametrize(
    ('plant', 'loaded', 'name'),
    [
        ('rigid', 0, 'joint{}'),
        ('panda/rigid', 1, 'panda_joint{}'),
        ('iiwa/rigid', 1, 'lbr_iiwa_joint_{}'),
    ],
)
@pytest.mark.parametrize(
    ('number', 'why'), [(np.nan, 'not finite'), (0.0, 'constantly 0')]
)
@pytest.mark.parametrize('begin', [0, 100])
@pytest.mark.parametrize('joint', range(3))
def test_joints_with_a_torque_are_watched_beside_one_without(
    plant, loaded, name, number, why, begin, joint
):
    """30 N on the elbow: seen within 6 ms, unless it is the joint that it loads alone."""
    with standing(plant, 0) as loop:
        elbow_forces(loop, begin)
        _, before = elbow_forces(loop, 100, broken(joint, number))
        assert set(reactions_of(before)) == {'none'}
        assert name.format(joint + 1) in before[-1].unwatched
        assert why in before[-1].unwatched
        loop.plant.contacts.put_before_tip(ELBOW_WALL, -2.0 * DEPTH)
        _, statuses = elbow_forces(loop, 100, broken(joint, number))
        if joint != loaded:
            assert reactions_of(statuses).index('hold') <= 3
        _, after = elbow_forces(loop, 2)
        assert after[-1].unwatched == ''


@pytest.mark.parametrize('change', [lambda effort: None, lambda effort: effort[:-1]])
def test_efforts_that_do_not_come_are_reported(change):
    with standing('rigid') as loop:
        _, statuses = elbow_forces(loop, 10, with_effort(change))
        assert statuses[-1].unwatched.endswith(
            'of all missing; collisions are not watched'
        )
        _, statuses = elbow_forces(
            loop, 10, lambda inputs: inputs._replace(joints=None)
        )
        _, statuses = elbow_forces(loop, 10)
    assert statuses[-1].unwatched == ''


def test_torque_that_is_zero_in_a_sample_is_one():
    """A joint without load may say so; one with it that says 0 measures nothing."""
    with standing('rigid') as loop:
        joints = loop.control.supervisor.controller.arm.joints
        elbow_forces(loop, 1, broken(0, 0.0))
        assert joints['watch']['effort_fault'].tolist() == [0] * 6
        elbow_forces(loop, 1, broken(1, 0.0))
        assert joints['watch']['effort_fault'].tolist() == [0, 3, 0, 0, 0, 0]


def test_command_stands_in_for_the_torque_of_a_joint():
    with standing('panda/rigid', 0, collision={'command_delay': 1}) as loop:
        _, before = elbow_forces(loop, 150, broken(1, np.nan))
        assert before[-1].unwatched.endswith('the commands stand in for them')
        loop.plant.contacts.put_before_tip(ELBOW_WALL, -2.0 * DEPTH)
        _, statuses = elbow_forces(loop, 100, broken(1, np.nan))
    assert 'collision_panda_joint2' in causes_of(statuses)


def test_first_torque_of_a_joint_without_a_measured_one_carries_it():
    with closing(quick_loop('rigid')) as loop:
        gravity = loop.plant.initial_torque
        loop.advance(broken(1, 0.0))
        np.testing.assert_allclose(loop.command[1], gravity[1], rtol=0.02)


def test_wrench_of_the_residual_needs_the_torque_of_every_joint():
    with closing(
        quick_loop('rigid', commanded=False, controller=WITHOUT_SENSOR)
    ) as loop:
        elbow_forces(loop, 100)
        _, statuses = elbow_forces(loop, 50, broken(3, np.nan))
    assert statuses[-1].causes == ('wrench_stale',)
    assert 'no wrench' in statuses[-1].unwatched


def test_severer_of_two_reactions_that_take_turns_stays():
    (hysteresis,) = np.zeros(1, HYSTERESIS)
    hysteresis['period'] = H
    reset_hysteresis(hysteresis)
    turns = ([TO_FLOAT] * 2 + [TO_HOLD] * 8) * 60
    taken = [steady_reaction(hysteresis, reaction) for reaction in turns]
    assert count_changes(taken) <= 4
    assert taken[-1] == TO_FLOAT
    after = [steady_reaction(hysteresis, TO_HOLD) for _ in range(300)]
    assert after[0] == TO_FLOAT
    assert after[-1] == TO_HOLD
    assert count_changes(after) == 1


def test_reactions_do_not_alternate_with_joints_that_come_and_go_and_a_wrong_wrench():
    """A third of the joint states is missing, and the wrench is a thousandth of what it is."""
    random = np.random.default_rng(1)

    weaken = with_wrench(lambda wrench: 1e-3 * wrench)

    def corrupt(inputs):
        inputs = weaken(inputs)
        if random.random() > 0.3:
            return inputs
        return inputs._replace(joints=None)

    with closing(quick_loop('rigid', commanded=False)) as loop:
        advance(loop, 4.0)
        _, statuses = advance(loop, 1.2, corrupt)
    assert count_changes(reactions_of(statuses)) <= 8
