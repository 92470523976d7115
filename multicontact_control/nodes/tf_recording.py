"""Link poses for viewers, worked out by the recorder from what it records anyway."""

from __future__ import annotations

from multicontact_control.dynamics.link_transforms import LinkTransforms
from multicontact_control.errors import ConfigError
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.tf_message import tf_bytes, TF_TYPE
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

TF_TOPIC = '/tf'
WORLD_FRAME = 'world'


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
        stamp = (int.from_bytes(data[4:8], 'little', signed=True) * messages.NANOSECONDS
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
