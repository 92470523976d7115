"""A graph that runs free and loses a part: what is left goes on, and reports it."""

from collections import Counter
import json

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import create_publisher, ignore_message
from multicontact_control.paths import find_config_folder
import pytest
from ros_graph import end_of, wait_for

pytestmark = [pytest.mark.ros, pytest.mark.slow]

CONTROLLER = 'multicontact_control.nodes.controller_node'
ESTIMATOR = 'multicontact_control.nodes.noise_estimator_node'
SIM = 'sim_bridge.sim_node'
FILES = {
    CONTROLLER: 'controller.yaml',
    ESTIMATOR: 'noise_estimator.yaml',
    SIM: 'plant_puma.yaml',
}


def subscribe(middleware, topic):
    return middleware.node.create_subscription(
        topic.message, topic.name, ignore_message, qos.INPUT
    )


def variances(status):
    """Return the variances among the values of a status [N^2]."""
    values = [x.value for x in status.values if x.key.endswith('noise_variance_n2')]
    return [float(value) for value in values]


def test_controller_holds_the_last_variance_of_an_estimator_that_died_and_can_be_restarted(
    middleware,
):
    commands = subscribe(middleware, topics.EFFORT_COMMAND)
    diagnostics = subscribe(middleware, topics.DIAGNOSTICS)

    def start(module, *parameters, flags=('--autostart',)):
        return middleware.start(
            module,
            *parameters,
            files=(find_config_folder() / FILES[module],),
            flags=flags,
        )

    def report(part, condition):
        """Wait for such a message of a node's part; return the variances in its values."""
        seen = []

        def satisfied():
            message = middleware.take(diagnostics)
            if message is not None:
                seen.extend(each for each in message.status if each.name == part)
            return seen and condition(seen[-1])

        wait_for(satisfied, f'{part} as wanted', lambda: seen[-1:])
        return variances(seen[-1])

    def commanded():
        """Wait for commands of newer samples."""
        stamps = set()

        def enough():
            message = middleware.take(commands)
            if message is not None:
                stamps.add(messages.stamp_to_ns(message.header.stamp))
            return len(stamps) > 20

        middleware.take(commands)
        wait_for(enough, 'commands')

    inputs = 'controller_node: inputs'
    contacts = 'controller_node: contacts'
    start(SIM, 'lockstep:=false', flags=())
    controller = start(CONTROLLER)
    estimator = start(ESTIMATOR)
    # Only what the controller has taken on can be held.
    report(contacts, lambda x: variances(x) not in ([], [0.6, 0.6]))
    estimator.kill()
    estimator.wait()
    report(inputs, lambda x: 'the last R is held' in x.message)
    commanded()
    first = report(contacts, lambda x: True)
    later = report(contacts, lambda x: True)
    assert len(first) == 2
    assert min(first) > 0.0
    assert first != [0.6, 0.6]
    assert later == first
    start(ESTIMATOR)
    report(inputs, lambda x: 'the last R is held' not in x.message)
    controller.kill()
    controller.wait()
    report('sim_node: inputs', lambda x: 'the drives hold their position' in x.message)
    start(CONTROLLER)
    commanded()


def test_simulator_times_a_command_from_the_first_sending_of_its_sample(
    middleware, tmp_path
):
    samples = subscribe(middleware, topics.JOINT_STATES)
    commands = create_publisher(middleware.node, topics.EFFORT_COMMAND)
    path = tmp_path / 'sim.json'
    sim = middleware.start(
        SIM,
        'ticks:=2',
        f'timing_file:={path}',
        files=(find_config_folder() / FILES[SIM],),
    )
    sent = Counter()
    while sim.poll() is None:
        if sample := middleware.take(samples):
            stamp = sample.header.stamp.nanosec
            sent[stamp] += 1
            if sent[stamp] >= len(sent):  # the second one: not at once
                commands.publish(sample)  # its effort is the torque that holds the arm
        middleware.pause()
    assert sim.returncode == 0, end_of(sim)
    assert json.loads(path.read_text())['latency_us']['max'] > 0.5e6
