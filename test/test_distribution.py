"""
The wheel alone, installed from the registry into an empty venv: every command in any folder.

`make dist` runs it with the wheel that it has built, and shows how long each command takes.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from urllib.request import urlopen

from multicontact_control.runs.graph.domain import reserve_domain
import pytest
from ros_graph import PATIENCE, ROOT

pytestmark = [pytest.mark.ros, pytest.mark.nightly]
EXTRAS = 'ros,view'
ADDRESS = re.compile(r'http://\S+')
NODES = ('sim_node', 'multicontact_controller_node', 'noise_estimator_node')
PARAMETER_FILES = ('plant_rigid', 'controller', 'noise_estimator')


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    """Return the wheel of `make dist`, or build one from the source distribution."""
    given = os.environ.get('MULTICONTACT_WHEEL')
    if given:
        return ROOT / given
    source = tmp_path_factory.mktemp('source') / 'project'
    left_out = shutil.ignore_patterns('.*', 'build', 'dist', 'runs', '__pycache__')
    shutil.copytree(ROOT, source, ignore=left_out)
    subprocess.run([sys.executable, '-m', 'build', '--quiet', source], check=True)
    (built,) = (source / 'dist').glob('*.whl')
    return built


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder of a user's, far from any checkout."""
    return tmp_path_factory.mktemp('anywhere')


@pytest.fixture(scope='module')
def environment(tmp_path_factory):
    """Return the environment of a user with empty caches, who has sourced nothing."""
    environment = {'HOME': str(tmp_path_factory.mktemp('home'))}
    for name, value in os.environ.items():
        if name in ('PATH', 'LANG') or name.startswith(('PIP_', 'UV_', 'SSL_')):
            environment[name] = value
    with reserve_domain() as domain:
        yield environment | {'ROS_DOMAIN_ID': str(domain)}


@pytest.fixture(scope='module')
def commands(wheel, environment, tmp_path_factory):
    """Return the bin folder of a new venv that has the wheel, and what that asks for."""
    venv = tmp_path_factory.mktemp('empty') / 'venv'
    subprocess.run([sys.executable, '-m', 'venv', venv], check=True)
    pip = (venv / 'bin/python', '-m', 'pip', 'install', '--quiet')
    begin = time.monotonic()
    installed = subprocess.run(
        [*pip, f'{wheel}[{EXTRAS}]'], env=environment, capture_output=True, text=True
    )
    if 'No matching distribution' in installed.stderr:
        pytest.skip(f'no registry can be reached: {installed.stderr.strip()}')
    assert installed.returncode == 0, installed.stderr
    show(f'pip install {wheel.name}[{EXTRAS}]', begin)
    return venv / 'bin'


def show(command, begin):
    """Print how long a command took that was begun at a monotonic time."""
    print(f'{time.monotonic() - begin:7.1f} s  {command}')


@pytest.fixture(scope='module')
def run(commands, folder, environment):
    """Return what runs a command of the venv in that folder, and shows its time."""

    def run_command(name, *arguments):
        begin = time.monotonic()
        done = subprocess.run(
            [commands / name, *map(str, arguments)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        show(' '.join([name, *map(str, arguments)]), begin)
        return done

    return run_command


def stop(process):
    """End a process as Ctrl-C does."""
    process.send_signal(signal.SIGINT)
    process.wait(PATIENCE)


def test_first_commands_need_nothing_but_the_wheel(run, folder):
    assert run('multicontact', '--version').returncode == 0
    help_text = run('multicontact', 'demo', '--help').stdout
    assert 'panda' in help_text  # the robots of config/ are found
    simulated = run('multicontact', 'simulate', '--scenario', 'quick', '--out', 'first')
    assert simulated.returncode == 0, simulated.stderr
    ran = run('multicontact', 'run', '--scenario', 'quick', '--out', 'second')
    assert ran.returncode == 0, ran.stderr
    assert (folder / 'second/figures/fig3_force_table.png').is_file()


def test_demo_serves_its_page(commands, folder, environment):
    begin = time.monotonic()
    with subprocess.Popen(
        [commands / 'multicontact', 'demo'],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            address = next(filter(None, map(ADDRESS.search, process.stdout)))[0]
            with urlopen(address) as page:
                assert b'</html>' in page.read()
            show('multicontact demo, until its page is served', begin)
        finally:
            stop(process)


def test_nodes_by_their_own_commands_obey_the_python_client(
    commands, run, folder, environment
):
    config = commands.parent / 'share/multicontact_control/config'
    nodes = []
    for name, file in zip(NODES, PARAMETER_FILES):
        command = [
            commands / name,
            '--ros-args',
            '--params-file',
            config / f'{file}.yaml',
        ]
        if name != 'sim_node':
            command.insert(1, '--autostart')
        if file == 'controller':  # which waits for a simulator that is slow
            command += ['-p', 'patience:=0.0']
        with (folder / f'{name}.log').open('w') as log:
            node = subprocess.Popen(
                command, cwd=folder, env=environment, stdout=log, stderr=log
            )
        nodes.append(node)
    try:
        shutil.copy(ROOT / 'examples/press_and_slide.py', folder)
        done = run('python', 'press_and_slide.py', environment['ROS_DOMAIN_ID'])
        assert done.returncode == 0, done.stderr
        assert 'let go' in done.stdout
    finally:
        for node in nodes:
            stop(node)


def test_ros2_run_finds_the_short_names(commands):
    short_names = (commands.parent / 'lib/multicontact_control').iterdir()
    found = {path.name for path in short_names}
    assert {'controller_node', 'sim_node', 'multicontact'} <= found
