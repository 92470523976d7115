"""What the process of the simulation does, tick by tick, in this one."""

from __future__ import annotations

from contextlib import closing

from multicontact_control.errors import MulticontactError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.simulation import Simulation
import numpy as np
import pytest


@pytest.fixture(scope='module')
def simulation():
    """Return one that presses with 10 N on both surfaces."""
    made = Simulation(resolve('paper', plant='rigid'))
    advance(made, 0.1)
    made.obey(source.FORCES, {'table': 10.0, 'board': 10.0})
    advance(made, 1.5)
    yield made
    made.close()


def advance(simulation, seconds):
    for _ in range(round(500 * seconds)):
        simulation.advance()
    return simulation.snapshot(0, 1.0)


def test_simulation_presses_as_commanded(simulation):
    snapshot = advance(simulation, 0.2)
    assert snapshot.states == ('holding', 'holding')
    np.testing.assert_allclose(snapshot.measured, 10.0, atol=1.0)
    assert snapshot.commanded == {'table': 10.0, 'board': 10.0}
    layout = source.CurveLayout(2, 6)
    assert len(snapshot.points) >= 0.2 * source.RATE * source.POINTS - 1
    assert snapshot.points.shape[1] == layout.width
    last = snapshot.points[-1]
    np.testing.assert_allclose(last[layout.of(source.DESIRED, 0)], 10.0)
    assert (last[layout.torque_use] < 1.0).all() and last[layout.torque_use].max() > 0.05
    assert snapshot.timing.typical > 0.0


def test_gains_and_estimator_change_without_a_jump_of_the_torque(simulation):
    torque = simulation.loop.command.copy()
    simulation.obey(source.GAINS, {
        'natural_frequency': 25.0, 'time_constant': 0.03, 'damping_rate': 60.0})
    simulation.obey(source.ESTIMATOR, {'name': 'innovation'})
    simulation.advance()
    assert np.abs(simulation.loop.command - torque).max() < 1.5
    snapshot = advance(simulation, 0.5)
    assert snapshot.gains == (25.0, 0.03, 60.0) and snapshot.estimator == 'innovation'
    assert snapshot.states == ('holding', 'holding')


def test_surface_and_push_change_the_world(simulation):
    simulation.obey(source.SURFACE, {'name': 'table', 'stiffness': 9000.0, 'friction': 0.2})
    still = advance(simulation, 0.3).position
    simulation.obey(source.PUSH, {'force': [5.0, 0.0, 0.0]})
    snapshot = advance(simulation, 0.3)
    assert snapshot.position[0] > still[0] + 1e-4, 'a push that has no effect'
    snapshot = advance(simulation, 1.0)
    np.testing.assert_allclose(snapshot.position, still, atol=1e-3)
    assert snapshot.surfaces['table'] == (9000.0, 0.2)


def test_hold_refuses_motion_until_it_is_released(simulation):
    simulation.obey(source.PATTERN, {'axis': 'x', 'amplitude': 0.03, 'period': 3.0})
    advance(simulation, 1.0)
    simulation.obey(source.HOLD, {'on': True})
    held = advance(simulation, 0.5)
    assert held.held and held.moving == ''
    with pytest.raises(MulticontactError, match='hold: expected released'):
        simulation.obey(source.JOG, {'offset': [0.01, 0.0, 0.0]})
    np.testing.assert_allclose(advance(simulation, 0.5).position, held.position, atol=1e-3)
    simulation.obey(source.HOLD, {'on': False})
    assert not advance(simulation, 0.3).held


@pytest.mark.parametrize(('name', 'values', 'field'), [
    (source.FORCES, {'table': 1.0}, 'force on table'), (source.FORCES, {'floor': 5.0}, 'contact'),
    (source.GO_TO, {'position': [0.0, 0.5, 0.0]}, 'position z'),
    (source.GO_TO, {'position': [0.0, 0.5]}, 'position'),
    (source.GAINS, {'natural_frequency': -1.0, 'time_constant': 0.02, 'damping_rate': 60.0},
     'motion.natural_frequency'),
    (source.ESTIMATOR, {'name': 'guess'}, 'estimator'),
    (source.SURFACE, {'name': 'table', 'stiffness': 1.0, 'friction': 0.1}, 'stiffness'),
    (source.PUSH, {'force': [500.0, 0.0, 0.0]}, 'push'), (source.TARE, {}, 'tare'),
    (source.PUSH_TEST, {}, 'push test'), (source.RETRY, {}, 'given up'), (source.HAND, {}, 'hand'),
    (source.PLAY, {'on': True}, 'a recording'), ('fly', {}, 'command'),
    (source.STOP, {'where': 'here'}, 'stop')])
def test_refused_command_names_the_field_and_changes_nothing(simulation, name, values, field):
    before = simulation.snapshot(0, 1.0)
    with pytest.raises(MulticontactError, match=field):
        simulation.obey(name, values)
    after = simulation.snapshot(0, 1.0)
    assert (after.commanded, after.gains, after.estimator, after.moving, after.surfaces) == (
        before.commanded, before.gains, before.estimator, before.moving, before.surfaces)


def test_tare_push_test_and_reset():
    with closing(Simulation(resolve('paper', plant='rigid', seed=1))) as simulation:
        advance(simulation, 0.5)
        simulation.obey(source.TARE, {})
        simulation.obey(source.PUSH_TEST, {})
        asked, gate = [], simulation.loop.control.push_gate
        while gate.result is None and simulation.time < 20.0:
            snapshot = advance(simulation, 0.1)
            if snapshot.asked_push and snapshot.push_test not in asked:
                asked.append(snapshot.push_test)
                simulation.obey(source.HAND, {})
        assert len(asked) == 3 and gate.result.passed, snapshot.push_test
        simulation.obey(source.RESET, {})
        snapshot = advance(simulation, 0.04)
        assert snapshot.time < 0.1 and snapshot.states == ('free', 'free')
