"""
The recorder as a ROS 2 node: every message of the graph into a bag, as it came, and /tf.

See `raw_recording` for how it keeps out of the way of the nodes that control.
"""

from __future__ import annotations

from pathlib import Path
import sys
import time

from multicontact_control.config import parameter, Real
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.nodes import qos
from multicontact_control.nodes.bag_writer import BagWriter, CHUNK_SIZE
from multicontact_control.nodes.diagnostics import Diagnostics, input_status, Status
from multicontact_control.nodes.graph_node import (
    full_topic_name,
    StartupConfig,
    StartupGate,
)
from multicontact_control.nodes.message_definitions import message_class
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.raw_recording import RawRecording
from multicontact_control.nodes.runtime import run_node, Spinner, yield_to_others
from multicontact_control.nodes.tf_recording import TfRecording
from multicontact_control.nodes.topics import (
    batched_by,
    batches_of,
    JOINT_STATES,
    RECORDER,
    ROBOT_DESCRIPTION,
    Topic,
    TOPICS,
    USER,
)
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

STALE_AGE = 1.0  # s
NICENESS = 10  # whoever controls goes first; two seconds of messages can wait


class RecorderConfig(StartupConfig):
    """What to record, and where to."""

    folder: str = parameter(..., 'Folder of the bag, to be created.')
    topics: tuple[str, ...] = parameter((), 'Topics to record; empty for all of the graph.')
    extra_topics: tuple[str, ...] = parameter(
        (), 'Topics of others to record as well, each as `NAME TYPE`, e.g. '
        '`/effort_controller/commands std_msgs/msg/Float64MultiArray`.')
    chunk_size: int = parameter(
        CHUNK_SIZE, 'Bytes of messages that are compressed together.', unit='B', ge=1024)
    poll_period: Real = parameter(
        0.02, 'Time between two looks for messages.', unit='s', gt=0.0, le=1.0)
    quiet_time: Real = parameter(
        0.2, 'Time without a message after which a recorder that is to stop does.', unit='s',
        ge=0.0)
    tf_rate: Real = parameter(
        50.0, 'Link poses per second for /tf, worked out from joint states and robot '
        'description; 0 for none.', unit='Hz', ge=0.0)
    drain_timeout: Real = parameter(
        3.0, 'Longest wait for such a time.', unit='s', ge=0.0)


class RecorderNode(Node):
    """Writes raw messages to a bag until asked to stop, then what still comes, then closes it."""

    def __init__(self) -> None:
        # Without an executor nobody would answer the parameter services.
        super().__init__(RECORDER, start_parameter_services=False)
        self._cpu_at_start = time.process_time()
        config: RecorderConfig
        config, = load_parameters(self, RecorderConfig)
        self._config = config
        chosen = self._chosen_topics()
        self._writer = BagWriter(Path(config.folder), chunk_size=config.chunk_size)
        try:
            self._subscribe(config, chosen)
        except Exception:
            self._writer.discard()
            raise

    def _subscribe(self, config: RecorderConfig, chosen: list[Topic]) -> None:
        self._recording = RawRecording(self, self._writer)
        batching = [name for name in config.startup_peers if name != RECORDER] if (
            config.recording_batches) else []
        batched: set[Topic] = set().union(*map(batched_by, batching))
        streams = {topic: self._recording.add(
            topic.name, topic.message, topic.type_name, offered=topic.profile,
            requested=None if topic in batched else _recording_profile(topic),
            judged=topic.rate == 'control')
            for topic in chosen}
        if config.tf_rate > 0.0 and {JOINT_STATES, ROBOT_DESCRIPTION} <= set(chosen):
            tf = TfRecording(self._writer, config.tf_rate, self.get_logger())
            streams[JOINT_STATES].on_message = tf.on_joint_states
            streams[ROBOT_DESCRIPTION].on_message = tf.on_description
        self._reported = (time.monotonic(), 0)
        self._diagnostics = Diagnostics(self, self._statuses)
        ends = {topic: x.subscription for topic, x in streams.items()
                if x.subscription is not None}
        for topic in map(batches_of, batching):
            ends[topic] = self._recording.add_batches(topic, qos.RECORDING)
        self._gate = StartupGate(self, {}, ends, config)

    def _chosen_topics(self) -> list[Topic]:
        names = [topic.name for topic in TOPICS]
        for name in self._config.topics:
            if name not in names:
                raise ConfigError('topics', f'names among {", ".join(names)}', f"'{name}'")
        chosen = [x for x in TOPICS if not self._config.topics or x.name in self._config.topics]
        return chosen + [
            self._extra_topic(text) for text in self._config.extra_topics]

    def _extra_topic(self, text: str) -> Topic:
        """
        Return a topic of others; nobody waits for it.

        Raises
        ------
        ConfigError
            If it is not a name of its own and an installed type.

        """
        name, _, type_name = text.strip().partition(' ')
        full_topic_name('extra_topics', name, self)
        if not type_name or self.resolve_topic_name(name) in [
                self.resolve_topic_name(topic.name) for topic in TOPICS]:
            raise ConfigError('extra_topics', 'NAME TYPE of topics beside those of the graph',
                              f"'{text}'")
        try:
            message = message_class(type_name.strip())
        except RunError as error:
            raise ConfigError('extra_topics', 'types that are installed', str(error)) from None
        return Topic(name, message, USER, (RECORDER,), qos.STREAM, 'event')

    def run(self, spinner: Spinner) -> None:
        """Record until asked to stop and nothing comes any more."""
        config = self._config
        yield_to_others(NICENESS)
        self._cpu_at_start = time.process_time()
        while not spinner.stop:
            self._gate.poll()
            self._recording.drain()
            self._diagnostics.poll()
            time.sleep(config.poll_period)
        self._recording.drain_until_quiet(
            config.quiet_time, config.drain_timeout, config.poll_period)

    def close(self) -> None:
        """Close the bag, and write the counts of this run, if asked to."""
        self._writer.close()
        streams = self._recording.streams.values()
        self._config.write_counts({
            'messages': self._writer.message_count, 'counts': self._writer.counts(),
            'lost': sum(stream.lost for stream in streams),
            'lost_by_topic': {x.name: x.lost for x in streams if x.lost},
            'before_start': sum(stream.before_start for stream in streams),
            'broken_batches': self._recording.broken,
            'cpu_s': time.process_time() - self._cpu_at_start})

    def _statuses(self) -> list[Status]:
        if self._gate.open:  # which looks at the ends that there are now
            self._recording.meet_publishers()
        now, count = time.monotonic(), self._writer.message_count
        then, before = self._reported
        self._reported = (now, count)
        lost = {x.name: x.lost for x in self._recording.streams.values() if x.lost}
        return [
            Status('loop', {
                'rate_hz': round((count - before) / max(1e-9, now - then), 1),
                'messages': count}),
            Status('messages', {
                'dropped': sum(lost.values()),
                **{f'dropped {name}': number for name, number in lost.items()}},
                warning=f'messages lost on {", ".join(lost)}' if lost else ''),
            # Of what has come and does so no more: no graph has all that can be recorded.
            input_status(self._recording.fresh, STALE_AGE, needed=count > 0)]


def _recording_profile(topic: Topic) -> QoSProfile:
    latched = topic.profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return qos.RECORDING_LATCHED if latched else qos.RECORDING


def main() -> int:
    """Run the recorder node."""
    return run_node(RecorderNode)


if __name__ == '__main__':
    sys.exit(main())
