"""A glance at a graph takes batches where there are some, and topics where there are none."""

from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.glance import GlancingLink
from multicontact_control.nodes.recording_batch import RecordingBatch
from multicontact_control.nodes.topics import batches_of
import pytest
from rclpy.serialization import serialize_message
from ros_graph import wait_for

pytestmark = pytest.mark.ros


@pytest.fixture
def link(domain_id):
    with GlancingLink((topics.POSE, topics.DESIRED_FORCES, topics.DIAGNOSTICS), namespace='arm',
                      domain_id=domain_id, timeout=1.0) as glance:
        yield glance


def forces(value):
    return messages.joint_state_message(0, ['table'], effort=[value])


def readers(middleware, topic):
    return middleware.node.count_subscribers(f'/arm/{topic.name}')


def test_topics_of_a_node_without_batches_are_subscribed_to(middleware, link):
    publisher = middleware.node.create_publisher(
        topics.DESIRED_FORCES.message, '/arm/contact_forces/desired', 10)

    def heard():
        publisher.publish(forces(3.0))
        return link.newest(topics.DESIRED_FORCES)

    assert wait_for(heard, 'a message').effort[0] == 3.0
    assert readers(middleware, topics.POSE) == 0  # which nobody has asked for


def test_topics_that_come_in_batches_are_not_subscribed_to(middleware, link):
    assert link.newest(topics.DESIRED_FORCES) is None
    wait_for(lambda: readers(middleware, topics.DESIRED_FORCES) == 1, 'a subscription')
    batches = batches_of(topics.CONTROLLER)
    publisher = middleware.node.create_publisher(batches.message, f'/arm/{batches.name}', 10)
    batch = RecordingBatch(['/arm/other', '/arm/contact_forces/desired'])

    def heard():
        for value in (1.0, 2.0):
            batch.add(0, b'nobody asks for this')
            batch.add(1, serialize_message(forces(value)))
        publisher.publish(batch.take())
        return link.newest(topics.DESIRED_FORCES)

    assert wait_for(heard, 'a batch').effort[0] == 2.0
    wait_for(lambda: readers(middleware, topics.DESIRED_FORCES) == 0, 'no subscription')
    assert link.newest(topics.DESIRED_FORCES).effort[0] == 2.0
    assert link.newest(topics.POSE) is None
    assert readers(middleware, topics.POSE) == 0  # batches may have it any time


def test_what_is_no_stream_is_subscribed_to_from_the_start(middleware, link):
    assert wait_for(lambda: readers(middleware, topics.DIAGNOSTICS), 'a subscription') == 1
