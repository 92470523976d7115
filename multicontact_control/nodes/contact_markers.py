"""Contact forces as arrows, for a viewer."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Point
from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.dynamics.pose import Pose
from multicontact_control.nodes.messages import ns_to_stamp
import numpy as np
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

NAMESPACE = 'contact_forces'
SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH = 0.008, 0.016, 0.02  # m
SMALLEST_FORCE = 0.2  # N; below it the arrow would be noise
LIFETIME = 0.5  # s; a viewer drops the arrows of a controller that is gone
CONTROLLED, FELT = (1.0, 0.45, 0.1), (0.5, 0.5, 0.5)


class ContactMarkers:
    """
    Turns contact forces into arrows, one per contact, a few times a second.

    An arrow ends at the contact's tip and points into the surface. It is orange where the force
    is controlled and grey where it is only felt.

    Parameters
    ----------
    config
        Contacts and control rate.
    rate
        Messages per second [Hz]; 0 for none.
    scale
        Length per force [m/N].

    """

    def __init__(self, config: ControllerConfig, *, rate: float, scale: float) -> None:
        contacts = [config.contacts[name] for name in config.contact_names]
        self._names = config.contact_names
        self._normals_world = np.array([contact.normal_world for contact in contacts])
        self._points_operational = np.array([contact.point_operational for contact in contacts])
        self._every = max(1, round(config.rate / rate)) if rate > 0.0 else 0
        self._scale = scale

    def due(self, tick: int) -> bool:
        """Return whether the sample `tick` is one to show."""
        return self._every > 0 and tick % self._every == 0

    def message(
        self, stamp: int, frame_id: str, pose: Pose, alpha: Vector, active: Any,
    ) -> MarkerArray:
        """
        Return the arrows of one sample.

        Parameters
        ----------
        stamp
            Time of the sample [ns].
        frame_id
            Name of the world frame.
        pose
            Pose of the operational frame.
        alpha, active
            Measured forces [N] and which of them are controlled, shape (r,).

        """
        tips = pose.position_world + self._points_operational @ pose.rotation_world.T
        tails = tips - self._scale * alpha[:, None] * self._normals_world
        markers = []
        for k, name in enumerate(self._names):
            marker = Marker(ns=f'{NAMESPACE}/{name}', id=k, type=Marker.ARROW)
            marker.header.frame_id = frame_id
            marker.header.stamp = ns_to_stamp(stamp)
            marker.pose.orientation.w = 1.0
            marker.action = Marker.ADD if alpha[k] > SMALLEST_FORCE else Marker.DELETE
            marker.points = [_point(tails[k]), _point(tips[k])]
            marker.scale.x, marker.scale.y, marker.scale.z = (
                SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH)
            red, green, blue = CONTROLLED if active[k] else FELT
            marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
            marker.lifetime = Duration(seconds=LIFETIME).to_msg()
            markers.append(marker)
        return MarkerArray(markers=markers)


def _point(position: Vector) -> Point:
    x, y, z = position.tolist()
    return Point(x=x, y=y, z=z)
