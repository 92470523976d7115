"""
Every topic of the graph, once.

The nodes make their publishers and subscriptions from this table, the recorder records what it
lists, and the start-up gate waits for the connections it promises. All names are relative, so a
namespace moves the whole graph.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from multicontact_control.nodes import qos
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

SIM = 'sim_node'
CONTROLLER = 'controller_node'
ESTIMATOR = 'noise_estimator_node'
RECORDER = 'recorder_node'
USER = 'user'
EVERY_NODE = 'every node'
LOCKSTEP_SIM = 'sim_node in lockstep'
WORLD_FRAME = 'world'

RateClass = Literal['control', 'event']


@dataclass(frozen=True, eq=False)
class Topic:
    """
    One topic.

    Attributes
    ----------
    name
        Relative name.
    message
        Message class.
    publisher
        Name of the node that publishes it; `USER` for whoever wants to. Nobody waits for what
        is not the name of a node.
    subscribers
        Names of the nodes that always subscribe to it. The controller subscribes to one of the
        two wrenches, so neither lists it.
    profile
        Quality of service of the publisher.
    rate
        ``control`` for one message per control period, ``event`` for now and then.

    """

    name: str
    message: Any
    publisher: str
    subscribers: tuple[str, ...]
    profile: QoSProfile = field(default_factory=lambda: qos.STREAM)
    rate: RateClass = 'control'

    @property
    def type_name(self) -> str:
        """Return the type as ROS tools write it, e.g. ``sensor_msgs/msg/JointState``."""
        package = self.message.__module__.split('.', 1)[0]
        return f'{package}/msg/{self.message.__name__}'


JOINT_STATES = Topic('joint_states', JointState, SIM, (CONTROLLER, RECORDER))
WRENCH = Topic('ft_sensor/wrench', WrenchStamped, SIM, (RECORDER,))
WRENCH_FILTERED = Topic('ft_sensor/wrench_filtered', WrenchStamped, SIM, (RECORDER,))
TRUE_FORCES = Topic('ground_truth/contact_forces', JointState, SIM, (RECORDER,))
EFFORT_COMMAND = Topic('joint_effort_command', JointState, CONTROLLER, (SIM, RECORDER))
MEASURED_FORCES = Topic(
    'contact_forces/measured', JointState, CONTROLLER, (ESTIMATOR, RECORDER))
ESTIMATED_FORCES = Topic('contact_forces/estimated', JointState, CONTROLLER, (RECORDER,))
DESIRED_FORCES = Topic('contact_forces/desired', JointState, CONTROLLER, (RECORDER,))
# Only estimators that work on innovations subscribe to it.
INNOVATION = Topic('contact_forces/innovation', JointState, CONTROLLER, (RECORDER,))
# Of controllers that find the stiffness on-line: estimate, standard error, and model in use.
STIFFNESS = Topic('contact_forces/stiffness', JointState, CONTROLLER, (RECORDER,))
# True over modelled stiffness at most, and how many times as stiff the surface might still be.
STABILITY_MARGIN = Topic(
    'contact_forces/stability_margin', JointState, CONTROLLER, (RECORDER,))
POSE = Topic('operational_point/pose', PoseStamped, CONTROLLER, (RECORDER,))
POSE_DESIRED = Topic('operational_point/pose_desired', PoseStamped, CONTROLLER, (RECORDER,))
NOISE_VARIANCE = Topic(
    'contact_forces/noise_variance', JointState, ESTIMATOR, (CONTROLLER, RECORDER))
FORCE_COMMAND = Topic(
    'contact_forces/command', JointState, USER, (RECORDER,), qos.COMMAND, 'event')
MOTION_COMMAND = Topic(
    'motion/command', MultiDOFJointTrajectoryPoint, USER, (RECORDER,), qos.COMMAND, 'event')
# `~/status` of the controller: a message for every command it refuses and change of its state.
STATUS = Topic(
    f'{CONTROLLER}/status', DiagnosticStatus, CONTROLLER, (RECORDER,), qos.COMMAND, 'event')
ROBOT_DESCRIPTION = Topic(
    'robot_description', String, SIM, (RECORDER,), qos.LATCHED, 'event')
CONTACT_MARKERS = Topic(
    'contact_markers', MarkerArray, CONTROLLER, (RECORDER,), qos.DISPLAY, 'event')
DIAGNOSTICS = Topic(
    'diagnostics', DiagnosticArray, EVERY_NODE, (RECORDER,), qos.REPORT, 'event')
# Absolute, as everything that uses simulated time expects it.
CLOCK = Topic('/clock', Clock, LOCKSTEP_SIM, (RECORDER,), qos.STREAM, 'event')

TOPICS: tuple[Topic, ...] = (
    JOINT_STATES, WRENCH, WRENCH_FILTERED, TRUE_FORCES, EFFORT_COMMAND, MEASURED_FORCES,
    ESTIMATED_FORCES, DESIRED_FORCES, INNOVATION, STIFFNESS, STABILITY_MARGIN, POSE,
    POSE_DESIRED, NOISE_VARIANCE,
    FORCE_COMMAND, MOTION_COMMAND, STATUS, ROBOT_DESCRIPTION, CONTACT_MARKERS,
    DIAGNOSTICS, CLOCK)


def published_by(node_name: str) -> tuple[Topic, ...]:
    """Return the topics that a node publishes."""
    return tuple(topic for topic in TOPICS if topic.publisher == node_name)


def batches_of(node_name: str) -> Topic:
    """Return the topic on which a node hands its messages to the recorder in batches."""
    return Topic(f'_recording/{node_name}', UInt8MultiArray, node_name, (RECORDER,))


def batched_by(node_name: str) -> set[Topic]:
    """Return the topics whose messages may be in these."""
    streams = {topic for topic in published_by(node_name) if topic.rate == 'control'}
    return streams | {CLOCK} if node_name == SIM else streams
