"""The environment of a process that uses ROS."""

import os
import re
import subprocess
import sys

import pytest
from ros_graph import ROOT

pytestmark = pytest.mark.ros
ESTIMATOR = 'multicontact_control.nodes.noise_estimator_node'
NODE = (ESTIMATOR, '--ros-args', '--params-file', 'ä')
TOPICS = ('multicontact_control.cli', 'topic', 'list', '--wait', '0')
ASCII = {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0'}
OTHER_ROS = {
    'ROS_DISTRO': 'humble',
    'AMENT_PREFIX_PATH': '/opt/ros/humble',
}


@pytest.mark.parametrize(
    ('command', 'changes', 'code', 'text'),
    [
        (TOPICS, {'HOME': '', 'AMENT_PREFIX_PATH': '/opt/ros/humble'}, 0, ''),
        (
            TOPICS,
            {'HOME': '', 'ROS_LOG_DIR': '/proc/x'},
            1,
            'cannot be started: .*logging',
        ),
        (NODE, {'RMW_IMPLEMENTATION': 'rmw_nothing'}, 1, 'RMW_IMPLEMENTATION'),
        (TOPICS, OTHER_ROS, 1, 'found: humble'),
        (NODE, OTHER_ROS, 1, 'found: humble'),
        (NODE, ASCII, 2, '--ros-args: expected .*UTF-8'),
        (('multicontact_control.cli', 'run', '--namespace', 'ä'), ASCII, 2, "got 'ä'"),
    ],
)
def test_odd_environment_does_no_harm_or_is_named_in_one_line(
    domain_id, tmp_path, command, changes, code, text
):
    (tmp_path / 'rclpy').mkdir()
    (tmp_path / 'rclpy/__init__.py').touch()  # of another Python: without its library
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id), **changes}
    if 'ROS_LOG_DIR' not in changes:
        environment.pop('ROS_LOG_DIR', None)
    if changes is OTHER_ROS:
        environment['PYTHONPATH'] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, '-m', *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        encoding='utf-8',
        env=environment,
    )
    assert done.returncode == code, done.stderr
    lines = [line for line in done.stderr.splitlines() if '[rcl]' not in line]
    assert len(lines) == int(code != 0)
    assert re.search(text, done.stderr)


@pytest.mark.ros
@pytest.mark.parametrize(
    ('argument', 'code', 'text'),
    [
        ('--help', 0, '--autostart .*--params-file'),
        ('--speed', 2, 'arguments: --speed'),
    ],
)
def test_node_prints_its_help_and_refuses_unknown_arguments(argument, code, text):
    done = subprocess.run(
        [sys.executable, '-m', ESTIMATOR, argument],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code
    assert re.search(text, done.stdout + done.stderr, re.DOTALL)
