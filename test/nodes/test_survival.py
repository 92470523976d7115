"""A graph that runs free and loses a part: what is left goes on, and reports it."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import ignore
from multicontact_control.paths import config_dir
import pytest
from ros_graph import wait_for
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

CONTROLLER = 'multicontact_control.nodes.controller_node'
ESTIMATOR = 'multicontact_control.nodes.noise_estimator_node'
SIM = 'sim_bridge.sim_node'
FILES = {CONTROLLER: 'controller.yaml', ESTIMATOR: 'noise_estimator.yaml', SIM: 'plant_puma.yaml'}


@pytest.mark.slow
def test_controller_holds_the_last_variance_of_an_estimator_that_died_and_can_be_restarted(
        middleware):
    commands, diagnostics = (middleware.node.create_subscription(
        topic.message, topic.name, ignore, qos.INPUT) for topic in (
            topics.EFFORT_COMMAND, topics.DIAGNOSTICS))

    def start(module, parameter):
        return middleware.start(module, parameter, files=(config_dir() / FILES[module],))

    def report(node, part, condition):
        """Wait for a part of a node's diagnostics that is like that; return its values."""
        seen = []

        def satisfied():
            message = middleware.take(diagnostics, DiagnosticArray)
            for x in message.status if message is not None else ():
                if x.name == f'{node}: {part}':
                    seen.append((x.message, {y.key: y.value for y in x.values}))
                    return condition(*seen[-1])
            return False

        wait_for(satisfied, f'{node} reports its {part}', lambda: seen[-1:])
        return seen[-1][1]

    def commanded():
        """Wait for commands of newer samples."""
        seen = set()

        def enough():
            message = middleware.take(commands, JointState)
            if message is not None:
                seen.add(messages.stamp_to_ns(message.header.stamp))
            return len(seen) > 20

        middleware.take(commands, JointState)
        wait_for(enough, 'commands')

    def variances(values):
        return [float(x) for key, x in values.items() if key.endswith('noise_variance_n2')]

    start(SIM, 'lockstep:=false')
    controller, estimator = (start(x, 'autostart:=true') for x in (CONTROLLER, ESTIMATOR))
    # Only what the controller has taken on can be held.
    report('controller_node', 'contacts',
           lambda text, values: variances(values) not in ([], [0.6, 0.6]))
    estimator.kill()
    estimator.wait()
    held = 'the last R is held'
    report('controller_node', 'inputs', lambda text, values: held in text)
    commanded()
    first, later = (variances(report(
        'controller_node', 'contacts', lambda text, values: True)) for _ in range(2))
    assert len(first) == 2 and min(first) > 0.0
    assert later == first != [0.6, 0.6]
    start(ESTIMATOR, 'autostart:=true')
    report('controller_node', 'inputs', lambda text, values: held not in text)
    controller.kill()
    controller.wait()
    report('sim_node', 'inputs', lambda text, values: 'the drives hold their position' in text)
    start(CONTROLLER, 'autostart:=true')
    commanded()
