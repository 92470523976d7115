"""Processes that were killed, and what Fast DDS keeps of them in shared memory."""

import mmap
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

from multicontact_control.nodes.link import LifecycleDriver
from multicontact_control.nodes.shared_memory import (
    PORT_NODE,
    PORT_NODE_AT,
    remove_dead_ports,
    remove_half_made_ports,
)
from multicontact_control.nodes.topics import ESTIMATOR
import pytest
from ros_graph import PATIENCE, ROOT, wait_for

MINUTE = 60.0
ENDLESS = """
import rclpy
import time
from multicontact_control.nodes.runtime import start_ros

start_ros(None)
node = rclpy.create_node('node')
print('ready', flush=True)
time.sleep(1e6)
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


@pytest.fixture
def endless(domain_id):
    """Return a function that starts a node that goes on until it is killed."""
    started = []

    def start():
        process = subprocess.Popen(
            [sys.executable, '-c', ENDLESS], stdout=subprocess.PIPE,
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)})
        started.append(process)
        assert process.stdout.readline() == b'ready\n'
        return process
    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()
    for lock in Path('/dev/shm').glob('fastrtps_port*_el'):
        age(lock)
    remove_dead_ports()


def age(path):
    """Let a file be old; not if it is removed meanwhile."""
    try:
        os.utime(path, (time.time() - MINUTE,) * 2)
    except OSError:
        pass


def read_ports(process):
    """Return the ports that a process reads from."""
    maps = Path(f'/proc/{process.pid}/maps').read_text()
    locks = [Path(name) for link in Path(f'/proc/{process.pid}/fd').iterdir()
             for name in re.findall(r'.*/fastrtps_port\d+_el$', os.readlink(link))]
    ports = [lock.with_name(lock.name[:-3]) for lock in locks]
    ports = [path for path in ports if f'{path}\n' in maps]
    assert ports
    return [Path(f'{path}_el') for path in ports], ports


def is_good(segment):
    """Return what Fast DDS reads before it puts a message into a port."""
    return bool(PORT_NODE.unpack_from(segment, PORT_NODE_AT)[-1] & 1)


@pytest.mark.ros
def test_whoever_sends_to_a_port_of_the_dead_is_told_and_ports_of_the_living_stay(endless):
    """A node that was killed and started again was out of reach for 15 s, or for ever."""
    dead, living = endless(), endless()
    locks, ports = read_ports(dead)
    kept = [path for paths in read_ports(living) for path in paths]
    senders = []
    for path in ports:
        with path.open('rb') as file:
            senders.append(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    for lock in (*locks, *kept):
        age(lock)
    remove_dead_ports()
    assert all(path.exists() for path in (*locks, *ports, *kept))
    assert all(is_good(sender) for sender in senders)
    dead.kill()
    dead.wait()
    remove_dead_ports()
    assert not any(path.exists() for path in (*locks, *ports))
    assert not any(is_good(sender) for sender in senders)
    assert all(path.exists() for path in kept)


def test_what_is_new_or_laid_out_otherwise_is_left_as_it_is(tmp_path):
    remove_dead_ports(tmp_path / 'nowhere')
    new, lock = tmp_path / 'fastrtps_port7001', tmp_path / 'fastrtps_port7001_el'
    other, other_lock = tmp_path / 'fastrtps_port7002', tmp_path / 'fastrtps_port7002_el'
    other.write_bytes(bytes(range(256)) * 4)
    for path in (new, lock, other_lock):
        path.touch()
    with other.open('rb') as file:
        sender = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    age(other_lock)
    before = bytes(sender)
    remove_dead_ports(tmp_path)
    assert new.exists() and lock.exists()
    assert not other.exists() and not other_lock.exists()
    assert bytes(sender) == before


@pytest.mark.ros
def test_node_that_nobody_can_find_starts_again(domain_id, tmp_path):
    """Fast DDS may remove its ports while others still send to one that was killed there."""
    log = tmp_path / 'log'
    with log.open('w') as file:
        process = subprocess.Popen(
            [sys.executable, '-m', 'multicontact_control.nodes.noise_estimator_node'],
            stdout=file, stderr=file, cwd=ROOT,
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)})
    try:
        with LifecycleDriver(domain_id) as driver:
            assert driver.state(ESTIMATOR, PATIENCE) == 'unconfigured'
        _, ports = read_ports(process)
        for path in ports:
            path.unlink()
        wait_for(lambda: 'that nobody can find this one: starting again' in log.read_text(),
                 'a start', log.read_text)
        with LifecycleDriver(domain_id, patience=PATIENCE) as driver:
            assert driver.state(ESTIMATOR, PATIENCE) == 'unconfigured'
        assert not {*read_ports(process)[1]} & {*ports}
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
        assert log.read_text().count('starting again') == 1
    finally:
        process.kill()
        process.wait()
