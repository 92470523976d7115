"""Samples that come late, in part, in another form or not at all, over the middleware."""

import time

from arms import HOME
from fake_arm import EFFORT, FakeArm, PARAMETERS, PERIOD, UNFELT, wrench_message
from multicontact_control.nodes import messages
from multicontact_control.nodes.diagnostics import InputMonitor
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.nodes.topics import (
    CONTROLLER,
    JOINT_STATES,
    NOISE_VARIANCE,
    TOPICS,
    WRENCH,
)
from multicontact_control.runs.graph.processes import LINE_LENGTH
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_graph import wait_for
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

pytestmark = pytest.mark.ros

# Far longer than the pauses of a busy machine, so that only what is left out is missed.
PATIENT = (
    'sensor.frozen_ticks:=0',
    UNFELT,
    'patience:=50.0',
    'watchdog.rate_band:=50.0',
)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
BOTH = {'joints', 'wrench'}


class StrangeArm(FakeArm):
    """Publishes best effort, with a gripper's joints among its own, the wrench 50 us later."""

    frame = 'ft_face'

    def send_parts(self, stamp, parts):
        joints = self.config.robot.joint_names[::-1]
        message = messages.joint_state_message(
            stamp, ['left_finger', *joints, 'right_finger'], velocity=np.zeros(8)
        )
        message.position = [np.nan, *map(float, HOME[::-1]), 0.04]
        message.effort = [np.nan, *map(float, EFFORT[::-1]), 0.04]
        self._joints.publish(message)
        self._wrench.publish(wrench_message(stamp + 50_000, self.frame, self.wrench))


def test_controller_subscribes_to_what_the_table_says_and_to_one_wrench(host):
    node = host.activate()
    expected = {WRENCH.name}
    for topic in TOPICS:
        if CONTROLLER in topic.subscribers:
            expected.add(topic.name)
    assert {
        subscription.topic_name.lstrip('/') for subscription in node.subscriptions
    } == expected


def test_parts_that_are_left_out_get_their_reaction_and_commands_go_on(host):
    host.activate(*PATIENT)
    arm = FakeArm(host)
    parts = BOTH

    def send():
        arm.send_parts(time.monotonic_ns() // PERIOD * PERIOD, parts)

    def answered():
        send()
        return arm.newest_command()

    def commanded():
        arm.newest_command()
        wait_for(answered, f'commands while there is {parts}')

    def supervisor_with(reaction, cause=''):
        def reacts(report):
            _, _, values = report['supervisor']
            return values['reaction'] == reaction and cause in values.get('causes', '')

        return arm.diagnostics(reacts, send)['supervisor']

    commanded()  # before the first one nothing is missing
    for parts, reaction, cause in (
        ({'joints'}, 'hold', 'wrench_stale'),
        ({'wrench'}, 'float', 'joints_stale'),
    ):
        level, _, values = supervisor_with(reaction, cause)
        assert level == 2
        assert int(values[f'ticks with {reaction}']) > 0
        commanded()
        parts = BOTH
        supervisor_with('none')


def refuses(text):
    """Return whether the diagnostics name a refusal, as a condition on them."""

    def condition(report):
        _, _, refusals = report['messages']
        return any(text in key for key in refusals)

    return condition


def test_older_sample_is_refused_and_a_clock_that_was_set_back_is_not(host):
    host.activate(*PARAMETERS)
    arm = FakeArm(host)
    arm.connect()
    torque = arm.settle(30)

    def send():
        arm.send_parts((arm.k - 10) * PERIOD, BOTH)
        for _ in range(20):
            host.pause()  # nothing is to overtake it

    for _ in range(3):
        send()
        before = torque
        torque = arm.step()
        # The blend at the start goes on.
        np.testing.assert_allclose(torque, before, atol=0.2)

    def send_and_step():
        send()
        arm.step()

    report = arm.diagnostics(refuses('stamp: expected one after'), send_and_step)
    _, _, values = report['supervisor']
    assert 'ticks with hold' not in values
    assert 'ticks with float' not in values
    arm.k -= 1000
    arm.connect()
    report = arm.diagnostics(lambda x: 'ticks with hold' in x['supervisor'][2])
    assert report['loop'][2]['restarts'] == '0'
    arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'none')


def test_driver_of_another_robot_is_understood_and_a_wrong_frame_is_refused(host):
    host.activate(*PARAMETERS)
    arm = StrangeArm(host, BEST_EFFORT)
    # The very first answer may go before it can be heard.
    np.testing.assert_allclose(arm.connect(), EFFORT, atol=1e-3)
    arm.settle(20)
    arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'none')
    arm.frame = 'tool0'
    arm.diagnostics(refuses('header.frame_id'))


@pytest.mark.parametrize(
    ('joints', 'wrench', 'part', 'text'),
    [
        (1, None, 'inputs', 'ft_sensor/wrench'),  # without a publisher
        (1, 10**9, 'loop', 'ms apart'),
        (4, 0, 'loop', 'expected 500 Hz'),
        (0, 0, 'loop', 'all with the same stamp'),
    ],
    ids=['missing', 'apart', 'rate', 'still'],
)
def test_samples_that_cannot_be_used_are_named(host, joints, wrench, part, text):
    """Joint states come with stamps so many periods apart, wrenches so much later, or not."""
    host.activate(*PARAMETERS)
    arm = FakeArm(host)

    def send():
        arm.k += joints
        arm.send_parts(arm.k * PERIOD, {'joints'})
        if wrench is not None:
            arm.send_parts(arm.k * PERIOD + wrench, {'wrench'})

    assert arm.diagnostics(lambda x: text in x[part][1], send)[part][0] > 0  # a warning


def test_second_node_that_publishes_joints_or_commands_is_named(host, host_domain):
    host.activate(*PARAMETERS, 'effort_output_topic:=/bare')
    arm = FakeArm(host)
    arm.connect()
    topics = {
        'joint_states': JointState,
        'joint_effort_command': JointState,
        '/bare': Float64MultiArray,
    }

    def has_two_of_each(report):
        _, _, counts = report['publishers']
        return all(counts[topic] == '2' for topic in topics)

    level, _, counts = arm.diagnostics(lambda x: 'publishers' in x)['publishers']
    assert level == 0
    for topic in topics:
        assert counts[topic] == '1'
    with ServiceClientNode('intruder', host_domain) as guest:
        for topic, message in topics.items():
            guest.node.create_publisher(message, topic, 1)
        report = arm.diagnostics(has_two_of_each, arm.step)
    level, text, _ = report['publishers']
    assert level == 1
    for name in ('intruder', *topics):
        assert name in text
    assert 'joint_states has 2 publishers, expected 1: intruder, sim_node' in text


def test_second_publisher_of_the_same_node_is_counted_and_not_named_twice(host):
    host.activate(*PARAMETERS)
    arm = FakeArm(host)
    second = FakeArm(host)
    arm.connect()
    report = arm.diagnostics(lambda x: x['publishers'][2]['joint_states'] == '2')
    _, text, _ = report['publishers']
    assert 'joint_states has 2 publishers, expected 1: sim_node (2 times, ' in text
    assert second.k == 0


@pytest.mark.parametrize(
    ('topic', 'options', 'missed'),
    [
        (JOINT_STATES, {}, True),
        (JOINT_STATES, {'may_pause': True}, False),
        (NOISE_VARIANCE, {}, False),
    ],
)
def test_input_that_came_before_is_missed_only_from_a_robot_that_goes_on(
    middleware, capfd, topic, options, missed
):
    inputs = InputMonitor(middleware.node, 500.0, topic, **options)
    publisher = middleware.node.create_publisher(topic.message, topic.name, 1)
    wait_for(lambda: middleware.node.count_publishers(topic.name), 'it is known')
    inputs.last[topic] = 1
    assert inputs.status(needed=True).warning.startswith(f'no {topic.name} for ')
    logged = capfd.readouterr().err
    assert (f'no message on /{topic.name} for ' in logged) == missed
    assert ('its publisher, sim_node, sends no more' in logged[:LINE_LENGTH]) == missed
    middleware.node.destroy_publisher(publisher)


def test_input_is_told_once_each_time_that_it_falls_silent_and_comes_again(
    middleware, capfd
):
    inputs = InputMonitor(middleware.node, 500.0, JOINT_STATES, WRENCH)

    def logged(joints, wrench):
        inputs.last = {JOINT_STATES: joints, WRENCH: wrench}
        for _ in range(2):
            inputs.status(needed=True)
        lines = capfd.readouterr().err.splitlines()
        return [line.rpartition(']: ')[2].partition(' for ')[0] for line in lines]

    for _ in range(2):
        now = time.monotonic_ns()
        assert logged(now, now) == []
        silent = now - 2 * 10**9
        assert logged(silent, now) == ['no message on /joint_states']
        assert logged(silent, silent) == ['no message on /ft_sensor/wrench']
        now = time.monotonic_ns()
        assert logged(now, now) == [
            'messages on /joint_states come now',
            'messages on /ft_sensor/wrench come now',
        ]
