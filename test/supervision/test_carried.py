"""An arm whose joints are known is carried through every fault: simulated arms do not fall."""

from contextlib import closing
from functools import reduce

from arms import controller_config, HOME, still_config
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.vocabulary import PARTS
from multicontact_control.experiment.scenario import resolve
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import config_dir
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.supervisor import Supervisor
import numpy as np
import pytest

REST = np.zeros(6)
ROBOT = RobotModel(controller_config().robot, config_dir())
FEET = {'a': [0.05, 0.05, 0.24], 'b': [-0.05, 0.05, 0.24], 'c': [-0.05, -0.05, 0.24],
        'd': [0.05, -0.05, 0.24]}
LINE = {'a': [0.0, 0.0, 0.24], 'b': [0.05, 0.0, 0.24], 'c': [0.1, 0.0, 0.24]}


def aligned():
    """Return two points of which, at the first posture, one is straight above the other."""
    rotation = ROBOT.update(HOME, REST).pose.rotation_world
    table = np.array([0.0, 0.0, 0.24])
    return {'table': table.tolist(),
            'board': (table + 0.05 * rotation.T @ np.array([0.0, 0.0, -1.0])).tolist()}


def pressing_down(points):
    """Return changes of a configuration with a contact at each point, all normals downwards."""
    return {'contact_names': list(points), 'contacts': {
        name: {'normal_world': [0.0, 0.0, -1.0], 'point_operational': point}
        for name, point in points.items()}}


@pytest.mark.parametrize('points', [FEET, LINE], ids=['four coplanar feet', 'three in a line'])
def test_contacts_that_depend_in_any_orientation_are_refused(points):
    with pytest.raises(ConfigError, match=f'found {", ".join(points)}, which depend'):
        ControlLoop(still_config(**pressing_down(points)), None, CommandLimits(), config_dir())


def test_contacts_that_depend_in_one_orientation_only_are_accepted():
    config = controller_config(**pressing_down(aligned()))
    law = Supervisor(config, ROBOT, CommandedTask(config.contact_names)).controller
    here = ROBOT.update(HOME, REST).pose.rotation_world
    assert np.linalg.matrix_rank(normal_space(law.contacts.copy(), here), 1e-9) == 1


def carried(loop, ticks, sag=0.02):
    """Advance a loop, and assert that the arm stays where it is."""
    start = loop.sample.q.copy()
    limit = np.array(loop.setup.controller.torque_limit)
    for _ in range(ticks):
        loop.advance()
        assert np.isfinite(loop.command).all() and (np.abs(loop.command) <= limit).all()
        assert np.abs(loop.sample.q - start).max() < sag


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_law_without_an_answer_leaves_the_arm_where_it_is(plant):
    changes = {'contacts': pressing_down(aligned())['contacts']}
    with closing(ClosedLoop(resolve('quick', plant=plant, controller=changes))) as loop:
        carried(loop, 500)
        assert (loop.status.reaction, loop.status.causes) == ('hold', ('latched',))
        assert any('law_ContactGeometryError' in what for _, what in loop.control.events.events)


@pytest.mark.parametrize('stage', PARTS)
def test_exception_in_any_stage_leaves_the_arm_where_it_is_and_control_resumes(
        stage, monkeypatch):
    def fail(*_arguments, **_named):
        raise ArithmeticError(stage)

    with closing(ClosedLoop(resolve('quick', plant='rigid'))) as loop:
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


def test_couple_is_held_on_with_whatever_its_sign():
    """While the wrench is missing a plane presses on with -3 N across its face."""
    with closing(ClosedLoop(resolve('plane', plant='rigid'))) as loop:
        for _ in range(round(7.0 * loop.setup.controller.rate)):
            loop.advance()
        before = loop.true_forces.copy()
        assert loop.control.output.alpha_est.min() < -2.0
        for _ in range(60):
            loop.advance(lambda inputs: inputs._replace(wrench=None))
        assert loop.status.reaction == 'hold'
        np.testing.assert_allclose(loop.true_forces, before, atol=2.0)


@pytest.mark.parametrize(('limits', 'place'), [
    ({'workspace_upper': [0.6, 0.9, 0.6]}, 'operational point: expected z in 0.3 to 0.6 m'),
    ({'joint_upper': [2.793, 3.927, 2.9, 2.967, 1.745, 4.643]}, 'joint3: ')])
def test_arm_that_starts_outside_its_limits_is_held_until_it_is_moved_inside(limits, place):
    """The limits would have led it inside at once; joint 3 is moved by hand."""
    third, q = np.eye(6)[2], HOME
    with closing(ClosedLoop(resolve('quick', plant='rigid', controller={
            'limits': limits, 'sensor': {'frozen_ticks': 0},
            'watchdog': {'frozen_joint_ticks': 0}}))) as loop:
        carried(loop, 500, sag=1e-4)
        assert (loop.status.reaction, loop.status.causes) == ('hold', ('start_outside',))
        assert loop.control.supervisor.outside[0].startswith(place)
        assert loop.sample.contact_force.max() == 0.0
        for k in range(400 if place == 'joint3: ' else 0):
            q, qd = HOME - 0.05 * min(k / 300, 1.0) * third, -0.05 / 0.6 * (k < 300) * third
            inputs = loop.inputs()
            loop.control.step(inputs._replace(joints=inputs.joints._replace(q=q, qd=qd)))
            assert loop.control.supervisor.outside or k > 100
            loop.tick += 1
        if q is not HOME:
            assert loop.status.reaction == 'none' and not loop.control.supervisor.outside
