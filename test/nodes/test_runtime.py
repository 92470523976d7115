"""The environment of a node's process, and transitions that take long."""

import os
import re
import subprocess
import sys
import threading
import time

from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.nodes import link
import pytest
from rclpy.executors import SingleThreadedExecutor
from ros_graph import ROOT

pytestmark = pytest.mark.ros
def test_transition_that_takes_long_is_waited_for(domain_id, monkeypatch):
    """The node at work answers neither this request nor the question for its state meanwhile."""
    monkeypatch.setattr(link, 'FIRST_TIMEOUT', 0.2)
    states = ['unconfigured']

    def change(request, response):
        response.success = (states[-1], request.transition.label) == (
            'unconfigured', link.CONFIGURE)
        if response.success:
            time.sleep(0.8)
            states.append('inactive')
        return response

    def get(_request, response):
        response.current_state.label = states[-1]
        return response

    with link.GuestNode('slow', domain_id) as slow, link.GuestNode('asks', domain_id) as asks:
        slow.node.create_service(GetState, '~/get_state', get)
        slow.node.create_service(ChangeState, '~/change_state', change)
        executor = SingleThreadedExecutor(context=slow.context)
        executor.add_node(slow.node)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        try:
            asks.change('slow', link.CONFIGURE)
            assert states == ['unconfigured', 'inactive']
            with pytest.raises(link.TransitionError):
                asks.change('slow', link.ACTIVATE)
        finally:
            executor.shutdown()
            thread.join()


NODE = ('multicontact_control.nodes.noise_estimator_node', '--ros-args', '--params-file', 'ä')
TOPICS = ('multicontact_control.cli', 'topic', 'list', '--wait', '0')
ASCII = {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0'}
OTHER_ROS = {'ROS_DISTRO': 'humble', 'AMENT_PREFIX_PATH': '/opt/ros/humble', 'PYTHONPATH': 'other'}


@pytest.mark.parametrize(('command', 'changes', 'code', 'text'), [
    (TOPICS, {'HOME': '', 'AMENT_PREFIX_PATH': '/opt/ros/humble'}, 0, ''),
    (TOPICS, {'HOME': '', 'ROS_LOG_DIR': '/proc/x'}, 1, 'cannot be started: .*logging'),
    (NODE, {'RMW_IMPLEMENTATION': 'rmw_nothing'}, 1, 'RMW_IMPLEMENTATION'),
    (TOPICS, OTHER_ROS, 1, 'found: humble'), (NODE, OTHER_ROS, 1, 'found: humble'),
    (NODE, ASCII, 2, '--ros-args: expected .*UTF-8')])
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
