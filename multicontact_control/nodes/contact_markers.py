"""Contact forces as arrows for viewers."""

from __future__ import annotations

from geometry_msgs.msg import Point
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.nodes import messages, topics
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

NAMESPACE = 'contact_forces'
RATE, SCALE = 25.0, 0.01  # messages per second, m/N
SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH = 0.008, 0.016, 0.02  # m
SMALLEST_FORCE = 0.2  # N; below it the arrow would be noise
LIFETIME = 0.5  # s; a viewer drops the arrows of a controller that is gone
CONTROLLED = ColorRGBA(r=1.0, g=0.45, b=0.1, a=1.0)
FELT = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)


def contact_arrows(config: ControllerConfig, stamp: int, output: ControlOutput) -> MarkerArray:
    """
    Return the measured contact forces of a sample at a time [ns] as arrows.

    Each points into its surface and ends at the contact's tip, orange where the force is
    controlled and grey where it is only felt.
    """
    arrows = []
    for number, (name, i) in enumerate(zip(config.contact_names, config.leaders)):
        force, pose = float(output.contacts['alpha_meas'][i]), output.pose
        tip = pose.position_world + pose.rotation_world @ config.contacts[name].point_operational
        tail = tip - SCALE * force * output.contacts['normal'][i]
        arrow = Marker(
            ns=f'{NAMESPACE}/{name}', id=number, type=Marker.ARROW,
            action=Marker.ADD if force > SMALLEST_FORCE else Marker.DELETE,
            color=CONTROLLED if output.answer['active'][i] else FELT,
            points=[Point(**dict(zip('xyz', messages.finite_array(end, 3, 'points').tolist())))
                    for end in (tail, tip)],
            lifetime=Duration(seconds=LIFETIME).to_msg())
        arrow.header.frame_id = topics.WORLD_FRAME
        arrow.header.stamp = messages.ns_to_stamp(stamp)
        arrow.pose.orientation.w = 1.0
        arrow.scale.x, arrow.scale.y, arrow.scale.z = SHAFT_DIAMETER, HEAD_DIAMETER, HEAD_LENGTH
        arrows.append(arrow)
    return MarkerArray(markers=arrows)
