"""Two graphs in one domain."""

from __future__ import annotations

from xml.etree.ElementTree import canonicalize

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.graph.domain import check_namespace, reserve_domain
from multicontact_control.nodes import qos
from multicontact_control.nodes.graph import ignore, take
from multicontact_control.nodes.link import GuestNode
from multicontact_control.paths import config_dir
import pytest
from ros_graph import end_of, start_graph, wait_for
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

pytestmark = pytest.mark.ros

STORE = get_typestore(Stores.ROS2_JAZZY)
SIDES = ('left', 'arms/right')
TICKS = 1000
EFFORTS = 'effort_controller/commands'


class Listener(GuestNode):
    """A node that hears some topics of both graphs."""

    def __init__(self, domain_id):
        super().__init__('listener', domain_id)

    def subscribe(self, message, name, profile):
        subscription = self.node.create_subscription(message, name, ignore, profile)
        received = []

        def newest():
            while (taken := take(subscription)) is not None:
                received.append(taken[0])
            return received
        return newest


@pytest.fixture(scope='module')
def two_runs(tmp_path_factory):
    """Run two graphs at once in one domain; return their folders and what was heard."""
    folders = {side: tmp_path_factory.mktemp(side.replace('/', '_')) for side in SIDES}
    with reserve_domain() as domain_id:
        listener = Listener(domain_id)
        heard = {side: {
            'efforts': listener.subscribe(
                Float64MultiArray, f'/{side}/{EFFORTS}', qos.STREAM),
            'commands': listener.subscribe(
                JointState, f'/{side}/joint_effort_command', qos.STREAM)} for side in SIDES}
        runs = [start_graph(
            folders[side], domain_id, namespace=side, ticks=TICKS, seed=seed, speed=1.0,
            extra_parameters={'controller_node': {'effort_output_topic': EFFORTS}})
            for seed, side in enumerate(SIDES)]

        late = {}

        def described_late():
            """Subscribe to each description long after it was sent, before its graph ends."""
            for run in runs:
                assert not run.poll(), end_of(run)[1]
            for side in SIDES:
                if side not in late and heard[side]['commands']():
                    late[side] = listener.subscribe(
                        String, f'/{side}/robot_description', qos.LATCHED)
            return len(late) == len(SIDES) and all(newest() for newest in late.values())

        try:
            wait_for(described_late, 'both descriptions')

            for run in runs:
                _, errors = end_of(run)
                assert run.returncode == 0, errors
            result = {side: {'description': late[side]()[-1].data,
                             'efforts': heard[side]['efforts'](),
                             'commands': heard[side]['commands']()} for side in SIDES}
        finally:
            for run in runs:
                if run.poll() is None:
                    run.terminate()
                    run.communicate()
            listener.close()
    yield folders, result


def read(folder, topic):
    with Reader(folder / 'bag') as reader:
        connections = [x for x in reader.connections if x.topic == topic]
        return [STORE.deserialize_cdr(data, x.msgtype)
                for x, _, data in reader.messages(connections)]


@pytest.mark.nightly
def test_each_graph_records_its_own_topics_only(two_runs):
    folders, _ = two_runs
    for side in SIDES:
        with Reader(folders[side] / 'bag') as reader:
            counts = {x.topic: x.msgcount for x in reader.connections}
        assert set(counts) - {'/clock'} == {x for x in counts if x.startswith(f'/{side}/')}
        assert counts[f'/{side}/joint_states'] == TICKS
        assert counts[f'/{side}/joint_effort_command'] == TICKS
    positions = [read(folders[side], f'/{side}/ft_sensor/wrench')[-1].wrench.force.z
                 for side in SIDES]
    assert positions[0] != positions[1]  # the seeds differ, and so do the graphs


@pytest.mark.nightly
def test_late_subscriber_gets_the_description(two_runs):
    folders, heard = two_runs
    expected = canonicalize(from_file=config_dir() / 'puma560.urdf')
    for side in SIDES:
        assert canonicalize(heard[side]['description']) == expected
        message, = read(folders[side], f'/{side}/robot_description')
        assert canonicalize(message.data) == expected


@pytest.mark.nightly
def test_bare_efforts_are_those_of_the_command(two_runs):
    """On the topics and in the bag; of both the first ones may be missing."""
    folders, heard = two_runs
    for side in SIDES:
        for efforts, commands in (
                (heard[side]['efforts'], heard[side]['commands']),
                (read(folders[side], f'/{side}/{EFFORTS}'),
                 read(folders[side], f'/{side}/joint_effort_command'))):
            count = min(len(efforts), len(commands))
            assert 0 < count <= TICKS
            assert [tuple(message.data) for message in efforts[-count:]] == [
                tuple(message.effort) for message in commands[-count:]]


@pytest.mark.parametrize(('namespace', 'bare'), [
    ('', ''), ('/', ''), ('left', 'left'), ('/arms/right/', 'arms/right')])
def test_check_namespace_strips_slashes(namespace, bare):
    assert check_namespace(namespace) == bare


@pytest.mark.parametrize('namespace', ['1st', 'a b', 'a//b', 'ä', 'a-b'])
def test_check_namespace_refuses_what_ros_would(namespace):
    with pytest.raises(ConfigError, match='namespace: expected names of letters'):
        check_namespace(namespace)
