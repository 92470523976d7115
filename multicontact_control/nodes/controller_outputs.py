"""What the controller publishes: its command, the state of each tick, and arrows for viewers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from geometry_msgs.msg import Point
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import ACROSS
from multicontact_control.control.controller import ControlOutput
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.controller_config import ControllerNodeConfig
from multicontact_control.nodes.graph_node import create_publisher, full_topic_name
from multicontact_control.nodes.streams import JOINT_FIELDS, Streams
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import ColorRGBA, Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

NAMESPACE = 'contact_forces'
SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH = 0.008, 0.016, 0.02  # m
SMALLEST_FORCE = 0.2  # N; below it the arrow would be noise
LIFETIME = 0.5  # s; a viewer drops the arrows of a controller that is gone
BESIDE = 0.022  # m, between the arrows of a contact
CONTROLLED, FELT, ESTIMATED, DESIRED = (
    ColorRGBA(r=red, g=green, b=blue, a=1.0) for red, green, blue in (
        (1.0, 0.45, 0.1), (0.5, 0.5, 0.5), (0.18, 0.45, 0.75), (0.2, 0.58, 0.36)))
KINDS = (('', FELT), ('/estimated', ESTIMATED), ('/desired', DESIRED))


class Command(NamedTuple):
    """A command as it is sent, and its torques, shape (n,) [N m]."""

    data: bytes
    torque: Vector


class ControllerOutputs:
    """
    What the controller publishes.

    The bare efforts, if asked for, are what ros2_control's `forward_command_controller` and
    `joint_group_effort_controller` subscribe to, in the order of the controller's joints.
    """

    def __init__(
        self, node: Node, streams: Streams, config: ControllerConfig,
        node_config: ControllerNodeConfig,
    ) -> None:
        self._node, self._streams = node, streams
        self._shown = {topic: numbers for topic, (_, numbers) in SHOWN.items()
                       if config.force.stiffness == 'adaptive' or topic not in OF_STIFFNESS}
        streams.advertise(examples(config.robot.joint_names, config.column_names))
        self._markers_publisher = create_publisher(node, topics.CONTACT_MARKERS)
        bare = node_config.effort_output_topic
        self._bare = node.create_publisher(
            Float64MultiArray, full_topic_name('effort_output_topic', bare, node),
            qos.STREAM) if bare else None
        self._markers = ContactMarkers(
            config, rate=node_config.marker_rate, scale=node_config.marker_scale)

    @property
    def publishers(self) -> dict[topics.Topic, Publisher]:
        """Return the publishers that have to find their readers."""
        return {**self._streams.publishers, topics.CONTACT_MARKERS: self._markers_publisher}

    def close(self) -> None:
        """Free the topics that are no streams."""
        for publisher in (self._markers_publisher, self._bare):
            if publisher is not None:
                self._node.destroy_publisher(publisher)

    def command(self, stamp: int, torque: Vector) -> Command:
        """Return a command; raise `MessageError` if a torque is not finite."""
        return Command(self._streams.message(topics.EFFORT_COMMAND, stamp, torque), torque)

    def send(self, command: Command) -> None:
        """Publish a command, and its bare efforts too if asked to."""
        self._streams.pass_on(topics.EFFORT_COMMAND, command.data)
        if self._bare is not None:
            self._bare.publish(Float64MultiArray(data=command.torque))

    def show(self, stamp: int, tick: int, output: ControlOutput) -> None:
        """Publish forces, innovations, poses and markers of a tick with a stamp [ns]."""
        for topic, numbers in self._shown.items():
            self._streams.send(topic, stamp, *numbers(output))
        if self._markers.due(tick):
            self._markers_publisher.publish(self._markers.message(
                stamp, output.pose, (output.alpha_meas, output.alpha_est, output.alpha_des),
                output.active, output.contacts['normal']))


# What is published of a tick: the fields of a message per contact, or none for a pose, and its
# numbers in the order of the message's fields.
Numbers = Callable[[ControlOutput], tuple[Vector, ...]]
SHOWN: dict[topics.Topic, tuple[tuple[str, ...], Numbers]] = {
    topics.MEASURED_FORCES: (('effort',), lambda output: (output.alpha_meas,)),
    topics.ESTIMATED_FORCES: (
        ('velocity', 'effort'), lambda output: (output.alpha_rate_est, output.alpha_est)),
    topics.DESIRED_FORCES: (('effort',), lambda output: (output.alpha_des,)),
    topics.INNOVATION: (JOINT_FIELDS, lambda output: (
        output.variance_used, output.prior_variance, output.innovation)),
    topics.STIFFNESS: (JOINT_FIELDS, lambda output: (
        output.contacts['stiffness_est'], output.contacts['stiffness_std'],
        output.contacts['stiffness'])),
    topics.STABILITY_MARGIN: (('position', 'effort'), lambda output: (
        output.contacts['ratio_bound'], output.contacts['margin'])),
    topics.POSE: ((), lambda output: (_seven(output.pose),)),
    topics.POSE_DESIRED: ((), lambda output: (_seven(output.pose_des),))}
OF_STIFFNESS = (topics.STIFFNESS, topics.STABILITY_MARGIN)


def _seven(pose: Pose) -> Vector:
    """Return the numbers of a pose message: position and quaternion, shape (7,)."""
    return np.concatenate((pose.position_world, pose.quaternion_xyzw))


def examples(joints: Sequence[str], contacts: Sequence[str]) -> dict[topics.Topic, Any]:
    """Return a message of each topic that the controller publishes at the control rate."""
    build: Any = messages.joint_state_message
    zeros = np.zeros(len(contacts))
    pose = messages.pose_message(0, np.zeros(3), np.zeros(4), topics.WORLD_FRAME)
    return {
        topics.EFFORT_COMMAND: build(0, joints, effort=np.zeros(len(joints))),
        **{topic: build(0, contacts, **dict.fromkeys(fields, zeros)) if fields else pose
           for topic, (fields, _) in SHOWN.items()}}


class ContactMarkers:
    """
    Turns contact forces into arrows, three per contact, a few times a second.

    That of the measured force ends at the contact's tip, or at the centre of pressure of an edge
    or plane; those of the estimated and the desired one stand beside it. All point into the
    surface. The measured one is orange where the force is controlled and grey where it is only
    felt. There are `rate` messages a second [Hz], with `scale` as length per force [m/N].
    """

    def __init__(self, config: ControllerConfig, *, rate: float, scale: float) -> None:
        contacts = [config.contacts[name] for name in config.contact_names]
        self._names, self._columns = config.contact_names, config.columns
        self._leaders = np.array(config.leaders)
        self._points_operational = np.array([contact.point_operational for contact in contacts])
        self._every = max(1, round(config.rate / rate)) if rate > 0.0 else 0
        self._scale = scale
        self._arrows = [_arrow(f'{NAMESPACE}/{name}{kind}', number, colour)
                        for kind, colour in KINDS for number, name in enumerate(self._names)]

    def due(self, tick: int) -> bool:
        """Return whether the sample `tick` is one to show."""
        return self._every > 0 and tick % self._every == 0

    def message(
        self, stamp: int, pose: Pose, forces: Sequence[Vector], active: Any,
        normals_world: Matrix,
    ) -> MarkerArray:
        """
        Return the arrows of one sample; the next call changes them.

        Parameters
        ----------
        stamp, pose
            Time of the sample [ns], and pose of the operational frame.
        forces
            Measured, estimated and desired, each of shape (r,) [N].
        active, normals_world
            Which of them are controlled, shape (r,), and their normals, shape (r, 3).

        """
        normals = normals_world[self._leaders]
        feet = pose.position_world + (self._points_operational + self._centres(
            forces[0], pose, normals)) @ pose.rotation_world.T
        alpha = np.array(forces)[:, self._leaders, None]
        # Beside each other in the surface: up, or along world -y where it is about level.
        level = np.abs(normals[:, 2:]) >= 0.8
        axes = np.where(level, (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
        along = axes - normals * np.sum(normals * axes, axis=1, keepdims=True)
        beside = along / np.linalg.norm(along, axis=1, keepdims=True)
        tips = feet + np.arange(len(forces))[:, None, None] * BESIDE * beside
        tails = tips - self._scale * alpha * normals
        messages.finite(np.ravel((tips, tails)), 'points')
        shown = (alpha > SMALLEST_FORCE).ravel().tolist()
        time = messages.ns_to_stamp(stamp)
        for arrow, tail, tip, is_shown in zip(
                self._arrows, tails.reshape(-1, 3).tolist(), tips.reshape(-1, 3).tolist(), shown):
            arrow.header.stamp = time
            arrow.action = Marker.ADD if is_shown else Marker.DELETE
            for point, values in zip(arrow.points, (tail, tip)):
                point.x, point.y, point.z = values
        for arrow, leader in zip(self._arrows, self._leaders):
            arrow.color = CONTROLLED if active[leader] else FELT
        return MarkerArray(markers=self._arrows)

    def _centres(self, alpha: Vector, pose: Pose, normals: Matrix) -> Matrix:
        """Return the centres of pressure from those of the contacts, operational axes [m]."""
        centres = np.zeros((len(self._names), 3))
        for column, value in zip(self._columns, alpha.tolist()):
            pressed = alpha[column.leader]
            if column.half_length == 0.0 or pressed <= SMALLEST_FORCE:
                continue
            contact = self._names.index(column.contact)
            direction = np.array(column.direction_operational)
            if column.kind == ACROSS:
                direction = np.cross(pose.rotation_world.T @ normals[contact], direction)
            centres[contact] += min(max(value / pressed, -1.0), 1.0) * (
                column.half_length * direction)
        return centres


def _arrow(namespace: str, number: int, colour: ColorRGBA) -> Marker:
    """Return an arrow of the controller, without time and place."""
    marker = Marker(ns=namespace, id=number, type=Marker.ARROW, color=colour,
                    points=[Point(), Point()], lifetime=Duration(seconds=LIFETIME).to_msg())
    marker.header.frame_id = topics.WORLD_FRAME
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH
    return marker
