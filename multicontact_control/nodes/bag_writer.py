"""
Writing a rosbag2 folder: one MCAP file and its metadata.yaml.

The messages are the bytes that came over the wire. Chunks are small, so that a recorder that is
killed loses little: `mcap.reader.NonSeekingReader` recovers everything up to the last whole chunk.
"""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.nodes.message_definitions import message_hash, message_text
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
import yaml

METADATA_VERSION = 9
CHUNK_SIZE = 128 * 1024
INFINITE = {'sec': 9223372036, 'nsec': 854775807}


@dataclass
class _Channel:
    identifier: int
    name: str
    type_name: str
    qos: dict[str, Any]
    count: int = 0


class BagWriter:
    """
    One recording.

    Parameters
    ----------
    folder
        Folder to create; it must not hold a recording already.
    chunk_size
        Bytes of messages that are compressed together.
    ros_distro
        Name of the ROS distribution for the metadata.

    Attributes
    ----------
    message_count
        Messages written so far.

    Raises
    ------
    RunError
        If the folder cannot be written to or already holds a recording.

    """

    def __init__(
        self, folder: Path, *, chunk_size: int = CHUNK_SIZE, ros_distro: str = 'jazzy',
    ) -> None:
        self._folder = folder
        self._distro = ros_distro
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._first = self._last = 0
        self.message_count = 0
        self._file_name = f'{folder.resolve().name}_0.mcap'
        path = folder / self._file_name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._stream = path.open('xb')
        except FileExistsError:
            raise RunError(f'{path}: already recorded') from None
        except OSError as error:
            raise RunError(f'{path}: {error.strerror}') from None
        self._writer = Writer(
            self._stream, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        self._writer.start(profile='ros2', library='multicontact_control')
        self._closed = False

    def __enter__(self) -> BagWriter:
        """Return the writer itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Close the recording, whatever happened."""
        self.close()

    def add_topic(self, name: str, type_name: str, profile: QoSProfile) -> None:
        """
        Announce a topic.

        Parameters
        ----------
        name
            Full name, with its leading slash.
        type_name
            For example ``sensor_msgs/msg/JointState``.
        profile
            Quality of service it is published with.

        Raises
        ------
        ConfigError
            If it is in the bag already.
        RunError
            If the type is not installed.

        """
        if name in self._channels:
            raise ConfigError('topics', 'each once in a bag', f'{name} twice')
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name, 'ros2msg', message_text(type_name).encode())
        described = describe_qos(profile)
        identifier = self._writer.register_channel(
            name, 'cdr', self._schemas[type_name],
            {'offered_qos_profiles': yaml.safe_dump([described], sort_keys=False)})
        self._channels[name] = _Channel(identifier, name, type_name, described)

    def write(
        self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int = 0,
    ) -> None:
        """
        Write one message.

        Parameters
        ----------
        topic
            A name given to `add_topic`.
        data
            The message as CDR, with its encapsulation header.
        log_time, publish_time
            When it was received and sent [ns since the epoch].
        sequence
            Its number in the stream of its publisher, 0 if unknown.

        """
        channel = self._channels[topic]
        self._writer.add_message(channel.identifier, log_time, data, publish_time, sequence)
        channel.count += 1
        self._first = min(self._first, log_time) if self.message_count else log_time
        self._last = max(self._last, log_time)
        self.message_count += 1

    def flush(self) -> None:
        """Hand the chunks that are complete to the operating system."""
        self._stream.flush()

    def counts(self) -> dict[str, int]:
        """Return the number of messages by topic."""
        return {channel.name: channel.count for channel in self._channels.values()}

    def close(self) -> None:
        """Complete the file and write metadata.yaml; calling it again does nothing."""
        if self._closed:
            return
        self._closed = True
        text = yaml.safe_dump(self.metadata(), sort_keys=False)
        self._writer.add_metadata('rosbag2', {'serialized_metadata': text})
        self._writer.finish()
        self._stream.close()
        temporary = self._folder / f'.metadata.yaml.{os.getpid()}'
        temporary.write_text(text, encoding='utf-8')
        os.replace(temporary, self._folder / 'metadata.yaml')

    def discard(self) -> None:
        """Remove what has been written: a recording that did not begin blocks no other."""
        self._closed = True
        self._stream.close()
        (self._folder / self._file_name).unlink()

    def metadata(self) -> dict[str, Any]:
        """Return the content of metadata.yaml."""
        start = {'nanoseconds_since_epoch': self._first}
        duration = {'nanoseconds': self._last - self._first if self.message_count else 0}
        return {'rosbag2_bagfile_information': {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            'duration': duration,
            'starting_time': start,
            'message_count': self.message_count,
            'topics_with_message_count': [
                _topic_metadata(channel) for channel in self._channels.values()],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self._file_name],
            'files': [{
                'path': self._file_name, 'starting_time': dict(start),
                'duration': dict(duration), 'message_count': self.message_count}],
            'custom_data': None,
            'ros_distro': self._distro}}


def _topic_metadata(channel: _Channel) -> dict[str, Any]:
    return {
        'topic_metadata': {
            'name': channel.name,
            'type': channel.type_name,
            'serialization_format': 'cdr',
            'offered_qos_profiles': [dict(channel.qos)],
            'type_description_hash': message_hash(channel.type_name)},
        'message_count': channel.count}


def describe_qos(profile: QoSProfile) -> dict[str, Any]:
    """Return a quality of service as rosbag2's metadata writes it."""
    return {
        'history': profile.history.name.lower(),
        'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': _described_duration(profile.deadline),
        'lifespan': _described_duration(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': _described_duration(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': bool(profile.avoid_ros_namespace_conventions)}


def _described_duration(duration: Duration) -> dict[str, int]:
    """Return a duration; none at all is written as the longest there is."""
    sec, nsec = divmod(duration.nanoseconds, 1_000_000_000)
    return {'sec': sec, 'nsec': nsec} if duration.nanoseconds else dict(INFINITE)
