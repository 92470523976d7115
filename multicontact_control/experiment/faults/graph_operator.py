"""The user of a graph that faults happen in: presses, slides, and comes back after an accident."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Transform, Twist
from multicontact_control.arrays import Vector
from multicontact_control.experiment.faults.graph_watch import GraphWatch
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.quintic import quintic
import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

RETURN_TIME = 1.0  # s to the middle of the motion, from wherever the arm should be
AMPLITUDE, PERIOD = 0.03, 3.0  # m, s
DIRECTION = np.array([1.0, 0.0, 0.0])


class Operator:
    """
    Commands forces and a slow to-and-fro along x about the first pose it sees.

    Time is that of the samples.

    Parameters
    ----------
    node
        The node that publishes.
    watch
        Where the commanded pose is read back from.
    forces
        Wanted force per contact [N].

    """

    def __init__(self, node: Node, watch: GraphWatch, forces: dict[str, float]) -> None:
        self._watch, self._forces = watch, forces
        self.force_command = create_publisher(node, topics.FORCE_COMMAND)
        self.motion_command = create_publisher(node, topics.MOTION_COMMAND)
        self._home: tuple[Vector, Rotation] | None = None
        self._begin: tuple[int, Vector, Vector] | None = None

    def start(self) -> bool:
        """Command the forces, and the motion from where the arm should be now; True if it is."""
        pose = self._watch.pose
        if pose is None or not all(
                publisher.get_subscription_count() for publisher in (
                    self.force_command, self.motion_command)):
            return False
        p, q = pose.pose.position, pose.pose.orientation
        position = np.array([p.x, p.y, p.z])
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
        if self._home is None:
            self._home = position, turn
        home, home_turn = self._home
        self._begin = (messages.stamp_to_ns(pose.header.stamp), position - home,
                       (turn * home_turn.inv()).as_rotvec())
        self._command(self._forces)
        return True

    def let_go(self) -> None:
        """Want no contact for now."""
        self._command(dict.fromkeys(self._forces, 0.0))

    def _command(self, forces: dict[str, float]) -> None:
        self.force_command.publish(messages.joint_state_message(
            0, list(forces), effort=list(forces.values())))

    def draft(self, topic: str) -> tuple[Publisher, Any]:
        """Return the publisher and a message of ``forces`` (none yet) or ``motion`` (to here)."""
        if topic == 'forces':
            return self.force_command, JointState(name=list(self._forces))
        transform = Transform()
        if self._watch.pose is not None:
            pose = self._watch.pose.pose
            for axis in 'xyz':
                setattr(transform.translation, axis, getattr(pose.position, axis))
            transform.rotation = pose.orientation
        return self.motion_command, MultiDOFJointTrajectoryPoint(
            transforms=[transform], velocities=[Twist()], accelerations=[Twist()])

    def stop(self) -> None:
        """Command no more."""
        self._begin = None

    def poll(self) -> None:
        """Command the motion of this moment."""
        pose = self._watch.pose
        if self._begin is None or self._home is None or pose is None:
            return
        begin, offset, turn_offset = self._begin
        elapsed = (messages.stamp_to_ns(pose.header.stamp) - begin) * 1e-9
        s, ds, dds = quintic(elapsed, RETURN_TIME)
        back, dback, ddback = 1.0 - s, -ds, -dds
        w = 2.0 * math.pi / PERIOD
        sine, cosine = AMPLITUDE * math.sin(w * elapsed), AMPLITUDE * w * math.cos(w * elapsed)
        x = s * sine
        v = s * cosine - dback * sine
        a = -s * w * w * sine - 2.0 * dback * cosine - ddback * sine
        home, home_turn = self._home
        self.motion_command.publish(messages.motion_message(
            home + back * offset + x * DIRECTION,
            (Rotation.from_rotvec(back * turn_offset) * home_turn).as_quat(),
            np.concatenate([dback * offset + v * DIRECTION, dback * turn_offset]),
            np.concatenate([ddback * offset + a * DIRECTION, ddback * turn_offset])))
