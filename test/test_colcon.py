"""A colcon workspace that holds the project, built and used."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

from multicontact_control.experiment.graph.domain import reserve_domain
import pytest
from ros_graph import PATIENCE, ROOT

NAME = 'multicontact_control'
PROGRAMS = {
    'controller_node', 'multicontact',
    'noise_estimator_node', 'recorder_node', 'sim_node'}

pytestmark = pytest.mark.colcon


@pytest.fixture(scope='module')
def install(tmp_path_factory):
    """Build a workspace and return its install space."""
    for module in ('colcon_core', 'colcon_ros', 'colcon_python_setup_py'):
        pytest.importorskip(module, reason='colcon is not installed')
    workspace = tmp_path_factory.mktemp('workspace')
    (workspace / 'src').mkdir()
    (workspace / 'src' / NAME).symlink_to(ROOT, target_is_directory=True)
    before = untracked()
    command = [sys.executable, '-c', 'from colcon_core.command import main; main()', 'build',
               '--event-handlers', 'console_direct+']
    environment = {**os.environ, 'COLCON_HOME': str(workspace / 'home')}
    built = subprocess.run(
        command, cwd=workspace, env=environment, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    assert untracked() == before, 'the build left files among the sources'
    return workspace / 'install'


def untracked():
    # Hidden are the caches of tools, which other tests fill.
    return {path.name for path in ROOT.iterdir() if not path.name.startswith('.')}


@pytest.fixture(autouse=True)
def own_domain(monkeypatch):
    """Keep what is started here apart: a node that lingers would answer to its name."""
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with reserve_domain() as domain_id:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
        yield


def run_in(install, *command):
    """Run a command where the workspace is sourced, away from the checkout, not for ever."""
    environment = {key: value for key, value in os.environ.items() if key != 'PYTHONPATH'}
    line = f'. "{install}/setup.sh" && exec "$@"'
    return subprocess.run(
        ['sh', '-c', line, 'sh', *map(str, command)], cwd=install, env=environment,
        capture_output=True, text=True, timeout=PATIENCE, check=False)


def test_colcon_installs_the_nodes_where_ros2_run_looks(install):
    folder = install / NAME / 'lib' / NAME
    assert {path.name for path in folder.iterdir()} == PROGRAMS
    assert all(os.access(path, os.X_OK) for path in folder.iterdir())


def test_colcon_installs_the_share_folder(install):
    share = install / NAME / 'share'
    assert (share / NAME / 'package.xml').is_file()
    assert (share / 'ament_index/resource_index/packages' / NAME).is_file()
    for source in filter(Path.is_file, (ROOT / 'config').rglob('*')):
        copy = share / NAME / source.relative_to(ROOT)
        assert copy.read_bytes() == source.read_bytes()


def test_installed_package_finds_its_own_configuration(install):
    program = 'from multicontact_control.paths import config_dir; print(config_dir())'
    done = run_in(install, sys.executable, '-c', program)
    assert Path(done.stdout.strip()) == install / NAME / 'share' / NAME / 'config', done.stderr


@pytest.mark.ros
@pytest.mark.parametrize('name', sorted(PROGRAMS - {'multicontact'}))
def test_installed_node_starts_and_reads_its_parameters(install, name):
    done = run_in(install, install / NAME / 'lib' / NAME / name,
                  '--autostart', '--ros-args', '-p', 'no_such_parameter:=1')
    assert done.returncode == 2, done.stderr
    assert "found unknown 'no_such_parameter'" in done.stderr.splitlines()[-1]


def test_installed_command_runs(install):
    done = run_in(install, install / NAME / 'lib' / NAME / 'multicontact', '--version')
    assert done.stdout.startswith('multicontact '), done.stderr
