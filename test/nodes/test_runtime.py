"""What a process of ROS does before it starts."""

import os
import time

from multicontact_control.nodes.runtime import remove_half_made_ports

MINUTE = 60.0


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
