"""`multicontact topics`, `echo` and `record` as processes beside a publisher."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.link import GuestNode
import pytest
from rclpy.node import Node
from ros_graph import end_of, PATIENCE, ROOT, wait_for
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import String
import yaml

pytestmark = pytest.mark.ros

STORE = get_typestore(Stores.ROS2_JAZZY)
PATIENT = ('--timeout', str(PATIENCE))


def numbered(number):
    return messages.joint_state_message(number, ['a'], effort=[number])


class Chatter:
    """Publishes numbered forces all the time, and said a description once."""

    def __init__(self, domain_id):
        self._guest = GuestNode('guest', domain_id)
        self.node = Node('chatter', context=self._guest.context, use_global_arguments=False)
        self._forces = self.node.create_publisher(JointState, 'left/forces', qos.STREAM)
        # What a reader that gets no processor for some seconds has yet missed nothing of.
        self._seldom = self.node.create_publisher(JointState, 'left/seldom', qos.STREAM)
        self._latched = self.node.create_publisher(String, 'description', qos.LATCHED)
        self._hidden = self.node.create_publisher(String, '_hidden/topic', qos.LATCHED)
        self._latched.publish(String(data='an arm'))
        self.number = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._talk)
        self._thread.start()

    def _talk(self):
        while not self._stop.wait(0.002):
            self.number += 1
            self._forces.publish(numbered(self.number))
            if self.number % 20 == 0:
                self._seldom.publish(numbered(self.number // 20))

    def close(self):
        self._stop.set()
        self._thread.join()
        self.node.destroy_node()
        self._guest.close()


@pytest.fixture(scope='module')
def chatter():
    saved = os.environ.pop('ROS_DOMAIN_ID', None)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with reserve_domain() as domain_id:
        os.environ['ROS_DOMAIN_ID'] = str(domain_id)
        talker = Chatter(domain_id)
        yield talker
        talker.close()
    os.environ.pop('ROS_DOMAIN_ID')
    if saved is not None:
        os.environ['ROS_DOMAIN_ID'] = saved


@pytest.fixture
def multicontact(chatter, tmp_path):
    """Return a function that starts the command; what still runs at the end is killed."""
    started, limits = [], []

    def start(*arguments):
        environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
        started.append(subprocess.Popen(
            [sys.executable, '-m', 'multicontact_control.cli', *arguments], cwd=tmp_path,
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        # Whoever reads a line of it reads the end then.
        limits.append(threading.Timer(PATIENCE, started[-1].kill))
        limits[-1].start()
        return started[-1]

    yield start
    for limit in limits:
        limit.cancel()
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def test_topics_lists_names_and_types_but_nothing_hidden(multicontact):
    listed = []

    def complete():
        output, errors = end_of(multicontact('topics'))
        assert errors == ''
        listed[:] = output.splitlines()
        return {'/left/forces [sensor_msgs/msg/JointState]',
                '/description [std_msgs/msg/String]'} <= set(listed)

    wait_for(complete, 'nodes found')
    assert not [line for line in listed if 'hidden' in line]


def test_echo_finds_the_type_and_prints_until_interrupted(multicontact):
    process = multicontact('echo', 'left/seldom', *PATIENT)
    lines = [process.stdout.readline() for _ in range(60)]
    process.send_signal(signal.SIGINT)
    rest, errors = end_of(process)
    assert (process.returncode, errors) == (0, '')
    documents = [x for x in yaml.safe_load_all(''.join(lines) + rest) if x is not None]
    numbers = [x['effort'][0] for x in documents]
    assert numbers == [numbers[0] + k for k in range(len(numbers))]


def test_echo_once_gets_what_was_said_before(multicontact):
    output, errors = end_of(multicontact('echo', '/description', '--once', *PATIENT))
    assert (output, errors) == ('data: an arm\n---\n', '')


@pytest.mark.parametrize(('arguments', 'code', 'message'), [
    (('echo', '/nothing', '--timeout', '0.5'), 1,
     '/nothing: expected a publisher within 0.5 s, found none'),
    (('echo', 'joint states'), 2, "topic: expected a name of a topic, found '/joint states' (to"),
    (('record', 'a//b'), 2, "topic: expected a name of a topic, found '/a//b' (topic name must"),
    (('echo', '/left/forces', '--field', 'x', *PATIENT), 2, '--field: expected one of header'),
    (('record',), 2, 'topics: expected either names or --all, found neither'),
    (('record', '/a', '-o', '.'), 2, '--output: expected a folder that does not exist yet')])
def test_bad_input_is_answered_in_one_line(multicontact, arguments, code, message):
    process = multicontact(*arguments)
    _, errors = end_of(process)
    assert process.returncode == code
    assert message in errors
    assert len(errors.splitlines()) == 1


@pytest.mark.parametrize('chosen', [('/left/forces', '/description', '/never'), ('--all',)])
def test_record_keeps_every_message_of_any_type(chatter, multicontact, tmp_path, chosen):
    process = multicontact('record', *chosen, '-o', 'bag')
    output = ''
    while not all(f"Subscribed to topic '{x}'" in output
                  for x in ('/left/forces', '/description')):
        line = process.stdout.readline()
        assert line, process.communicate()[1]
        output += line
    enough = chatter.number + 300
    wait_for(lambda: chatter.number > enough, 'messages')
    process.send_signal(signal.SIGINT)
    rest, errors = end_of(process)
    assert (process.returncode, errors) == (0, '')
    output += rest
    with Reader(tmp_path / 'bag') as reader:
        assert f'Recorded {reader.message_count} messages' in output
        kept = {x.topic: x for x in reader.connections}
        assert {'/left/forces', '/description'} <= set(kept)
        assert ('/rosout' in kept) == (chosen == ('--all',))
        assert not [topic for topic in kept if 'hidden' in topic]
        profile = kept['/description'].ext.offered_qos_profiles[0]
        assert profile.durability == QosDurability.TRANSIENT_LOCAL
        found = [(x.topic, STORE.deserialize_cdr(data, x.msgtype))
                 for x, _, data in reader.messages()]
    assert [message.data for topic, message in found if topic == '/description'] == ['an arm']
    numbers = [message.effort[0] for topic, message in found if topic == '/left/forces']
    assert len(numbers) > 10
    assert numbers == [numbers[0] + k for k in range(len(numbers))]
