"""Topics at the control rate: made where they are subscribed to."""

from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import ignore
from multicontact_control.nodes.streams import Streams
import numpy as np
import pytest
from ros_graph import wait_for

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
