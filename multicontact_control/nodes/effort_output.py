"""The command of the controller in the forms that robots take it in."""

from __future__ import annotations

from multicontact_control.nodes import qos
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


class EffortOutput:
    """
    Publishes each command, and its bare efforts too if asked to.

    The bare list is what ros2_control's `forward_command_controller` and
    `joint_group_effort_controller` subscribe to, in the order of the controller's joints.

    Parameters
    ----------
    node
        The node.
    publisher
        Publisher of the command itself.
    topic
        Topic of the bare efforts, e.g. ``/effort_controller/commands``; empty for none.

    """

    def __init__(self, node: Node, publisher: Publisher, topic: str) -> None:
        self._publisher = publisher
        self._bare: Publisher | None = None
        if topic:
            self._bare = node.create_publisher(Float64MultiArray, topic, qos.STREAM)

    def publish(self, command: JointState) -> None:
        """Publish one command."""
        self._publisher.publish(command)
        if self._bare is not None:
            self._bare.publish(Float64MultiArray(data=command.effort))
