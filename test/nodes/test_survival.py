"""A graph in real time that loses a part: what is left goes on, and says so."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from multicontact_control.experiment.lifecycle import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
    LifecycleDriver,
    SHUT_DOWN,
)
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from ros_graph import wait_for
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

CONTROLLER = 'multicontact_control.nodes.controller_node'
ESTIMATOR = 'multicontact_control.nodes.noise_estimator_node'
SIM = 'sim_bridge.sim_node'
FILES = {CONTROLLER: 'controller.yaml', ESTIMATOR: 'noise_estimator.yaml', SIM: 'plant_puma.yaml'}


class Watch:
    """Stamps of a topic, as they come."""

    def __init__(self, middleware, topic):
        self._middleware, self._topic = middleware, topic
        self._subscription = middleware.node.create_subscription(
            topic.message, topic.name, lambda _: None, qos.INPUT)

    def newest(self):
        """Return the newest message, None if none has come since."""
        return self._middleware.take(self._subscription, self._topic.message)

    def advance_and_take(self):
        """Return the newest message after some more have come."""
        self.advances()
        found = []
        wait_for(lambda: found.append(self.newest()) or found[-1] is not None, 'one more')
        return found[-1]

    def advances(self, count=20):
        """Wait until this many newer messages have come."""
        self.newest()
        seen = set()

        def enough():
            message = self.newest()
            if message is not None:
                seen.add(messages.stamp_to_ns(message.header.stamp))
            return len(seen) >= count

        wait_for(enough, f'{count} messages on {self._topic.name}')
        return sorted(seen)


@pytest.fixture
def start(middleware):
    def start_node(module, *parameters):
        return middleware.start(
            module, *parameters, files=(config_dir() / FILES[module],))
    return start_node


def wait_for_status(watch, node, part, condition):
    def told():
        report = watch.newest()
        return report is not None and any(
            x.name == f'{node}: {part}' and condition(x) for x in report.status)
    wait_for(told, f'{node} to tell of its {part}')


def test_controller_goes_on_without_its_estimator_and_says_so(middleware, start):
    start(SIM)
    start(CONTROLLER, 'autostart:=true')
    estimator = start(ESTIMATOR, 'autostart:=true')
    commands = Watch(middleware, topics.EFFORT_COMMAND)
    variances = Watch(middleware, topics.NOISE_VARIANCE)
    reports = Watch(middleware, topics.DIAGNOSTICS)
    variances.advances()
    estimator.kill()
    estimator.wait()
    wait_for_status(
        reports, 'controller_node', 'inputs',
        lambda x: x.level == b'\1' and 'contact_forces/noise_variance' in x.message
        and 'the last R is held' in x.message)
    assert len(commands.advances()) >= 20
    # The last R is not forgotten.
    first, later = [], []
    for found in (first, later):
        wait_for_status(
            reports, 'controller_node', 'contacts', lambda x, found=found: found.extend(
                float(v.value) for v in x.values if v.key.endswith('noise_variance_n2'))
            or bool(found))
    assert len(first) == 2
    assert 0.0 < min(first)
    assert later == first != [0.6, 0.6]
    # A new one is taken on as if nothing had been.
    start(ESTIMATOR, 'autostart:=true')
    variances.advances()
    wait_for_status(
        reports, 'controller_node', 'inputs',
        lambda x: 'the last R is held' not in x.message)


def test_controller_can_be_killed_and_started_again_mid_run(middleware, start):
    start(SIM)
    commands = Watch(middleware, topics.EFFORT_COMMAND)
    reports = Watch(middleware, topics.DIAGNOSTICS)
    for _ in range(2):
        controller = start(CONTROLLER, 'autostart:=true')
        commands.advances()
        controller.kill()
        controller.wait()
        wait_for_status(
            reports, 'sim_node', 'inputs',
            lambda x: x.level == b'\1' and 'the drives hold their position' in x.message)


@pytest.mark.parametrize('ahead', [0, 100])
def test_drives_hold_their_position_while_nobody_commands_them(middleware, start, ahead):
    # Half a second, so that only somebody who does not command at all is too late.
    start(SIM, 'command_timeout:=0.5')
    samples = Watch(middleware, topics.JOINT_STATES)
    reports = Watch(middleware, topics.DIAGNOSTICS)
    publisher = middleware.node.create_publisher(
        JointState, topics.EFFORT_COMMAND.name, topics.EFFORT_COMMAND.profile)
    found = []
    wait_for(lambda: found.append(samples.newest()) or found[-1] is not None, 'sample 0')
    first = found[-1]
    # One sample answered again and again is enough, even one that has not come yet: the newest
    # command is the one in force.
    stamp = messages.stamp_to_ns(first.header.stamp) + ahead * 2_000_000
    answer = messages.joint_state_message(stamp, first.name, effort=first.effort)

    def loop_of_sim():
        report = reports.newest()
        return next(({x.key: x.value for x in status.values} for status in (
            report.status if report is not None else ()) if status.name == 'sim_node: loop'), None)

    def commanded_for_long():
        publisher.publish(answer)
        loop = loop_of_sim()
        return loop is not None and int(loop['ticks']) > 700 and loop['command_timeouts'] == '0'

    wait_for(commanded_for_long, 'a second and more without a timeout')
    wait_for(lambda: (loop_of_sim() or {}).get('command_timeouts') == '1', 'a timeout')
    before = np.array(samples.advance_and_take().position)
    after = np.array(samples.advance_and_take().position)
    np.testing.assert_allclose(after, before, atol=1e-3)


def test_estimator_goes_through_every_transition_again_and_again(domain_id, middleware, start):
    process = start(ESTIMATOR)
    publisher = middleware.node.create_publisher(
        JointState, topics.MEASURED_FORCES.name, topics.MEASURED_FORCES.profile)
    variances = Watch(middleware, topics.NOISE_VARIANCE)
    stamp = 0

    def answer(force):
        nonlocal stamp
        stamp += 2_000_000
        publisher.publish(messages.joint_state_message(
            stamp, ['table', 'board'], effort=[force, force]))
        middleware.pause(0.002)
        return variances.newest()

    def first_variance():
        found = []
        wait_for(lambda: found.append(answer(1.0)) or found[-1], 'first variance')
        return list(found[-1].effort)

    def alternate():
        found = answer((-1.0) ** (stamp // 2_000_000))
        return found is not None and found.effort[0] > 1.0

    with LifecycleDriver(domain_id) as driver:
        for _ in range(2):
            driver.change(topics.ESTIMATOR, CONFIGURE)
            for _ in range(2):
                driver.change(topics.ESTIMATOR, ACTIVATE)
                # The window of the last activation is forgotten: the fixed variance again.
                assert first_variance() == [0.6, 0.6]
                wait_for(alternate, 'variance of an alternating force')
                driver.change(topics.ESTIMATOR, DEACTIVATE)
                assert answer(1.0) is None
            driver.change(topics.ESTIMATOR, CLEAN_UP)
        driver.change(topics.ESTIMATOR, SHUT_DOWN)
    assert process.wait(60) == 0


def test_diagnostics_are_of_the_type_that_viewers_expect():
    assert topics.DIAGNOSTICS.message is DiagnosticArray
    assert topics.DIAGNOSTICS.type_name == 'diagnostic_msgs/msg/DiagnosticArray'
