"""Contact forces as arrows for viewers."""

from __future__ import annotations

from geometry_msgs.msg import Point
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.nodes import messages, topics
import numpy as np
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

NAMESPACE = 'contact_forces'
RATE, SCALE = 25.0, 0.01  # messages per second, m/N
SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH = 0.008, 0.016, 0.02  # m
SMALLEST_FORCE = 0.2  # N; below it the arrow would be noise
LIFETIME = 0.5  # s; a viewer drops the arrows of a controller that is gone
BESIDE = 0.022  # m, between the arrows of a contact
CONTROLLED, FELT, ESTIMATED, DESIRED = (
    ColorRGBA(r=red, g=green, b=blue, a=1.0) for red, green, blue in (
        (1.0, 0.45, 0.1), (0.5, 0.5, 0.5), (0.18, 0.45, 0.75), (0.2, 0.58, 0.36)))
KINDS = (('', FELT), ('/estimated', ESTIMATED), ('/desired', DESIRED))


class ContactMarkers:
    """
    Turns contact forces into arrows into the surface, three per contact.

    That of the measured force ends at the contact's tip, orange where the force is controlled and
    grey where it is only felt; those of the estimated and the desired one stand beside it.
    """

    def __init__(self, config: ControllerConfig) -> None:
        self._leaders = np.array(config.leaders)
        self._points_operational = np.array(
            [config.contacts[name].point_operational for name in config.contact_names])
        self._every = max(1, round(config.rate / RATE))
        self._arrows = [_arrow(f'{NAMESPACE}/{name}{kind}', number, colour)
                        for kind, colour in KINDS
                        for number, name in enumerate(config.contact_names)]

    def due(self, tick: int) -> bool:
        """Return whether the sample `tick` is one to show."""
        return tick % self._every == 0

    def message(self, stamp: int, output: ControlOutput) -> MarkerArray:
        """Return the arrows of a sample at a time [ns]; the next call changes them."""
        normals, pose = output.contacts['normal'][self._leaders], output.pose
        feet = pose.position_world + self._points_operational @ pose.rotation_world.T
        answer = output.answer
        forces = output.contacts['alpha_meas'], answer['alpha_est'], answer['alpha_des']
        alpha = np.array(forces)[:, self._leaders, None]
        # Beside each other in the surface: up, or along world -y where it is about level.
        axes = np.where(np.abs(normals[:, 2:]) >= 0.8, (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
        along = axes - normals * np.sum(normals * axes, axis=1, keepdims=True)
        beside = along / np.linalg.norm(along, axis=1, keepdims=True)
        tips = feet + np.arange(len(forces))[:, None, None] * BESIDE * beside
        tails = tips - SCALE * alpha * normals
        ends = messages.finite_array(
            np.ravel(np.stack((tails, tips), axis=-2)), 6 * len(self._arrows), 'points')
        time = messages.ns_to_stamp(stamp)
        for arrow, points, force in zip(
                self._arrows, ends.reshape(-1, 2, 3).tolist(), alpha.ravel().tolist()):
            arrow.header.stamp = time
            arrow.action = Marker.ADD if force > SMALLEST_FORCE else Marker.DELETE
            for point, values in zip(arrow.points, points):
                point.x, point.y, point.z = values
        for arrow, active in zip(self._arrows, answer['active'][self._leaders]):
            arrow.color = CONTROLLED if active else FELT
        return MarkerArray(markers=self._arrows)


def _arrow(namespace: str, number: int, colour: ColorRGBA) -> Marker:
    marker = Marker(ns=namespace, id=number, type=Marker.ARROW, color=colour,
                    points=[Point(), Point()], lifetime=Duration(seconds=LIFETIME).to_msg())
    marker.header.frame_id = topics.WORLD_FRAME
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH
    return marker
