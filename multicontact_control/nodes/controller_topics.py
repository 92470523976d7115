"""Topics and services of the controller: what it publishes, and how a user commands it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import Point, PoseStamped, Vector3
from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.errors import MulticontactError
from multicontact_control.loop import ControlLoop
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import create_publisher, full_topic_name
from multicontact_control.nodes.lifecycle import ManagedNode
from multicontact_control.nodes.messages import get_identifier, JOINT_FIELDS
from multicontact_control.nodes.streams import StreamPublisher
from multicontact_control.sensor.push_test import PushTestConfig
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import ColorRGBA, Float64MultiArray, Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

# What is published of a tick: the fields of a message per contact, or none for a pose, and its
# numbers in the order of the message's fields.
Numbers = Callable[[ControlOutput], tuple[Vector, ...]]
SHOWN: dict[topics.Topic, tuple[tuple[str, ...], Numbers]] = {
    topics.MEASURED_FORCES: (
        ('effort',),
        lambda output: (output.contacts['alpha_meas'],),
    ),
    topics.ESTIMATED_FORCES: (
        ('velocity', 'effort'),
        lambda output: (output.answer['alpha_rate_est'], output.answer['alpha_est']),
    ),
    topics.DESIRED_FORCES: (('effort',), lambda output: (output.answer['alpha_des'],)),
    topics.INNOVATION: (
        JOINT_FIELDS,
        lambda output: (
            output.answer['variance_used'],
            output.answer['prior_variance'],
            output.answer['innovation'],
        ),
    ),
    topics.STIFFNESS: (
        JOINT_FIELDS,
        lambda output: (
            output.contacts['stiffness_est'],
            output.contacts['stiffness_std'],
            output.contacts['stiffness'],
        ),
    ),
    topics.STABILITY_MARGIN: (
        ('position', 'effort'),
        lambda output: (output.contacts['ratio_bound'], output.contacts['margin']),
    ),
    topics.POSE: (
        (),
        lambda output: (output.pose.position_world, output.pose.quaternion_xyzw),
    ),
    topics.POSE_DESIRED: (
        (),
        lambda output: (
            output.pose_des.position_world,
            output.pose_des.quaternion_xyzw,
        ),
    ),
}
OF_STIFFNESS = (topics.STIFFNESS, topics.STABILITY_MARGIN)

# Of the arrows for viewers.
MARKER_NAMESPACE = 'contact_forces'
MARKER_RATE, SCALE = 25.0, 0.01  # messages per second, m/N
SIZE = Vector3(
    x=0.008, y=0.016, z=0.02
)  # m: diameters of shaft and head, length of the head
SMALLEST_FORCE = 0.2  # N; below it the arrow would be noise
LIFETIME = 0.5  # s; a viewer drops the arrows of a controller that is gone
CONTROLLED = ColorRGBA(r=1.0, g=0.45, b=0.1, a=1.0)
FELT = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)


class ControllerOutputs:
    """
    Publishes the command, the state of each tick, and arrows for viewers.

    `command` makes the bytes of a command from a stamp [ns] and torques, or raises `MessageError`;
    `publish` sends them, `publish_bare` the efforts for ros2_control, where these are asked for.
    """

    def __init__(self, node: Node, config: ControllerConfig, bare: str) -> None:
        self._config = config
        joints, contacts = config.robot.joint_names, config.column_names
        build = messages.joint_state_message
        commands = StreamPublisher(
            node, topics.EFFORT_COMMAND, build(0, joints, effort=np.zeros(len(joints)))
        )
        self.command, self.publish = commands.encode_message, commands.publish
        self.publish_bare = (
            node.create_publisher(
                Float64MultiArray,
                full_topic_name('effort_output_topic', bare, node),
                qos.STREAM,
            ).publish
            if bare
            else None
        )
        self._shown: list[tuple[StreamPublisher, Numbers]] = []
        for topic, (fields, numbers) in SHOWN.items():
            publisher = StreamPublisher(
                node,
                topic,
                build(0, contacts, **dict.fromkeys(fields, np.zeros(len(contacts))))
                if fields
                else (PoseStamped(header=Header(frame_id=topics.WORLD_FRAME))),
            )
            if config.force.stiffness == 'adaptive' or topic not in OF_STIFFNESS:
                self._shown.append((publisher, numbers))
        self._markers = create_publisher(node, topics.CONTACT_MARKERS)
        self._marker_ticks = max(1, round(config.rate / MARKER_RATE))

    def publish_tick(self, stamp: int, tick: int, output: ControlOutput) -> None:
        """Publish forces, innovations, poses and markers of a tick with a stamp [ns]."""
        for publisher, numbers in self._shown:
            publisher.publish_if_subscribed(stamp, *numbers(output))
        if tick % self._marker_ticks == 0:
            self._markers.publish(build_contact_arrows(self._config, stamp, output))


def build_contact_arrows(
    config: ControllerConfig, stamp: int, output: ControlOutput
) -> MarkerArray:
    """
    Return the measured contact forces of a sample at a time [ns] as arrows.

    Each points into its surface and ends at the contact's tip, orange where the force is
    controlled and grey where it is only felt.
    """
    arrows, header = (
        [],
        Header(frame_id=topics.WORLD_FRAME, stamp=messages.ns_to_stamp(stamp)),
    )
    for number, (name, i) in enumerate(zip(config.contact_names, config.leaders)):
        force, pose = float(output.contacts['alpha_meas'][i]), output.pose
        tip = (
            pose.position_world
            + pose.rotation_world @ config.contacts[name].point_operational
        )
        tail = tip - SCALE * force * output.contacts['normal'][i]
        arrows.append(
            Marker(
                header=header,
                ns=f'{MARKER_NAMESPACE}/{name}',
                id=number,
                type=Marker.ARROW,
                action=Marker.ADD if force > SMALLEST_FORCE else Marker.DELETE,
                color=CONTROLLED if output.answer['active'][i] else FELT,
                points=[
                    Point(
                        **dict(
                            zip('xyz', messages.finite_array(end, 3, 'points').tolist())
                        )
                    )
                    for end in (tail, tip)
                ],
                scale=SIZE,
                lifetime=Duration(seconds=LIFETIME).to_msg(),
            )
        )
    return MarkerArray(markers=arrows)


# The services of the controller's node: class, and content for the reference.
SERVICES = {
    'tare': (
        Trigger,
        'Takes the present reading of the wrist sensor for its bias; refused while '
        'a contact is under force control, or pressed by a reaction.',
    ),
    'hold': (SetBool, 'Holds the present pose and forces, or lets go of them.'),
    'retry': (
        Trigger,
        'Resumes control that waits for an operator (cause `latched`, or '
        'velocities in doubt), and seeks contacts that were given up.',
    ),
    'push_test': (
        Trigger,
        'Begins the push test: log, diagnostics and `~/status` say where to '
        'push the tool.',
    ),
    'cancel_push_test': (
        Trigger,
        'Takes back a push test that is under way, or has ended because '
        'nothing pushed; force control is allowed if it was before.',
    ),
}


def create_command_servers(
    node: ManagedNode,
    loop: ControlLoop,
    answer: Callable[[str, str, Exception | None, str], None],
    push_test: Callable[[], PushTestConfig],
) -> None:
    """
    Hand commands on topics and requests of services to a control loop.

    `answer` is called with the source of each, its identifier, its refusal if it is one, and what
    is not obeyed of one that is accepted; `push_test` returns how the tool is to be pushed.
    """

    def obey(
        source: str, work: Callable[[Any], Any], wish: Any, identifier: str = ''
    ) -> Any:
        refusal, left_out = None, ''
        try:
            outcome = work(wish)
            if source == topics.MOTION_COMMAND.name:
                left_out = outcome
        except MulticontactError as error:
            node.refusals.log_refusal(source, error)
            outcome = refusal = error
        answer(source, identifier, refusal, left_out)
        return outcome

    def serve(
        source: str, work: Callable[[Any], Any], request: Any, response: Any
    ) -> Any:
        outcome = obey(source, work, request)
        response.message = str(outcome)
        response.success = not isinstance(outcome, MulticontactError)
        return response

    def tare(_request: Any) -> str:
        bias = loop.tare().tolist()
        (result,) = node.set_parameters([Parameter('tool.bias_sensor', value=bias)])
        if not result.successful:
            raise MulticontactError(result.reason)
        return 'bias [N, N m]: ' + ', '.join(f'{x:.4g}' for x in bias)

    commands: dict[topics.Topic, Callable[[Any], Any]] = {
        topics.FORCE_COMMAND: lambda message: loop.set_forces(
            *messages.read_force_command(message, loop.config.column_names)
        ),
        topics.MOTION_COMMAND: lambda message: loop.set_motion(
            messages.read_motion(message)
        ),
    }
    for topic, command in commands.items():
        node.create_subscription(
            topic.message,
            topic.name,
            lambda message, source=topic.name, work=command: obey(
                source, work, message, get_identifier(message)
            ),
            qos.EVENT,
        )
    works: dict[str, Callable[[Any], Any]] = {
        'tare': tare,
        'hold': lambda request: loop.hold(request.data),
        'retry': lambda _: loop.retry(),
        'push_test': lambda _: loop.push_test(push_test()),
        'cancel_push_test': lambda _: loop.cancel_push_test(),
    }
    for name, (kind, _) in SERVICES.items():
        node.create_service(kind, f'~/{name}', partial(serve, f'~/{name}', works[name]))
