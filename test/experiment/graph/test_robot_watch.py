"""Robots that are not there, not whole, or not what the controller takes for its robot."""

from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.robot_watch import RobotWatch
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.link import GuestNode
import pytest
from ros_graph import wait_for

pytestmark = pytest.mark.ros

JOINTS = ('a', 'b')


class Robot:
    """A robot's node, which publishes what it is told to."""

    def __init__(self, domain_id, profile=qos.STREAM):
        self._guest = GuestNode('their_robot', domain_id)
        self.node = self._guest.node
        self.joints = self.node.create_publisher(
            topics.JOINT_STATES.message, topics.JOINT_STATES.name, profile)
        self._wrench = self.node.create_publisher(
            topics.WRENCH.message, topics.WRENCH.name, profile)
        self.k = 0

    def listen(self):
        self.node.create_subscription(
            topics.EFFORT_COMMAND.message, topics.EFFORT_COMMAND.name, lambda _: None, 10)

    def publish(self, *, names=JOINTS, late=0, period=2_000_000, count=1):
        for _ in range(count):
            self.k += 1
            stamp = 1_000_000_000 + self.k * period
            self.joints.publish(messages.joint_state_message(
                stamp, names, position=[0.0] * len(names), velocity=[0.0] * len(names)))
            self._wrench.publish(messages.wrench_message(stamp + late, [0.0] * 6, 'wrist'))

    def close(self):
        self._guest.close()


@pytest.fixture(name='domain_id')
def fixture_domain_id(monkeypatch):
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    with reserve_domain() as number:
        yield number


def wait_until(watch, robot, condition, **published):
    def seen():
        robot.publish(**published)
        return condition(watch)
    return wait_for(seen, 'what the watch says', watch.missing)


def test_what_is_missing_is_said_until_nothing_is(domain_id):
    with RobotWatch(domain_id, '', joint_names=JOINTS, rate=500.0) as watch:
        assert watch.missing() == (
            '/joint_states (sensor_msgs/msg/JointState) from the robot: nobody publishes it; '
            '/ft_sensor/wrench (geometry_msgs/msg/WrenchStamped) from the robot: nobody '
            'publishes it; a subscriber of /joint_effort_command (the robot is to apply these '
            'efforts)')
        robot = Robot(domain_id)
        wait_for(lambda: '/joint_states from their_robot, which publishes nothing yet' in (
            watch.missing()), 'publishers', watch.missing)
        wait_until(watch, robot, lambda it: it.missing().startswith('the joints b in joint_states,'
                   ' which has a, c'), names=('a', 'c'))
        wait_until(watch, robot, lambda it: it.missing().startswith('a subscriber of'))
        robot.listen()
        wait_until(watch, robot, lambda it: not it.missing())
        assert watch.found == (
            '/joint_states from their_robot, /ft_sensor/wrench from their_robot')
        assert watch.silent(60.0) == ''
        # The last messages may still be on their way.
        assert wait_for(lambda: watch.silent(0.2), 'silence').startswith(
            'their_robot has not published /joint_states for ')
        robot.close()


def test_joints_of_others_are_not_the_robot(domain_id):
    with RobotWatch(domain_id, '', joint_names=JOINTS, rate=500.0) as watch:
        arm, gripper = Robot(domain_id), Robot(domain_id)
        arm.listen()

        def publish_both(condition):
            def seen():
                arm.publish()
                gripper.publish(names=('finger',))
                return condition()
            return wait_for(seen, 'what the watch says', watch.missing)

        publish_both(lambda: not watch.missing())
        for _ in range(20):
            publish_both(lambda: True)
            assert watch.missing() == ''
        arm.close()
        wait_for(lambda: gripper.publish(names=('finger',)) or watch.silent(0.3), 'silence')
        assert ' has not published /joint_states of its joints for ' in watch.silent(0.3)
        gripper.close()


@pytest.mark.parametrize(('published', 'doubt'), [
    ({'late': 900_000}, 'with stamps that differ by at most 0.8 ms, which never came'),
    ({'period': 10_000_000}, 'joint_states at 500 Hz, the rate of the controller; its stamps '
     'come at 100 Hz')])
def test_samples_that_cannot_be_answered_are_doubted(domain_id, published, doubt):
    with RobotWatch(domain_id, '', joint_names=JOINTS, rate=500.0, pair_tolerance=8e-4) as watch:
        robot = Robot(domain_id)
        wait_until(watch, robot, lambda it: doubt in it.doubts(), **published)
        robot.close()


def test_robot_without_a_wrist_sensor_needs_none(domain_id):
    with RobotWatch(domain_id, '', joint_names=JOINTS, rate=500.0, wrench=None) as watch:
        assert 'wrench' not in watch.missing()
        robot = Robot(domain_id)
        robot.listen()
        wait_until(watch, robot, lambda it: not it.missing())
        wait_until(watch, robot, lambda it: 'at 500 Hz' in it.doubts(), period=10_000_000)
        assert watch.found == '/joint_states from their_robot'
        robot.close()


def test_reliability_that_the_nodes_cannot_have_is_said(domain_id):
    with RobotWatch(domain_id, '', joint_names=JOINTS, rate=500.0) as watch:
        robot = Robot(domain_id, qos.profile(10, reliable=False))
        ours = GuestNode(topics.CONTROLLER, domain_id)
        ours.node.create_subscription(
            topics.JOINT_STATES.message, topics.JOINT_STATES.name, lambda _: None, qos.NEWEST)
        robot.listen()
        wait_until(watch, robot, lambda it: it.missing() == (
            '/joint_states as reliable from their_robot, which publishes it best effort; '
            'controller_node cannot get it so'))
        ours.close()
        robot.close()
