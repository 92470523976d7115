"""
A node between simulator and controller that passes messages on, and damages them during a fault.

A line ``INPUT KIND SEED`` of its standard input begins a fault, an empty one ends it; it answers.
"""

from collections import deque
from select import select
import sys

from campaign.graph_faults import GRAPH_FAULTS, Resending
from multicontact_control.experiment.faults.vocabulary import CLOCK, Edit, PERIOD
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.runtime import EventsExecutor, start_ros
import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

PREFIX = 'faulty/'  # of the topics that are passed on, to which the controller listens
HISTORY = 512  # messages: a second at 500 Hz, twice the longest fault
INPUTS = {'joints': topics.JOINT_STATES, 'wrench': topics.WRENCH,
          'variance': topics.NOISE_VARIANCE}
FIELDS = {'q': 'position', 'qd': 'velocity', 'names': 'name', 'variance': 'effort'}


def read_field(message, name):
    if name == 'wrench':
        return messages.read_wrench(message)[1]
    return np.array(getattr(message, FIELDS[name]))


def write_field(message, name, values):
    if name == 'wrench':
        f, t = message.wrench.force, message.wrench.torque
        f.x, f.y, f.z, t.x, t.y, t.z = map(float, values)
    else:
        setattr(message, FIELDS[name], list(values))


class Stream:
    """The messages of one input, serialised; `history` has the good ones, newest last."""

    def __init__(self, node, topic):
        self._message, self._fault = topic.message, None
        self.history = deque(maxlen=HISTORY)
        self._publisher = node.create_publisher(
            topic.message, PREFIX + topic.name, topic.profile)
        node.create_subscription(topic.message, topic.name, self.pass_on, qos.INPUT, raw=True)

    def newest_stamp(self):
        newest = deserialize_message(self.history[-1], self._message)
        return messages.stamp_to_ns(newest.header.stamp)

    def begin(self, fault, seed, start):
        """Begin a fault at a stamp [ns], or end it by None."""
        self._random = np.random.default_rng(seed)
        self._start, self._choice = start, self._random.random(4)
        self._passed, self._first, self._fault = 0, {}, fault

    def pass_on(self, data):
        """Publish the messages that go on in the place of one."""
        self.history.append(data)
        for message in [data] if self._fault is None else self._damaged(data):
            self._publisher.publish(message)

    def _damaged(self, data):
        n, action = self._passed, self._fault.action
        self._passed += 1
        if isinstance(action, Resending):
            last = len(self.history) - 1
            return [self.history[max(0, last - age)] for age in action.ages(self._random, n)]
        message = deserialize_message(data, self._message)
        if isinstance(action, Edit):
            now = {name: read_field(message, name) for name in action.fields}
            self._first = self._first or now
            for name, values in action.values(now, self._first, self._choice).items():
                write_field(message, name, values)
        else:  # a clock
            stamp = messages.stamp_to_ns(message.header.stamp)
            shift = action.shift(1e-9 * (stamp - self._start), 1e-9 * self._start)
            message.header.stamp = messages.ns_to_stamp(stamp + round(max(-stamp, 1e9 * shift)))
        return [serialize_message(message)]


def main():
    """Pass messages on until the standard input is closed."""
    start_ros([])
    node, executor = Node('fault_relay'), EventsExecutor()
    executor.add_node(node)
    streams, line = {source: Stream(node, topic) for source, topic in INPUTS.items()}, 'none'
    while line:
        executor.spin_once(timeout_sec=0.02)
        if not select([sys.stdin], [], [], 0.0)[0]:
            continue
        line = sys.stdin.readline()
        for stream in streams.values():
            stream.begin(None, 0, 0)
        if line.strip():
            source, kind, seed = line.split()
            hit = [streams[x] for x in (('joints', 'wrench') if source == CLOCK else (source,))]
            start = max(x.newest_stamp() for x in hit) + round(1e9 * PERIOD)
            for stream in hit:
                stream.begin(GRAPH_FAULTS[kind, source], int(seed), start)
        print('done', flush=True)


if __name__ == '__main__':
    main()
