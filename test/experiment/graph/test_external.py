"""
A user's own robot behind the topics, on the way that docs/your_robot.md shows.

The robot is `docs/minimal_simulator.py`, which takes what `new-robot` writes.
"""

import json
import os
import re
import signal
import subprocess
import sys

from arms import seven_joint_urdf
from multicontact_control.client import MultiContactClient
from multicontact_control.config import merge, read_parameters
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.parameter_file import write_parameters
from multicontact_control.experiment.recording import read_graph
from multicontact_control.experiment.results import load
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import ignore, take
from multicontact_control.nodes.link import GuestNode
import numpy as np
import pytest
from ros_graph import node_processes, PATIENCE, ROOT, wait_for
from sim_bridge.new_robot import new_robot
from test_commands_of_docs import blocks, commands
import yaml

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ARM = (str(ROOT / 'docs/minimal_simulator.py'), 'my_arm.yaml', 'controller.yaml')
QUICK = ['--move-time', '0.5', '--tilt', '15']  # what a test has time for
# A simulator may be slow, and has no hand that pushes.
NODE = {'patience': 0.0, 'push_test': {'timeout': 1.0}, 'sensor': {'require_push_test': False}}


def documented():
    """Return the commands and the program of the page, as they stand there."""
    page = ROOT / 'docs/your_robot.md'
    (_, program), = blocks(page, 'python')
    program, count = re.subn(r'timeout=[\d.]+', f'timeout={PATIENCE}', program)
    assert count == 1
    return [words[1:] for _, words in commands(page) if words[0] == 'multicontact'], program


class Shell:
    """Processes in one folder and ROS domain, as in a user's terminals."""

    def __init__(self, folder, domain_id):
        self.folder, self.domain_id = folder, domain_id
        self._environment = {
            **os.environ, 'PYTHONPATH': str(ROOT), 'ROS_DOMAIN_ID': str(domain_id),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'COLUMNS': '200'}
        self._running = []

    def start(self, *command, log):
        with (self.folder / log).open('w') as file:
            self._running.append(subprocess.Popen(
                [sys.executable, *command], cwd=self.folder, env=self._environment,
                stdout=file, stderr=subprocess.STDOUT, start_new_session=True))
        return self._running[-1]

    def multicontact(self, *arguments, log):
        return self.start('-m', 'multicontact_control.cli', *arguments, log=log)

    def output(self, log):
        return (self.folder / log).read_text(encoding='utf-8')

    def wait_for_line(self, process, log, text):
        wait_for(lambda: text in self.output(log) or process.poll() is not None, text,
                 lambda: self.output(log))
        assert text in self.output(log)

    def end(self, process, log, number=None, code=0):
        """Wait for the end of a process with an exit code; return what it wrote."""
        if number is not None:
            process.send_signal(number)
        assert process.wait(PATIENCE) == code, self.output(log)
        return self.output(log)

    def close(self):
        for process in self._running:
            process.kill()
            process.wait()


@pytest.fixture
def shell(tmp_path):
    with reserve_domain() as domain_id:
        terminals = Shell(tmp_path, domain_id)
        yield terminals
        terminals.close()


def write_robot(folder, **changes):
    """Write what `new-robot` does, for the arm of seven joints, and what a simulator needs."""
    file = folder / 'controller.yaml'
    new_robot(seven_joint_urdf(folder), 'wrist', 'wrist', folder / 'my_arm.yaml', file)
    write_parameters(file, {'/**': merge(read_parameters(file), {**NODE, **changes})})


@pytest.mark.nightly
def test_documented_way_leads_from_a_urdf_to_ten_newtons(shell, tmp_path):
    listed, program = documented()
    # Of what `new-robot` writes, the tool is another one than the simulated.
    write_robot(tmp_path, tool={'mass': 0.2, 'com_sensor': [0.0, 0.0, 0.0]})
    given = [command for command in listed if command[0] not in ('new-robot', 'simulate')]
    assert [command[0] for command in given] == [
        'run', 'calibrate', 'run', 'push-test', 'report', 'identify']
    first, calibrate, second, push, report, identify = given

    running = shell.multicontact(*first, log='first')
    shell.wait_for_line(running, 'first', 'waiting for /joint_states')
    arm = shell.start(*ARM, log='arm')
    shell.wait_for_line(running, 'first', 'found /joint_states from ')
    shell.end(shell.multicontact(*calibrate, *QUICK, log='weighing'), 'weighing')
    tool = yaml.safe_load((tmp_path / 'tool.yaml').read_text())['/**']['ros__parameters']['tool']
    assert tool['mass'] == pytest.approx(0.501, abs=0.02)
    np.testing.assert_allclose(tool['com_sensor'], [0.0, 0.0, 0.08], atol=3e-3)
    np.testing.assert_allclose(tool['bias_sensor'], np.zeros(6), atol=0.1)
    # With no push no force is obeyed afterwards: not in the second run, as documented.
    text = shell.end(shell.multicontact(*push, log='pushing'), 'pushing', code=1)
    assert text.splitlines()[-1].startswith('push test failed'), text
    weighed, = (tmp_path / 'runs').iterdir()  # it is the latest with its recording
    running.send_signal(signal.SIGINT)
    wait_for(lambda: not node_processes(weighed), 'the end of the first nodes')
    judged = running  # of which there is no need to wait for the figures
    running = shell.multicontact(*second, log='second')
    shell.wait_for_line(running, 'second', 'found /joint_states from ')
    text = shell.end(shell.start('-c', program, log='program'), 'program')
    assert float(re.search(r"'table': ([\d.]+)", text)[1]) == pytest.approx(10.0, abs=1.0), text
    text = shell.end(running, 'second', signal.SIGINT)
    assert arm.poll() is None
    arm.kill()
    run = tmp_path / 'runs/latest'
    summary = json.loads((run / 'summary.json').read_text())
    assert 'not judged: no ground truth; by the measured forces no limit was passed' in text
    assert (summary['without_truth'], summary['mode'], summary['stable']) == (
        ['table'], 'external', None)
    data = load(run).data
    assert np.nanmax(data.alpha_meas) > 9.0 and np.nanmax(data.command) == 10.0
    recorded = read_graph(run / 'bag').by_topic
    # The safe behaviour, after the controller was deactivated.
    assert recorded['joint_effort_command'].stamps[-1] > (
        recorded['contact_forces/measured'].stamps[-1])
    shell.end(shell.multicontact(*report, log='report'), 'report')
    assert 'no ground truth' in (run / 'report.html').read_text(encoding='utf-8')
    assert 'table: ' in shell.end(shell.multicontact(*identify, log='identify'), 'identify')
    assert 'not judged' in shell.end(judged, 'first')


class Listener(GuestNode):
    """Hears efforts and measured forces; keeps the last stamp of each."""

    def __init__(self, domain_id, namespace=''):
        super().__init__('listener', domain_id, namespace)
        self._ends = [self.node.create_subscription(topic.message, topic.name, ignore, qos.WATCH)
                      for topic in (topics.EFFORT_COMMAND, topics.MEASURED_FORCES)]
        self.stamps = [0, 0]

    def poll(self):
        for i, end in enumerate(self._ends):
            while (taken := take(end)) is not None:
                self.stamps[i] = messages.stamp_to_ns(taken[0].header.stamp)
        return True


def test_ur_presses_as_documented_and_is_left_with_the_safe_behaviour_by_a_kill(shell, tmp_path):
    """Its driver takes bare efforts without gravity, tells currents and the opposite wrench."""
    block, = re.findall(r'```yaml\n(.*?)```', (ROOT / 'docs/ur.md').read_text('utf-8'), re.S)
    write_robot(tmp_path, **yaml.safe_load(block)['/**']['ros__parameters'],
                safe_behaviour='zero_torque')
    shell.start(str(ROOT / 'test/ur_driver.py'), *ARM[1:], log='arm')
    shell.start(str(ROOT / 'docs/ur_wrench.py'), '/force_torque_sensor_broadcaster/wrench',
                'ft_face', log='wrench')
    running = shell.multicontact(
        'run', '--external', '--controller', 'controller.yaml', '--out', 'run', log='log')
    with MultiContactClient(domain_id=shell.domain_id, timeout=PATIENCE) as arm:
        arm.set_forces({'table': 10.0})
        arm.wait_until_reached(force_tolerance=1.0, timeout=PATIENCE)
    with Listener(shell.domain_id) as listener:
        wait_for(lambda: listener.poll() and listener.stamps[1], 'measured forces')
        assert len(node_processes(tmp_path / 'run')) == 3
        running.kill()
        running.wait(PATIENCE)
        wait_for(lambda: listener.poll() and not node_processes(tmp_path / 'run'), 'their end')
        answered, controlled = listener.stamps
        assert answered - controlled > 30_000_000


def test_robot_that_is_gone_ends_the_run_and_is_named(shell, tmp_path):
    write_robot(tmp_path)
    arm = shell.start(*ARM, '--ros-args', '-r', '__ns:=/left', log='arm')
    running = shell.multicontact(
        'run', '--external', '--controller', 'controller.yaml', '--namespace', 'left',
        '--out', 'run', log='left')
    shell.wait_for_line(running, 'left', 'found /left/joint_states from ')
    with Listener(shell.domain_id, 'left') as listener:
        wait_for(lambda: listener.poll() and listener.stamps[0] > 1_000_000_000, 'commands',
                 lambda: shell.output('left'))
    arm.kill()
    text = shell.end(running, 'left', code=1)
    assert 'ended: my_simulator has not published /left/' in text
    summary = json.loads((tmp_path / 'run/summary.json').read_text())
    assert summary['ended_early'].startswith('my_simulator has not published')
    assert summary['without_truth'] and summary['verdict'] == 'ended: robot silent'
    assert (tmp_path / 'run/figures/fig3_force_table.png').is_file()
