"""
Every topic of the graph, once: what nodes publish, the recorder records, the gate waits for.

All names but /clock are relative, so that a namespace moves the whole graph.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3Stamped, WrenchStamped
from multicontact_control.nodes import qos
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

# Or what stands in its place: the driver of a robot, another simulator.
SIM = 'sim_node'
CONTROLLER = 'controller_node'
ESTIMATOR = 'noise_estimator_node'
RECORDER = 'recorder_node'
USER = 'user'  # a command of ours, a program or a person
EVERY_NODE = 'every node'
WORLD_FRAME = 'world'
MARKER_RATE = 25.0  # Hz, of what a viewer is shown in motion


# A profile has no hash: without eq=False a topic could not be a key.
@dataclass(frozen=True, eq=False)
class Topic:
    """
    One topic of the graph.

    The recorder subscribes to each, so that it is not among the subscribers here.
    """

    name: str
    message: type[Any]  # class of the messages, e.g. `JointState`
    publisher: str  # name of a node; for a `USER` no node waits
    # Nodes that always subscribe, for which the gate of the publisher waits. Beside them the
    # controller reads one of two wrenches, and some noise estimators the innovation.
    subscribers: tuple[str, ...] = ()
    profile: QoSProfile = field(default_factory=lambda: qos.STREAM)  # of the publisher
    # One message per control period, of which the recorder counts losses; or now and then.
    rate: Literal['control', 'event'] = 'control'
    # Of a message: for docs/reference, and for the log where the topic is missing.
    content: str = ''

    @property
    def type_name(self) -> str:
        """Return the type as ROS tools write it, e.g. ``sensor_msgs/msg/JointState``."""
        package, kind, *_ = self.message.__module__.split('.')
        return f'{package}/{kind}/{self.message.__name__}'


JOINT_STATES = Topic(
    'joint_states',
    JointState,
    SIM,
    (CONTROLLER,),
    content='q [rad] and qd [rad/s] of every joint, in any order; effort [N m] if it is measured.',
)
WRENCH = Topic(
    'ft_sensor/wrench',
    WrenchStamped,
    SIM,
    content='The wrist sensor in its own frame, with the weight of the tool in it [N, N m].',
)
WRENCH_FILTERED = Topic(
    'ft_sensor/wrench_filtered',
    WrenchStamped,
    SIM,
    content="The same through the sensor's low-pass.",
)
# By `wrench_input`; with `momentum` no wrench is read.
WRENCHES = {'raw': WRENCH, 'filtered': WRENCH_FILTERED}
TRUE_FORCES = Topic(
    'ground_truth/contact_forces',
    JointState,
    SIM,
    content='effort = true force per contact [N], for evaluation; no robot can publish it.',
)
EFFORT_COMMAND = Topic(
    'joint_effort_command',
    JointState,
    CONTROLLER,
    (SIM,),
    content='effort [N m]; the stamp is that of the sample it answers.',
)
MEASURED_FORCES = Topic(
    'contact_forces/measured',
    JointState,
    CONTROLLER,
    (ESTIMATOR,),
    content='name = force or couple, as in every topic `contact_forces/*`; effort = measured '
    'force [N], position = 1 where the wrench is of this sample, 0 where the force repeats the '
    'last reading.',
)
ESTIMATED_FORCES = Topic(
    'contact_forces/estimated',
    JointState,
    CONTROLLER,
    content="effort = the observer's force [N], velocity = its rate [N/s].",
)
DESIRED_FORCES = Topic(
    'contact_forces/desired',
    JointState,
    CONTROLLER,
    content='effort = desired force [N], as the supervisor passes it on.',
)
INNOVATION = Topic(
    'contact_forces/innovation',
    JointState,
    CONTROLLER,
    content='effort = measured less predicted force [N], velocity = C P_1 C^T (variance of the '
    'predicted force) and position = the R that was used [N²].',
)
STIFFNESS = Topic(
    'contact_forces/stiffness',
    JointState,
    CONTROLLER,
    content='Only if the stiffness is found on-line: position = estimate, velocity = its standard '
    'error, effort = model in use [N/m].',
)
STABILITY_MARGIN = Topic(
    'contact_forces/stability_margin',
    JointState,
    CONTROLLER,
    content='Only if the stiffness is found on-line: position = upper bound (2 sigma) of true '
    'over modelled stiffness, effort = factor by which that ratio may still grow before the force '
    'loop is unstable.',
)
POSE = Topic(
    'operational_point/pose',
    PoseStamped,
    CONTROLLER,
    content='The operational point in world axes [m].',
)
POSE_DESIRED = Topic(
    'operational_point/pose_desired',
    PoseStamped,
    CONTROLLER,
    content='Where it should be [m].',
)
NOISE_VARIANCE = Topic(
    'contact_forces/noise_variance',
    JointState,
    ESTIMATOR,
    (CONTROLLER,),
    content='effort = R per contact [N²]; the stamp is that of its newest sample.',
)
FORCE_COMMAND = Topic(
    'contact_forces/command',
    JointState,
    USER,
    (CONTROLLER,),
    profile=qos.EVENT,
    rate='event',
    content='name, and effort = desired force per contact, or couple [N]; or position = centre of '
    'pressure for each couple [m]. What is not named stays as it is; a force of 0 lets go. '
    'header.frame_id = identifier that `~/status` answers with, empty for none.',
)
MOTION_COMMAND = Topic(
    'motion/command',
    MultiDOFJointTrajectoryPoint,
    USER,
    (CONTROLLER,),
    profile=qos.EVENT,
    rate='event',
    content='One transform: pose of the operational point in world axes, with a quaternion of '
    'unit length. Its twist and acceleration may be left empty: 0. time_from_start.sec = a number '
    'as identifier, 0 for none.',
)
TRAJECTORY_COMMAND = Topic(
    'motion/trajectory',
    MultiDOFJointTrajectory,
    USER,
    (CONTROLLER,),
    profile=qos.EVENT,
    rate='event',
    content='A whole path of the operational point: of each point time_from_start, one transform '
    'in world axes with a quaternion of unit length, and its twist at all points or at none. '
    'Without points it ends the one that is followed. header.frame_id = identifier that '
    '`~/status` answers with, empty for none.',
)
PUSH = Topic(
    f'{SIM}/push',
    Vector3Stamped,
    USER,
    (SIM,),
    profile=qos.EVENT,
    rate='event',
    content='`~/push` of the simulator: a force in world axes [N], of 150 N at most, that pushes '
    'the arm for 0.8 s. header.frame_id = `tool` to push the tool beyond the wrist sensor, empty '
    'for the operational point.',
)
STATUS = Topic(
    f'{CONTROLLER}/status',
    DiagnosticStatus,
    CONTROLLER,
    profile=qos.EVENT,
    rate='event',
    content='`~/status` of the controller: the answer to each command that is refused or has an '
    'identifier, each change of its state and of the forces that it obeys, and once a second the '
    'newest state.',
)
ROBOT_DESCRIPTION = Topic(
    'robot_description',
    String,
    SIM,
    profile=qos.LATCHED,
    rate='event',
    content='The URDF, also for a reader that comes late.',
)
CONTACT_MARKERS = Topic(
    'contact_markers',
    MarkerArray,
    CONTROLLER,
    profile=qos.EVENT,
    rate='event',
    content=f'Per contact the measured force as an arrow at its tip, at {MARKER_RATE:g} Hz.',
)
SURFACE_MARKERS = Topic(
    'ground_truth/surfaces',
    MarkerArray,
    SIM,
    profile=qos.LATCHED,
    rate='event',
    content='What can be touched, as only the simulator knows it, also for a reader that comes '
    f'late; at {MARKER_RATE:g} Hz if it moves.',
)
DIAGNOSTICS = Topic(
    'diagnostics',
    DiagnosticArray,
    EVERY_NODE,
    profile=qos.EVENT,
    rate='event',
    content='Once a second: rates, jitter, misses, latency, ages of inputs, refusals; of the '
    'controller also publishers, reaction and causes, contact states and sensor.',
)
CLOCK = Topic(
    '/clock',
    Clock,
    'sim_node in lockstep',  # not SIM: the recorder waits for no clock of another loop
    content='Time of the newest sample.',
)

TOPICS = tuple(topic for topic in globals().values() if isinstance(topic, Topic))
