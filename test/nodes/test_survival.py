"""A graph in real time that loses a part: what is left goes on, and says so."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.link import (
    ACTIVATE,
    CLEAN_UP,
    CONFIGURE,
    DEACTIVATE,
    LifecycleDriver,
    SHUT_DOWN,
)
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from ros_graph import PATIENCE, wait_for
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
        return wait_for(self.newest, 'one more')

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
    seen = []

    def told():
        report = watch.newest()
        seen.extend(x for x in (report.status if report is not None else ())
                    if x.name == f'{node}: {part}')
        return seen and condition(seen[-1])

    wait_for(told, f'{node} to tell of its {part}', lambda: seen[-1:])


def test_controller_goes_on_without_its_estimator_and_says_so(middleware, start):
    start(SIM)
    start(CONTROLLER, 'autostart:=true')
    estimator = start(ESTIMATOR, 'autostart:=true')
    commands = Watch(middleware, topics.EFFORT_COMMAND)
    variances = Watch(middleware, topics.NOISE_VARIANCE)
    reports = Watch(middleware, topics.DIAGNOSTICS)
    told = {}

    def noise_variances(found):
        told.update({x.key: float(x.value) for x in found.values
                     if x.key.endswith('noise_variance_n2')})
        return list(told.values())

    # Only what the controller has taken on can be held.
    wait_for_status(reports, 'controller_node', 'contacts',
                    lambda x: noise_variances(x) not in ([], [0.6, 0.6]))
    estimator.kill()
    estimator.wait()
    wait_for_status(
        reports, 'controller_node', 'inputs',
        lambda x: x.level == b'\1' and 'contact_forces/noise_variance' in x.message
        and 'the last R is held' in x.message)
    assert len(commands.advances()) >= 20
    # The last R is not forgotten.
    held = []
    for _ in range(2):
        wait_for_status(reports, 'controller_node', 'contacts', noise_variances)
        held.append(list(told.values()))
    first, later = held
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
        assert len(commands.advances()) >= 20
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
    first = wait_for(samples.newest, 'sample 0')
    # One sample answered again and again is enough, even one that has not come yet: the newest
    # command is the one in force.
    stamp = messages.stamp_to_ns(first.header.stamp) + ahead * 2_000_000
    answer = messages.joint_state_message(stamp, first.name, effort=first.effort)

    def loop_of_sim():
        report = reports.newest()
        return next(({x.key: x.value for x in status.values} for status in (
            report.status if report is not None else ()) if status.name == 'sim_node: loop'), None)

    # By how many timeouts there were, the ticks at which that was told. On a busy machine this
    # test itself may be too late, but not for ever.
    told = {}

    def commanded_for_long():
        publisher.publish(answer)
        loop = loop_of_sim()
        if loop is not None:
            told.setdefault(int(loop['command_timeouts']), []).append(int(loop['ticks']))
        return any(ticks[-1] - ticks[0] > 700 for ticks in told.values())

    wait_for(commanded_for_long, 'a second and more without a timeout', lambda: told)
    wait_for_status(reports, 'sim_node', 'inputs',
                    lambda x: 'the drives hold their position' in x.message)
    # One silence is one timeout, however long it is.
    counts = [int(wait_for(loop_of_sim, 'its loop')['command_timeouts']) for _ in range(2)]
    assert counts[0] == counts[1] > max(told)
    before = np.array(samples.advance_and_take().position)
    after = np.array(samples.advance_and_take().position)
    np.testing.assert_allclose(after, before, atol=1e-3)


def test_estimator_goes_through_every_transition_again_and_again(domain_id, middleware, start):
    process = start(ESTIMATOR)
    publisher = middleware.node.create_publisher(
        JointState, topics.MEASURED_FORCES.name, topics.MEASURED_FORCES.profile)
    variances = Watch(middleware, topics.NOISE_VARIANCE)
    stamp = 0

    def send(force):
        nonlocal stamp
        stamp += 2_000_000
        publisher.publish(messages.joint_state_message(
            stamp, ['table', 'board'], effort=[force, force]))

    def answer(force, since):
        """Send a sample; return the newest answer to one from then on, which may be late."""
        send(force)
        middleware.pause(0.002)
        found = variances.newest()
        late = found is not None and messages.stamp_to_ns(found.header.stamp) <= since
        return None if late else found

    def first_variance():
        since = stamp
        return list(wait_for(lambda: answer(1.0, since), 'first variance').effort)

    def alternate():
        found = answer((-1.0) ** (stamp // 2_000_000), 0)
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
                since = stamp
                send(1.0)
                # It answers one thing after the other.
                assert driver.state(topics.ESTIMATOR) == 'inactive'
                assert answer(1.0, since) is None
            driver.change(topics.ESTIMATOR, CLEAN_UP)
        driver.change(topics.ESTIMATOR, SHUT_DOWN)
    assert process.wait(PATIENCE) == 0


def test_diagnostics_are_of_the_type_that_viewers_expect():
    assert topics.DIAGNOSTICS.message is DiagnosticArray
    assert topics.DIAGNOSTICS.type_name == 'diagnostic_msgs/msg/DiagnosticArray'
