"""
A user's own robot behind the topics, on the way that docs/your_robot.md shows.

The robot is `docs/minimal_simulator.py`, which takes what `new-robot` writes.
"""

import json
import os
import re
import signal
import subprocess

from arms import seven_joint_urdf
from multicontact_control.client import MultiContactClient
from multicontact_control.config import merge, read_parameters
from multicontact_control.judging.results import load
from multicontact_control.nodes import topics
from multicontact_control.runs.parameter_file import write_parameters
from multicontact_control.runs.recording import read_graph
import numpy as np
from numpy.testing import assert_allclose
import pytest
from ros_graph import node_processes, PATIENCE, ROOT, start_python, wait_for
from sim_bridge.new_robot import new_robot
from test_commands_of_docs import blocks, commands
import yaml

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ARM = (ROOT / 'docs/minimal_simulator.py', 'my_arm.yaml', 'controller.yaml')
CLI = ('-m', 'multicontact_control.cli')
EXTERNAL = ('run', '--external', '--controller', 'controller.yaml', '--out', 'run')
QUICK = ['--move-time', '0.5', '--tilt', '15']  # what a test has time for
# A simulator may be slow, and has no hand that pushes.
NODE = {
    'patience': 0.0,
    'push_test': {'timeout': 1.0},
    'sensor': {'require_push_test': False},
}


@pytest.fixture
def start(tmp_path, domain_id):
    """Return what starts Python in one folder and ROS domain, as in a user's terminals."""
    running = []
    environment = {
        **os.environ,
        'PYTHONPATH': str(ROOT),
        'ROS_DOMAIN_ID': str(domain_id),
        'COLUMNS': '200',
    }

    def start(*command):
        log = tmp_path / f'{len(running)}.log'
        running.append(
            start_python(
                *command,
                cwd=tmp_path,
                env=environment,
                stdout=log.open('w'),
                stderr=subprocess.STDOUT,
            )
        )
        running[-1].text = log.read_text
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.wait()


def wait_for_line(process, words):
    wait_for(
        lambda: words in process.text() or process.poll() is not None,
        words,
        process.text,
    )
    assert words in process.text()


def end(process, number=0, code=0):
    """Send a signal, 0 for none; wait for the end with an exit code; return what it wrote."""
    process.send_signal(number)
    assert process.wait(PATIENCE) == code, process.text()
    return process.text()


def write_robot(folder, **changes):
    """Write what `new-robot` does, for the arm of seven joints, and what a simulator needs."""
    file = folder / 'controller.yaml'
    new_robot(seven_joint_urdf(folder), 'wrist', 'wrist', folder / 'my_arm.yaml', file)
    write_parameters(file, {'/**': merge(read_parameters(file), {**NODE, **changes})})


@pytest.mark.nightly
def test_documented_way_leads_from_a_urdf_to_ten_newtons(start, tmp_path):
    page = ROOT / 'docs/your_robot.md'
    ((_, program),) = blocks(page, 'python')
    program = re.sub(r'timeout=[\d.]+', f'timeout={PATIENCE}', program)
    listed = [words[1:] for _, words in commands(page) if words[0] == 'multicontact']
    # Of what `new-robot` writes, the tool is another one than the simulated.
    write_robot(tmp_path, tool={'mass': 0.2, 'com_sensor': [0.0, 0.0, 0.0]})
    given = [
        command for command in listed if command[0] not in ('new-robot', 'simulate')
    ]
    assert [command[0] for command in given] == [
        'run',
        'calibrate',
        'run',
        'push-test',
        'report',
        'identify',
    ]
    first, calibrate, second, push, report, identify = given

    running = start(*CLI, *first)
    wait_for_line(running, 'waiting for /joint_states')
    arm = start(*ARM)
    wait_for_line(running, 'found /joint_states from ')
    end(start(*CLI, *calibrate, *QUICK))
    tool = yaml.safe_load((tmp_path / 'tool.yaml').read_text())['/**'][
        'ros__parameters'
    ]['tool']
    assert tool['mass'] == pytest.approx(0.501, abs=0.02)
    assert_allclose(tool['com_sensor'], [0.0, 0.0, 0.08], atol=3e-3)
    assert_allclose(tool['bias_sensor'], np.zeros(6), atol=0.1)
    # With no push no force is obeyed afterwards: not in the second run, as documented.
    text = end(start(*CLI, *push), code=1)
    assert text.splitlines()[-1].startswith('push test failed'), text
    (weighed,) = (tmp_path / 'runs').iterdir()  # it is the latest with its recording
    running.send_signal(signal.SIGINT)
    wait_for(lambda: not node_processes(weighed), 'the end of the first nodes')
    judged = running  # of which there is no need to wait for the figures
    running = start(*CLI, *second)
    wait_for_line(running, 'found /joint_states from ')
    text = end(start('-c', program))
    assert float(re.search(r"'table': ([\d.]+)", text)[1]) == pytest.approx(
        10.0, abs=1.0
    ), text
    text = end(running, signal.SIGINT)
    assert arm.poll() is None
    arm.kill()
    run = tmp_path / 'runs/latest'
    summary = json.loads((run / 'summary.json').read_text())
    assert (
        'not judged: no ground truth; by the measured forces no limit was passed'
        in text
    )
    assert (summary['without_truth'], summary['mode'], summary['stable']) == (
        ['table'],
        'external',
        None,
    )
    data = load(run).data
    assert np.nanmax(data.alpha_meas) > 9.0 and np.nanmax(data.command) == 10.0
    recorded = read_graph(run / 'bag').by_topic
    # The safe behaviour, after the controller was deactivated.
    assert (
        recorded['joint_effort_command'].stamps[-1]
        > (recorded['contact_forces/measured'].stamps[-1])
    )
    end(start(*CLI, *report))
    assert 'no ground truth' in (run / 'report.html').read_text(encoding='utf-8')
    assert 'table: ' in end(start(*CLI, *identify))
    assert 'not judged' in end(judged)


def test_ur_presses_as_documented_and_is_left_with_the_safe_behaviour_by_a_kill(
    start, domain_id, tmp_path
):
    """Its driver takes bare efforts without gravity, tells currents and the opposite wrench."""
    (block,) = re.findall(
        r'```yaml\n(.*?)```', (ROOT / 'docs/ur.md').read_text('utf-8'), re.S
    )
    write_robot(
        tmp_path,
        **yaml.safe_load(block)['/**']['ros__parameters'],
        safe_behaviour='zero_torque',
    )
    start(ROOT / 'test/ur_driver.py', *ARM[1:])
    start(
        ROOT / 'docs/ur_wrench.py', '/force_torque_sensor_broadcaster/wrench', 'ft_face'
    )
    running = start(*CLI, *EXTERNAL)
    with MultiContactClient(domain_id=domain_id, timeout=PATIENCE) as arm:
        arm.set_forces({'table': 10.0})
        arm.wait_until_reached(force_tolerance=1.0, timeout=PATIENCE)
        assert len(node_processes(tmp_path / 'run')) == 3
        running.kill()
        wait_for(lambda: not node_processes(tmp_path / 'run'), 'their end')
    assert 'commanding zero torque' in (
        tmp_path / f'run/logs/{topics.CONTROLLER}.log'
    ).read_text(encoding='utf-8')


def test_robot_that_is_gone_ends_the_run_and_is_named(start, domain_id, tmp_path):
    write_robot(tmp_path)
    arm = start(*ARM, '--ros-args', '-r', '__ns:=/left')
    running = start(*CLI, *EXTERNAL, '--namespace', 'left')
    wait_for_line(running, 'found /left/joint_states from ')
    with MultiContactClient('left', domain_id=domain_id, timeout=PATIENCE) as client:
        wait_for(lambda: client.read().time > 1.0, 'some samples', running.text)
    arm.kill()
    assert 'ended: my_simulator has not published /left/' in end(running, code=1)
    summary = json.loads((tmp_path / 'run/summary.json').read_text())
    assert summary['ended_early'].startswith('my_simulator has not published')
    assert summary['without_truth'] and summary['verdict'] == 'ended: robot silent'
    assert (tmp_path / 'run/figures/fig3_force_table.png').is_file()
