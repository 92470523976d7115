"""Whatever fails, an arm whose joints are known is carried: simulated arms do not fall."""

from arms import controller_config, HOME, still_config
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.reference import CommandedReference
from multicontact_control.control_loop import ControlLoop
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.vocabulary import PARTS
from multicontact_control.experiment.scenario import resolve
from multicontact_control.paths import config_dir
from multicontact_control.sampling import PairedSample
from multicontact_control.sensor.weight import weight_reading
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.supervisor import Supervisor
import numpy as np
import pytest

ROBOT = RobotModel(controller_config().robot, config_dir())
FEET = {'a': [0.05, 0.05, 0.24], 'b': [-0.05, 0.05, 0.24], 'c': [-0.05, -0.05, 0.24],
        'd': [0.05, -0.05, 0.24]}
LINE = {'a': [0.0, 0.0, 0.24], 'b': [0.05, 0.0, 0.24], 'c': [0.1, 0.0, 0.24]}


def pressing(points, normals=None):
    return controller_config(contact_names=list(points), contacts={
        name: {'normal_world': (normals or {}).get(name, [0.0, 0.0, -1.0]),
               'point_operational': point} for name, point in points.items()})


@pytest.mark.parametrize('points', [FEET, LINE], ids=['four coplanar feet', 'three in a line'])
def test_contacts_that_no_wrist_sensor_can_tell_apart_are_refused(points):
    config = pressing(points)
    with pytest.raises(ConfigError, match=f'found {", ".join(points)}, which depend'):
        ControlLoop(config, None, CommandLimits(), config_dir())


def test_three_feet_are_accepted_and_so_is_what_depends_in_one_orientation_only():
    here = ROBOT.update(HOME, np.zeros(6)).pose.rotation_world
    for config, rank in ((pressing(dict(list(FEET.items())[:3])), 3), (aligned_config(), 1)):
        law = Supervisor(config, ROBOT, CommandedReference(config.contact_names)).controller
        assert np.linalg.matrix_rank(normal_space(law.contacts.copy(), here), 1e-9) == rank


def aligned_points():
    """Return two points of which, at the first posture, one is straight above the other."""
    rotation = ROBOT.update(HOME, np.zeros(6)).pose.rotation_world
    table = np.array([0.0, 0.0, 0.24])
    board = table + 0.05 * rotation.T @ np.array([0.0, 0.0, -1.0])
    return {'table': {'normal_world': [0.0, 0.0, -1.0], 'point_operational': table.tolist()},
            'board': {'normal_world': [0.0, 0.0, -1.0], 'point_operational': board.tolist()}}


def aligned_config():
    return controller_config(contacts=aligned_points())


def test_control_begins_where_the_arm_was_moved_to_after_an_attempt_that_failed(monkeypatch):
    """Free to be moved where there is no answer: not drawn back to there."""
    config = still_config(watchdog={'on_law_fault': 'damp'})
    loop, random = ControlLoop(config, None, CommandLimits(), config_dir()), (
        np.random.default_rng(0))

    def fail(settled):
        raise ArithmeticError

    monkeypatch.setattr(loop.supervisor._law, 'answer', fail)
    way, ticks = np.array([0.1, 0.0, 0.1, 0.0, 0.2, 0.0]), 500
    for k in range(2 * ticks):
        share, qd = (min(k, ticks) / ticks, way / (ticks * config.period) * (k < ticks))
        q = HOME + share * way + 1e-7 * random.standard_normal(6)
        pose = ROBOT.update(q, qd).sensor_pose
        weight = weight_reading(
            pose.rotation_world, config.tool, np.array(config.robot.gravity_world))
        loop.step(PairedSample(
            2_000_000 * k, q, qd, weight + 0.02 * random.standard_normal(6), None))
        if k == ticks:
            assert loop.status.reaction == 'damp' or 'recovering' in loop.status.causes
            monkeypatch.undo()
    assert loop.status.reaction == 'none'
    np.testing.assert_allclose(
        loop.output.pose_des.position_world, loop.output.pose.position_world, atol=1e-4)


def carried(loop, ticks, sag=0.02):
    """Advance a loop, and assert that the arm stays where it is."""
    start = loop.sample.q.copy()
    limit = np.array(loop.setup.controller.torque_limit)
    for _ in range(ticks):
        loop.advance()
        assert np.isfinite(loop.command).all()
        assert (np.abs(loop.command) <= limit).all()
        assert np.abs(loop.sample.q - start).max() < sag


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_law_without_an_answer_leaves_the_arm_where_it_is(plant):
    loop = ClosedLoop(resolve('quick', plant=plant, controller={'contacts': aligned_points()}))
    try:
        carried(loop, 500)
        assert (loop.status.reaction, loop.status.causes) == ('hold', ('latched',))
        assert any('law_ContactGeometryError' in what for _, what in loop.control.events.events)
    finally:
        loop.close()


@pytest.mark.parametrize('stage', PARTS)
@pytest.mark.parametrize('begin', [5, 700], ids=['from the start', 'approaching'])
def test_exception_in_any_stage_leaves_the_arm_where_it_is_and_control_comes_back(
        stage, begin, monkeypatch):
    def fail(*_arguments, **_named):
        raise ArithmeticError(stage)

    loop = ClosedLoop(resolve('quick', plant='puma'))
    try:
        for _ in range(begin):
            loop.advance()
        *way, name = stage.split('.')
        owner = loop.control.supervisor
        for part in way:
            owner = getattr(owner, part)
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, fail)
            carried(loop, 500, sag=0.03)
        if loop.status.causes == ('latched',):
            loop.control.retry()
        back = 0
        for _ in range(1000):
            loop.advance()
            back = back + 1 if loop.status.reaction == 'none' else 0
            if back == 250:
                break
        assert back >= 250
    finally:
        loop.close()


def test_arm_that_was_not_seen_for_a_moment_is_held_once_it_is_seen_again():
    """While it waited for control to go on, or for an operator, it floated undamped."""
    loop = ClosedLoop(resolve('quick', plant='rigid', controller={
        'watchdog': {'recovery_time': 0.3}}), commanded=True)
    try:
        for _ in range(200):
            loop.advance()
        for _ in range(20):
            loop.advance(lambda inputs: inputs._replace(joints=None))
        assert (loop.status.reaction, loop.status.causes) == ('float', ('joints_stale',))
        for _ in range(25):
            loop.advance()
        assert (loop.status.reaction, loop.status.causes) == ('hold', ('recovering',))
        start = loop.sample.q.copy()
        loop.plant.push(np.array([0.0, 0.0, -10.0]), 0.05)
        while loop.status.reaction == 'hold':
            loop.advance()
            assert np.abs(loop.sample.q - start).max() < 0.02
    finally:
        loop.close()


def test_arm_that_waits_damped_is_damped_again_after_a_gap():
    config = controller_config(collision={'reaction': 'damp'})
    supervisor = Supervisor(config, ROBOT, CommandedReference(config.contact_names))
    supervisor._react(('collision_joint2',), (), 'damp')
    supervisor._react(('joints_stale',), (), 'float')
    supervisor._react(('internal_ValueError', 'joints_stale'), (), 'float')
    assert supervisor._waiting_reaction == 'damp'


def test_posture_that_is_held_after_an_arm_was_moved_by_hand_is_that_where_it_is_then():
    config = controller_config()
    supervisor = Supervisor(config, ROBOT, CommandedReference(config.contact_names))
    reactions, arm = supervisor._reactions, supervisor.controller.arm

    def torque(reaction, q):
        arm.update(q, np.zeros(6))
        return reactions.torque(reaction, arm, True)
    held = torque('hold', HOME)
    torque('damp', HOME + 0.1)
    moved = torque('hold', HOME + 0.1)
    assert np.abs(moved - arm.bias_torque).max() < 1e-9
    assert np.abs(torque('hold', HOME) - held).max() > 1.0


def test_what_is_held_on_with_is_the_couple_too_whatever_its_sign():
    setup = resolve('plane', plant='rigid')
    loop = ClosedLoop(setup)
    try:
        while loop.tick < round(7.0 * setup.controller.rate):  # face/across is to be -3 N
            loop.advance()
        output = loop.control.output
        assert output.alpha_est.min() < -2.0
        reactions = loop.control.supervisor._reactions
        reactions.begin(output)
        pressed = reactions._pressing.torque(np.ones(len(output.contacts), dtype=bool))
        contacts = output.contacts
        expected = loop.control.supervisor.controller.robot.terms.jacobian.T @ (
            contacts['N'].T @ output.alpha_est)
        np.testing.assert_allclose(pressed, expected, atol=0.05 * np.abs(expected).max())
    finally:
        loop.close()
