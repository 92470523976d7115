"""Samples that come late, in part, in another form or not at all, over the middleware."""

from __future__ import annotations

import signal
import threading
import time

from arms import HOME
from fake_arm import EFFORT, FakeArm, PARAMETERS, PERIOD, UNFELT
from multicontact_control.nodes import messages
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_graph import end_of, wait_for

pytestmark = pytest.mark.ros

MODULE = 'multicontact_control.nodes.controller_node'
FILE = config_dir() / 'controller.yaml'
# Far longer than the pauses of a busy machine, so that only what is left out is missed.
PATIENT = ('watchdog.frozen_samples:=0', 'sensor.frozen_ticks:=0', UNFELT, 'patience:=50.0')
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATE = 50_000  # ns


class Source(threading.Thread):
    """Sends samples at their rate, with stamps of a clock of its own; parts can be left out."""

    def __init__(self, arm, origin):
        super().__init__(daemon=True)
        self._arm, self._origin = arm, origin
        self.parts = {'joints', 'wrench'}
        self.running = True

    def run(self):
        start, k = time.monotonic(), 0
        while self.running:
            k += 1
            self._arm.send_parts(self._origin + k * PERIOD, self.parts)
            time.sleep(max(0.0, start + 0.002 * k - time.monotonic()))


class StrangeArm(FakeArm):
    """Publishes best effort, with a gripper's joints among its own, the wrench 50 us later."""

    frame = 'ft_face'

    def send_parts(self, stamp, parts):
        names = ['left_finger', *reversed(self.config.robot.joint_names), 'right_finger']
        if 'joints' in parts:
            position, effort = ([np.nan, *reversed(x), 0.04] for x in (HOME, EFFORT))
            message = messages.joint_state_message(stamp, names, velocity=np.zeros(8))
            message.position, message.effort = list(map(float, position)), list(map(float, effort))
            self._joints.publish(message)
        if 'wrench' in parts:
            self._wrench.publish(messages.wrench_message(stamp + LATE, self.wrench, self.frame))


@pytest.fixture
def controller(middleware):
    def start(*parameters):
        return middleware.start(MODULE, 'autostart:=true', *parameters, files=(FILE,))
    return start


def report_with(arm, reaction, cause=''):
    """Wait for diagnostics in which the supervisor reacts like that, for that cause."""
    found = []

    def told():
        # Without causes there has been no sample yet.
        report = arm.newest_report()
        values = report['supervisor'][2] if report and 'supervisor' in report else {}
        if 'causes' in values:
            found.append(report)
            return values['reaction'] == reaction and cause in values['causes']
        return False

    wait_for(told, f'a report of {reaction} {cause}', lambda: found[-1:])
    return found[-1]


def wait_for_report(arm, middleware, send, condition):
    """Send until a report satisfies a condition; return it."""
    seen = []

    def told():
        send()
        middleware.pause(0.005)
        report = arm.newest_report()
        seen.extend([report] if report is not None else [])
        return report if report is not None and condition(report) else None

    return wait_for(told, 'such a report', lambda: seen[-1:])


def test_parts_that_are_left_out_get_their_reaction_and_commands_go_on(middleware, controller):
    controller(*PATIENT)
    arm = FakeArm(middleware)
    source = Source(arm, 1_700_000_000 * 10 ** 9)
    source.start()
    try:
        report_with(arm, 'none')
        for parts, reaction, cause in (({'joints'}, 'hold', 'wrench_stale'),
                                       ({'wrench'}, 'float', 'joints_stale')):
            source.parts = parts
            level, _, values = report_with(arm, reaction, cause)['supervisor']
            assert level == 2 and int(values[f'ticks with {reaction}']) > 0
            arm.newest_command()
            wait_for(arm.newest_command, f'commands while there is {parts}')
            source.parts = {'joints', 'wrench'}
            report_with(arm, 'none')
    finally:
        source.running = False
        source.join()


def test_older_sample_is_refused_and_a_clock_that_was_set_back_is_not(middleware, controller):
    controller(*PARAMETERS)
    arm = FakeArm(middleware)
    arm.connect()
    for _ in range(30):
        torque = arm.step()
    for _ in range(3):
        arm.send_parts((arm.k - 10) * PERIOD, {'joints', 'wrench'})
        middleware.pause(0.05)  # nothing is to overtake it
        before, torque = torque, arm.step()
        np.testing.assert_allclose(torque, before, atol=0.2)  # the blend at the start goes on

    def send():
        arm.send_parts((arm.k - 10) * PERIOD, {'joints', 'wrench'})
        middleware.pause(0.01)
        arm.step()

    report = wait_for_report(arm, middleware, send, lambda x: any(
        'stamp: expected one after' in key for key in x['messages'][2]))
    assert report['supervisor'][2].keys().isdisjoint({'ticks with hold', 'ticks with float'})
    arm.k -= 1000
    arm.connect()
    report = arm.diagnostics(lambda x: 'ticks with hold' in x['supervisor'][2])
    assert report['loop'][2]['restarts'] == '0'
    arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'none')


def test_driver_of_another_robot_is_understood_and_a_wrong_frame_is_refused(
        middleware, controller):
    controller(*PARAMETERS)
    arm = StrangeArm(middleware, BEST_EFFORT)
    # The very first answer may go before it can be heard.
    np.testing.assert_allclose(arm.connect(), EFFORT, atol=1e-3)
    for _ in range(20):
        arm.step()
    report = arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'none')
    assert int(report['messages'][2]['slow']) <= 4  # the first of each; then in place
    assert report['messages'][2]['refused'] == '0'
    arm.frame = 'tool0'
    # What is refused is no input. Of a busy machine joint states may be late, too.
    report = arm.diagnostics(lambda x: 'ft_sensor/wrench' in x['inputs'][1] and (
        'joint_states' not in x['inputs'][1]))
    assert any('frame_id' in key for key in report['messages'][2])


def test_input_without_a_publisher_is_named_in_the_log(middleware, controller):
    process = controller(*PARAMETERS)
    arm = FakeArm(middleware)

    def send():
        arm.k += 1
        arm.send_parts(arm.k * PERIOD, {'joints'})

    start = time.monotonic()
    wait_for_report(arm, middleware, send, lambda x: (
        'ft_sensor/wrench' in x['inputs'][1] and time.monotonic() > start + 2.5))
    process.send_signal(signal.SIGINT)
    assert 'no message on /ft_sensor/wrench' in end_of(process)[1]


def test_stamps_that_never_meet_are_named(middleware, controller):
    controller(*PARAMETERS)
    arm = FakeArm(middleware)
    arm.connect()

    def send():
        arm.k += 1
        arm.send_parts(arm.k * PERIOD, {'joints'})
        arm.send_parts(arm.k * PERIOD + 10 ** 9, {'wrench'})

    wait_for_report(arm, middleware, send, lambda x: 'ms apart' in x['loop'][1])


@pytest.mark.parametrize('supervised', [True, False], ids=['supervised', 'bare'])
def test_stamps_that_stand_still_are_named_and_not_answered_for_ever(
        middleware, controller, supervised):
    controller(f'supervised:={str(supervised).lower()}', *PARAMETERS)
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

    wait_for_report(arm, middleware, again, lambda x: 'stand still' in x['loop'][1])
    count = len(answers)
    for _ in range(50):
        again()
    assert set(answers) == {arm.k * PERIOD}
    assert len(answers) > count if supervised else len(answers) == count <= 25
    assert len(arm.step()) == 6  # goes on with the next stamp


def test_rate_that_is_not_that_of_the_samples_is_named(middleware, controller):
    controller(*PARAMETERS)
    arm = FakeArm(middleware)
    arm.send_parts, send = (lambda stamp, parts: send(4 * stamp, parts)), arm.send_parts
    report = arm.diagnostics(lambda x: 'expected 500 Hz' in x['loop'][1])
    assert 'samples come at 1' in report['loop'][1]  # 125 Hz, fewer on a busy machine


def test_start_outside_the_workspace_is_refused_and_the_arm_is_held(middleware, controller):
    controller(*PARAMETERS, 'limits.workspace_upper:=[0.6, 0.9, 0.6]')
    arm = FakeArm(middleware)
    first = arm.connect()
    report = arm.diagnostics(lambda x: 'start_outside' in x['supervisor'][1])
    assert report['supervisor'][0] == 2
    assert 'expected z in 0.3 to 0.6 m' in report['supervisor'][1]
    torques = [arm.step() for _ in range(20)]
    np.testing.assert_allclose(torques[-1], arm.state.gravity, atol=1e-6)
    assert np.abs(first - arm.state.gravity).max() < 20.0
