"""An arm that stands still, as far as a controller can tell over its topics."""

from arms import controller_config, HOME, pressed_wrench
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph import (
    create_publisher,
    ignore_message,
    take_message,
)
from multicontact_control.paths import find_config_folder
from multicontact_control.sensor.tool import predict_weight_reading
import numpy as np
from rclpy.qos import QoSProfile
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

PERIOD = 2_000_000
UNFELT = f'collision.threshold:={[1e9] * 6}'  # its torques mean nothing
# An arm that is late because a test is, and whose readings have no noise.
PARAMETERS = ('patience:=0.0', 'sensor.frozen_ticks:=0', UNFELT)
EFFORT = np.array([1.0, 29.0, 7.0, 0.5, 0.5, 0.1])  # not quite what gravity wants
DEPTH = QoSProfile(depth=1000)


def wrench_message(stamp, frame_id, wrench):
    """Build a wrench in a frame, force first."""
    fx, fy, fz, mx, my, mz = map(float, wrench)
    force = Vector3(x=fx, y=fy, z=fz)
    torque = Vector3(x=mx, y=my, z=mz)
    return WrenchStamped(
        header=Header(stamp=messages.ns_to_stamp(stamp), frame_id=frame_id),
        wrench=Wrench(force=force, torque=torque),
    )


class FakeArm:
    def __init__(self, middleware, profile=DEPTH):
        self._middleware = middleware
        node = middleware.node
        self.config = controller_config()
        robot = RobotModel(self.config.robot, find_config_folder())
        self.state = robot.update(HOME, np.zeros(6))
        self.weight = predict_weight_reading(
            self.state.sensor_pose.rotation_world,
            self.config.tool,
            np.array(self.config.robot.gravity_world),
        )
        self.wrench = self.weight
        self.k = 0
        self._joints = node.create_publisher(JointState, 'joint_states', profile)
        self._wrench = node.create_publisher(
            topics.WRENCH.message, 'ft_sensor/wrench', profile
        )
        self.force_command = create_publisher(node, topics.FORCE_COMMAND)
        self.motion_command = create_publisher(node, topics.MOTION_COMMAND)
        self._variance = create_publisher(node, topics.NOISE_VARIANCE)
        self._commands = self._listen(JointState, 'joint_effort_command')
        self._forces = {
            'desired': self._listen(JointState, 'contact_forces/desired'),
            'measured': self._listen(JointState, 'contact_forces/measured'),
        }
        self._diagnostics = self._listen(DiagnosticArray, 'diagnostics')

    def _listen(self, message, topic):
        node = self._middleware.node
        return node.create_subscription(message, topic, ignore_message, DEPTH)

    def press(self, **forces):
        """Let the sensor read these contact forces [N], and nothing else but the tool."""
        self.wrench = self.weight + pressed_wrench(self.config, self.state, **forces)

    def send(self):
        self.k += 1
        self.send_parts(self.k * PERIOD, {'joints', 'wrench'})
        return self.k * PERIOD

    def send_parts(self, stamp, parts):
        if 'wrench' in parts:
            self._wrench.publish(wrench_message(stamp, 'ft_face', self.wrench))
        if 'joints' in parts:
            names = self.config.robot.joint_names
            message = messages.joint_state_message(
                stamp, names, position=HOME, velocity=np.zeros(6), effort=EFFORT
            )
            self._joints.publish(message)

    def send_variance(self):
        """Send an R of the newest sample, as the noise estimator does [N^2]."""
        names = self.config.column_names
        R = np.full(len(names), 0.5)
        message = messages.joint_state_message(self.k * PERIOD, names, effort=R)
        self._variance.publish(message)

    def newest_command(self):
        """Return the newest command that has come since, None without any."""
        return self._middleware.take(self._commands)

    def answer(self, stamp):
        """Return the newest command, if it answers this sample."""
        command = self.newest_command()
        if command is None or messages.stamp_to_ns(command.header.stamp) != stamp:
            return None
        return command

    def step(self):
        """Publish a sample and return the torque that answers it."""
        stamp = self.send()
        command = wait_for(lambda: self.answer(stamp), f'answer to sample {self.k}')
        return np.array(command.effort)

    def settle(self, count=60):
        """Return the torque that answers the last of so many samples."""
        for _ in range(count):
            torque = self.step()
        return torque

    def connect(self):
        """Send samples until the newest is answered; return the first answer that came."""
        answers = []

        def answered():
            stamp = self.send()
            for _ in range(40):
                while (taken := take_message(self._commands)) is not None:
                    answers.append(np.array(taken[0].effort))
                    if messages.stamp_to_ns(taken[0].header.stamp) == stamp:
                        return True
                self._middleware.pause()
            return False

        wait_for(answered, 'any answer')
        return answers[0]

    def forces(self, kind):
        """Return the newest forces by contact, 'desired' or 'measured'."""
        message = wait_for(lambda: self._middleware.take(self._forces[kind]), 'forces')
        return dict(zip(message.name, message.effort))

    def diagnostics(self, condition, send=None):
        """Send until a report, {part: (level, message, values)}, is as wanted; return it."""
        seen = []

        def satisfied():
            (send or self.send)()
            self._middleware.pause(0.01)
            report = self._middleware.take(self._diagnostics)
            if report is None:
                return False
            parts = {}
            for status in report.status:
                node, _, part = status.name.partition(': ')
                if node != 'controller_node':
                    return False
                values = {value.key: value.value for value in status.values}
                parts[part] = status.level[0], status.message, values
            seen.append(parts)
            return condition(parts)

        wait_for(satisfied, 'such diagnostics', lambda: seen[-1:])
        return seen[-1]
