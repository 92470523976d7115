"""The page's view of a graph that runs: what it hears, what it commands, what is refused."""

from contextlib import closing

from multicontact_control.client import MultiContactClient
from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.nodes import topics
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.nodes.messages import joint_state_message
from multicontact_control.runs.graph.domain import reserve_domain
from multicontact_control.runs.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.graph import GraphSource
from multicontact_control.view.streams import EffortStream
import numpy as np
import pytest
from robots import robot_parameters
from ros_graph import obedient_graph, PATIENCE, wait_for
from sim_bridge.surface_patch import shape_configured_patch

pytestmark = pytest.mark.ros

PERIOD = 2_000_000  # ns


@pytest.fixture(scope='module')
def domain(tmp_path_factory):
    """Return the domain of a graph in lockstep that obeys commands."""
    with obedient_graph(tmp_path_factory.mktemp('graph')) as domain_id:
        yield domain_id


@pytest.fixture(scope='module')
def shown(domain):
    with closing(
        GraphSource(resolve('paper'), namespace='arm', domain_id=domain)
    ) as joined:
        yield joined


def until(shown, condition, what):
    """Return the first snapshot of which a condition is true."""
    return wait_for(lambda: next(filter(condition, shown.take_snapshots()), None), what)


def test_graph_source_joins_presses_moves_and_tunes(shown):
    snapshot = until(shown, lambda snapshot: np.isfinite(snapshot.q).all(), 'samples')
    assert tuple(snapshot.gains.values()) == (30.0, 0.02, 100.0)
    simulated = resolve('quick', plant='rigid').plant.surfaces
    for name, _, point, patch in shown.scene.surfaces:
        expected = shape_configured_patch(simulated[name])
        assert point == snapshot.places_world[name] == simulated[name].point_world
        np.testing.assert_allclose(
            patch.vertices[patch.faces], expected.vertices[expected.faces], atol=1e-12
        )
    shown.give_command(source.FORCES, table=8.0, board=6.0)
    events = []
    innovations = []

    def look(snapshot):
        events.extend(snapshot.events)
        innovations.extend(snapshot.points[:, 11:13])  # behind the time and five kinds
        return True

    snapshot = until(
        shown,
        lambda snapshot: (
            look(snapshot)
            and (
                set(snapshot.states) == {'holding'}
                and (np.abs(snapshot.measured - (8.0, 6.0)) < 0.5).all()
                and np.nanmin(innovations) < 0.0 < np.nanmax(innovations)
            )
        ),
        'the forces, and both signs',
    )
    assert any('table holding' in text for _, text in events)
    start = snapshot.position_des
    until(
        shown,
        lambda snapshot: (
            len(snapshot.points) and np.isfinite(snapshot.points[-1]).all()
        ),
        'points of the curves',
    )
    shown.give_command(source.JOG, offset=[0.02, 0.0, 0.0])
    until(
        shown, lambda snapshot: snapshot.position_des[0] > start[0] + 0.0199, 'the jog'
    )
    until(shown, lambda snapshot: snapshot.moving == '', 'rest')
    gains = dict(zip(source.GAIN_NAMES, (25.0, 0.03, 60.0)))
    shown.give_command(source.GAINS, **gains)
    assert until(shown, lambda snapshot: snapshot.gains == gains, 'the gains')


def test_surface_and_push_change_the_simulated_world(shown):
    before = until(shown, lambda snapshot: snapshot.moving == '', 'rest')
    assert before.surfaces == shown.scene.simulated
    shown.give_command(source.SURFACE, name='table', stiffness=9000.0, friction=0.3)
    assert until(shown, bool, 'a snapshot').surfaces['table'] == (9000.0, 0.3)
    until(
        shown,
        lambda snapshot: (
            shown.give_command(source.PUSH, force=[8.0, 0.0, 0.0], tool=False)
            or snapshot.position[0] > before.position[0] + 2e-4
        ),
        'the push',
    )
    until(
        shown,
        lambda snapshot: snapshot.position[0] < before.position[0] + 1e-4,
        'the way back',
    )


def test_another_client_is_shown_and_ends_a_motion(shown, domain):
    shown.give_command(source.PATTERN, axis='x', amplitude=0.03, period=2.0)
    until(shown, lambda snapshot: snapshot.moving, 'the pattern')
    with MultiContactClient('arm', domain_id=domain, timeout=PATIENCE) as other:
        other.set_forces(forces := {'table': 7.0, 'board': 5.0})
        until(shown, lambda snapshot: snapshot.commanded == forces, 'the forces')
        other.hold()
        events = []
        until(
            shown,
            lambda snapshot: (
                events.extend(snapshot.events)
                or (snapshot.held and not snapshot.moving)
            ),
            'the hold',
        )
        with pytest.raises(MulticontactError, match='hold: the arm is held'):
            shown.give_command(source.JOG, offset=[0.01, 0.0, 0.0])
        refused = joint_state_message(0, ['table'], effort=[9.0])
        for _ in range(2):  # as a command whose answer is late is resent
            wait_for(
                lambda: (
                    other.publish_command(topics.FORCE_COMMAND, refused, '7')
                    or any(status.command == '7' for status in other.take_statuses())
                ),
                'the refusal',
            )
        other.hold(False)
    released = until(
        shown,
        lambda snapshot: events.extend(snapshot.events) or not snapshot.held,
        'the release',
    )
    texts = [text for _, text in events]
    for text, count in {
        'pose and forces held': 1,
        'refused: contact_forces/command': 1,
        'refused: ~/hold': 1,
        'hold released': 1,
    }.items():
        assert sum(each.startswith(text) for each in texts) == count, texts
    later = until(
        shown, lambda snapshot: snapshot.time > released.time + 3.0, 'the last pose'
    )
    rest = until(shown, lambda snapshot: snapshot.time > later.time + 0.5, 'a snapshot')
    assert (
        rest.moving == ''
        and np.abs(rest.position_des - later.position_des).max() < 0.002
    )


def test_push_test_is_cancelled_and_each_refusal_told_once(shown):
    shown.give_command(source.FORCES, table=0.0, board=0.0)
    events = []
    first = until(shown, lambda snapshot: set(snapshot.states) == {'free'}, 'freedom')
    until(shown, lambda snapshot: snapshot.time > first.time + 3.0, 'the way back')
    shown.give_command(source.PUSH_TEST)

    def gather(snapshot):
        events.extend(text for _, text in snapshot.events)
        return snapshot

    until(shown, lambda snapshot: gather(snapshot).push_test, 'an instruction')
    for command, values in (
        (source.FORCES, {'table': 8.0}),
        (source.HOLD, {'on': True}),
    ):
        with pytest.raises(MulticontactError, match='~/push_test: pass it first'):
            shown.give_command(command, **values)
    assert shown.give_command(source.CANCEL_PUSH_TEST) == 'push test cancelled'
    with pytest.raises(MulticontactError, match='none is under way'):
        shown.give_command(source.CANCEL_PUSH_TEST)
    shown.give_command(source.FORCES, table=8.0)
    until(shown, lambda snapshot: gather(snapshot).states[0] == 'holding', 'the table')
    refusals = [text for text in events if 'refused' in text]
    for part in (
        'contact_forces/command: ~/push_test: pass it first',
        '~/hold: ~/push_test',
        '~/cancel_push_test: push test: none is under way',
    ):
        assert sum(part in text for text in refusals) == 1, refusals
    assert len(refusals) == 3, refusals


def test_stream_has_the_extremes_of_every_message_since_they_were_asked_for():
    with reserve_domain() as domain_id, ServiceClientNode('sender', domain_id) as guest:
        publisher = create_publisher(guest.node, topics.MEASURED_FORCES)
        stream = EffortStream(guest.node, topics.MEASURED_FORCES, ('table', 'board'))
        assert np.isnan(stream.take_extremes()).all()
        wait_for(publisher.get_subscription_count, 'a connection')
        for k, force in enumerate([20.0, -20.0, 3.0, 5.0]):
            publisher.publish(
                joint_state_message(
                    PERIOD * k, ['other', 'board'], effort=[99.0, force]
                )
            )
        wait_for(
            lambda: stream.take_messages() or stream.newest[1] == 5.0,
            'the last message',
        )
        np.testing.assert_array_equal(
            stream.take_extremes(), [[np.nan, -20.0], [np.nan, 20.0]]
        )
        np.testing.assert_array_equal(stream.take_extremes(), [[np.nan, 5.0]] * 2)


@pytest.mark.parametrize('robot', robot_parameters(['panda']))
def test_graph_of_another_arm_is_refused_and_the_right_one_named(shown, domain, robot):
    with pytest.raises(
        RunError,
        match='robot.joint_names: expected panda_joint1, .* got joint1'
        ', .*joint6; name --robot puma, and its --scenario$',
    ):
        GraphSource(resolve('paper', robot=robot), namespace='arm', domain_id=domain)
