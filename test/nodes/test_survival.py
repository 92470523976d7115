"""A graph that runs free and loses a part: what is left goes on, and reports it."""

from __future__ import annotations

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import ignore
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
    """The newest message of a topic."""

    def __init__(self, middleware, topic):
        self._middleware, self._topic = middleware, topic
        self._subscription = middleware.node.create_subscription(
            topic.message, topic.name, ignore, qos.INPUT)

    def newest(self):
        return self._middleware.take(self._subscription, self._topic.message)

    def advance(self, count=20):
        """Wait until this many newer messages have come; return the last."""
        self.newest()
        seen = {}

        def enough():
            message = self.newest()
            if message is not None:
                seen[messages.stamp_to_ns(message.header.stamp)] = message
            return len(seen) >= count

        wait_for(enough, f'{count} messages on {self._topic.name}')
        return seen[max(seen)]

    def report(self, node, part, condition=lambda level, text, values: True):
        """Wait for a part of a node's diagnostics that is like that; return its values."""
        seen = []

        def told():
            report = self.newest()
            for x in report.status if report is not None else ():
                if x.name == f'{node}: {part}':
                    seen.append((x.level[0], x.message, {y.key: y.value for y in x.values}))
                    return condition(*seen[-1])
            return False

        wait_for(told, f'{node} to tell of its {part}', lambda: seen[-1:])
        return seen[-1][2]


@pytest.fixture
def start(middleware):
    def start_node(module, *parameters):
        return middleware.start(module, *parameters, files=(config_dir() / FILES[module],))
    return start_node


def test_controller_holds_the_last_variance_of_an_estimator_that_died_and_can_be_restarted(
        middleware, start):
    start(SIM, 'lockstep:=false')
    controller = start(CONTROLLER, 'autostart:=true')
    estimator = start(ESTIMATOR, 'autostart:=true')
    commands, reports = (Watch(middleware, topic) for topic in (
        topics.EFFORT_COMMAND, topics.DIAGNOSTICS))

    def variances(values):
        return [float(x) for key, x in values.items() if key.endswith('noise_variance_n2')]

    # Only what the controller has taken on can be held.
    reports.report('controller_node', 'contacts',
                   lambda level, text, values: variances(values) not in ([], [0.6, 0.6]))
    estimator.kill()
    estimator.wait()
    held = 'the last R is held'
    reports.report('controller_node', 'inputs',
                   lambda level, text, values: level == 1 and held in text)
    commands.advance()
    first, later = (variances(reports.report('controller_node', 'contacts')) for _ in range(2))
    assert len(first) == 2 and min(first) > 0.0
    assert later == first != [0.6, 0.6]
    start(ESTIMATOR, 'autostart:=true')
    reports.report('controller_node', 'inputs', lambda level, text, values: held not in text)
    controller.kill()
    controller.wait()
    reports.report('sim_node', 'inputs', lambda level, text, values: (
        level == 1 and 'the drives hold their position' in text))
    start(CONTROLLER, 'autostart:=true')
    commands.advance()


def test_drives_hold_their_position_without_commands(middleware, start):
    # Half a second, so that a busy machine is not taken for silence.
    start(SIM, 'lockstep:=false', 'command_timeout:=0.5')
    samples, reports = (Watch(middleware, topic) for topic in (
        topics.JOINT_STATES, topics.DIAGNOSTICS))
    publisher = middleware.node.create_publisher(
        JointState, topics.EFFORT_COMMAND.name, topics.EFFORT_COMMAND.profile)
    first = wait_for(samples.newest, 'sample 0')
    # One sample answered again and again is enough: the newest command is the one in force.
    answer = messages.joint_state_message(
        messages.stamp_to_ns(first.header.stamp), first.name, effort=first.effort)

    def commanded():
        publisher.publish(answer)
        report = reports.newest()
        return any(y.key == 'ticks' and int(y.value) > 500 for x in (
            report.status if report is not None else ()) for y in x.values)

    wait_for(commanded, 'a second of commands')
    reports.report('sim_node', 'inputs', lambda level, text, values: (
        'the drives hold their position' in text))
    # One silence is one timeout, however long it is.
    counts = [reports.report('sim_node', 'loop')['command_timeouts'] for _ in range(2)]
    assert counts[0] == counts[1] != '0'
    before, after = (np.array(samples.advance().position) for _ in range(2))
    np.testing.assert_allclose(after, before, atol=1e-3)
