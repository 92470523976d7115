"""Topics and services of the controller: what it publishes, and how a user commands it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from geometry_msgs.msg import Point, PoseStamped, Vector3
from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, LimitsConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.control.trajectory_checks import check_points, TimedPoses
from multicontact_control.errors import MulticontactError
from multicontact_control.loop import ControlLoop
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.background import Pausing
from multicontact_control.nodes.controller_report import CommandAnswer, ControllerReport
from multicontact_control.nodes.graph import create_publisher, full_topic_name
from multicontact_control.nodes.lifecycle import ManagedNode
from multicontact_control.nodes.messages import get_identifier
from multicontact_control.nodes.streams import StreamPublisher
from multicontact_control.sensor.push_test import PushTestConfig
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from std_msgs.msg import ColorRGBA, Float64MultiArray, Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray


class ContactSeries(NamedTuple):
    """A topic with numbers per force and couple: fields of its message, and of which record."""

    record: str  # attribute of `ControlOutput`: `contacts` or `answer`
    numbers: dict[str, str]  # field of the record by field of the message, in its order


CONTACT_SERIES = {
    topics.ESTIMATED_FORCES: ContactSeries(
        'answer', {'velocity': 'alpha_rate_est', 'effort': 'alpha_est'}
    ),
    topics.DESIRED_FORCES: ContactSeries('answer', {'effort': 'alpha_des'}),
    topics.INNOVATION: ContactSeries(
        'answer',
        {
            'position': 'variance_used',
            'velocity': 'prior_variance',
            'effort': 'innovation',
        },
    ),
}
STIFFNESS_SERIES = {  # only if the stiffness is found on-line
    topics.STIFFNESS: ContactSeries(
        'contacts',
        {
            'position': 'stiffness_est',
            'velocity': 'stiffness_std',
            'effort': 'stiffness',
        },
    ),
    topics.STABILITY_MARGIN: ContactSeries(
        'contacts', {'position': 'ratio_bound', 'effort': 'margin'}
    ),
}

# Of the arrows for viewers.
MARKER_NAMESPACE = 'contact_forces'
ARROW_SCALE = 0.01  # m/N
# m: diameters of shaft and head, length of the head
ARROW_SIZE = Vector3(x=0.008, y=0.016, z=0.02)
SMALLEST_FORCE = 0.2  # N; below it the arrow would be noise
MARKER_LIFETIME = 0.5  # s; a viewer drops the arrows of a controller that is gone
CONTROLLED_COLOUR = ColorRGBA(r=1.0, g=0.45, b=0.1, a=1.0)
MEASURED_COLOUR = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)


class ControllerOutputs:
    """
    Publishes the command, the state of each tick, and arrows for viewers.

    Parameters
    ----------
    node, config
        The node that publishes, and the configuration of its controller.
    bare_topic
        Topic of bare efforts for the forward controllers of ros2_control; empty for none.

    Attributes
    ----------
    encode_command
        Returns the bytes of a command from a stamp [ns] and torques, shape (n,) [N m];
        MessageError if these are not finite.
    publish_command
        Publishes these bytes.

    """

    def __init__(self, node: Node, config: ControllerConfig, bare_topic: str) -> None:
        self._config = config
        joints = config.robot.joint_names
        pattern = messages.joint_state_message(0, joints, effort=np.zeros(len(joints)))
        commands = StreamPublisher(node, topics.EFFORT_COMMAND, pattern)
        self.encode_command = commands.encode_message
        self.publish_command = commands.publish
        self._bare_publisher: Publisher | None = None
        if bare_topic:
            name = full_topic_name('effort_output_topic', bare_topic, node)
            self._bare_publisher = node.create_publisher(
                Float64MultiArray, name, qos.STREAM
            )
        zeros = np.zeros(len(config.column_names))
        pattern = messages.joint_state_message(
            0, config.column_names, position=zeros, effort=zeros
        )
        self._measured_forces = StreamPublisher(node, topics.MEASURED_FORCES, pattern)
        self._series: list[tuple[StreamPublisher, ContactSeries]] = []
        for topic, series in {**CONTACT_SERIES, **STIFFNESS_SERIES}.items():
            pattern = messages.joint_state_message(
                0, config.column_names, **dict.fromkeys(series.numbers, zeros)
            )
            publisher = StreamPublisher(node, topic, pattern)
            if topic in CONTACT_SERIES or config.force.stiffness == 'adaptive':
                self._series.append((publisher, series))
        pose = PoseStamped(header=Header(frame_id=topics.WORLD_FRAME))
        self._pose = StreamPublisher(node, topics.POSE, pose)
        self._pose_desired = StreamPublisher(node, topics.POSE_DESIRED, pose)
        self._markers = create_publisher(node, topics.CONTACT_MARKERS)
        self._marker_ticks = max(1, round(config.rate / topics.MARKER_RATE))

    def publish_bare_efforts(self, torque: Vector) -> None:
        """Publish a torque, shape (n,) [N m], for ros2_control if that is asked for."""
        if self._bare_publisher is not None:
            self._bare_publisher.publish(Float64MultiArray(data=torque))

    def publish_tick(self, stamp: int, tick: int, output: ControlOutput) -> None:
        """
        Publish forces, innovations and poses of a tick, and arrows at `topics.MARKER_RATE`.

        Parameters
        ----------
        stamp, tick
            Time of the sample [ns], and its number, of which the arrows' rate is made.
        output
            The controller's answer to the sample.

        """
        forces = output.contacts['alpha_meas']
        is_measured = np.full_like(forces, output.controls['measured'][0])
        self._measured_forces.publish_if_subscribed(stamp, is_measured, forces)
        for publisher, series in self._series:
            record = getattr(output, series.record)
            columns = [record[field] for field in series.numbers.values()]
            publisher.publish_if_subscribed(stamp, *columns)
        for publisher, pose in (
            (self._pose, output.pose),
            (self._pose_desired, output.pose_des),
        ):
            publisher.publish_if_subscribed(
                stamp, pose.position_world, pose.quaternion_xyzw
            )
        if tick % self._marker_ticks == 0:
            self._markers.publish(build_contact_arrows(self._config, stamp, output))


def build_contact_arrows(
    config: ControllerConfig, stamp: int, output: ControlOutput
) -> MarkerArray:
    """
    Return the measured contact forces of a sample at a time [ns] as arrows in world axes.

    Each points into its surface and ends at the contact's tip, orange where the force is
    controlled and grey where it is only measured; an arrow of less than `SMALLEST_FORCE` is
    deleted.
    """
    header = Header(frame_id=topics.WORLD_FRAME, stamp=messages.ns_to_stamp(stamp))
    pose = output.pose
    arrows = []
    for number, (name, column) in enumerate(
        zip(config.contact_names, config.force_columns)
    ):
        force = float(output.contacts['alpha_meas'][column])
        point_operational = config.contacts[name].point_operational
        tip = pose.position_world + pose.rotation_world @ point_operational
        tail = tip - ARROW_SCALE * force * output.contacts['normal'][column]
        controlled = output.answer['active'][column]
        arrows.append(
            Marker(
                header=header,
                ns=f'{MARKER_NAMESPACE}/{name}',
                id=number,
                type=Marker.ARROW,
                action=Marker.ADD if force > SMALLEST_FORCE else Marker.DELETE,
                color=CONTROLLED_COLOUR if controlled else MEASURED_COLOUR,
                points=[_make_point(tail), _make_point(tip)],
                scale=ARROW_SIZE,
                lifetime=Duration(seconds=MARKER_LIFETIME).to_msg(),
            )
        )
    return MarkerArray(markers=arrows)


def _make_point(position: Vector) -> Point:
    x, y, z = messages.finite_array(position, 3, 'points').tolist()
    return Point(x=x, y=y, z=z)


class Service(NamedTuple):
    """A service of the controller's node: its class, and its content for the reference."""

    kind: Any
    content: str


SERVICES = {
    'tare': Service(
        Trigger,
        'Takes the present reading of the wrist sensor for its bias; refused while '
        'a contact is under force control, or pressed by a reaction.',
    ),
    'hold': Service(SetBool, 'Holds the present pose and forces, or lets go of them.'),
    'retry': Service(
        Trigger,
        'Resumes control that waits for an operator (cause `latched`, or '
        'velocities in doubt), and seeks contacts that were given up.',
    ),
    'push_test': Service(
        Trigger,
        'Begins the push test: log, diagnostics and `~/status` say where to '
        'push the tool.',
    ),
    'cancel_push_test': Service(
        Trigger,
        'Takes back a push test that is under way, or has ended because '
        'nothing pushed; force control is allowed if it was before.',
    ),
}


NO_TRAJECTORY_LEFT = object()


def _deserialise_trajectory(data: bytes) -> Any:
    return deserialize_message(data, topics.TRAJECTORY_COMMAND.message)


def _read_trajectory(message: Any, limits: LimitsConfig) -> TimedPoses:
    """Return the points of a trajectory, checked if there are any; MulticontactError."""
    points = messages.read_trajectory(message)
    if len(points.times):
        check_points(points, limits)
    return points


class CommandServers:
    """
    Hands commands on topics and requests of services to a control loop, and reports each answer.

    What the loop refuses is logged by the node, answered on ~/status, and said in the response of
    a service; the loop is then as it was.

    Parameters
    ----------
    node, loop, report
        The node that is commanded, its control loop, and the report that gets the answers.
    get_push_test
        Returns the present parameters of the push test, which may change while the node works.

    """

    def __init__(
        self,
        node: ManagedNode,
        loop: ControlLoop,
        report: ControllerReport,
        get_push_test: Callable[[], PushTestConfig],
    ) -> None:
        self._node = node
        self._loop = loop
        self._report = report
        self._get_push_test = get_push_test
        for topic, obey_message in (
            (topics.FORCE_COMMAND, self._set_forces),
            (topics.MOTION_COMMAND, self._set_motion),
        ):
            node.create_subscription(
                topic.message,
                topic.name,
                partial(self._answer_message, topic.name, obey_message),
                qos.EVENT,
            )
        self._trajectories: deque[Iterator[None]] = deque()  # that are read and planned
        self._obeyed_trajectory = b''
        trajectory = topics.TRAJECTORY_COMMAND
        node.create_subscription(
            trajectory.message,
            trajectory.name,
            self._queue_trajectory,
            qos.EVENT,
            raw=True,
        )
        for name, obey_request in (
            ('tare', self._tare),
            ('hold', self._hold),
            ('retry', self._retry),
            ('push_test', self._push_test),
            ('cancel_push_test', self._cancel_push_test),
        ):
            source = f'~/{name}'
            node.create_service(
                SERVICES[name].kind,
                source,
                partial(self._answer_request, source, obey_request),
            )

    def _answer_message(
        self, source: str, obey: Callable[[Any], str], message: Any
    ) -> None:
        """Obey a command on a topic; report what of it is left out, or why it is refused."""
        identifier = get_identifier(message)
        try:
            answer = CommandAnswer(source, identifier, left_out=obey(message))
        except MulticontactError as error:
            answer = self._refuse(source, identifier, error)
        self._report.report_answer(answer)

    def _queue_trajectory(self, data: bytes) -> None:
        self._trajectories.append(self._take_trajectory(data))

    def poll(self) -> None:
        """Go on with trajectories that another thread reads and plans; called between samples."""
        while self._trajectories:
            if (
                next(self._trajectories[0], NO_TRAJECTORY_LEFT)
                is not NO_TRAJECTORY_LEFT
            ):
                return  # it waits for the thread
            self._trajectories.popleft()

    def _take_trajectory(self, data: bytes) -> Iterator[None]:
        """
        Read, plan and follow a trajectory, and report that, or why it is refused.

        A message that comes again while it is followed is accepted, and changes nothing.
        """
        source = topics.TRAJECTORY_COMMAND.name
        compute = self._node.background.compute
        outcome = yield from compute(_deserialise_trajectory, data)
        message = outcome.result()
        identifier = get_identifier(message)
        repeats = data == self._obeyed_trajectory and self._loop.progress is not None
        left_out = ''
        try:
            if not repeats:
                left_out = yield from self._follow_trajectory(message)
                self._obeyed_trajectory = data
            answer = CommandAnswer(source, identifier, left_out=left_out)
        except MulticontactError as error:
            answer = self._refuse(source, identifier, error)
        self._report.report_answer(answer)

    def _follow_trajectory(self, message: Any) -> Pausing[str]:
        """Follow the trajectory of a message; return how it differs from what was asked for."""
        loop = self._loop
        compute = self._node.background.compute
        read = yield from compute(_read_trajectory, message, loop.config.limits)
        request = loop.request_trajectory(read.result())
        if request is None:
            return ''
        planned = yield from compute(request.plan)
        try:
            trajectory = planned.result()
            loop.follow(request, trajectory)
        except MulticontactError:
            loop.keep_trajectory()
            raise
        if trajectory.slowdown <= 1.0:
            return ''
        return f'slowed down {trajectory.slowdown:.3g} times for limits.operational_*'

    def _answer_request(
        self, source: str, obey: Callable[[Any], str], request: Any, response: Any
    ) -> Any:
        """Obey a request of a service; respond with what happens now, or why not."""
        answer = CommandAnswer(source)
        try:
            response.message = obey(request)
            response.success = True
        except MulticontactError as error:
            answer = self._refuse(source, '', error)
            response.message = answer.refusal
        self._report.report_answer(answer)
        return response

    def _refuse(
        self, source: str, identifier: str, error: MulticontactError
    ) -> CommandAnswer:
        self._node.refusals.log_refusal(source, error)
        return CommandAnswer(source, identifier, refusal=str(error))

    def _set_forces(self, message: Any) -> str:
        forces, centres = messages.read_force_command(
            message, self._loop.config.column_names
        )
        self._loop.set_forces(forces, centres)
        return ''

    def _set_motion(self, message: Any) -> str:
        return self._loop.set_motion(messages.read_motion(message))

    def _tare(self, _request: Any) -> str:
        """Set the bias of the sensor, shape (6,) [N, N m], as a parameter of the node."""
        bias = self._loop.tare().tolist()
        (result,) = self._node.set_parameters(
            [Parameter('tool.bias_sensor', value=bias)]
        )
        if not result.successful:
            raise MulticontactError(result.reason)
        numbers = ', '.join(f'{x:.4g}' for x in bias)
        return f'bias [N, N m]: {numbers}'

    def _hold(self, request: Any) -> str:
        return self._loop.hold(request.data)

    def _retry(self, _request: Any) -> str:
        return self._loop.retry()

    def _push_test(self, _request: Any) -> str:
        return self._loop.push_test(self._get_push_test())

    def _cancel_push_test(self, _request: Any) -> str:
        return self._loop.cancel_push_test()
