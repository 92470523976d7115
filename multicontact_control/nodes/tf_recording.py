"""
Link poses for viewers, worked out by the recorder from what it records anyway.

They are of a type that need not be installed: a list of geometry_msgs/TransformStamped, which is
simple enough to be laid out here.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

from multicontact_control.dynamics.link_transforms import LinkTransform, LinkTransforms
from multicontact_control.errors import ConfigError
from multicontact_control.nodes import qos
from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.loop_statistics import NANOSECONDS
from multicontact_control.nodes.message_definitions import TF_TYPE
from multicontact_control.nodes.recording_batch import LITTLE_ENDIAN
from multicontact_control.nodes.topics import WORLD_FRAME
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

TF_TOPIC = '/tf'


class TfRecording:
    """
    Adds /tf to a bag from its joint states and its robot description.

    Nobody publishes it: the nodes that control are spared the work, and the type need not be
    installed. Few joint states are decoded, so this costs the recorder next to nothing.

    Parameters
    ----------
    writer
        The bag.
    rate
        Transforms per second, in the time of the samples [Hz].
    logger
        Told of a description that cannot be used.

    """

    def __init__(self, writer: BagWriter, rate: float, logger: RcutilsLogger) -> None:
        self._writer = writer
        self._period = round(1e9 / rate)
        self._logger = logger
        self._links: LinkTransforms | None = None
        self._last = -self._period
        self._sequence = 0
        writer.add_topic(TF_TOPIC, TF_TYPE, qos.STREAM)

    def on_description(self, data: bytes, _log_time: int, _publish_time: int) -> None:
        """Take in a robot description."""
        try:
            self._links = LinkTransforms(
                deserialize_message(data, String).data, world_frame=WORLD_FRAME)
        except ConfigError as error:
            self._logger.error(f'no /tf: {error}')

    def on_joint_states(self, data: bytes, log_time: int, publish_time: int) -> None:
        """Write the poses of a sample whose turn it is."""
        if self._links is None:
            return
        # The stamp stands first in the message: no need to decode what is not used.
        stamp = (int.from_bytes(data[4:8], 'little', signed=True) * NANOSECONDS
                 + int.from_bytes(data[8:12], 'little'))
        if 0 <= stamp - self._last < self._period:
            return
        self._last = stamp
        joints = deserialize_message(data, JointState)
        if len(joints.position) != len(joints.name):
            return
        self._sequence += 1
        transforms = self._links.at(dict(zip(joints.name, joints.position)))
        self._writer.write(
            TF_TOPIC, tf_bytes(stamp, transforms), log_time, publish_time, self._sequence)


def tf_bytes(stamp: int, transforms: Sequence[LinkTransform]) -> bytes:
    """
    Return a TFMessage as CDR, with its encapsulation header.

    Parameters
    ----------
    stamp
        Time of all transforms [ns].
    transforms
        The poses.

    """
    # Alignment counts from the end of the encapsulation header.
    body = bytearray(struct.pack('<I', len(transforms)))
    for transform in transforms:
        _align(body, 4)
        body += struct.pack('<iI', *divmod(stamp, NANOSECONDS))
        _add_string(body, transform.parent)
        _add_string(body, transform.child)
        _align(body, 8)
        body += struct.pack('<7d', *transform.translation, *transform.quaternion_xyzw)
    return LITTLE_ENDIAN + bytes(body)


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _add_string(body: bytearray, text: str) -> None:
    _align(body, 4)
    data = text.encode() + b'\0'
    body += struct.pack('<I', len(data)) + data
