"""Topics at the control rate: made where they are subscribed to."""

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.nodes.streams import Streams
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros_graph import wait_for
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

TOPIC = topics.MEASURED_FORCES
EXAMPLE = {TOPIC: messages.joint_state_message(0, ['table'], effort=[0.0])}


def test_message_is_made_and_sent_while_it_is_subscribed_to(middleware):
    sender = Streams(middleware.node)
    sender.advertise(EXAMPLE)
    sender.send(TOPIC, 1, np.full(1, np.nan))  # not even looked at
    with pytest.raises(messages.MessageError, match='finite'):
        sender.message(TOPIC, 1, np.full(1, np.nan))
    subscription = middleware.node.create_subscription(
        TOPIC.message, TOPIC.name, ignore, 10, raw=True)
    wait_for(subscription.get_publisher_count, 'connection')
    wait_for(lambda: sender.wants(TOPIC), 'connection')
    sender.send(TOPIC, 2, np.full(1, 2.0))
    message = wait_for(lambda: middleware.take(subscription, TOPIC.message), 'the message')
    assert (messages.stamp_to_ns(message.header.stamp), list(message.effort)) == (2, [2.0])
    middleware.node.destroy_subscription(subscription)
    wait_for(lambda: not sender.wants(TOPIC), 'the end of the connection')
    sender.close()


def test_best_effort_publishers_are_heard_beside_reliable_ones(middleware):
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
    assert reader.subscriptions[TOPIC] is end
    reader.close()
    for publisher in (first, second):
        node.destroy_publisher(publisher)
