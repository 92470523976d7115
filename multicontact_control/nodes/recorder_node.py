"""
The recorder as a ROS 2 node: every message of the graph into a bag, as it came.

The subscriptions are raw, and emptied fifty times a second without an executor. A recorder that
is killed leaves a bag that `report` and `view` read up to half a second before the end.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from operator import itemgetter
import os
from pathlib import Path
import sys
import time
from typing import Any

from multicontact_control.config import parameter
from multicontact_control.errors import RunError
from multicontact_control.nodes import graph, qos
from multicontact_control.nodes.background import BackgroundThread
from multicontact_control.nodes.diagnostics import ComponentStatus, DiagnosticsPublisher
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.topics import CONTROLLER, RECORDER, Topic, TOPICS
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from rosbags import interfaces
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
    WriterError,
)
from rosbags.typesys import get_typestore, Stores
from std_msgs.msg import Float64MultiArray

NICENESS = 10  # the nodes that control go first; ten seconds of messages can wait
POLL_PERIOD = 0.02  # s, between two looks at the subscriptions
FLUSH_PERIOD = 0.5  # s
QUIET_TIME = 0.2  # s without a message, that end a recording
DRAIN_TIMEOUT = 3.0  # s, that the end of a recording waits for that at most
# As rosbag2 writes that there is no limit.
INFINITE = interfaces.QosTime(9223372036, 854775807)


class RecorderConfig(graph.StartupConfig):
    """Parameters of the recorder: the folder of the bag, and a topic that not all graphs have."""

    folder: str = parameter(..., 'Folder of the bag, to be created.')
    effort_output_topic: str = parameter(
        '',
        "The controller's topic for bare efforts, to be recorded as well; empty for none.",
    )


@dataclass
class _RecordedTopic:
    """A topic with its connection of the bag, and its subscription, which may be replaced."""

    topic: Topic
    connection: interfaces.Connection
    subscription: Subscription
    last_number: int = 0  # of a message among those of its publisher


class Bag(Writer):
    """
    A recording in a folder, which the constructor makes: MCAP, compressed by zstd.

    RunError if the folder exists already, or cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self._types = get_typestore(Stores.ROS2_JAZZY)
        try:
            super().__init__(folder, version=9, storage_plugin=StoragePlugin.MCAP)
            self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self.open()
        except WriterError:
            raise RunError(
                f'{folder}: expected a folder that does not exist yet'
            ) from None
        except OSError as error:
            raise RunError(f'{folder}: {error.strerror}') from None

    def add_topic(
        self, name: str, type_name: str, profile: QoSProfile
    ) -> interfaces.Connection:
        """
        Return the connection that messages of a topic are written to.

        Parameters
        ----------
        name, type_name
            Full name of the topic, and type of its messages, e.g. 'std_msgs/msg/String'.
        profile
            Profile of the publisher: a player offers the same.

        """
        offered = interfaces.Qos(
            interfaces.QosHistory(profile.history),
            profile.depth,
            interfaces.QosReliability(profile.reliability),
            interfaces.QosDurability(profile.durability),
            INFINITE,
            INFINITE,
            interfaces.QosLiveliness(profile.liveliness),
            INFINITE,
            False,
        )
        return self.add_connection(
            name, type_name, typestore=self._types, offered_qos_profiles=[offered]
        )

    def flush(self) -> None:
        """Hand all messages to the operating system: a process that is killed then loses none."""
        storage: Any = self.storage
        if storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()


class RecorderNode(Node):
    """
    Records the topics of the graph to a rosbag2 folder with MCAP.

    Asked to stop, it writes what still comes, then closes the bag. RunError if the folder of the
    bag exists already.
    """

    def __init__(self) -> None:
        # Parameter services need an executor, which this node has not.
        super().__init__(RECORDER, start_parameter_services=False)
        self._config: RecorderConfig = load_parameters(self, RecorderConfig)[0]
        topics = self._list_topics()  # first: a bad name leaves no folder behind
        self._bag = Bag(Path(self._config.folder))
        self._recorded = []
        for name, topic in topics.items():
            latched = topic.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            profile = qos.make_profile(qos.STREAM.depth, latched=latched)
            connection = self._bag.add_topic(name, topic.type_name, topic.profile)
            subscription = self._subscribe(topic, profile)
            self._recorded.append(_RecordedTopic(topic, connection, subscription))
        # Messages by topic, since the first of each.
        self._lost: Counter[str] = Counter()
        self._flush_due = 0.0
        self._diagnostics = DiagnosticsPublisher(
            self, self._collect_statuses, BackgroundThread()
        )
        self._gate = graph.StartupGate(self, self._config)

    def _list_topics(self) -> dict[str, Topic]:
        """Return the topics to record by their full names."""
        topics = {self.resolve_topic_name(topic.name): topic for topic in TOPICS}
        efforts = self._config.effort_output_topic
        if efforts:
            name = graph.full_topic_name('effort_output_topic', efforts, self)
            topics[name] = Topic(name, Float64MultiArray, CONTROLLER, rate='event')
        return topics

    def _subscribe(self, topic: Topic, profile: QoSProfile) -> Subscription:
        return self.create_subscription(
            topic.message, topic.name, graph.ignore_message, profile, raw=True
        )

    def run(self, spinner: Spinner) -> None:
        """Record until asked to stop, and then until nothing has come for `QUIET_TIME`."""
        os.nice(NICENESS)  # of this thread; those that take in messages keep theirs
        while not spinner.stop:
            self._gate.poll()
            self._write_arrived()
            self._diagnostics.poll()
            time.sleep(POLL_PERIOD)
        give_up = time.monotonic() + DRAIN_TIMEOUT
        while time.monotonic() < give_up and self._write_arrived():
            time.sleep(QUIET_TIME)

    def _write_arrived(self) -> bool:
        """Write what has arrived, in the order of publication; return whether anything has."""
        arrived = []
        for recorded in self._recorded:
            while (taken := graph.take_message(recorded.subscription)) is not None:
                data, info = taken
                sent = info['source_timestamp'] or info['received_timestamp']
                if not sent:  # the middleware knows neither
                    sent = time.time_ns()
                arrived.append((sent, recorded.connection, data))
                self._count_lost(recorded, info['publication_sequence_number'])
        for sent, connection, data in sorted(arrived, key=itemgetter(0)):
            self._bag.write(connection, sent, data)
        if time.monotonic() >= self._flush_due:
            self._bag.flush()
            self._flush_due = time.monotonic() + FLUSH_PERIOD
        return bool(arrived)

    def _count_lost(self, recorded: _RecordedTopic, number: int) -> None:
        """Count the messages between the last one of a topic and that with a number."""
        last = recorded.last_number
        recorded.last_number = number
        if recorded.topic.rate != 'control' or not 0 < last < number - 1:
            return
        # Each publisher counts its own messages: those of two cannot be told apart.
        if recorded.subscription.get_publisher_count() < 2:
            self._lost[recorded.connection.topic] += number - last - 1

    def _meet_publishers(self) -> None:
        """Subscribe best effort to topics of which a publisher offers less than is asked for."""
        for recorded in self._recorded:
            name = recorded.connection.topic
            requested = recorded.subscription.qos_profile
            if not all(
                graph.offers_enough(publisher.qos_profile, requested)
                for publisher in self.get_publishers_info_by_topic(name)
            ):
                self._write_arrived()
                self.destroy_subscription(recorded.subscription)
                recorded.subscription = self._subscribe(
                    recorded.topic, qos.make_profile(requested.depth, reliable=False)
                )
                self.get_logger().info(f'{name}: recorded best effort, as published')

    def close(self) -> None:
        """Close the bag, and write its counts by topic to `timing_file`, if given."""
        self._bag.close()
        counts = {}
        for connection in self._bag.connections:
            counts[connection.topic] = self._bag.counts[connection.id]
        self._config.write_counts({'counts': counts, 'lost': self._lost.total()})

    def _collect_statuses(self) -> list[ComponentStatus]:
        if self._gate.open:  # which looks at the subscriptions that there are now
            self._meet_publishers()
        values = {'dropped': self._lost.total()}
        for name, number in self._lost.items():
            values[f'dropped {name}'] = number
        warning = ''
        if self._lost:
            warning = f'messages lost on {", ".join(self._lost)}'
        return [
            ComponentStatus('loop', {'messages': sum(self._bag.counts.values())}),
            ComponentStatus('messages', values, warning),
        ]


def main() -> int:
    """Run the recorder node in this process; return the exit code, see `run_node`."""
    return run_node(RecorderNode)


if __name__ == '__main__':
    sys.exit(main())
