"""Samples that do not come, or all at once, over the middleware and in real time."""

from __future__ import annotations

import signal
import threading
import time

from arms import HOME
from fake_arm import FakeArm, PERIOD, UNFELT
from multicontact_control.nodes import messages
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from ros_graph import wait_for
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

MODULE = 'multicontact_control.nodes.controller_node'
FILE = config_dir() / 'controller.yaml'
STILL = ('autostart:=true', 'watchdog.frozen_samples:=0', 'sensor.frozen_ticks:=0', UNFELT)
# Far longer than the pauses of a busy machine, so that only what is left out is missed.
PATIENT = (*STILL, 'patience:=50.0')


class Source(threading.Thread):
    """Sends samples at their rate, each with the time it was sent; parts can be left out."""

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


@pytest.fixture
def source(middleware):
    made = []

    def make(origin, *parameters):
        middleware.start(MODULE, *parameters, files=(FILE,))
        arm = FakeArm(middleware)
        made.append(Source(arm, origin))
        made[0].start()
        return arm, made[0]

    yield make
    for thread in made:
        thread.running = False
        thread.join()


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


@pytest.mark.parametrize('origin', [0, 1_700_000_000 * 10 ** 9])
def test_what_is_left_out_gets_its_reaction_and_commands_go_on(middleware, source, origin):
    """The stamps' clock is its own: it began at 0, or is off from ours by years."""
    arm, samples = source(origin, *PATIENT)
    report_with(arm, 'none')
    for parts, reaction, cause in (({'joints'}, 'hold', 'wrench_stale'),
                                   ({'wrench'}, 'float', 'joints_stale'),
                                   (set(), 'float', 'joints_stale')):
        samples.parts = parts
        report = report_with(arm, reaction, cause)
        level, text, values = report['supervisor']
        assert level == 2
        assert f'{reaction} instead of control: ' in text
        assert int(values[f'ticks with {reaction}']) > 0
        arm.newest_command()
        wait_for(arm.newest_command, f'commands while there is {parts or "nothing"}')
        samples.parts = {'joints', 'wrench'}
        report_with(arm, 'none')


def test_a_burst_is_not_worked_through_but_its_newest_sample_is_answered(middleware):
    process = middleware.start(MODULE, *STILL, 'patience:=0.0', files=(FILE,))
    arm = FakeArm(middleware)
    arm.connect()
    arm.step()
    before = arm.k
    process.send_signal(signal.SIGSTOP)
    for _ in range(60):
        arm.send()
    process.send_signal(signal.SIGCONT)
    answered = []

    def newest_answered():
        answered.extend(arm.commands())
        return answered and answered[-1] == arm.k * PERIOD

    wait_for(newest_answered, 'an answer to the newest sample')
    assert answered == sorted(answered)
    assert answered[0] > before * PERIOD
    assert len(answered) < 30
    skipped = []

    def counted():
        report = arm.newest_report()
        if report is not None:
            skipped.append(int(report['loop'][2]['deadline_misses_in_all']))
        return skipped and skipped[-1] >= 60 - len(answered)

    wait_for(counted, 'a count of what was overtaken')


def test_an_older_sample_is_refused_and_a_clock_that_was_set_back_is_not(middleware):
    middleware.start(MODULE, *STILL, 'patience:=0.0', files=(FILE,))
    arm = FakeArm(middleware)
    arm.connect()
    for _ in range(30):
        torque = arm.step()
    for _ in range(5):
        arm.send_parts((arm.k - 10) * PERIOD, {'joints', 'wrench'})
        middleware.pause(0.05)  # nothing is to overtake it
        before, torque = torque, arm.step()
        np.testing.assert_allclose(torque, before, atol=0.2)  # the blend at the start goes on
    reports = []

    def refused():
        arm.send_parts((arm.k - 10) * PERIOD, {'joints', 'wrench'})
        middleware.pause(0.01)
        arm.step()
        reports.extend(filter(None, [arm.newest_report()]))
        return reports and any(
            'stamp: expected one after' in key for key in reports[-1]['messages'][2])

    wait_for(refused, 'a refusal', lambda: reports[-1:])
    report = reports[-1]
    assert report['supervisor'][2].keys().isdisjoint({'ticks with hold', 'ticks with float'})
    arm.k -= 1000
    arm.connect()
    report = arm.diagnostics(lambda x: 'ticks with hold' in x['supervisor'][2])
    assert report['loop'][2]['restarts'] == '0'
    arm.diagnostics(lambda x: x['supervisor'][2]['reaction'] == 'none')


def test_fake_arm_sends_what_it_is_asked_to(middleware):
    arm = FakeArm(middleware)
    seen = middleware.node.create_subscription(JointState, 'joint_states', lambda _: None, 10)
    wait_for(lambda: seen.get_publisher_count(), 'connection')
    newest = []

    def come():
        arm.send_parts(7, {'joints'})
        newest.append(middleware.take(seen, JointState))
        return newest[-1]

    wait_for(come, 'a joint state')
    assert messages.stamp_to_ns(newest[-1].header.stamp) == 7
    np.testing.assert_array_equal(newest[-1].position, HOME)
