"""What the controller publishes of a tick beside its command."""

from __future__ import annotations

from collections.abc import Mapping

from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.contact_markers import ContactMarkers
from rclpy.publisher import Publisher

WORLD_FRAME = 'world'


class StateOutput:
    """
    Publishes forces, innovations, poses and, now and then, markers.

    Parameters
    ----------
    config
        The controller's.
    publishers
        By topic.
    markers
        Makes the markers.

    """

    def __init__(
        self, config: ControllerConfig, publishers: Mapping[topics.Topic, Publisher],
        markers: ContactMarkers,
    ) -> None:
        self._names = config.contact_names
        self._publishers, self._markers = publishers, markers

    def publish(self, stamp: int, tick: int, output: ControlOutput) -> None:
        """
        Publish the state of a tick.

        Parameters
        ----------
        stamp
            Of its sample [ns].
        tick
            Its number.
        output
            What the controller made of it.

        Raises
        ------
        MessageError
            If a number is not finite.

        """
        build, publishers, names = messages.joint_state_message, self._publishers, self._names
        publishers[topics.MEASURED_FORCES].publish(build(stamp, names, effort=output.alpha_meas))
        publishers[topics.ESTIMATED_FORCES].publish(build(
            stamp, names, effort=output.alpha_est, velocity=output.alpha_rate_est))
        publishers[topics.DESIRED_FORCES].publish(build(stamp, names, effort=output.alpha_des))
        publishers[topics.INNOVATION].publish(build(
            stamp, names, position=output.variance_used, velocity=output.prior_variance,
            effort=output.innovation))
        for topic, pose in ((topics.POSE, output.pose), (topics.POSE_DESIRED, output.pose_des)):
            publishers[topic].publish(messages.pose_message(
                stamp, pose.position_world, pose.quaternion_xyzw, WORLD_FRAME))
        if self._markers.due(tick):
            publishers[topics.CONTACT_MARKERS].publish(self._markers.message(
                stamp, WORLD_FRAME, output.pose, output.alpha_meas, output.active))
