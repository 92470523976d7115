"""Writing a rosbag2 folder: one MCAP file of serialised messages, and its metadata.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError
from multicontact_control.errors import RunError
from multicontact_control.nodes.runtime import prepare_environment
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

INFINITE = QosTime(9223372036, 854775807)


class Bag:
    """
    One recording, in a folder to create; RunError if it exists, or cannot be written to.

    `types` are the message types of ROS 2 Jazzy, and those of the topics.
    """

    def __init__(self, folder: Path) -> None:
        self.types = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except WriterError:
            raise RunError(f'{folder}: expected a folder that does not exist yet') from None
        except OSError as error:
            raise RunError(f'{folder}: {error.strerror}') from None

    def add_topic(self, name: str, type_name: str, profile: QoSProfile) -> None:
        """Announce a topic; RunError if the definition of its type is not known."""
        if type_name not in self.types.fielddefs:
            self._learn_package(type_name)
        self._connections[name] = self._writer.add_connection(
            name, type_name, typestore=self.types, offered_qos_profiles=[_described(profile)])

    def _learn_package(self, type_name: str) -> None:
        """Add the types of an installed package that is no part of ROS 2 itself."""
        prepare_environment()
        package = type_name.split('/')[0]
        try:
            files = Path(get_package_share_directory(package), 'msg').glob('*.msg')
        except (PackageNotFoundError, ValueError):
            raise RunError(f'{type_name}: package {package} is not installed') from None
        types: dict[str, Any] = {}
        for path in files:
            types |= get_types_from_msg(
                path.read_text(encoding='utf-8'), f'{package}/msg/{path.stem}')
        if type_name not in types:
            raise RunError(f'{type_name}: expected one of the types of {package}, found none')
        self.types.register(types)

    def write(self, topic: str, data: bytes, time: int) -> None:
        """Write a message as CDR with its encapsulation header; `time` in ns since the epoch."""
        self._writer.write(self._connections[topic], time, data)

    def flush(self) -> None:
        """Hand all messages to the operating system: a process that is killed then loses none."""
        storage: Any = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()

    def counts(self) -> dict[str, int]:
        """Return the number of messages by topic."""
        return {name: self._writer.counts[x.id] for name, x in self._connections.items()}

    def close(self) -> None:
        """Complete the file and write metadata.yaml; calling it again does nothing."""
        if self._writer.storage is not None:
            self._writer.close()


def _described(profile: QoSProfile) -> Qos:
    return Qos(
        QosHistory(profile.history), profile.depth, QosReliability(profile.reliability),
        QosDurability(profile.durability), _time(profile.deadline), _time(profile.lifespan),
        QosLiveliness(profile.liveliness), _time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions)


def _time(duration: Duration) -> QosTime:
    """Return a duration; rosbag2 writes none at all as the longest there is."""
    return QosTime(*divmod(duration.nanoseconds, 10 ** 9)) if duration.nanoseconds else INFINITE
