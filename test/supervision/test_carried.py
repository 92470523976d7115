"""Whatever fails, an arm whose joints are known is carried: simulated arms do not fall."""

from functools import reduce

from arms import controller_config, HOME, still_config
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.reference import CommandedReference
from multicontact_control.control_loop import ControlLoop
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.vocabulary import PARTS
from multicontact_control.experiment.scenario import resolve
from multicontact_control.paths import config_dir
from multicontact_control.sampling import JointReading, PairedSample
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
    """Neither shares the wrench with the smallest norm, as four feet have to."""
    three = pressing(dict(list(FEET.items())[:3]))
    four = pressing(FEET)
    four = four.model_copy(update={'force': four.force.model_copy(
        update={'dependent_columns': 'minimum_norm'})})
    here = ROBOT.update(HOME, np.zeros(6)).pose.rotation_world
    for config, dependent, rank in ((three, False, 3), (four, True, 3),
                                    (aligned_config(), False, 1)):
        law = Supervisor(config, ROBOT, CommandedReference(config.contact_names)).controller
        assert law.controls['law']['dependent'][0] == dependent
        assert np.linalg.matrix_rank(normal_space(law.contacts.copy(), here), 1e-9) == rank


def test_forces_of_dependent_contacts_are_shared_anew_in_every_tick():
    """What was shared once is not shared again, which would wear it down."""
    config = pressing(FEET)
    config = config.model_copy(update={'force': config.force.model_copy(
        update={'dependent_columns': 'minimum_norm'})})
    reference = CommandedReference(config.contact_names)
    law, shared = Controller(config, ROBOT, reference), []
    for k in range(50):
        output = law.step(Measurement(0.002 * k, HOME, np.zeros(6), np.zeros(6)), np.full(4, 0.6))
        if k == 0:
            reference.set_forces({'a': 9.0, 'b': 5.0, 'c': 5.0, 'd': 5.0})
        else:
            shared.append(output.alpha_des.copy())
    np.testing.assert_array_equal(shared, shared[:1] * len(shared))
    np.testing.assert_allclose(shared[0], [8.0, 6.0, 4.0, 6.0], atol=1e-3)


def test_forces_that_dependent_contacts_would_turn_into_pulls_are_refused():
    loop = ControlLoop(still_config(
        contact_names=list(FEET), force={'dependent_columns': 'minimum_norm'},
        contacts={name: {'normal_world': [0.0, 0.0, -1.0], 'point_operational': point}
                  for name, point in FEET.items()}), None, CommandLimits(), config_dir())
    weight = weight_reading(ROBOT.update(HOME, np.zeros(6)).sensor_pose.rotation_world,
                            loop.config.tool, np.array(loop.config.robot.gravity_world))
    random = np.random.default_rng(0)
    for k in range(5):
        loop.step(PairedSample(2_000_000 * k, HOME, np.zeros(6),
                               weight + 0.02 * random.standard_normal(6), None))
    with pytest.raises(CommandError, match='force on c: expected at least 3 N of what dependent '
                       'contacts share, found -1.25 N'):
        loop.set_forces({'a': 20.0, 'b': 3.0, 'c': 3.0, 'd': 3.0})
    assert set(loop.commanded_forces.values()) == {0.0}
    loop.set_forces({'a': 9.0, 'b': 5.0, 'c': 5.0, 'd': 5.0})
    loop.set_forces({'d': 0.0})  # three of them are independent
    assert loop.commanded_forces == {'a': 9.0, 'b': 5.0, 'c': 5.0, 'd': 0.0}


def aligned_points():
    """Return two points of which, at the first posture, one is straight above the other."""
    rotation = ROBOT.update(HOME, np.zeros(6)).pose.rotation_world
    table = np.array([0.0, 0.0, 0.24])
    board = table + 0.05 * rotation.T @ np.array([0.0, 0.0, -1.0])
    return {'table': {'normal_world': [0.0, 0.0, -1.0], 'point_operational': table.tolist()},
            'board': {'normal_world': [0.0, 0.0, -1.0], 'point_operational': board.tolist()}}


def aligned_config():
    return controller_config(contacts=aligned_points())


def test_control_begins_where_the_arm_was_moved_to_after_an_attempt_that_failed():
    """Free to be moved where there is no answer: not drawn back to there."""
    config = still_config(watchdog={'on_law_fault': 'damp'}, contacts=aligned_points())
    loop, random = ControlLoop(config, None, CommandLimits(), config_dir()), (
        np.random.default_rng(0))
    way, ticks = np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]), 500  # away from where they are aligned
    for k in range(2 * ticks):
        share, qd = (min(k, ticks) / ticks, way / (ticks * config.period) * (k < ticks))
        q = HOME + share * way + 1e-7 * random.standard_normal(6)
        pose = ROBOT.update(q, qd).sensor_pose
        weight = weight_reading(
            pose.rotation_world, config.tool, np.array(config.robot.gravity_world))
        loop.step(PairedSample(
            2_000_000 * k, q, qd, weight + 0.02 * random.standard_normal(6), None))
        if k == 0:
            assert loop.status.causes == ('law_ContactGeometryError',)
            assert loop.status.reaction == 'damp'
    if loop.status.causes == ('latched',):
        loop.retry()
        for k in range(2 * ticks, 2 * ticks + 100):
            loop.step(PairedSample(2_000_000 * k, q + 1e-7 * random.standard_normal(6), qd,
                                   weight + 0.02 * random.standard_normal(6), None))
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
def test_exception_in_any_stage_leaves_the_arm_where_it_is_and_control_comes_back(
        stage, monkeypatch):
    def fail(*_arguments, **_named):
        raise ArithmeticError(stage)

    loop = ClosedLoop(resolve('quick', plant='rigid'))
    try:
        for _ in range(700):  # approaching
            loop.advance()
        *way, name = stage.split('.')
        with monkeypatch.context() as patch:
            patch.setattr(reduce(getattr, way, loop.control.supervisor), name, fail)
            carried(loop, 250, sag=0.03)
        if loop.status.causes == ('latched',):
            loop.control.retry()
        reactions = []
        for _ in range(500):
            loop.advance()
            reactions.append(loop.status.reaction)
        assert set(reactions[-100:]) == {'none'}
    finally:
        loop.close()


def test_arm_that_was_not_seen_for_a_moment_is_held_once_it_is_seen_again():
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


def test_arm_that_is_damped_may_be_moved_and_is_held_where_it_is_then():
    """And is damped again after a gap in which it was not seen."""
    config = still_config(watchdog={'on_wrench_fault': 'damp'})
    loop, random = ControlLoop(config, None, CommandLimits(), config_dir()), (
        np.random.default_rng(0))
    weight = weight_reading(ROBOT.update(HOME, np.zeros(6)).sensor_pose.rotation_world,
                            config.tool, np.array(config.robot.gravity_world))
    reactions = []
    for k in range(260):
        q = HOME + 0.001 * min(max(k - 80, 0), 100) * np.eye(6)[5]
        q = q + 1e-7 * random.standard_normal(6)
        wrench = weight + 0.02 * random.standard_normal(6)
        if 110 <= k < 113:
            loop.step_without(1)
        elif 50 <= k < 200:
            loop.step_half(JointReading(2_000_000 * k, q, np.zeros(6)))
        else:
            loop.step(PairedSample(2_000_000 * k, q, np.zeros(6), wrench, None))
        reactions.append(loop.status.reaction)
    assert set(reactions[65:110]) == set(reactions[116:200]) == {'damp'}
    assert 'float' in reactions[110:116]
    assert reactions[-1] in ('none', 'inflate')
    np.testing.assert_allclose(
        loop.output.pose_des.position_world, loop.output.pose.position_world, atol=1e-4)


def test_couple_is_held_on_with_too_whatever_its_sign():
    """While the wrench is missing a plane presses on with -3 N across its face."""
    loop = ClosedLoop(resolve('plane', plant='rigid', duration=8.0))
    try:
        for _ in range(round(7.0 * loop.setup.controller.rate)):
            loop.advance()
        before = loop.true_forces.copy()
        assert loop.control.output.alpha_est.min() < -2.0
        for _ in range(60):
            loop.advance(lambda inputs: inputs._replace(wrench=None))
        assert loop.status.reaction == 'hold'
        np.testing.assert_allclose(loop.true_forces, before, atol=2.0)
    finally:
        loop.close()
