"""
A node between simulator and controller that passes messages on, and damages them during a fault.

A line ``INPUT KIND SEED`` of its standard input begins a fault, an empty one ends it; it answers.
"""

from collections import deque
from select import select
import sys

from campaign.graph_faults import ClockShift, GRAPH_FAULTS, Resending
from multicontact_control.faults.vocabulary import CLOCK
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.runtime import EventsExecutor, start_ros
import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

PREFIX = 'faulty/'  # of the topics that are passed on, to which the controller listens
HISTORY = 512  # messages: a second at 500 Hz, twice the longest fault
INPUTS = {
    'joints': topics.JOINT_STATES,
    'wrench': topics.WRENCH,
    'variance': topics.NOISE_VARIANCE,
}


class Stream:
    """The messages of one input, serialised; `history` has the good ones, newest last."""

    def __init__(self, node, topic):
        self._message = topic.message
        self._fault = None
        self.history = deque(maxlen=HISTORY)
        self._publisher = node.create_publisher(
            topic.message, PREFIX + topic.name, topic.profile
        )
        node.create_subscription(
            topic.message, topic.name, self.pass_on, qos.INPUT, raw=True
        )

    def begin(self, fault, seed):
        """Begin a fault, or end it by None."""
        self._random = np.random.default_rng(seed)
        self._passed = 0
        self._fault = fault

    def pass_on(self, data):
        """Publish the messages that go on in the place of one."""
        self.history.append(data)
        sent = [data] if self._fault is None else self._damaged(data)
        for message in sent:
            self._publisher.publish(message)

    def _damaged(self, data):
        action = self._fault.action
        number = self._passed
        self._passed += 1
        if isinstance(action, Resending):
            last = len(self.history) - 1
            ages = action.ages(self._random, number)
            return [self.history[max(0, last - age)] for age in ages]
        message = deserialize_message(data, self._message)
        if isinstance(action, ClockShift):
            stamp = messages.stamp_to_ns(message.header.stamp)
            shift = max(-stamp, 1e9 * action.shift)  # to 0 at most
            message.header.stamp = messages.ns_to_stamp(stamp + round(shift))
        else:
            message.name = action.change(message.name)
        return [serialize_message(message)]


def main():
    """Pass messages on until the standard input is closed."""
    start_ros([])
    node = Node('fault_relay')
    executor = EventsExecutor()
    executor.add_node(node)
    streams = {source: Stream(node, topic) for source, topic in INPUTS.items()}
    line = 'none'
    while line:
        executor.spin_once(timeout_sec=0.02)
        if not select([sys.stdin], [], [], 0.0)[0]:
            continue
        line = sys.stdin.readline()
        for stream in streams.values():
            stream.begin(None, 0)
        if line.strip():
            source, kind, seed = line.split()
            damaged = ('joints', 'wrench') if source == CLOCK else (source,)
            for name in damaged:
                streams[name].begin(GRAPH_FAULTS[kind, source], int(seed))
        print('done', flush=True)


if __name__ == '__main__':
    main()
