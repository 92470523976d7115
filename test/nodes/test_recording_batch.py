"""Messages that go to the recorder many at a time."""

import time

from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.errors import MessageError
from multicontact_control.nodes.recording_batch import LARGEST, read_batch, RecordingBatch
import pytest
from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt8MultiArray

NAMES = ('/a', '/left/contact_forces/measured')
ADDED = st.lists(st.tuples(st.integers(0, 1), st.binary(max_size=300)), min_size=1, max_size=20)


@settings(max_examples=100, deadline=None)
@given(added=ADDED)
def test_what_is_put_in_comes_out_in_order_with_numbers_and_times(added):
    batch = RecordingBatch(NAMES)
    start = time.time_ns()
    for _ in range(2):  # the numbers go on from batch to batch
        for topic, data in added:
            batch.add(topic, data)
        found = list(read_batch(batch.take()))
        assert [(entry.topic_name, entry.data) for entry in found] == [
            (NAMES[topic], data) for topic, data in added]
        times = [start, *(entry.sent for entry in found), time.time_ns()]
        assert times == sorted(times)
    for topic, name in enumerate(NAMES):
        count = sum(each == topic for each, _ in added)
        assert [entry.sequence for entry in found if entry.topic_name == name] == list(
            range(count + 1, 2 * count + 1))


def test_a_batch_is_a_message_that_rclpy_reads():
    batch = RecordingBatch(NAMES)
    assert batch.take() == b''
    batch.add(1, b'abc')
    data = batch.take()
    message = deserialize_message(data, UInt8MultiArray)
    assert bytes(message.data) == data[16:]
    assert bytes(message.data).endswith(b'abc')


def test_a_full_batch_says_so():
    batch = RecordingBatch(NAMES)
    assert not batch.add(0, bytes(LARGEST))
    assert batch.add(0, b'x')


@settings(max_examples=100, deadline=None)
@given(added=ADDED, data=st.data())
def test_a_batch_that_is_cut_off_or_none_is_refused(added, data):
    batch = RecordingBatch(NAMES)
    for topic, content in added:
        batch.add(topic, content)
    whole = batch.take()
    with pytest.raises(MessageError, match='batch'):
        list(read_batch(whole[:data.draw(st.integers(0, len(whole) - 1))]))
    with pytest.raises(MessageError, match='batch'):
        list(read_batch(b'\7\7\7\7' + whole[4:]))
