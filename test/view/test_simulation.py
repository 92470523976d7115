"""What the process of the simulation does, tick by tick, in this one."""

from __future__ import annotations

from multicontact_control.errors import MulticontactError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.simulation import Simulation
import numpy as np
import pytest
from robots import needs_mujoco


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


def test_it_presses_as_commanded_and_says_so(simulation):
    snapshot = advance(simulation, 0.2)
    assert snapshot.states == ('holding', 'holding')
    np.testing.assert_allclose(snapshot.measured, 10.0, atol=1.0)
    assert snapshot.commanded == {'table': 10.0, 'board': 10.0}
    assert len(snapshot.points) >= 0.2 * source.RATE * source.POINTS - 1
    layout = source.CurveLayout(2, 6)
    assert snapshot.points.shape[1] == layout.width
    last = snapshot.points[-1]
    np.testing.assert_allclose(last[layout.of(source.DESIRED, 0)], 10.0)
    assert (last[layout.torque_use] < 1.0).all() and last[layout.torque_use].max() > 0.05
    assert snapshot.timing.typical > 0.0


def test_a_pattern_moves_the_point_and_keeps_the_forces(simulation):
    before = simulation.snapshot(0, 1.0).position
    simulation.obey(source.PATTERN, {
        'kind': 'sine', 'axes': 'x', 'amplitude': 0.05, 'period': 2.0})
    places, forces = [], []
    for _ in range(30):
        snapshot = advance(simulation, 0.1)
        places.append(snapshot.position[0])
        forces.append(snapshot.measured)
    assert snapshot.moving == 'sine along x'
    np.testing.assert_allclose(max(places) - before[0], 0.05, atol=0.005)
    np.testing.assert_allclose(np.mean(forces, axis=0), 10.0, atol=0.5)
    simulation.obey(source.STOP, {})
    snapshot = advance(simulation, 2.0)
    assert snapshot.moving == ''
    np.testing.assert_allclose(snapshot.position[0], before[0], atol=2e-3)


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
    assert any('K_2 60' in what for _, what in snapshot.events)


def test_a_surface_without_friction_can_be_given_some():
    simulation = Simulation(resolve('quick', plant='rigid', plant_overrides={
        'surfaces': {'table': {'friction': 0.0}}}))
    try:
        simulation.obey(
            source.SURFACE, {'name': 'table', 'stiffness': 6000.0, 'friction': 0.3})
        assert simulation.loop.plant.contacts._surfaces['friction'][0] == 0.3
    finally:
        simulation.close()


@needs_mujoco
def test_surfaces_of_the_engine_are_not_said_to_have_changed():
    simulation = Simulation(resolve('quick', plant='rigid', plant_overrides={
        'engine': 'mujoco', 'contact': 'native', 'joint_friction_scale': 0.0}))
    try:
        before = dict(simulation._surfaces)
        with pytest.raises(MulticontactError, match='contact: expected compliant, for surfaces'):
            simulation.obey(
                source.SURFACE, {'name': 'table', 'stiffness': 9000.0, 'friction': 0.3})
        assert simulation._surfaces == before
    finally:
        simulation.close()


def test_push_test_is_of_any_link_of_the_tool():
    simulation = Simulation(resolve(
        'paper', plant='rigid', plant_overrides={'tool_push_link': 'tool'}))
    try:
        advance(simulation, 0.5)
        assert simulation.obey(source.PUSH_TEST, {}) == 'keep off the tool'
    finally:
        simulation.close()


def test_the_world_can_be_made_harder(simulation):
    simulation.obey(source.SURFACE, {'name': 'table', 'stiffness': 9000.0, 'friction': 0.2})
    surfaces = simulation.loop.plant.contacts._surfaces
    np.testing.assert_allclose([surfaces['stiffness'][0], surfaces['friction'][0]], [9000.0, 0.2])
    still = advance(simulation, 0.3).position
    simulation.obey(source.PUSH, {'force': [5.0, 0.0, 0.0]})
    snapshot = advance(simulation, 0.3)
    assert snapshot.position[0] > still[0] + 1e-4, 'a push that nothing feels'
    snapshot = advance(simulation, 1.0)
    np.testing.assert_allclose(snapshot.position, still, atol=1e-3)
    assert snapshot.surfaces['table'] == (9000.0, 0.2)


def test_holding_refuses_motion_until_it_is_released(simulation):
    simulation.obey(source.PATTERN, {
        'kind': 'circle', 'axes': 'xz', 'amplitude': 0.03, 'period': 3.0})
    advance(simulation, 1.0)
    simulation.obey(source.HOLD, {'on': True})
    held = advance(simulation, 0.5)
    assert held.held and held.moving == ''
    with pytest.raises(MulticontactError, match='hold: expected released'):
        simulation.obey(source.JOG, {'offset': [0.01, 0.0, 0.0]})
    np.testing.assert_allclose(advance(simulation, 0.5).position, held.position, atol=1e-3)
    simulation.obey(source.HOLD, {'on': False})
    assert not advance(simulation, 0.3).held


@pytest.mark.parametrize(('name', 'values', 'words'), [
    (source.FORCES, {'table': 1.0}, 'force on table: expected 0 or 3 to 30 N, found 1 N'),
    (source.FORCES, {'floor': 5.0}, 'contacts among table, board'),
    (source.GO_TO, {'position': [0.0, 0.5, 0.0]}, 'position z: expected 0.3 to 1.2 m'),
    (source.GO_TO, {'position': [0.0, 0.5]}, 'three finite numbers'),
    (source.GAINS, {'natural_frequency': -1.0, 'time_constant': 0.02, 'damping_rate': 60.0},
     'motion.natural_frequency'),
    (source.ESTIMATOR, {'name': 'guess'}, 'estimator: expected'),
    (source.SURFACE, {'name': 'table', 'stiffness': 1.0, 'friction': 0.1}, '200 to 80000 N/m'),
    (source.PUSH, {'force': [500.0, 0.0, 0.0]}, 'above 0 to 20 N'),
    (source.TARE, {}, 'none under force control for a tare'),
    (source.PUSH_TEST, {}, 'none under force control for a push test'),
    (source.RETRY, {}, 'given up'), (source.HAND, {}, 'a push test that waits for a push'),
    (source.PLAY, {'on': True}, 'a recording'), ('fly', {}, 'command: expected one of'),
    (source.STOP, {'where': 'here'}, 'values that it takes')])
def test_what_is_refused_says_why_and_changes_nothing(simulation, name, values, words):
    before = simulation.snapshot(0, 1.0)
    with pytest.raises(MulticontactError, match=words.replace('.', r'\.')):
        simulation.obey(name, values)
    after = simulation.snapshot(0, 1.0)
    assert (after.commanded, after.gains, after.estimator, after.moving, after.surfaces) == (
        before.commanded, before.gains, before.estimator, before.moving, before.surfaces)


def test_push_test_is_led_through_by_the_simulated_hand():
    """Tare and push test as the page guides them, then a reset."""
    simulation = Simulation(resolve('paper', plant='rigid', seed=1))
    try:
        advance(simulation, 0.5)
        assert simulation.obey(source.TARE, {}).startswith('bias')
        assert simulation.obey(source.PUSH_TEST, {}) == 'keep off the tool'
        asked = []
        for _ in range(100):
            snapshot = advance(simulation, 0.1)
            if snapshot.asked_push and snapshot.push_test not in asked:
                asked.append(snapshot.push_test)
                simulation.obey(source.HAND, {})
            if simulation.loop.control.push_gate.result is not None:
                break
        assert len(asked) == 3
        assert simulation.loop.control.push_gate.result.passed, snapshot.push_test
        simulation.obey(source.RESET, {})
        snapshot = advance(simulation, 0.04)
        assert snapshot.time < 0.1 and snapshot.states == ('free', 'free')
    finally:
        simulation.close()


def test_an_edge_is_pressed_with_a_couple_too():
    simulation = Simulation(resolve('edge', plant='rigid'))
    try:
        advance(simulation, 0.1)
        simulation.obey(source.FORCES, {'edge': 10.0})
        advance(simulation, 1.2)
        simulation.obey(source.FORCES, {'edge/along': 3.0})
        simulation.obey(source.SURFACE, {'name': 'edge', 'stiffness': 3500.0, 'friction': 0.1})
        snapshot = advance(simulation, 1.0)
        assert snapshot.states == ('holding',) and len(snapshot.normals_world) == 1
        np.testing.assert_allclose(snapshot.measured, [10.0, 3.0], atol=1.0)
        np.testing.assert_allclose(
            simulation.loop.plant.contacts._surfaces['stiffness'], 3500.0)
    finally:
        simulation.close()
