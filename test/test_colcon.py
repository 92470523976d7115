"""A colcon workspace that holds the project, built and used."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

import pytest
from ros_graph import own_domain, PATIENCE, ROOT

NAME = 'multicontact_control'
NODES = ['controller_node', 'noise_estimator_node', 'recorder_node', 'sim_node']

pytestmark = [pytest.mark.colcon, pytest.mark.ros, pytest.mark.nightly]


@pytest.fixture
def install(tmp_path):
    """Build a workspace and return its install space."""
    for module in ('colcon_core', 'colcon_ros', 'colcon_python_setup_py'):
        pytest.importorskip(module, reason='colcon is not installed')
    (tmp_path / 'src').mkdir()
    (tmp_path / 'src' / NAME).symlink_to(ROOT, target_is_directory=True)
    command = [sys.executable, '-c', 'from colcon_core.command import main; main()', 'build',
               '--event-handlers', 'console_direct+']
    built = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, 'COLCON_HOME': str(tmp_path / 'home')},
        capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return tmp_path / 'install'


def run_in(install, *command):
    """Run a command where the workspace is sourced, in a domain of its own."""
    with own_domain() as domain_id:
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        environment.pop('PYTHONPATH', None)
        return subprocess.run(
            ['sh', '-c', f'. "{install}/setup.sh" && exec "$@"', 'sh', *map(str, command)],
            cwd=install, env=environment, capture_output=True, text=True, timeout=PATIENCE,
            check=False)


def test_colcon_installs_what_ros2_looks_for(install):
    folder, share = install / NAME / 'lib' / NAME, install / NAME / 'share'
    assert {path.name for path in folder.iterdir() if os.access(path, os.X_OK)} == {
        *NODES, 'multicontact'}
    assert (share / NAME / 'package.xml').is_file()
    assert (share / 'ament_index/resource_index/packages' / NAME).is_file()
    done = run_in(install, sys.executable, '-c',
                  'from multicontact_control.paths import config_dir; print(config_dir())')
    assert Path(done.stdout.strip()) == share / NAME / 'config', done.stderr
    assert run_in(install, folder / 'multicontact', '--version').stdout.startswith('multicontact ')
    for name in NODES:  # each starts, and reads its parameters
        done = run_in(install, folder / name, '--autostart', '--ros-args', '-p', 'no_such:=1')
        assert done.returncode == 2, done.stderr
        assert "found unknown 'no_such'" in done.stderr.splitlines()[-1]
