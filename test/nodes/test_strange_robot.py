"""A driver as others write it: more joints, later wrenches, best effort; and what is logged."""

from __future__ import annotations

import re
import signal

from arms import HOME
from fake_arm import EFFORT, FakeArm, PARAMETERS, PERIOD
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_graph import end_of, wait_for
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

MODULE = 'multicontact_control.nodes.controller_node'
FILE = config_dir() / 'controller.yaml'
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATE = 50_000  # ns


class StrangeArm(FakeArm):
    """Publishes best effort, with a gripper's joints among its own, the wrench 50 us later."""

    def __init__(self, middleware, frame='ft_face'):
        super().__init__(middleware, BEST_EFFORT)
        self.frame = frame

    def send_parts(self, stamp, parts):
        names = ['left_finger', *reversed(self.config.robot.joint_names), 'right_finger']
        if 'joints' in parts:
            position, effort = ([np.nan, *reversed(x), 0.04] for x in (HOME, EFFORT))
            message = messages.joint_state_message(stamp, names, velocity=np.zeros(8))
            message.position, message.effort = list(map(float, position)), list(map(float, effort))
            self._joints.publish(message)
        if 'wrench' in parts:
            self._wrench.publish(messages.wrench_message(stamp + LATE, self.wrench, self.frame))


class Said:
    """What nodes log from now on."""

    def __init__(self, node):
        self._subscription = node.create_subscription(Log, '/rosout', ignore, LATCHED)
        self.lines = []

    def has(self, text):
        """Return whether a line with this has been logged."""
        while (taken := take(self._subscription)) is not None:
            self.lines.append(taken[0].msg)
        return any(text in line for line in self.lines)


def log_of(process):
    """End a node and return what it has logged."""
    process.send_signal(signal.SIGINT)
    return end_of(process)[1]


def test_driver_of_another_robot_is_understood(middleware):
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    arm = StrangeArm(middleware)
    # The very first answer may go before anybody hears it.
    np.testing.assert_allclose(arm.connect(), EFFORT, atol=1e-3)
    for _ in range(20):
        arm.step()
    report = arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'none')
    assert int(report['messages'][2]['slow']) <= 2 + 2  # the first of each; then in place
    assert report['messages'][2]['refused'] == '0'
    arm.frame = 'tool0'
    for _ in range(3):
        arm.send()
        middleware.pause(0.01)
    report = arm.diagnostics(lambda x: any('frame_id' in key for key in x['messages'][2]))
    log = log_of(process)
    assert ("ft_sensor/wrench: refused: header.frame_id: expected 'ft_face' (robot.sensor_frame), "
            "or none, found 'tool0'") in log
    assert 'joint_states: subscribed best effort, as it is published' in log
    assert 'no message goes' not in log


def test_what_is_missing_and_who_cannot_be_heard_is_named(middleware):
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    node = middleware.node
    arm = FakeArm(middleware)
    node.create_publisher(JointState, topics.FORCE_COMMAND.name, BEST_EFFORT)
    node.create_subscription(JointState, topics.EFFORT_COMMAND.name, lambda _: None, LATCHED)
    said = Said(node)
    node.destroy_publisher(arm._wrench)
    for line in (
            'no message on /ft_sensor/wrench for', 'nobody publishes it',
            'expected geometry_msgs/msg/WrenchStamped (reliable or best effort) with force [N] '
            'and torque [N m] in the axes of ft_face',
            '/contact_forces/command: no message goes from /sim_node: reliability is offered as '
            'best effort by the publisher and requested as reliable by the subscriber',
            '/joint_effort_command: no message goes to /sim_node: durability is offered as '
            'volatile by the publisher and requested as transient local by the subscriber'):
        def told(line=line):
            arm.k += 1
            arm.send_parts(arm.k * PERIOD, {'joints'})
            middleware.pause(0.05)
            return said.has(line)

        assert wait_for(told, line, lambda: said.lines)
    log_of(process)


def test_stamps_that_never_meet_are_named(middleware):
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    arm = FakeArm(middleware)
    arm.connect()

    def told():
        arm.k += 1
        arm.send_parts(arm.k * PERIOD, {'joints'})
        arm.send_parts(arm.k * PERIOD + 10 ** 9, {'wrench'})
        middleware.pause(0.01)
        report = arm.newest_report()
        return report is not None and 'ms apart: expected at most 0.5 periods of 2 ms' in (
            report['loop'][1])

    wait_for(told, 'a warning')
    assert 'ms apart: expected at most 0.5 periods' in log_of(process)


@pytest.mark.parametrize('supervised', [True, False], ids=['supervised', 'bare'])
def test_stamps_that_stand_still_are_named_and_not_answered_for_ever(middleware, supervised):
    process = middleware.start(
        MODULE, 'autostart:=true', f'supervised:={str(supervised).lower()}', *PARAMETERS,
        files=(FILE,))
    arm = FakeArm(middleware)
    arm.connect()
    for _ in range(10):
        arm.step()
    arm.commands()
    answers = []

    def again():
        arm.send_parts(arm.k * PERIOD, {'joints', 'wrench'})
        middleware.pause(0.005)
        answers.extend(arm.commands())
        report = arm.newest_report()
        return report is not None and 'their stamps stand still at' in report['loop'][1]

    wait_for(again, 'a warning')
    count = len(answers)
    for _ in range(50):
        again()
    assert set(answers) == {arm.k * PERIOD}
    assert len(answers) > count if supervised else len(answers) == count <= 25
    np.testing.assert_array_equal(len(arm.step()), 6)  # goes on with the next stamp
    assert 'samples come, but their stamps stand still' in log_of(process)


def test_messages_that_are_refused_are_none(middleware):
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    arm = StrangeArm(middleware)
    arm.connect()
    arm.frame = 'tool0'
    # Of a busy machine joint states may be late, too, but not in every report.
    report = arm.diagnostics(lambda x: 'no ft_sensor/wrench for' in x['inputs'][1] and (
        'joint_states' not in x['inputs'][1]))
    assert int(report['messages'][2]['refused']) > 0
    log_of(process)


def test_a_rate_that_is_not_that_of_the_samples_is_named(middleware):
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    arm = FakeArm(middleware)
    arm.send_parts, send = (lambda stamp, parts: send(4 * stamp, parts)), arm.send_parts
    # Of a busy machine a sample or two may be missing.
    told = re.compile(r'samples come at 1[12]\d(\.\d)? Hz: expected 500 Hz \(rate\)')
    arm.diagnostics(lambda x: told.search(x['loop'][1]))
    log = log_of(process)
    # It is said once, also where a busy machine made it fewer just then.
    assert re.search(r'samples come at \d+(\.\d+)? Hz: expected 500 Hz \(rate\)', log)
    assert 'instead of control: clock_rate' in log


def test_a_start_outside_the_box_is_refused_and_said(middleware):
    process = middleware.start(
        MODULE, 'autostart:=true', *PARAMETERS, 'limits.workspace_upper:=[0.6, 0.9, 0.6]',
        files=(FILE,))
    arm = FakeArm(middleware)
    first = arm.connect()
    report = arm.diagnostics(lambda x: 'start_outside' in x['supervisor'][1])
    assert report['supervisor'][0] == 2
    assert 'operational point: expected z in 0.3 to 0.6 m' in report['supervisor'][1]
    torques = [arm.step() for _ in range(20)]
    np.testing.assert_allclose(torques[-1], arm.state.gravity, atol=1e-6)
    assert np.abs(first - arm.state.gravity).max() < 20.0
    log = log_of(process)
    assert ('control does not start, the arm is held until it is inside its limits: operational '
            'point: expected z in 0.3 to 0.6 m') in log
