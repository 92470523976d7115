"""The push test over the graph: a wrong sensor never gets to force control."""

from __future__ import annotations

from multicontact_control.experiment.push_trial import fault_mounting
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.link import ACTIVATE, CONFIGURE, LifecycleDriver
from multicontact_control.sensor.push_config import PushTestConfig
import pytest
from ros_graph import Middleware, wait_for
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

pytestmark = [pytest.mark.ros, pytest.mark.slow]

TEST = PushTestConfig(rest_time=0.1, settle_time=0.2, hold_time=0.1)
LENGTH, GAP, FIRST = 0.4, 0.3, 0.4  # s, of a push, from one to the next, until the first
NODES = {'sim_bridge.sim_node': 'plant.yaml',
         'multicontact_control.nodes.controller_node': 'controller.yaml',
         'multicontact_control.nodes.noise_estimator_node': 'noise_estimator.yaml'}
PARAMETERS = {
    'multicontact_control.nodes.controller_node': (
        'sensor.require_push_test:=true',
        *(f'push_test.{name}:={getattr(TEST, name)}'
          for name in ('rest_time', 'settle_time', 'hold_time'))),
    'multicontact_control.nodes.noise_estimator_node': ('autostart:=true',)}


class Graph:
    """The graph in lockstep, with somebody who pushes the tool and reads what is told."""

    def __init__(self, domain_id, folder, mounting):
        count = len(TEST.directions)
        setup = resolve('quick', plant='rigid', plant_overrides={
            'sensor': {'mounting': mounting.ravel().tolist()},
            'tool_push_start': [FIRST + i * (LENGTH + GAP) for i in range(count)],
            'tool_push_duration': [LENGTH] * count,
            'tool_push_force_world': (TEST.force * TEST.directions_world).ravel().tolist()})
        setup.write(folder)
        self.middleware = Middleware(domain_id)
        node = self.middleware.node
        self.processes = {module: self.middleware.start(
            module, 'lockstep:=true' if 'estimator' not in module else 'use_sim_time:=true',
            *PARAMETERS.get(module, ()), files=(folder / name,))
            for module, name in NODES.items()}
        self._reports = node.create_subscription(
            topics.DIAGNOSTICS.message, topics.DIAGNOSTICS.name, lambda _: None, qos.RECORDING)
        self._desired = node.create_subscription(
            JointState, topics.DESIRED_FORCES.name, lambda _: None, qos.INPUT)
        self.force_command = node.create_publisher(
            JointState, topics.FORCE_COMMAND.name, topics.FORCE_COMMAND.profile)
        self.told = []

    def wait_for_sensor(self, condition):
        """Wait until the diagnostics of the sensor satisfy a condition on level and text."""
        found = []

        def reported():
            report = self.middleware.take(self._reports, topics.DIAGNOSTICS.message)
            for x in report.status if report is not None else ():
                if x.name == 'controller_node: sensor':
                    self.told.append(x.message)
                    if condition(x.level, x.message):
                        found.append(x.message)
            return found

        wait_for(reported, 'such a status of the sensor')
        return found[-1]

    def command(self, force):
        self.force_command.publish(messages.joint_state_message(0, ['table'], effort=[force]))

    def desired(self):
        taken = self.middleware.take(self._desired, JointState)
        return None if taken is None else dict(zip(taken.name, taken.effort))['table']


@pytest.mark.parametrize(('fault', 'seed', 'finding'), [
    ('none', 0, None), ('sign', 0, 'sign flipped'), ('rotate', 2, 'rotated by 90 deg')])
def test_only_a_right_sensor_gets_to_force_control(domain_id, tmp_path, monkeypatch, fault, seed,
                                                   finding):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    graph = Graph(domain_id, tmp_path, fault_mounting(fault, seed))
    with graph.middleware, LifecycleDriver(domain_id) as driver:
        driver.change('controller_node', CONFIGURE)
        answer = driver.call('controller_node', Trigger, 'push_test', Trigger.Request())
        assert answer.success and answer.message == 'keep off the tool'
        driver.change('controller_node', ACTIVATE)
        if finding is None:
            graph.wait_for_sensor(lambda level, text: level == b'\0')
            wait_for(lambda: graph.command(5.0) or (graph.desired() or 0.0) > 0.0, 'a contact')
            return
        told = graph.wait_for_sensor(lambda level, text: level == b'\2')
        assert told.startswith('push test failed') and finding in told
        for _ in range(200):
            graph.command(5.0)
            graph.middleware.pause(0.005)
            assert not graph.desired()
