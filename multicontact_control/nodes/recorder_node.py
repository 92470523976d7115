"""
The recorder as a ROS 2 node: every message of the graph into a bag, as it came.

The subscriptions are not left to an executor but emptied 200 times a second. The middleware stores
what arrives meanwhile, with the time of its arrival; so the recorder takes next to no time from
the nodes it shares the machine with, and learns the number of each message in its publisher's
stream, which tells how many are missing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
import sys
import time
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from multicontact_control.config import parameter, Real
from multicontact_control.errors import ConfigError
from multicontact_control.nodes import qos
from multicontact_control.nodes.bag_writer import BagWriter, CHUNK_SIZE
from multicontact_control.nodes.diagnostics import Diagnostics, input_status, Status
from multicontact_control.nodes.graph_node import StartupConfig, StartupGate
from multicontact_control.nodes.loop_watch import Freshness
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner, yield_to_others
from multicontact_control.nodes.timing import write_json
from multicontact_control.nodes.topics import RECORDER, Topic, TOPICS

FLUSH_PERIOD = 0.5
STALE_AGE = 1.0  # s
NICENESS = 10  # whoever controls goes first; two seconds of messages can wait


class RecorderConfig(StartupConfig):
    """What to record, and where to."""

    folder: str = parameter(..., 'Folder of the bag, to be created.')
    topics: tuple[str, ...] = parameter((), 'Topics to record; empty for all of the graph.')
    chunk_size: int = parameter(
        CHUNK_SIZE, 'Bytes of messages that are compressed together.', unit='B', ge=1024)
    poll_period: Real = parameter(
        0.005, 'Time between two looks for messages.', unit='s', gt=0.0, le=1.0)
    quiet_time: Real = parameter(
        0.2, 'Time without a message after which a recorder that is to stop does.', unit='s',
        ge=0.0)
    drain_timeout: Real = parameter(
        3.0, 'Longest wait for such a time.', unit='s', ge=0.0)


@dataclass
class _Stream:
    """One topic being recorded."""

    name: str
    topic: Topic
    subscription: Subscription
    last_sequence: int = 0
    lost: int = 0
    before_start: int = 0

    def take(self) -> tuple[bytes, dict[str, Any]] | None:
        """Return the next message and what is known of it."""
        handle = self.subscription.handle
        with handle:
            taken: tuple[bytes, dict[str, Any]] | None = handle.take_message(
                self.topic.message, True)
        return taken

    def count(self, sequence: int | None) -> None:
        """
        Take note of a message's number in its stream; what is skipped was lost.

        A number that falls back is a new publisher's. What was sent before the first number was
        not for the recorder, which may have come late. Topics that users publish to are not
        judged: the numbers of several publishers cannot be told apart.
        """
        if sequence is None or self.topic.rate != 'control':
            return
        if self.last_sequence == 0:
            self.before_start = sequence - 1
        elif sequence > self.last_sequence:
            self.lost += sequence - self.last_sequence - 1
        self.last_sequence = sequence


@dataclass(order=True)
class _Message:
    log_time: int
    stream: _Stream = field(compare=False)
    data: bytes = field(compare=False)
    publish_time: int = field(compare=False)
    sequence: int = field(compare=False)


class RecorderNode(Node):
    """Writes raw messages to a bag until asked to stop, then what still comes, then closes it."""

    def __init__(self) -> None:
        # Without an executor nobody would answer the parameter services.
        super().__init__(RECORDER, start_parameter_services=False)
        config: RecorderConfig
        config, = load_parameters(self, RecorderConfig)
        self._config = config
        chosen = self._chosen_topics()
        self._writer = BagWriter(Path(config.folder), chunk_size=config.chunk_size)
        self._streams = []
        for topic in chosen:
            name = self.resolve_topic_name(topic.name)
            self._writer.add_topic(name, topic.type_name, topic.profile)
            # The callback is never called, since no executor has the node.
            subscription = self.create_subscription(
                topic.message, topic.name, self._ignore, qos.RECORDING, raw=True)
            self._streams.append(_Stream(name, topic, subscription))
        self._fresh = Freshness()
        self._fresh.expect(*(x.name for x in self._streams if x.topic.rate == 'control'))
        self._reported = (time.monotonic(), 0)
        self._diagnostics = Diagnostics(self, self._statuses)
        self._gate = StartupGate(
            self, {}, {x.topic: x.subscription for x in self._streams}, config)

    def _ignore(self, _message: bytes) -> None:
        pass

    def _chosen_topics(self) -> list[Topic]:
        names = [topic.name for topic in TOPICS]
        for name in self._config.topics:
            if name not in names:
                raise ConfigError('topics', f'names among {", ".join(names)}', f"'{name}'")
        return [x for x in TOPICS if not self._config.topics or x.name in self._config.topics]

    def run(self, spinner: Spinner) -> None:
        """Record until asked to stop and nothing comes any more."""
        yield_to_others(NICENESS)
        next_flush = time.monotonic()
        while not spinner.stop:
            self._gate.poll()
            self._drain()
            self._diagnostics.poll()
            if time.monotonic() >= next_flush:
                self._writer.flush()
                next_flush = time.monotonic() + FLUSH_PERIOD
            time.sleep(self._config.poll_period)
        give_up = time.monotonic() + self._config.drain_timeout
        quiet_since = time.monotonic()
        while time.monotonic() < give_up:
            if self._drain():
                quiet_since = time.monotonic()
            if time.monotonic() - quiet_since >= self._config.quiet_time:
                break
            time.sleep(self._config.poll_period)

    def close(self) -> None:
        """Close the bag, and write the counts of this run, if asked to."""
        self._writer.close()
        path = self._config.timing_path
        if path is not None:
            write_json(path, {
                'messages': self._writer.message_count, 'counts': self._writer.counts(),
                'lost': sum(stream.lost for stream in self._streams),
                'lost_by_topic': {x.name: x.lost for x in self._streams if x.lost},
                'before_start': sum(stream.before_start for stream in self._streams)})

    def _drain(self) -> int:
        """Write what has arrived, in the order of arrival; return how much that was."""
        messages = []
        for stream in self._streams:
            while (taken := stream.take()) is not None:
                data, info = taken
                sequence = info['publication_sequence_number']
                stream.count(sequence)
                received = info['received_timestamp'] or time.time_ns()
                sent = info['source_timestamp'] or received
                messages.append(_Message(received, stream, data, sent, sequence or 0))
                if stream.topic.rate == 'control':
                    self._fresh.note(stream.name)
        messages.sort()
        for message in messages:
            self._writer.write(
                message.stream.name, message.data, message.log_time, message.publish_time,
                message.sequence & 0xFFFFFFFF)
        return len(messages)

    def _statuses(self) -> list[Status]:
        now, count = time.monotonic(), self._writer.message_count
        then, before = self._reported
        self._reported = (now, count)
        lost = {x.name: x.lost for x in self._streams if x.lost}
        return [
            Status('loop', {
                'rate_hz': round((count - before) / max(1e-9, now - then), 1),
                'messages': count}),
            Status('messages', {
                'dropped': sum(lost.values()),
                **{f'dropped {name}': number for name, number in lost.items()}},
                warning=f'messages lost on {", ".join(lost)}' if lost else ''),
            input_status(self._fresh, STALE_AGE, needed=count > 0)]


def main() -> int:
    """Run the recorder node."""
    return run_node(RecorderNode)


if __name__ == '__main__':
    sys.exit(main())
