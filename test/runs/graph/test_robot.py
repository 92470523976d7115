"""Robots that are not there, not whole, or not what the controller takes for its robot."""

from contextlib import closing

from fake_arm import wrench_message
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph import create_publisher, ignore_message
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.runs.graph.robot import ExpectedRobot, RobotWatch
import pytest
from ros_graph import wait_for

pytestmark = pytest.mark.ros

JOINTS = ('a', 'b')


class Publisher(ServiceClientNode):
    """A robot's node, which publishes what it is told to."""

    def __init__(self, domain_id):
        super().__init__('their_robot', domain_id)
        self._joints, self._wrench = (
            create_publisher(self.node, topic)
            for topic in (topics.JOINT_STATES, topics.WRENCH)
        )
        self._k = 0

    def listen(self):
        topic = topics.EFFORT_COMMAND
        self.node.create_subscription(topic.message, topic.name, ignore_message, 10)

    def publish(self, *, names=JOINTS):
        self._k += 1
        stamp = 1_000_000_000 + self._k * 2_000_000
        message = messages.joint_state_message(
            stamp, names, position=[0.0] * len(names)
        )
        self._joints.publish(message)
        self._wrench.publish(wrench_message(stamp, 'wrist', [0.0] * 6))


def wait_until(watch, robot, condition, **published):
    def seen():
        robot.publish(**published)
        return condition(watch)

    return wait_for(seen, 'what the watch says', watch.describe_missing)


def test_watch_names_what_is_missing_until_nothing_is_and_what_falls_silent(domain_id):
    with RobotWatch(domain_id, '', ExpectedRobot(JOINTS, timeout=0.2)) as watch:
        for topic in ('/joint_states', '/ft_sensor/wrench', '/joint_effort_command'):
            assert topic in watch.describe_missing()
        with (
            closing(Publisher(domain_id)) as robot,
            closing(Publisher(domain_id)) as gripper,
        ):
            wait_until(
                watch,
                robot,
                lambda it: 'joints b in' in it.describe_missing(),
                names=('a', 'c'),
            )
            wait_until(
                watch,
                robot,
                lambda it: it.describe_missing().startswith('a subscriber of'),
            )
            robot.listen()
            for _ in range(
                20
            ):  # joints of others are not the robot's; velocities may lack
                gripper.publish(names=('finger',))
                wait_until(watch, robot, lambda it: not it.describe_missing())
            wait_until(
                watch,
                robot,
                lambda it: it.sources.startswith('/joint_states from their_robot'),
            )
            wait_for(
                lambda: gripper.publish(names=('finger',)) or watch.describe_silence(),
                'silence',
            )
            assert 'has not published /joint_states' in watch.describe_silence()


def test_robot_without_a_wrist_sensor_needs_none(domain_id):
    expected = ExpectedRobot(JOINTS, wrench_input='momentum')
    with (
        RobotWatch(domain_id, '', expected) as watch,
        closing(Publisher(domain_id)) as robot,
    ):
        assert 'wrench' not in watch.describe_missing()
        robot.listen()
        wait_until(watch, robot, lambda it: not it.describe_missing())
