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
    setup = resolve('paper')
    with closing(GraphSource(setup, namespace='arm', domain_id=domain)) as joined:
        yield joined


def until(shown, condition, what):
    """Return the first snapshot of which a condition is true."""

    def take():
        for snapshot in shown.take_snapshots():
            if condition(snapshot):
                return snapshot
        return None

    return wait_for(take, what)


def until_time(shown, time):
    """Return the first snapshot that is later than a time [s]."""
    return until(shown, lambda snapshot: snapshot.time > time, 'a later snapshot')


def until_at_rest(shown):
    return until(shown, lambda snapshot: snapshot.moving == '', 'rest')


class Events:
    """What has happened, in the snapshots that were looked at."""

    def __init__(self):
        self.texts = []

    def when(self, condition):
        """Return a condition that also gathers the events of every snapshot it is asked of."""

        def gather(snapshot):
            for _, text in snapshot.events:
                self.texts.append(text)
            return condition(snapshot)

        return gather

    def count(self, part):
        """Return how many events have a text in them."""
        return sum(part in text for text in self.texts)


def test_graph_source_joins_presses_moves_and_tunes(shown):
    snapshot = until(shown, lambda snapshot: np.isfinite(snapshot.q).all(), 'samples')
    assert tuple(snapshot.gains.values()) == (30.0, 0.02, 100.0)
    simulated = resolve('quick', plant='rigid').plant.surfaces
    for name, _, point, patch in shown.scene.surfaces:
        expected = shape_configured_patch(simulated[name])
        assert point == snapshot.places_world[name] == simulated[name].point_world
        corners = patch.vertices[patch.faces]
        expected_corners = expected.vertices[expected.faces]
        np.testing.assert_allclose(corners, expected_corners, atol=1e-12)
    shown.give_command(source.FORCES, table=8.0, board=6.0)
    events = Events()
    innovations = []

    def presses_with_noise(snapshot):
        innovations.extend(snapshot.points[:, 11:13])  # behind the time and five kinds
        errors = np.abs(snapshot.measured - (8.0, 6.0))
        if set(snapshot.states) != {'holding'} or errors.max() >= 0.5:
            return False
        return np.nanmin(innovations) < 0.0 < np.nanmax(innovations)

    def has_whole_points(snapshot):
        return len(snapshot.points) and np.isfinite(snapshot.points[-1]).all()

    pressing = events.when(presses_with_noise)
    snapshot = until(shown, pressing, 'the forces, and both signs')
    assert events.count('table holding')
    goal = snapshot.position_des[0] + 0.0199
    until(shown, has_whole_points, 'points of the curves')
    shown.give_command(source.JOG, offset=[0.02, 0.0, 0.0])
    until(shown, lambda snapshot: snapshot.position_des[0] > goal, 'the jog')
    until_at_rest(shown)
    gains = dict(zip(source.GAIN_NAMES, (25.0, 0.03, 60.0)))
    shown.give_command(source.GAINS, **gains)
    assert until(shown, lambda snapshot: snapshot.gains == gains, 'the gains')


def test_surface_and_push_change_the_simulated_world(shown):
    before = until_at_rest(shown)
    place = before.position[0]

    def is_pushed(snapshot):
        shown.give_command(source.PUSH, force=[8.0, 0.0, 0.0], tool=False)
        return snapshot.position[0] > place + 2e-4

    assert before.surfaces == shown.scene.simulated
    shown.give_command(source.SURFACE, name='table', stiffness=9000.0, friction=0.3)
    assert until(shown, bool, 'a snapshot').surfaces['table'] == (9000.0, 0.3)
    until(shown, is_pushed, 'the push')
    until(shown, lambda snapshot: snapshot.position[0] < place + 1e-4, 'the way back')


def test_another_client_is_shown_and_ends_a_motion(shown, domain):
    shown.give_command(source.PATTERN, axis='x', amplitude=0.03, period=2.0)
    until(shown, lambda snapshot: snapshot.moving, 'the pattern')
    forces = {'table': 7.0, 'board': 5.0}
    events = Events()
    held = events.when(lambda snapshot: snapshot.held and not snapshot.moving)
    with MultiContactClient('arm', domain_id=domain, timeout=PATIENCE) as other:

        def is_refused():
            other.publish_command(topics.FORCE_COMMAND, refused, '7')
            return any(status.command == '7' for status in other.take_statuses())

        other.set_forces(forces)
        until(shown, lambda snapshot: snapshot.commanded == forces, 'the forces')
        other.hold()
        until(shown, held, 'the hold')
        with pytest.raises(MulticontactError, match='hold: the arm is held'):
            shown.give_command(source.JOG, offset=[0.01, 0.0, 0.0])
        refused = joint_state_message(0, ['table'], effort=[9.0])
        for _ in range(2):  # as a command whose answer is late is resent
            wait_for(is_refused, 'the refusal')
        other.hold(False)
    is_released = events.when(lambda snapshot: not snapshot.held)
    released = until(shown, is_released, 'the release')
    for text in (
        'pose and forces held',
        'refused: contact_forces/command',
        'refused: ~/hold',
        'hold released',
    ):
        assert events.count(text) == 1, events.texts
    later = until_time(shown, released.time + 3.0)
    rest = until_time(shown, later.time + 0.5)
    assert rest.moving == ''
    np.testing.assert_allclose(rest.position_des, later.position_des, rtol=0, atol=2e-3)


def test_push_test_is_cancelled_and_each_refusal_told_once(shown):
    shown.give_command(source.FORCES, table=0.0, board=0.0)
    events = Events()
    first = until(shown, lambda snapshot: set(snapshot.states) == {'free'}, 'freedom')
    until_time(shown, first.time + 3.0)  # the way back
    shown.give_command(source.PUSH_TEST)
    instructed = events.when(lambda snapshot: snapshot.push_test)
    until(shown, instructed, 'an instruction')
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
    holding = events.when(lambda snapshot: snapshot.states[0] == 'holding')
    until(shown, holding, 'the table')
    for part in (
        'contact_forces/command: ~/push_test: pass it first',
        '~/hold: ~/push_test',
        '~/cancel_push_test: push test: none is under way',
    ):
        assert events.count(part) == 1, events.texts
    assert events.count('refused') == 3, events.texts


def test_stream_has_the_extremes_of_every_message_since_they_were_asked_for():

    def last_has_come():
        stream.take_messages()
        return stream.newest[1] == 5.0

    with reserve_domain() as domain_id, ServiceClientNode('sender', domain_id) as guest:
        publisher = create_publisher(guest.node, topics.MEASURED_FORCES)
        stream = EffortStream(guest.node, topics.MEASURED_FORCES, ('table', 'board'))
        assert np.isnan(stream.take_extremes()).all()
        wait_for(publisher.get_subscription_count, 'a connection')
        for k, force in enumerate([20.0, -20.0, 3.0, 5.0]):
            message = joint_state_message(
                PERIOD * k, ['other', 'board'], effort=[99.0, force]
            )
            publisher.publish(message)
        wait_for(last_has_come, 'the last message')
        least, most = stream.take_extremes()
        np.testing.assert_array_equal(least, [np.nan, -20.0])
        np.testing.assert_array_equal(most, [np.nan, 20.0])
        np.testing.assert_array_equal(stream.take_extremes(), [[np.nan, 5.0]] * 2)


@pytest.mark.parametrize('robot', robot_parameters(['panda']))
def test_graph_of_another_arm_is_refused_and_the_right_one_named(shown, domain, robot):
    setup = resolve('paper', robot=robot)
    with pytest.raises(
        RunError,
        match='robot.joint_names: expected panda_joint1, .* got joint1'
        ', .*joint6; name --robot puma, and its --scenario$',
    ):
        GraphSource(setup, namespace='arm', domain_id=domain)
