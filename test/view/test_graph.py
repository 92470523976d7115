"""The page's view of a graph that runs: what it hears, what it commands, what is refused."""

from __future__ import annotations

import time

from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
import numpy as np
import pytest
from sim_bridge.surface_patch import patch_of

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
from multicontact_control.nodes.link import LifecycleDriver  # noqa: E402, I100
from multicontact_control.view.graph import GraphSource  # noqa: E402, I100
from ros_graph import obedient_graph, own_domain, PATIENCE  # noqa: E402, I100
from std_srvs.srv import SetBool  # noqa: E402, I100

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def shown(tmp_path_factory):
    """Return what joins a graph in lockstep that obeys commands."""
    with own_domain() as domain_id, obedient_graph(
            tmp_path_factory.mktemp('graph'), domain_id, composed='all',
            recording_batches=True):
        joined = join(domain_id)
        yield joined
        joined.close()


def join(domain_id):
    give_up = time.monotonic() + PATIENCE
    while True:  # the nodes may take a while to come up
        try:
            return GraphSource(resolve('paper'), namespace='arm', domain_id=domain_id)
        except RunError:
            if time.monotonic() > give_up:
                raise


def until(shown, condition, what):
    give_up = time.monotonic() + PATIENCE
    last = None
    while time.monotonic() < give_up:
        for snapshot in shown.poll():
            if condition(last := snapshot):
                return snapshot
        time.sleep(0.01)
    raise AssertionError(f'{what}: did not happen; last: {last}')


def test_page_joins_a_graph_presses_moves_and_tunes(shown):
    snapshot = until(shown, lambda found: np.isfinite(found.q).all(), 'samples')
    assert snapshot.gains == (30.0, 0.02, 100.0)
    simulated = resolve('quick', plant='rigid').plant.surfaces
    snapshot = until(shown, lambda found: found.places_world, 'the surfaces')
    assert dict(snapshot.places_world) == {
        name: surface.point_world for name, surface in simulated.items()}
    for name, surface in simulated.items():
        drawn, told = patch_of(surface), snapshot.patches[name]
        assert np.allclose(told.vertices[told.faces], drawn.vertices[drawn.faces], atol=1e-12)
    shown.command(source.FORCES, table=8.0, board=6.0)
    snapshot = until(shown, lambda found: (np.abs(found.measured - (8.0, 6.0)) < 0.5).all() and
                     set(found.states) == {'holding'}, 'the forces')
    assert len(snapshot.points) and np.isfinite(snapshot.points[-1]).all()
    start = snapshot.position_des
    shown.command(source.JOG, offset=[0.02, 0.0, 0.0])
    snapshot = until(shown, lambda found: found.position_des[0] > start[0] + 0.0199, 'the jog')
    until(shown, lambda found: found.moving == '', 'rest')
    shown.command(source.GAINS, natural_frequency=25.0, time_constant=0.03, damping_rate=60.0)
    assert until(shown, lambda found: found.gains[0] == 25.0, 'the gains')


def test_motion_that_somebody_else_stops_is_not_gone_on_with(shown):
    """It ran on unseen, and the arm jumped to where it was by then when it was released."""
    shown.command(source.PATTERN, kind='sine', axes='x', amplitude=0.03, period=2.0)
    until(shown, lambda found: found.moving, 'the pattern')
    with LifecycleDriver(shown._link._domain_id, namespace='arm', name='another') as other:
        for held in (True, False):
            answer = other.call('controller_node', SetBool, 'hold',
                                SetBool.Request(data=held))
            assert answer.success
            if held:
                snapshot = until(shown, lambda found: found.held, 'the hold')
                snapshot = until(shown, lambda found: found.moving == '', 'rest')
    where = snapshot.position_des
    snapshot = until(shown, lambda found: not found.held, 'the release')
    for _ in range(20):
        snapshot = until(shown, lambda found: True, 'a snapshot')
    assert snapshot.moving == ''
    assert np.abs(snapshot.position_des - where).max() < 0.002


def test_what_a_graph_refuses_is_said(shown):
    for name, values, words in (
            (source.FORCES, {'table': 40.0}, '0 or 3 to 30 N'),
            (source.FORCES, {'floor': 4.0}, 'one of table, board'),
            (source.TARE, {}, 'none under force control'),
            (source.GO_TO, {'position': [0.0, 0.5, 9.0]}, 'position z'),
            (source.GAINS, {'natural_frequency': -1.0, 'time_constant': 0.02,
                            'damping_rate': 60.0}, 'natural_frequency'),
            (source.PUSH, {'force': [5.0, 0.0, 0.0]}, 'a simulation of the page'),
            (source.SEEK, {'time': 1.0}, 'a recording')):
        with pytest.raises(MulticontactError, match=words):
            shown.command(name, **values)
    shown.command(source.HOLD, on=True)
    until(shown, lambda found: found.held, 'the hold')
    with pytest.raises(MulticontactError, match='hold'):
        shown.command(source.JOG, offset=[0.01, 0.0, 0.0])
    shown.command(source.HOLD, on=False)
    until(shown, lambda found: not found.held, 'the release')


def test_where_no_graph_runs_it_is_said_at_once():
    with reserve_domain() as nobody, pytest.raises(RunError, match='is the controller active'):
        GraphSource(resolve('paper'), domain_id=nobody)
