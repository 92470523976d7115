"""`multicontact topic list`, `echo` and `hz`, against what `ros2 topic` of ROS 2 Jazzy prints."""

import os
import re
import signal
import threading

from geometry_msgs.msg import PoseStamped
from multicontact_control.cli.topic import describe_rate, document
from multicontact_control.errors import ConfigError
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.runs.graph.domain import reserve_domain
import pytest
from ros_graph import end_of, PATIENCE, start_command
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
import yaml

JOINTS = """header:
  stamp:
    sec: 1
    nanosec: 2
  frame_id: ''
name:
- a
position:
- -2.5e-07
velocity: []
effort:
- .nan
---"""


def test_document_is_what_ros2_prints():
    message = JointState(name=['a'], position=[-2.5e-7], effort=[float('nan')])
    message.header.stamp.sec, message.header.stamp.nanosec = 1, 2
    for field, text in (
        ('', JOINTS),
        ('header.stamp', 'sec: 1\nnanosec: 2\n---'),
        ('header.stamp.sec', '1\n---'),
        ('name', '- a\n---'),
    ):
        assert document(message, field) == text
    for field, known in (
        ('efort', 'header, name, position, velocity, effort'),
        ('name.x', 'no further fields'),
    ):
        with pytest.raises(
            ConfigError, match=f'--field: expected one of {known}, got '
        ):
            document(message, field)
    for message in (PoseStamped(), PointCloud2(data=b'\x01\xff')):
        assert list(yaml.safe_load(document(message)[:-3])) == list(
            message.get_fields_and_field_types()
        )


@pytest.fixture(scope='module')
def start():
    """Return what starts the command beside a node that publishes numbered forces."""
    with reserve_domain() as domain_id, ServiceClientNode('guest', domain_id) as guest:
        forces = guest.node.create_publisher(JointState, '/left/forces', qos.STREAM)
        latched = guest.node.create_publisher(String, '/description', qos.LATCHED)
        hidden = guest.node.create_publisher(String, '/_hidden/topic', qos.LATCHED)
        for publisher in (latched, hidden):
            publisher.publish(String(data='an arm'))
        stop = threading.Event()

        def talk():
            number = 0
            while not stop.wait(0.04):
                number += 1
                forces.publish(
                    messages.joint_state_message(number, ['a'], effort=[number])
                )

        talker = threading.Thread(target=talk)
        talker.start()
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        yield lambda *arguments: start_command('topic', *arguments, env=environment)
        stop.set()
        talker.join()


@pytest.mark.ros
def test_list_and_echo_show_a_running_graph(start):
    output, errors = end_of(start('list', '--wait', '5'))
    assert errors == '' and 'hidden' not in output
    assert {
        '/left/forces [sensor_msgs/msg/JointState]',
        '/description [std_msgs/msg/String]',
    } <= set(output.splitlines())
    process = start('echo', 'left/forces', '--timeout', str(PATIENCE))
    lines = [process.stdout.readline() for _ in range(60)]
    process.send_signal(signal.SIGINT)
    rest, errors = end_of(process)
    assert (process.returncode, errors) == (0, '')
    numbers = [
        each['effort'][0] for each in yaml.safe_load_all(''.join(lines) + rest) if each
    ]
    assert numbers == [numbers[0] + k for k in range(len(numbers))]
    assert end_of(
        start('echo', '/description', '--once', '--timeout', str(PATIENCE))
    ) == ('data: an arm\n---\n', '')
    for arguments, code, message in (
        (
            ('/nothing', '--timeout', '0.5'),
            1,
            '/nothing: expected a publisher within 0.5 s',
        ),
        (('joint states',), 2, 'TOPIC: expected a name of a topic'),
    ):
        process = start('echo', *arguments)
        _, errors = end_of(process)
        assert (
            process.returncode == code and message in errors and errors.count('\n') == 1
        )


@pytest.mark.ros
def test_hz_shows_how_often_messages_arrive(start):
    """Of 25 Hz, on a machine that may be busy; and of a topic with one message."""
    text, errors = end_of(
        start('hz', '/left/forces', '--once', '--timeout', str(PATIENCE))
    )
    found = re.fullmatch(
        r'([\d.]+) Hz: [\d.]+ to [\d.]+ ms apart, standard deviation [\d.]+ ms, (\d+) messages\n',
        text,
    )
    assert errors == '' and found, text + errors
    assert 1.0 < float(found[1]) < 50.0 and 2 <= int(found[2]) <= 50
    assert end_of(
        start('hz', '/description', '--once', '--timeout', str(PATIENCE))
    ) == ('no two messages within a second\n', '')


def test_rate_is_that_of_the_arrivals():
    assert describe_rate([0, 2_000_000, 4_000_000, 9_000_000]) == (
        '333.3 Hz: 2.00 to 5.00 ms apart, standard deviation 1.41 ms, 4 messages'
    )


@pytest.mark.parametrize('domain', ['abc', '500'])
def test_domain_that_is_none_is_refused(multicontact, monkeypatch, domain):
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    done = multicontact('topic', 'list')
    assert done.exit_code == 2 and 'ROS_DOMAIN_ID' in done.stderr
