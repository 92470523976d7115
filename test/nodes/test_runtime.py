"""What a process of ROS does before it starts, and what ends it."""

import os
import subprocess
import sys
import time

from multicontact_control.nodes.runtime import remove_half_made_ports
import pytest

MINUTE = 60.0
DESTROYED_END = """
import rclpy
import time
from multicontact_control.nodes import qos
from multicontact_control.nodes.graph_node import create_subscription
from multicontact_control.nodes.runtime import Spinner, start_ros, StopFlag
from multicontact_control.nodes.topics import FORCE_COMMAND
from rclpy.exceptions import InvalidHandle
from std_msgs.msg import String

start_ros(None)
node = rclpy.create_node('node')
spinner = Spinner(node, StopFlag())
driver = node.create_publisher(
    FORCE_COMMAND.message, FORCE_COMMAND.name, qos.profile(1, reliable=False))
for _ in range(5):
    ends = [create_subscription(node, FORCE_COMMAND, print, FORCE_COMMAND.profile)
            for _ in range(5)]
    spinner.spin_once(0.0)  # it is told of one, and has the others' events
    time.sleep(0.1)
    for end in ends:
        node.destroy_subscription(end)
    spinner.drain(0.1)

gone = node.create_publisher(String, 'gone', 1)
heard = node.create_subscription(String, 'heard', lambda message: gone.publish(message), 1)
said = node.create_publisher(String, 'heard', 1)
node.destroy_publisher(gone)
said.publish(String())
try:
    spinner.drain(5.0)
except InvalidHandle:
    print('raised')
"""


def port(folder, name, state, age):
    path = folder / name
    path.write_bytes(state.to_bytes(4, 'little') + bytes(60))
    os.utime(path, (time.time() - age,) * 2)
    return path


def test_only_ports_that_nobody_will_finish_are_removed(tmp_path):
    half = [port(tmp_path, f'fastrtps_port700{state}', state, MINUTE) for state in (0, 1)]
    kept = [port(tmp_path, 'fastrtps_port7002', 2, MINUTE),
            port(tmp_path, 'fastrtps_port7003', 0, 0.0),
            port(tmp_path, 'fastrtps_port7003_el', 0, MINUTE),
            port(tmp_path, 'fastrtps_0123456789abcdef', 0, MINUTE),
            port(tmp_path, 'other', 0, MINUTE)]
    for _ in range(2):
        remove_half_made_ports(tmp_path)
    assert not any(path.exists() for path in half)
    assert all(path.exists() for path in kept)
    remove_half_made_ports(tmp_path / 'nowhere')


@pytest.mark.ros
def test_only_what_comes_for_an_end_that_is_gone_is_ignored(domain_id):
    """An end that nobody could connect to was destroyed: the node went on with the next."""
    script = subprocess.run(
        [sys.executable, '-c', DESTROYED_END], capture_output=True, text=True,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)})
    assert (script.returncode, script.stdout) == (0, 'raised\n'), script.stderr
