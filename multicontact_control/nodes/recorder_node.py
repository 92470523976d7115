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
POLL_PERIOD, FLUSH_PERIOD = 0.02, 0.5  # s
QUIET_TIME, DRAIN_TIMEOUT = (
    0.2,
    3.0,
)  # s without a message that end a recording, at most this long
INFINITE = interfaces.QosTime(
    9223372036, 854775807
)  # as rosbag2 writes that there is no limit


class RecorderConfig(graph.StartupConfig):
    """What to record, and where to."""

    folder: str = parameter(..., 'Folder of the bag, to be created.')
    effort_output_topic: str = parameter(
        '',
        "The controller's topic for bare efforts, to be recorded as well; empty for none.",
    )


@dataclass
class _Stream:
    """One topic being recorded."""

    topic: Topic
    connection: interfaces.Connection
    subscription: Subscription
    last_number: int = 0  # of a message in its stream


class Bag(Writer):
    """One recording, in a folder to create; RunError if it exists, or cannot be written to."""

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
        self,
        name: str,
        type_name: str,
        profile: QoSProfile,
    ) -> interfaces.Connection:
        """Return what messages of a topic are written to."""
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

    Asked to stop, it writes what still comes, then closes the bag.
    """

    def __init__(self) -> None:
        # Parameter services need an executor, which this node has not.
        super().__init__(RECORDER, start_parameter_services=False)
        self._config: RecorderConfig = load_parameters(self, RecorderConfig)[0]
        topics = {self.resolve_topic_name(topic.name): topic for topic in TOPICS}
        if efforts := self._config.effort_output_topic:
            name = graph.full_topic_name('effort_output_topic', efforts, self)
            topics[name] = Topic(
                name, Float64MultiArray, CONTROLLER, (RECORDER,), rate='event'
            )
        self._bag = Bag(Path(self._config.folder))
        self._streams = []
        for name, topic in topics.items():
            latched = topic.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            self._streams.append(
                _Stream(
                    topic,
                    self._bag.add_topic(name, topic.type_name, topic.profile),
                    self.create_subscription(
                        topic.message,
                        topic.name,
                        graph.ignore_message,
                        qos.make_profile(qos.STREAM.depth, latched=latched),
                        raw=True,
                    ),
                )
            )
        self._lost: Counter[str] = (
            Counter()
        )  # messages by topic, since the first of each
        self._next_flush = 0.0
        self._diagnostics = DiagnosticsPublisher(
            self, self._statuses, BackgroundThread()
        )
        self._gate = graph.StartupGate(self, self._config)

    def run(self, spinner: Spinner) -> None:
        """Record until asked to stop and nothing comes any more."""
        os.nice(NICENESS)  # of this thread; those that take in messages keep theirs
        while not spinner.stop:
            self._gate.poll()
            self._drain()
            self._diagnostics.poll()
            time.sleep(POLL_PERIOD)
        give_up = time.monotonic() + DRAIN_TIMEOUT
        while time.monotonic() < give_up and self._drain():
            time.sleep(QUIET_TIME)

    def _drain(self) -> bool:
        """Write what has arrived, in the order of publication; return whether anything has."""
        arrived = []
        for stream in self._streams:
            while (taken := graph.take_message(stream.subscription)) is not None:
                data, info = taken
                sent = (
                    info['source_timestamp']
                    or info['received_timestamp']
                    or time.time_ns()
                )
                arrived.append((sent, stream.connection, data))
                number, last = info['publication_sequence_number'], stream.last_number
                stream.last_number = number
                if (
                    stream.topic.rate == 'control'
                    and 0 < last < number - 1
                    and (stream.subscription.get_publisher_count() < 2)
                ):  # it counts its own
                    self._lost[stream.connection.topic] += number - last - 1
        for sent, connection, data in sorted(arrived, key=itemgetter(0)):
            self._bag.write(connection, sent, data)
        if time.monotonic() >= self._next_flush:
            self._bag.flush()
            self._next_flush = time.monotonic() + FLUSH_PERIOD
        return bool(arrived)

    def _meet_publishers(self) -> None:
        """Ask for no more than is given where one of a topic's publishers gives less."""
        for stream in self._streams:
            name, asked = stream.connection.topic, stream.subscription.qos_profile
            if not all(
                graph.offers_enough(x.qos_profile, asked)
                for x in self.get_publishers_info_by_topic(name)
            ):
                self._drain()
                self.destroy_subscription(stream.subscription)
                stream.subscription = self.create_subscription(
                    stream.topic.message,
                    name,
                    graph.ignore_message,
                    qos.make_profile(asked.depth, reliable=False),
                    raw=True,
                )
                self.get_logger().info(f'{name}: recorded best effort, as published')

    def close(self) -> None:
        """Close the bag, and write the counts of this run, if asked to."""
        self._bag.close()
        counts = {x.topic: self._bag.counts[x.id] for x in self._bag.connections}
        self._config.write_counts({'counts': counts, 'lost': self._lost.total()})

    def _statuses(self) -> list[ComponentStatus]:
        if self._gate.open:  # which looks at the ends that there are now
            self._meet_publishers()
        warning = f'messages lost on {", ".join(self._lost)}' if self._lost else ''
        return [
            ComponentStatus('loop', {'messages': sum(self._bag.counts.values())}),
            ComponentStatus(
                'messages',
                {
                    'dropped': self._lost.total(),
                    **{
                        f'dropped {name}': number for name, number in self._lost.items()
                    },
                },
                warning,
            ),
        ]


def main() -> int:
    """Run the recorder node."""
    return run_node(RecorderNode)


if __name__ == '__main__':
    sys.exit(main())
