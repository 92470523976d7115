"""Topics at the control rate: made for whoever wants them, and for nobody else."""

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.nodes.local_delivery import LocalDelivery
from multicontact_control.nodes.recording_batch import read_batch
from multicontact_control.nodes.streams import Streams
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros_graph import wait_for
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

TOPIC = topics.MEASURED_FORCES
EXAMPLE = {TOPIC: messages.joint_state_message(0, ['table'], effort=[0.0])}


def effort(data):
    return list(deserialize_message(data, JointState).effort)


@pytest.fixture
def streams(middleware):
    made = []

    def make(local=None, **options):
        made.append(Streams(middleware.node, local))
        made[-1].advertise(EXAMPLE, **options)
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_a_reader_that_comes_gets_what_is_sent_from_then_on(middleware, streams):
    sender = streams()
    assert not sender.wants(TOPIC)
    sender.send(TOPIC, 1, np.ones(1))
    subscription = middleware.node.create_subscription(
        TOPIC.message, TOPIC.name, lambda _: None, 10, raw=True)
    wait_for(subscription.get_publisher_count, 'connection')
    wait_for(lambda: sender.wants(TOPIC), 'connection')
    sender.send(TOPIC, 2, np.full(1, 2.0))
    message = wait_for(lambda: middleware.take(subscription, TOPIC.message), 'the message')
    assert (messages.stamp_to_ns(message.header.stamp), list(message.effort)) == (2, [2.0])
    middleware.node.destroy_subscription(subscription)
    wait_for(lambda: sender.poll() or not sender.wants(TOPIC), 'nobody to listen any more')


def test_what_is_not_wanted_is_not_even_looked_at(streams):
    sender = streams()
    sender.send(TOPIC, 1, np.full(1, np.nan))
    with pytest.raises(messages.MessageError, match='finite'):
        sender.message(TOPIC, 1, np.full(1, np.nan))


def test_nodes_of_a_process_hand_each_other_bytes(middleware, streams):
    local, seen = LocalDelivery([topics.CONTROLLER, topics.ESTIMATOR]), []
    sender = streams(local)
    reader = Streams(middleware.node, local)
    reader.subscribe(TOPIC, seen.append, qos.INPUT)
    sender.send(TOPIC, 1, np.full(1, 3.0))
    assert local.deliver()
    assert [effort(data) for data in seen] == [[3.0]]
    ends, = sender.publishers
    assert topics.ESTIMATOR not in ends.subscribers
    assert topics.RECORDER in ends.subscribers
    reader.close()
    sender.send(TOPIC, 2, np.full(1, 4.0))
    assert not local.deliver()


def test_the_recorder_gets_batches_and_is_not_waited_for_elsewhere(middleware, streams):
    sender = streams(batched=True)
    batches = topics.batches_of(middleware.node.get_name())
    subscription = middleware.node.create_subscription(
        batches.message, batches.name, lambda _: None, 10)
    wait_for(subscription.get_publisher_count, 'connection')
    plain, batched = sender.publishers
    assert topics.RECORDER not in plain.subscribers
    assert batched.subscribers == (topics.RECORDER,)
    wait_for(sender.publishers[batched].get_subscription_count, 'connection')
    for k in range(3):
        sender.send(TOPIC, k, np.full(1, float(k)))
    sender.flush()
    message = wait_for(lambda: middleware.take(subscription, batches.message), 'the batch')
    content = bytes(message.data)
    envelope = b'\0\1\0\0' + bytes(8) + len(content).to_bytes(4, 'little')
    assert [effort(entry.data) for entry in read_batch(envelope + content)] == [
        [0.0], [1.0], [2.0]]


def test_publishers_that_give_less_are_heard_beside_those_that_give_more(middleware):
    node, seen = middleware.node, []
    first = node.create_publisher(JointState, TOPIC.name, qos.STREAM)
    reader = Streams(node)
    reader.subscribe(TOPIC, ignore, qos.NEWEST, adapt=True)
    wait_for(first.get_subscription_count, 'connection')
    second = node.create_publisher(JointState, TOPIC.name, qos.SENSOR)

    def heard():
        reader.meet_publishers()
        for name, publisher in (('first', first), ('second', second)):
            publisher.publish(messages.joint_state_message(0, [name], effort=[0.0]))
        while (taken := take(reader.subscriptions[TOPIC])) is not None:
            seen.extend(deserialize_message(taken[0], JointState).name)
        return set(seen) if second.get_subscription_count() else None

    wait_for(lambda: heard() == {'first', 'second'}, 'both', lambda: set(seen))
    end = reader.subscriptions[TOPIC]
    for _ in range(3):
        reader.meet_publishers()
        middleware.pause(0.11)
    assert reader.subscriptions[TOPIC] is end  # and that is all
    reader.close()
    for publisher in (first, second):
        node.destroy_publisher(publisher)
