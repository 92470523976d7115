"""Writing a rosbag2 folder: one MCAP file of serialised messages, and its metadata.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from multicontact_control.errors import RunError
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
from rosbags.typesys import get_typestore, Stores

INFINITE = QosTime(9223372036, 854775807)  # as rosbag2 writes that there is no limit


class Bag:
    """One recording, in a folder to create; RunError if it exists, or cannot be written to."""

    def __init__(self, folder: Path) -> None:
        self._types = get_typestore(Stores.ROS2_JAZZY)
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
        if type_name not in self._types.fielddefs:
            raise RunError(f'{type_name}: expected a message type of ROS 2 Jazzy')
        offered = Qos(
            QosHistory(profile.history), profile.depth, QosReliability(profile.reliability),
            QosDurability(profile.durability), INFINITE, INFINITE,
            QosLiveliness(profile.liveliness), INFINITE, False)
        self._connections[name] = self._writer.add_connection(
            name, type_name, typestore=self._types, offered_qos_profiles=[offered])

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
