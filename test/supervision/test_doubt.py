"""Velocities that were refuted, holds that are stiff, and joint torques that are of no use."""

from contextlib import closing

from multicontact_control.control.tasks import MotionReading
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.supervision import reactions
from multicontact_control.supervision.reactions import ReactionHysteresis
import numpy as np
import pytest
from robots import robot_parameters
from supervision.test_recovery import (
    DEPTH,
    elbow_forces,
    ELBOW_WALL,
    standing,
    with_effort,
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
    loop = ClosedLoop(resolve('quick', plant=plant, **options), commanded=True)
    advance(loop, 0.1)
    return closing(loop)


def advance(loop, seconds, corrupt=None):
    """Advance; return the places of the tool [m], shape (ticks, 3), and the statuses."""
    robot = place_of(loop)
    places = []
    statuses = []
    for _ in range(round(seconds / H)):
        loop.advance(corrupt)
        places.append(robot(loop.plant.arm.q))
        statuses.append(loop.status)
    return np.array(places), statuses


def place_of(loop):
    """Return a function of joint positions that returns the place of the tool [m]."""
    model = RobotModel(loop.setup.controller.robot, loop.setup.urdf_dir)
    return lambda q: model.update(q, 0.0 * q).pose.position_world


def with_velocity(change):
    return lambda inputs: inputs._replace(
        joints=inputs.joints._replace(qd=change(inputs.joints.qd))
    )


def without_wrench(inputs):
    return inputs._replace(wrench=None)


def refute(loop):
    """Push an arm whose velocities have the opposite sign, until it is held, at rest again."""
    loop.plant.push(PUSH, 0.2, tool=True)
    _, statuses = advance(loop, 0.7, with_velocity(np.negative))
    assert 'joints_velocity' in statuses[-1].causes


@pytest.mark.slow
def test_hold_of_refuted_velocities_keeps_its_place_against_a_push(plant='rigid'):
    for wrong in WRONG.values():
        assert_held_against_a_push(plant, wrong)


@pytest.mark.slow
@pytest.mark.parametrize('name', ARMS)
@pytest.mark.parametrize('wrong', list(WRONG))
def test_hold_of_refuted_velocities_keeps_the_place_of_every_arm(name, wrong):
    assert_held_against_a_push(f'{name}/rigid', WRONG[wrong])


def assert_held_against_a_push(plant, wrong):
    """Push an arm with wrong velocities: it is held where that began, also at rest if refuted."""
    with make_loop(plant) as loop:
        loop.plant.push(PUSH, 1.5, tool=True)
        places, statuses = advance(loop, 3.0, with_velocity(wrong))
        refuted = loop.control.supervisor.inputs.velocities_refuted
    first = [status.reaction for status in statuses].index('hold')
    way = np.linalg.norm(places - places[first], axis=1)[first:]
    assert way.max() < FARTHEST and way[-1] < 1e-3
    assert refuted == ('joints_velocity' in statuses[-1].causes)
    assert not refuted or statuses[-1].reaction == 'hold'


@pytest.mark.parametrize('plant', ['flexible', 'panda/flexible', 'iiwa/flexible'])
@pytest.mark.parametrize('wrong', ['three times', 'offset'])
def test_hold_by_estimates_calms_down_behind_flexible_drives(plant, wrong):
    """As stiff as the law it swings there: it softens."""
    with make_loop(plant) as loop:
        loop.plant.push(PUSH, 1.0, tool=True)
        places, statuses = advance(loop, 3.0, with_velocity(WRONG[wrong]))
        speeds = np.abs(loop.plant.arm.qd).max()
    way = np.linalg.norm(places - places[0], axis=1)
    assert way.max() < 0.025 and way[-1] < 2e-3
    assert speeds < 1e-3 and {status.reaction for status in statuses} <= {
        'none',
        'hold',
    }


def test_hold_by_estimates_from_coarse_encoders_presses_on_a_stiff_surface():
    """12 bits per turn, no velocities, and 60 N/mm: no more force than without steps."""
    step = 2.0 * np.pi / 4096
    with make_loop('rigid') as loop:
        loop.control.set_forces({'table': 10.0, 'board': 10.0})
        advance(loop, 1.8)
        for surface in (0, 1):
            loop.plant.contacts.scale_stiffness(surface, 10.0)
        forces = []
        for _ in range(1000):
            loop.advance(
                lambda inputs: inputs._replace(
                    wrench=None,
                    joints=inputs.joints._replace(
                        qd=None, q=step * np.round(inputs.joints.q / step)
                    ),
                )
            )
            forces.append(loop.sample.contact_force.max())
    assert loop.status.reaction == 'hold'
    assert max(forces) < 30.0 and max(forces[-200:]) < 10.0


@pytest.mark.parametrize('name', ARMS)
def test_hold_is_as_stiff_as_the_motion_law(name):
    """Lambda w^2 at the tool, with the wrench missing; in either way it gives in as much."""
    ways = []
    for corrupt in (None, without_wrench):
        with make_loop(f'{name}/rigid') as loop:
            before, _ = advance(loop, 0.2, corrupt)
            loop.plant.push(PUSH, 1.0)  # before the sensor
            after, statuses = advance(loop, 0.9, corrupt)
        assert (statuses[-1].reaction == 'hold') == (corrupt is not None) or (
            'collision' in ' '.join(statuses[-1].causes)
        )
        ways.append(np.linalg.norm(after[-1] - before[-1]))
    assert ways[1] == pytest.approx(ways[0], rel=0.15)


def test_holds_one_soon_after_another_return_to_where_the_first_began():
    """The wrench is missing for 0.3 s every 0.5 s, and a hand pushes all the time."""
    with make_loop('rigid') as loop:
        loop.plant.push(PUSH, 4.0)
        places, statuses = advance(
            loop,
            5.0,
            lambda inputs: without_wrench(inputs) if loop.tick % 250 > 100 else inputs,
        )
    reactions_ = [status.reaction for status in statuses]
    assert sum(a != b for a, b in zip(reactions_, reactions_[1:])) >= 4
    first = reactions_.index('hold')
    way = np.linalg.norm(places - places[first], axis=1)[first:]
    assert way.max() < FARTHEST and way[-1] < 1e-3


def test_hold_after_a_commanded_motion_does_not_return_to_the_one_before():
    with make_loop('rigid') as loop:
        advance(loop, 0.1, without_wrench)
        advance(loop, 0.3)
        pose = loop.control.output.pose
        for _ in range(2):
            loop.control.set_motion(
                MotionReading(
                    pose.position_world + [0.02, 0.0, 0.0],
                    pose.quaternion_xyzw,
                    np.zeros(6),
                    np.zeros(6),
                )
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
        loop.plant.push(
            30.0 * (-1) ** k * np.eye(3)[k // 2 % 3], 0.15, tool=k // 6 % 2 == 0
        )
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
        assert {status.reaction for status in statuses} == {'hold'}
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
    with make_loop('rigid') as loop:
        _, statuses = advance(
            loop, 0.1, with_velocity(lambda qd: np.append(np.nan, qd[1:]))
        )
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
        assert not gate.running and not gate.open
        assert 'velocities are in doubt' in gate.instruction
        with pytest.raises(CommandError, match='velocities are in doubt'):
            loop.control.push_test(PushTestConfig())
        loop.control.retry()
        advance(loop, 0.5)
        assert loop.control.push_test(PushTestConfig()).startswith('keep off')


def broken(joint, number):
    """Return a change of the effort of a joint."""
    return with_effort(
        lambda effort: np.where(np.arange(len(effort)) == joint, number, effort)
    )


@pytest.mark.parametrize(
    ('plant', 'loaded', 'name'),
    [
        ('rigid', 0, 'joint{}'),
        ('panda/rigid', 1, 'panda_joint{}'),
        ('iiwa/rigid', 1, 'lbr_iiwa_joint_{}'),
    ],
)
@pytest.mark.parametrize('number', [np.nan, 0.0])
@pytest.mark.parametrize('begin', [0, 100])
def test_joints_with_a_torque_are_watched_beside_one_without(
    plant, loaded, name, number, begin
):
    """30 N on the elbow: seen within 6 ms, unless it is the joint that it loads alone."""
    for joint in range(3):
        with standing(plant, 0) as loop:
            elbow_forces(loop, begin)
            _, before = elbow_forces(loop, 100, broken(joint, number))
            assert {status.reaction for status in before} == {'none'}
            assert name.format(joint + 1) in before[-1].unwatched
            assert ('constantly 0' if number == 0.0 else 'not finite') in before[
                -1
            ].unwatched
            loop.plant.contacts.put_before_tip(ELBOW_WALL, -2.0 * DEPTH)
            _, statuses = elbow_forces(loop, 100, broken(joint, number))
            held = [status.reaction == 'hold' for status in statuses]
            assert joint == loaded or held.index(True) <= 3
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
    assert 'collision_panda_joint2' in {x for status in statuses for x in status.causes}


def test_first_torque_of_a_joint_without_a_measured_one_carries_it():
    with closing(ClosedLoop(resolve('quick', plant='rigid'), commanded=True)) as loop:
        gravity = loop.plant.initial_torque
        loop.advance(broken(1, 0.0))
        np.testing.assert_allclose(loop.command[1], gravity[1], rtol=0.02)


def test_wrench_of_the_residual_needs_the_torque_of_every_joint():
    with closing(
        ClosedLoop(
            resolve(
                'quick',
                plant='rigid',
                controller={'wrench_input': 'momentum', 'robot': {'sensor_frame': ''}},
            )
        )
    ) as loop:
        elbow_forces(loop, 100)
        _, statuses = elbow_forces(loop, 50, broken(3, np.nan))
    assert (
        statuses[-1].causes == ('wrench_stale',)
        and 'no wrench' in statuses[-1].unwatched
    )


def test_severer_of_two_reactions_that_take_turns_stays():
    steadiness = ReactionHysteresis(H)
    turns = [
        steadiness.steady_reaction(reactions.FLOAT if k % 10 < 2 else reactions.HOLD)
        for k in range(600)
    ]
    assert sum(a != b for a, b in zip(turns, turns[1:])) <= 4
    assert turns[-1] == reactions.FLOAT
    after = [steadiness.steady_reaction(reactions.HOLD) for _ in range(300)]
    assert after[0] == reactions.FLOAT and after[-1] == reactions.HOLD
    assert sum(a != b for a, b in zip(after, after[1:])) == 1


def test_reactions_do_not_alternate_with_joints_that_come_and_go_and_a_wrong_wrench():
    """A third of the joint states is missing, and the wrench has the opposite sign."""
    random = np.random.default_rng(1)
    with closing(ClosedLoop(resolve('quick', plant='rigid'))) as loop:
        advance(loop, 4.0)

        def corrupt(inputs):
            wrench = inputs.wrench._replace(wrench=1e-3 * inputs.wrench.wrench)
            joints = inputs.joints if random.random() > 0.3 else None
            return inputs._replace(joints=joints, wrench=wrench)

        _, statuses = advance(loop, 1.2, corrupt)
    reactions_ = [status.reaction for status in statuses]
    assert sum(a != b for a, b in zip(reactions_, reactions_[1:])) <= 8
