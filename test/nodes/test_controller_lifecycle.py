"""The life cycle of controller and noise estimator, as processes."""

from __future__ import annotations

import contextlib

from fake_arm import EFFORT, FakeArm
from fake_arm import PARAMETERS as STILL
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import ignore
from multicontact_control.nodes.link import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
    NoAnswerError,
    SHUT_DOWN,
    TransitionError,
)
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from ros_graph import end_of, PATIENCE, set_parameter, wait_for
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros

MODULE = 'multicontact_control.nodes.controller_node'
NAME = 'controller_node'
FILE = config_dir() / 'controller.yaml'
RATE, BLEND = 100.0, 0.02  # transition.torque_rate [N m/s], transition.blend_time [s]
PARAMETERS = (*STILL, f'transition.torque_rate:={RATE}', f'transition.blend_time:={BLEND}')
LARGEST_STEP = RATE * 0.002 * (1.0 + 1e-9)


@pytest.fixture
def process(middleware):
    return middleware.start(MODULE, *PARAMETERS, files=(FILE,))


@pytest.fixture
def arm(middleware):
    return FakeArm(middleware)


def settle(arm):
    for _ in range(60):
        torque = arm.step()
    return torque


def test_controller_goes_through_every_transition_again_and_again(process, driver, arm):
    gravity = arm.state.gravity
    for transition in (ACTIVATE, DEACTIVATE, CLEAN_UP):  # not possible yet
        with pytest.raises(TransitionError):
            driver.change(NAME, transition)
    assert driver.state(NAME) == 'unconfigured'
    for _ in range(2):
        driver.change(NAME, CONFIGURE)
        arm.send()
        driver.change(NAME, ACTIVATE)
        arm.connect()
        driver.change(NAME, DEACTIVATE)
        driver.change(NAME, ACTIVATE)
        np.testing.assert_array_equal(arm.step(), EFFORT)  # nothing is remembered
        second = arm.step()
        assert 0.0 < np.abs(second - EFFORT).max() <= LARGEST_STEP
        np.testing.assert_allclose(settle(arm), gravity, atol=1e-6)
        driver.change(NAME, DEACTIVATE)
        np.testing.assert_allclose(arm.step(), gravity, atol=1e-6)
        driver.change(NAME, CLEAN_UP)
        stamp = arm.send()
        assert driver.state(NAME) == 'unconfigured'
        assert arm.answer(stamp) is None
    driver.change(NAME, SHUT_DOWN)
    assert process.wait(PATIENCE) == 0


def test_deactivation_and_end_go_to_the_declared_behaviour_without_a_jump(
        process, middleware, driver, arm):
    for transition in (CONFIGURE, ACTIVATE):
        driver.change(NAME, transition)
    arm.connect()
    assert set_parameter(driver, NAME, 'safe_behaviour.kind', 'zero_torque').successful
    last = settle(arm)
    driver.change(NAME, DEACTIVATE)
    torques = [last] + [arm.step() for _ in range(300)]
    np.testing.assert_array_equal(torques[1], last)
    assert np.abs(np.diff(torques, axis=0)).max() <= LARGEST_STEP
    assert np.abs(torques[-1]).max() < 0.5 * np.abs(last).max()
    driver.change(NAME, ACTIVATE)
    torques = [settle(arm)]
    process.terminate()
    while process.poll() is None:
        arm.send()
        middleware.pause()
        command = arm.newest_command()
        if command is not None:
            torques.append(np.array(command.effort))
    assert process.returncode == 0
    assert np.abs(torques[-1]).max() < np.abs(torques[0]).max() - 5 * LARGEST_STEP


def test_configure_refuses_what_is_wrong_until_it_is_repaired(middleware, driver):
    process = middleware.start(
        MODULE, 'robot.urdf:=nowhere.urdf', 'rate:=-500.0', "effort_output_topic:='bare efforts'",
        files=(FILE,))
    for name, value in (('rate', 500.0), ('robot.urdf', 'puma560.urdf'),
                        ('effort_output_topic', '~/efforts')):
        with pytest.raises(TransitionError):
            driver.change(NAME, CONFIGURE)
        assert driver.state(NAME) == 'unconfigured'
        assert set_parameter(driver, NAME, name, value).successful
    driver.change(NAME, CONFIGURE)
    assert driver.state(NAME) == 'inactive'
    process.kill()
    errors = process.communicate()[1]
    for name in ('rate', 'robot.urdf', 'effort_output_topic'):
        assert f'cannot configure: {name}: expected' in errors
    assert 'Traceback' not in errors


def test_autostart_begins_alone_or_ends_with_the_reason(middleware, arm):
    bad = middleware.start(
        MODULE, 'force.time_constant:=-1.0', files=(FILE,), flags=('--autostart',))
    process = middleware.start(MODULE, 'autostart:=true', *PARAMETERS, files=(FILE,))
    arm.connect()
    assert process.poll() is None
    _, errors = end_of(bad)
    assert bad.returncode == 2
    assert errors.splitlines()[-1].endswith(
        'force.time_constant: expected greater than 0, found -1.0')


def test_force_control_waits_for_the_push_test_where_it_is_required(middleware, driver):
    middleware.start(MODULE, *PARAMETERS, 'sensor.require_push_test:=true', files=(FILE,))
    driver.change(NAME, CONFIGURE)

    def ask():  # ROS loses an answer to a client that its service does not know yet
        with contextlib.suppress(NoAnswerError):
            return driver.call(NAME, Trigger, 'push_test', Trigger.Request(), timeout=10.0)

    answer = wait_for(ask, 'an answer')
    assert answer.success and answer.message
    driver.change(NAME, ACTIVATE)
    arm = FakeArm(middleware)
    arm.connect()
    wait_for(arm.force_command.get_subscription_count, 'connection')
    arm.force_command.publish(messages.joint_state_message(0, ['table'], effort=[5.0]))
    report = arm.diagnostics(lambda x: any(
        'contact_forces/command' in key for key in x['messages'][2]))
    assert report['sensor'][2]['force_control'] == 'disabled'
    settle(arm)
    assert arm.desired() == {'table': 0.0, 'board': 0.0}


def test_estimator_forgets_its_window_and_is_silent_while_inactive(middleware, driver):
    process = middleware.start('multicontact_control.nodes.noise_estimator_node',
                               files=(config_dir() / 'noise_estimator.yaml',))
    node, stamps = middleware.node, [0]
    publisher = node.create_publisher(
        JointState, topics.MEASURED_FORCES.name, topics.MEASURED_FORCES.profile)
    variances = node.create_subscription(JointState, topics.NOISE_VARIANCE.name, ignore, 1000)

    def answer(force, since=0):
        """Send a sample; return the newest answer to one from then on, which may be late."""
        stamps.append(stamps[-1] + 2_000_000)
        publisher.publish(messages.joint_state_message(
            stamps[-1], ['table', 'board'], effort=[force, force]))
        middleware.pause(0.002)
        found = middleware.take(variances, JointState)
        late = found is not None and messages.stamp_to_ns(found.header.stamp) <= since
        return None if late else found

    def varies():
        found = answer((-1.0) ** len(stamps))
        return found is not None and found.effort[0] > 1.0

    driver.change(topics.ESTIMATOR, CONFIGURE)
    for _ in range(2):
        driver.change(topics.ESTIMATOR, ACTIVATE)
        since = stamps[-1]
        first = wait_for(lambda since=since: answer(1.0, since), 'first variance')
        assert list(first.effort) == [0.6, 0.6]  # the fixed one, until the window is full
        wait_for(varies, 'variance of an alternating force')
        driver.change(topics.ESTIMATOR, DEACTIVATE)
        since = stamps[-1]
        answer(1.0)
        assert driver.state(topics.ESTIMATOR) == 'inactive'
        assert answer(1.0, since) is None
    driver.change(topics.ESTIMATOR, CLEAN_UP)
    driver.change(topics.ESTIMATOR, SHUT_DOWN)
    assert process.wait(PATIENCE) == 0
