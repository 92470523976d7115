"""What a process of ROS does before it starts, and what ends it."""

import os
import re
import signal
import subprocess
import sys

import pytest
from ros_graph import ROOT

DESTROYED_END = """
import rclpy
import time
from multicontact_control.nodes import qos
from multicontact_control.nodes.runtime import Spinner, start_ros, StopFlag
from multicontact_control.nodes.topics import FORCE_COMMAND

start_ros(None)
node = rclpy.create_node('node')
spinner = Spinner(node, StopFlag())
driver = node.create_publisher(
    FORCE_COMMAND.message, FORCE_COMMAND.name, qos.profile(1, reliable=False))
for _ in range(5):
    ends = [node.create_subscription(
        FORCE_COMMAND.message, FORCE_COMMAND.name, print, FORCE_COMMAND.profile)
            for _ in range(5)]
    spinner.spin_once(0.0)  # it is told of one, and has the others' events
    time.sleep(0.1)
    for end in ends:
        node.destroy_subscription(end)
    for _ in range(10):
        spinner.spin_once(0.01)
print('went on')
"""


@pytest.mark.ros
def test_what_comes_for_an_end_that_is_gone_is_ignored(domain_id):
    """An end that nobody could connect to was destroyed: the node went on with the next."""
    script = subprocess.run(
        [sys.executable, '-c', DESTROYED_END], capture_output=True, text=True,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)})
    # The middleware may have said something before, e.g. about shared memory.
    assert (script.returncode, script.stdout.splitlines()[-1:]) == (0, ['went on']), (
        script.stdout + script.stderr)


TRANSPORT = """
from pathlib import Path
import rclpy
from multicontact_control.nodes.runtime import start_ros
from std_msgs.msg import String

start_ros(None)
node = rclpy.create_node('node')
node.create_subscription(String, 'heard', print, 1)
print(*[line for line in Path('/proc/self/maps').read_text().splitlines() if '_port' in line])
"""


@pytest.mark.ros
def test_process_is_reached_without_shared_memory(domain_id):
    """A process that is killed leaves a port behind, and the next was out of reach for ever."""
    environment = {name: value for name, value in os.environ.items()
                   if name != 'FASTRTPS_DEFAULT_PROFILES_FILE'}
    script = subprocess.run(
        [sys.executable, '-c', TRANSPORT], capture_output=True, text=True,
        env={**environment, 'ROS_DOMAIN_ID': str(domain_id)})
    assert (script.returncode, script.stdout.splitlines()[-1:]) == (0, ['']), (
        script.stdout + script.stderr)


STOPPED_LATE = """
import os
import re
import signal
import sys

from multicontact_control.nodes.runtime import run_node
from rclpy.node import Node


class Idle(Node):
    def run(self, spinner):
        os.kill(os.getpid(), signal.SIGINT)
        while not spinner.stop:
            spinner.spin_once(0.1)

    def close(self):
        print('closed', flush=True)


class TakenApart:
    # Python has put its handlers of signals away by then.
    def __del__(self, kill=os.kill, pid=os.getpid(), number=int(sys.argv[1])):
        kill(pid, number)


sys.last = TakenApart()
sys.exit(run_node(lambda: Idle('idle')))
"""


@pytest.mark.ros
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_node_that_has_closed_is_not_ended_by_a_signal(domain_id, number):
    """A controller that waited 5 s for a reader that was dead ended with -15."""
    script = subprocess.run(
        [sys.executable, '-c', STOPPED_LATE, str(int(number))], capture_output=True, text=True,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)})
    assert (script.returncode, script.stdout.splitlines()[-1:]) == (0, ['closed']), (
        script.stdout + script.stderr)


NODE = ('multicontact_control.nodes.noise_estimator_node', '--ros-args', '--params-file', 'ä')
TOPICS = ('multicontact_control.cli', 'topic', 'list', '--wait', '0')
ASCII = {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0'}
NO_RMW = {'RMW_IMPLEMENTATION': 'rmw_nothing'}
OTHER_ROS = {'ROS_DISTRO': 'humble', 'AMENT_PREFIX_PATH': '/opt/ros/humble', 'PYTHONPATH': 'other'}


@pytest.mark.ros
@pytest.mark.parametrize(('command', 'changes', 'code', 'text'), [
    (TOPICS, {'HOME': ''}, 0, ''), (TOPICS, {'AMENT_PREFIX_PATH': '/opt/ros/humble'}, 0, ''),
    (TOPICS, {'HOME': '', 'ROS_LOG_DIR': '/proc/x'}, 1, 'cannot be started: .*logging'),
    (TOPICS, NO_RMW, 1, 'RMW_IMPLEMENTATION'), (NODE, NO_RMW, 1, 'RMW_IMPLEMENTATION'),
    (TOPICS, OTHER_ROS, 1, 'found: humble'), (NODE, OTHER_ROS, 1, 'found: humble'),
    (NODE, ASCII, 2, '--ros-args: expected .*UTF-8'),
    (('multicontact_control.cli', 'run', '--namespace', 'ä'), ASCII, 2, "found 'ä'")])
def test_odd_environment_does_no_harm_or_is_named_in_one_line(
        domain_id, tmp_path, command, changes, code, text):
    (tmp_path / 'rclpy').mkdir()
    (tmp_path / 'rclpy/__init__.py').touch()  # of another Python: without its library
    environment = {name: value for name, value in os.environ.items() if name != 'ROS_LOG_DIR'}
    changes = {name: value.replace('other', str(tmp_path)) for name, value in changes.items()}
    done = subprocess.run(
        [sys.executable, '-m', *command], cwd=ROOT, capture_output=True, text=True,
        encoding='utf-8', env={**environment, 'ROS_DOMAIN_ID': str(domain_id), **changes})
    assert done.returncode == code, done.stderr
    lines = [line for line in done.stderr.splitlines() if '[rcl]' not in line]
    assert len(lines) == (code != 0) and re.search(text, done.stderr)
