"""
The bridge to a Franka arm, with a stand-in for libfranka whose time goes on when a test says so.

Nightly the way of docs/franka.md is gone, with libfranka itself and a simulated arm.
"""

from contextlib import suppress
import os
from queue import Empty, SimpleQueue
import re
import subprocess
import sys
from threading import Thread
from types import SimpleNamespace
from unittest.mock import MagicMock

from diagnostic_msgs.msg import DiagnosticStatus
from fake_arm import wrench_message
from geometry_msgs.msg import WrenchStamped
from multicontact_control.nodes.franka_bridge import FrankaBridge, LateConfig, LateRule
from multicontact_control.nodes.graph import ignore_message
from multicontact_control.nodes.runtime import Spinner
import numpy as np
import pytest
from rclpy.parameter import Parameter
from ros_graph import PATIENCE, ROOT, wait_for
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

JOINTS = [f'joint{i}' for i in range(1, 8)]
GRAVITY = np.arange(7.0)  # N m, that of the stand-in
LATE = LateConfig()
ConnectionLost = type('ConnectionLost', (RuntimeError,), {})


@pytest.mark.parametrize(
    ('age', 'kind', 'wanted'),
    [
        (0.006, 'commanded', 1.0),
        (0.007, 'held', 1.0),
        (0.02, 'held', 1.0),
        (0.021, 'damped', -4.0),
        (0.5, 'damped', -4.0),
        (0.501, 'stopped', None),
    ],
)
def test_late_rule_holds_damps_and_ends_within_the_rate_and_counts(age, kind, wanted):
    rule = LateRule(LATE)
    before = np.zeros(7)
    for _ in range(10):
        torque = rule.choose_torque(age, np.full(7, 1.0), np.full(7, 0.2), before)
        if torque is not None:
            assert np.abs(torque - before).max() < 1.0
            before = torque
    assert rule.kind == kind
    assert rule.figures[kind] == 10
    if wanted is None:
        assert torque is None
    else:
        assert torque[0] == pytest.approx(wanted)


class Bench:
    """
    A bridge with a stand-in for libfranka, and a controller and a sensor in the test's hand.

    The robot's time goes on by `cycles` that are put; `failure` is raised by its next state.
    """

    def __init__(self, middleware):
        self.cycles = SimpleQueue()
        self.time = 0
        self.failure = None
        self.mode = 'Idle'
        self.torque = [0.0] * 7
        self.sent = []
        self.status = {}
        self.robot = MagicMock(read_once=self.state)
        self.robot.load_model.return_value.gravity.return_value = GRAVITY
        self.robot.start_torque_control.return_value = SimpleNamespace(
            readOnce=lambda: (self.state('Move'), None), writeOnce=self.write
        )
        self.robot.automatic_error_recovery.side_effect = self.recover
        self.library = SimpleNamespace(
            FrankaException=ValueError,
            NetworkException=ConnectionLost,
            RealtimeConfig=SimpleNamespace(kEnforce=0, kIgnore=1),
            Robot=MagicMock(return_value=self.robot),
            Torques=lambda tau: SimpleNamespace(tau_J=tau, motion_finished=False),
        )
        self.middleware = middleware
        self._stop = []
        node = middleware.node
        self._bridge = FrankaBridge(
            self.library,
            context=node.context,
            parameter_overrides=[Parameter('address', value='127.0.0.1')],
        )
        self._spinner = Spinner(self._bridge, self._stop)
        self._thread = Thread(target=self._bridge.run, args=(self._spinner,))
        self._thread.start()
        self.samples = self.subscribe(JointState, 'joint_states')
        self.wrenches = self.subscribe(WrenchStamped, 'ft_sensor/wrench')
        self._statuses = self.subscribe(DiagnosticStatus, 'franka_bridge/status')
        self._commands = node.create_publisher(JointState, 'joint_effort_command', 10)
        self._sensor = node.create_publisher(WrenchStamped, 'franka_bridge/wrench', 10)

    def subscribe(self, message, name):
        node = self.middleware.node
        return node.create_subscription(message, name, ignore_message, 10)

    def recover(self):
        self.mode = 'Idle'

    def close(self):
        self._stop.append(2)
        self._thread.join()
        self._spinner.close()
        self._bridge.close()
        self._bridge.destroy_node()

    def state(self, mode=None):
        with suppress(Empty):
            self.cycles.get(timeout=0.2)  # a robot never stands still
        self.time += 1
        now = 1e-3 * self.time
        failure = self.failure
        self.failure = None
        if failure is not None:
            raise failure
        return SimpleNamespace(
            time=SimpleNamespace(to_sec=lambda: now),
            q=[0.1] * 7,
            dq=[0.2] * 7,
            tau_J=GRAVITY + self.torque,
            tau_J_d=self.torque,
            O_ddP_O=[0, 0, -9.81],
            robot_mode=f'RobotMode.{mode or self.mode}',
            current_errors='[]',
            control_command_success_rate=1.0,
        )

    def write(self, torques):
        self.sent.append(torques)
        self.torque = torques.tau_J

    def newest(self, subscription):
        """Let two cycles pass; return the newest message."""
        self.cycles.put(None)
        self.cycles.put(None)
        self.middleware.pause(0.01)
        return self.middleware.take(subscription)

    def command(self, effort):
        """Answer the newest sample, with a wrench of the sensor beside it."""
        sample = self.newest(self.samples)
        if sample is not None:
            wrench = wrench_message(0, '', [0.0, 0.0, effort, 0.0, 0.0, 0.0])
            answer = JointState(
                header=sample.header, name=JOINTS[::-1], effort=[effort] * 7
            )
            self._sensor.publish(wrench)
            self._commands.publish(answer)
        return sample

    def press(self, effort):
        """Command until the robot has got a torque."""

        def has_torque():
            return self.command(effort) and self.torque[0] == effort

        wait_for(has_torque, 'a torque')

    def wait_for_status(self, condition):
        """Wait until a status has message and values as a condition wants."""

        def matches():
            new = self.newest(self._statuses)
            if new is not None:
                self.status = {x.key: x.value for x in new.values}
                self.status['message'] = new.message
            return self.status and condition(self.status)

        wait_for(matches, 'a status', lambda: self.status)


@pytest.fixture
def bench(middleware):
    interval = sys.getswitchinterval()
    handle = Bench(middleware)
    yield handle
    handle.close()
    assert handle.sent[-1].motion_finished
    sys.setswitchinterval(interval)


@pytest.mark.ros
def test_bridge_publishes_pairs_without_gravity_and_obeys_until_commands_stay_away(
    bench,
):

    def loaded_sample():
        sample = bench.command(2.5)
        if sample is not None and sample.effort[0] == 2.5:
            return sample
        return None

    bench.press(2.5)
    sample = wait_for(loaded_sample, 'a sample')
    wrench = wait_for(lambda: bench.newest(bench.wrenches), 'a wrench')
    assert list(sample.name) == JOINTS
    assert list(sample.velocity) == [0.2] * 7
    assert list(sample.effort) == [2.5] * 7
    assert wrench.wrench.force.z == 2.5
    for message in (sample, wrench):  # the robot's time
        assert message.header.stamp.nanosec % 1_000_000 == 0
    before = len(bench.sent)
    for _ in range(600):
        bench.cycles.put(None)
    wait_for(lambda: bench.sent[-1].motion_finished, 'the end of torque control')
    torques = np.array([each.tau_J for each in bench.sent[before:]])
    first = torques[:, 0]
    damped = -0.2 * np.array(LATE.damping)
    assert np.abs(np.diff(first)).max() < 1.0
    assert np.count_nonzero(first == 2.5) <= 25  # 20 ms
    np.testing.assert_allclose(torques[-1], damped, rtol=1e-6)
    bench.wait_for_status(
        lambda status: int(status['damped']) > 400 and status['stopped'] == '1'
    )
    starts = int(bench.status['starts'])
    bench.press(1.0)  # the next command starts anew
    bench.wait_for_status(lambda status: int(status['starts']) == starts + 1)


@pytest.mark.ros
def test_bridge_waits_for_recovery_after_reflex_user_stop_and_lost_connection(
    bench, driver
):
    def recover():
        request = Trigger.Request()
        return driver.call_service('franka_bridge', Trigger, 'recover', request)

    def needs_recovery(status):
        return status['message'].endswith('; call ~/recover')

    for effort, failure, mode in (
        (1.5, RuntimeError('aborted by reflex'), 'Reflex'),
        (2.0, RuntimeError('aborted by user stop'), 'UserStopped'),
        (2.5, ConnectionLost('libfranka: UDP receive: Timeout'), 'Idle'),
    ):
        bench.press(effort)
        bench.failure = failure
        bench.mode = mode
        bench.wait_for_status(needs_recovery)
        message, _, _ = bench.status['message'].partition(';')
        assert message.split('1: ')[-1] in str(failure)
        sent = len(bench.sent)
        for _ in range(5):
            bench.command(9.0)
        assert all(each.motion_finished for each in bench.sent[sent:])
        if mode == 'UserStopped':
            bench.wait_for_status(lambda status: status['robot_mode'] == 'UserStopped')
            refused = recover()
            assert not refused.success
            assert 'release the user stop' in refused.message
            bench.mode = 'Idle'
            bench.wait_for_status(lambda status: status['robot_mode'] == 'Idle')
        answer = recover()
        assert answer.success, answer.message
    bench.press(0.5)
    bench.wait_for_status(
        lambda status: status['aborts'] == '3' and status['message'] == 'ok'
    )
    assert bench.robot.automatic_error_recovery.call_count == 2
    assert bench.library.Robot.call_count == 2


@pytest.mark.ros
@pytest.mark.nightly
def test_documented_way_presses_ten_newtons_with_a_simulated_fr3(domain_id, tmp_path):
    for name in ('pylibfranka', 'franky_sim'):
        pytest.importorskip(name, reason=f'{name} is not installed: extra [franka]')
    text = (ROOT / 'docs/franka.md').read_text(encoding='utf-8')
    simulate, simulator, bridge, run = re.findall(
        r'^(?:multicontact|python docs|franka_bridge)[^#\n]*', text, re.MULTILINE
    )[:4]
    for name in ('docs', 'config'):
        (tmp_path / name).symlink_to(ROOT / name)
    program = re.search(r'```python\n(.*?)```', text, re.DOTALL)[1]
    (tmp_path / 'press.py').write_text(program)
    python_folder = os.path.dirname(sys.executable)
    changes = {
        'PYTHONPATH': str(ROOT),
        'ROS_DOMAIN_ID': str(domain_id),
        'PATH': f'{python_folder}:{os.environ["PATH"]}',
    }
    script = f"""
        trap 'kill $(jobs -p)' EXIT
        {simulate} > log; {simulator} > log &
        {bridge} -p late.hold_time:=5.0 -p late.stop_time:=9.0 &
        {run} > run.log &
        until grep ready run.log >&2; do sleep 0.5; done
        python press.py"""
    printed = subprocess.run(
        ['timeout', str(PATIENCE), 'bash', '-ec', script],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env={**os.environ, **changes},
    ).stdout
    forces = [float(force) for force in re.findall(r"': ([\d.]+)", printed)]
    # At one time; 0.5 is for their mean.
    assert forces == pytest.approx([10.0, 10.0], abs=2.0)
