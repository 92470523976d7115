"""The page's view of a graph that runs: what it hears, what it commands, what is refused."""

from __future__ import annotations

import time

from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
import numpy as np
import pytest
from robots import robot_parameters
from sim_bridge.surface_patch import patch_of

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
from multicontact_control.client import (  # noqa: E402, I100
    CommandRefusedError,
    MultiContactClient,
)
from multicontact_control.nodes import topics  # noqa: E402, I100
from multicontact_control.nodes.controller_outputs import ContactMarkers  # noqa: E402, I100
from multicontact_control.nodes.graph_node import create_publisher  # noqa: E402, I100
from multicontact_control.nodes.link import GuestNode, LifecycleDriver  # noqa: E402, I100
from multicontact_control.view.graph import GraphSource  # noqa: E402, I100
from ros_graph import obedient_graph, own_domain, PATIENCE  # noqa: E402, I100
from std_srvs.srv import SetBool  # noqa: E402, I100

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def shown(tmp_path_factory):
    """Return what joins a graph in lockstep that obeys commands."""
    with own_domain() as domain_id, obedient_graph(
            tmp_path_factory.mktemp('graph'), domain_id):
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


def test_forces_are_shown_as_they_are_obeyed_whoever_commands_them(shown):
    with MultiContactClient('arm', domain_id=shown._link._domain_id, timeout=PATIENCE) as other:
        other.set_forces({'table': 7.0, 'board': 5.0})
        until(shown, lambda found: found.commanded == {'table': 7.0, 'board': 5.0}, 'the forces')
        shown.command(source.FORCES, board=6.0)
        until(shown, lambda found: found.commanded == {'table': 7.0, 'board': 6.0}, 'the force')
        other.hold()
        with pytest.raises(CommandRefusedError, match='contact_forces/command: ~/hold: expected'):
            shown.command(source.FORCES, table=9.0)
        for _ in range(20):
            snapshot = until(shown, lambda found: True, 'a snapshot')
        assert snapshot.commanded == {'table': 7.0, 'board': 6.0}
        other.hold(False)
        shown.command(source.FORCES, table=8.0)


def test_normals_are_those_that_the_controller_draws(shown):
    until(shown, lambda found: found.measured.min() > 4.0, 'the forces')
    found = np.array([[0.0, 0.6, -0.8], [0.6, 0.8, 0.0]])
    markers = ContactMarkers(resolve('paper').controller, rate=25.0, scale=0.01)
    with GuestNode('another', shown._link._domain_id, 'arm') as other:
        publisher = create_publisher(other.node, topics.CONTACT_MARKERS)

        def there(snapshot):
            publisher.publish(markers.message(
                0, Pose(np.zeros(3), np.eye(3)), [np.full(2, 9.0)] * 3, [True, True], found))
            return np.allclose(snapshot.normals_world, found, atol=1e-9)

        until(shown, there, 'the normals')
    configured = resolve('paper').controller.contacts
    until(shown, lambda snapshot: np.allclose(
        snapshot.normals_world, [configured[name].normal_world for name in configured],
        atol=1e-9), "the controller's own")


@pytest.mark.parametrize('robot', robot_parameters(['panda']))
def test_the_graph_of_another_arm_is_refused_and_the_right_one_named(shown, robot):
    with pytest.raises(RunError, match='robot.joint_names: expected panda_joint1, .* found joint1'
                                       ', .*joint6; name --robot puma, and its --scenario$'):
        GraphSource(resolve('paper', robot=robot), namespace='arm',
                    domain_id=shown._link._domain_id)


def test_where_no_graph_runs_it_is_said_at_once():
    with reserve_domain() as nobody, pytest.raises(RunError, match='is the controller active'):
        GraphSource(resolve('paper'), domain_id=nobody)
