"""
The recorder as a ROS 2 node: every message of the graph into a bag, as it came, and /tf.

The subscriptions are raw, and emptied fifty times a second without an executor: the middleware
keeps what arrives meanwhile, with its time and its number in the publisher's stream. A recorder
that is killed leaves a bag that `report` and `view` read up to half a second before the end.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from operator import itemgetter
import os
from pathlib import Path
import sys
import time

from multicontact_control.config import parameter
from multicontact_control.dynamics.robot import LinkTransforms
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.nodes import qos
from multicontact_control.nodes.bag import Bag
from multicontact_control.nodes.diagnostics import Diagnostics, input_status, Status
from multicontact_control.nodes.graph_node import (
    full_topic_name,
    ignore,
    quality_mismatches,
    StartupConfig,
    StartupGate,
    take,
)
from multicontact_control.nodes.loop_statistics import Freshness, NANOSECONDS
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.streams import HEADER, STAMP
from multicontact_control.nodes.topics import (
    JOINT_STATES,
    message_class,
    RECORDER,
    ROBOT_DESCRIPTION,
    Topic,
    TOPICS,
    USER,
    WORLD_FRAME,
)
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import String

STALE_AGE = 1.0  # s
NICENESS = 10  # the nodes that control go first; ten seconds of messages can wait
POLL_PERIOD, FLUSH_PERIOD = 0.02, 0.5  # s
QUIET_TIME, DRAIN_TIMEOUT = 0.2, 3.0  # s without a message that end a recording, at most this long
TF_TOPIC, TF_TYPE, TF_PERIOD = '/tf', 'tf2_msgs/msg/TFMessage', NANOSECONDS // 25


class RecorderConfig(StartupConfig):
    """What to record, and where to."""

    folder: str = parameter(..., 'Folder of the bag, to be created.')
    topics: tuple[str, ...] = parameter((), 'Topics to record; empty for all of the graph.')
    extra_topics: tuple[str, ...] = parameter(
        (), 'Topics of others to record as well, each as `NAME TYPE`, e.g. '
        '`/effort_controller/commands std_msgs/msg/Float64MultiArray`.')


@dataclass
class Stream:
    """One topic being recorded, and how many messages since the first one have not come."""

    topic: Topic
    subscription: Subscription
    last_number: int = 0
    lost: int = 0

    def count(self, number: int) -> None:
        """Take note of a message's number in its stream; of several publishers none is known."""
        if 0 < self.last_number < number - 1 and self.subscription.get_publisher_count() < 2:
            self.lost += number - self.last_number - 1
        self.last_number = number


class RecorderNode(Node):
    """Writes raw messages to a bag until asked to stop, then what still comes, then closes it."""

    def __init__(self) -> None:
        # Parameter services need an executor, which this node has not.
        super().__init__(RECORDER, start_parameter_services=False)
        self._config: RecorderConfig
        self._config, = load_parameters(self, RecorderConfig)
        chosen = self._chosen_topics()
        self._bag = Bag(Path(self._config.folder))
        self._streams: dict[str, Stream] = {}
        for topic in chosen:
            name = self.resolve_topic_name(topic.name)
            self._bag.add_topic(name, topic.type_name, topic.profile)
            latched = topic.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            self._streams[name] = Stream(topic, self._subscribe(
                topic, qos.RECORDING_LATCHED if latched else qos.RECORDING))
        self._transforms = _TransformWriter(self._bag, self.get_logger()) if (
            {JOINT_STATES, ROBOT_DESCRIPTION} <= set(chosen)) else None
        self._messages, self._next_flush = 0, 0.0
        self._fresh = Freshness()
        self._diagnostics = Diagnostics(self, self._statuses)
        self._gate = StartupGate(
            self, {}, {x.topic: x.subscription for x in self._streams.values()}, self._config)

    def _chosen_topics(self) -> list[Topic]:
        """Return the topics to record; ConfigError if one is not known, or is there twice."""
        names = [topic.name for topic in TOPICS]
        for name in self._config.topics:
            if name not in names:
                raise ConfigError('topics', f'names among {", ".join(names)}', f"'{name}'")
        chosen = [x for x in TOPICS if not self._config.topics or x.name in self._config.topics]
        taken = {self.resolve_topic_name(name) for name in names}
        for text in self._config.extra_topics:
            name, _, type_name = text.strip().partition(' ')
            full_topic_name('extra_topics', name, self)
            full = self.resolve_topic_name(name)
            if not type_name or full in taken:
                raise ConfigError('extra_topics', 'NAME TYPE of other topics, each once',
                                  f"'{text}'")
            taken.add(full)
            try:
                message = message_class(type_name.strip())
            except RunError as error:
                raise ConfigError('extra_topics', 'types that are installed', error) from None
            chosen.append(Topic(name, message, USER, (RECORDER,), qos.STREAM, 'event'))
        return chosen

    def _subscribe(self, topic: Topic, profile: QoSProfile) -> Subscription:
        return self.create_subscription(topic.message, topic.name, ignore, profile, raw=True)

    def run(self, spinner: Spinner) -> None:
        """Record until asked to stop and nothing comes any more."""
        with contextlib.suppress(OSError):
            os.nice(NICENESS)  # of this thread; those that take in messages keep theirs
        while not spinner.stop:
            self._gate.poll()
            self._drain()
            self._diagnostics.poll()
            time.sleep(POLL_PERIOD)
        quiet_since = time.monotonic()
        give_up = quiet_since + DRAIN_TIMEOUT
        while (now := time.monotonic()) < min(give_up, quiet_since + QUIET_TIME):
            if self._drain():
                quiet_since = now
            time.sleep(POLL_PERIOD)

    def _drain(self) -> bool:
        """Write what has arrived, in the order of publication; return whether anything has."""
        arrived = []
        for name, stream in self._streams.items():
            while (taken := take(stream.subscription)) is not None:
                data, info = taken
                sent = info['source_timestamp'] or info['received_timestamp'] or time.time_ns()
                arrived.append((sent, name, data))
                if stream.topic.rate == 'control':
                    stream.count(info['publication_sequence_number'])
                    self._fresh.note(name)
        arrived.sort(key=itemgetter(0))
        for sent, name, data in arrived:
            self._bag.write(name, data, sent)
            if self._transforms is not None:
                self._transforms.take(self._streams[name].topic, data, sent)
        self._messages += len(arrived)
        if time.monotonic() >= self._next_flush:
            self._bag.flush()
            self._next_flush = time.monotonic() + FLUSH_PERIOD
        return bool(arrived)

    def _meet_publishers(self) -> None:
        """Ask for no more than is given where one of a topic's publishers gives less."""
        for name, stream in self._streams.items():
            end, asked = stream.subscription, stream.subscription.qos_profile
            if self.count_publishers(name) > end.get_publisher_count() and (
                    quality_mismatches(self, name, asked)):
                self._drain()
                self.destroy_subscription(end)
                stream.subscription = self._subscribe(
                    stream.topic, qos.profile(asked.depth, reliable=False))
                self.get_logger().info(f'{name}: recorded best effort, as published')

    def close(self) -> None:
        """Close the bag, and write the counts of this run, if asked to."""
        self._bag.close()
        self._config.write_counts({
            'messages': self._messages, 'counts': self._bag.counts(),
            'lost': sum(self._lost().values()), 'lost_by_topic': self._lost()})

    def _lost(self) -> dict[str, int]:
        return {name: x.lost for name, x in self._streams.items() if x.lost}

    def _statuses(self) -> list[Status]:
        if self._gate.open:  # which looks at the ends that there are now
            self._meet_publishers()
        lost = self._lost()
        return [
            Status('loop', {'messages': self._messages}),
            Status('messages', {
                'dropped': sum(lost.values()),
                **{f'dropped {name}': number for name, number in lost.items()}},
                warning=f'messages lost on {", ".join(lost)}' if lost else ''),
            # Of what has come and does so no more: no graph has all that can be recorded.
            input_status(self._fresh, STALE_AGE, needed=self._messages > 0)]


class _TransformWriter:
    """Adds the poses of the links to a bag, from its joint states and robot description."""

    def __init__(self, bag: Bag, logger: RcutilsLogger) -> None:
        self._bag, self._logger = bag, logger
        self._links: LinkTransforms | None = None
        self._last = -TF_PERIOD
        bag.add_topic(TF_TOPIC, TF_TYPE, qos.STREAM)

    def take(self, topic: Topic, data: bytes, sent: int) -> None:
        """Take in a message; write the poses of a joint state 25 times a second."""
        if topic is ROBOT_DESCRIPTION:
            try:
                self._links = LinkTransforms(
                    deserialize_message(data, String).data, world_frame=WORLD_FRAME)
            except ConfigError as error:
                self._logger.error(f'no {TF_TOPIC}: {error}')
        if topic is not JOINT_STATES or self._links is None:
            return
        sec, nanosec = STAMP.unpack_from(data, HEADER)
        stamp = sec * NANOSECONDS + nanosec
        if 0 <= stamp - self._last < TF_PERIOD:
            return
        self._last = stamp
        joints = deserialize_message(data, JointState)
        types = self._bag.types.types
        at = types['builtin_interfaces/msg/Time'](sec, nanosec)
        make, transform, vector, quaternion = (types[f'geometry_msgs/msg/{name}'] for name in (
            'TransformStamped', 'Transform', 'Vector3', 'Quaternion'))
        message = types[TF_TYPE]([make(
            types['std_msgs/msg/Header'](at, x.parent), x.child,
            transform(vector(*x.translation), quaternion(*x.quaternion_xyzw)))
            for x in self._links.at(dict(zip(joints.name, joints.position)))])
        self._bag.write(TF_TOPIC, bytes(self._bag.types.serialize_cdr(message, TF_TYPE)), sent)


def main() -> int:
    """Run the recorder node."""
    return run_node(RecorderNode)


if __name__ == '__main__':
    sys.exit(main())
