"""What setup.py, package.xml and the Makefile promise, held against the sources."""

import ast
from importlib import metadata
from importlib.util import find_spec
import os
from pathlib import Path
import re
import runpy
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import multicontact_control
from packaging.requirements import Requirement
import pytest
import setuptools
from source_imports import imports_of, is_ros, PACKAGES

ROOT = Path(__file__).resolve().parents[1]
NODES = {
    'controller_node', 'noise_estimator_node',
    'recorder_node', 'sim_node'}
ALLOWED_AT_THE_TOP = {
    'package.xml', 'setup.py', 'setup.cfg', 'multicontact_control', 'sim_bridge', 'config', 'test',
    'resource', 'README.md', 'LICENSE', 'CHANGELOG.md', 'CONTRIBUTING.md', 'Makefile', '.ci',
    '.gitignore', 'pyproject.toml', 'docs', 'benchmarks'}
IMPORT_NAMES = {'pin': 'pinocchio', 'pyyaml': 'yaml', 'mcap-ros2-support': 'mcap_ros2'}


@pytest.fixture
def described(monkeypatch):
    """Return what setup.py hands to setuptools when it is run with some arguments."""
    def run(*arguments):
        received = {}
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr(sys, 'argv', ['setup.py', *arguments])
        monkeypatch.setattr(setuptools, 'setup', lambda **keywords: received.update(keywords))
        runpy.run_path(str(ROOT / 'setup.py'))
        return received
    return run


@pytest.fixture(scope='module')
def manifest():
    return ElementTree.parse(ROOT / 'package.xml').getroot()


def scripts_of(keywords):
    return dict(line.split(' = ') for line in keywords['entry_points']['console_scripts'])


def requirements_of(keywords):
    extras = keywords['extras_require'].values()
    return [Requirement(line) for lines in (keywords['install_requires'], *extras)
            for line in lines]


def test_version_is_the_same_everywhere(described, manifest):
    version = multicontact_control.__version__
    assert described()['version'] == version
    assert manifest.findtext('version') == version
    assert re.fullmatch(r'\d+\.\d+\.\d+', version)


def test_maintainer_address_is_one_that_colcon_accepts(described, manifest):
    addresses = [element.get('email') for element in manifest.iter('maintainer')]
    assert addresses == [described()['maintainer_email']]
    assert re.fullmatch(r'[\w.+-]+@[\w-]+\.[\w.-]+', addresses[0])


def test_package_name_is_the_same_everywhere(described, manifest):
    assert described()['name'] == manifest.findtext('name')
    assert (ROOT / 'resource' / manifest.findtext('name')).is_file()


def test_both_packages_are_installed(described):
    assert {name.split('.')[0] for name in described()['packages']} == set(PACKAGES)
    assert (ROOT / 'multicontact_control' / 'py.typed').is_file()


def test_every_folder_with_modules_is_a_package():
    bare = {path.parent for name in PACKAGES for path in (ROOT / name).rglob('*.py')
            if not (path.parent / '__init__.py').is_file()}
    assert bare == set()


def test_files_beside_the_modules_are_installed(described):
    patterns = described()['package_data']['multicontact_control']
    package = ROOT / 'multicontact_control'
    beside = [path.relative_to(package) for path in package.rglob('*') if path.is_file()
              and path.suffix != '.py' and '__pycache__' not in path.parts]
    assert len(beside) > 1
    assert [path for path in beside if not any(map(path.match, patterns))] == []


def test_console_scripts_exist(described):
    for name, target in scripts_of(described()).items():
        module, function = target.split(':')
        spec = find_spec(module)
        assert spec is not None and spec.origin, f'{name}: no module {module}'
        names = {getattr(node, 'name', None) for node in ast.parse(
            Path(spec.origin).read_text(encoding='utf-8')).body}
        assert function in names, f'{name}: no function {function} in {module}'


def test_every_node_has_a_console_script(described):
    assert set(scripts_of(described())) == NODES | {'multicontact'}


def test_wrappers_are_those_of_the_console_scripts(described):
    keywords = described('bdist_wheel')
    wrappers = dict(keywords['data_files'])['lib/multicontact_control']
    assert {Path(path).name for path in wrappers} == set(scripts_of(keywords))


def test_wrappers_are_left_to_colcon_when_it_builds(described):
    keywords = described('egg_info', 'build', 'install', 'install_data')
    assert 'lib/multicontact_control' not in dict(keywords['data_files'])


def test_every_dependency_has_a_lower_and_an_upper_bound(described):
    for requirement in requirements_of(described()):
        operators = {specifier.operator for specifier in requirement.specifier}
        assert operators == {'=='} or operators == {'>=', '<'}, str(requirement)


def test_installed_versions_are_inside_the_stated_ranges(described):
    for line in described()['install_requires']:
        requirement = Requirement(line)
        found = metadata.version(requirement.name)
        assert requirement.specifier.contains(found), f'{line}, found {found}'


def test_every_imported_distribution_is_declared(described):
    keywords = described()
    required = [Requirement(line).name.lower()
                for line in keywords['install_requires'] + keywords['extras_require']['dask']
                + keywords['extras_require']['mujoco'] + keywords['extras_require']['view']]
    declared = {IMPORT_NAMES.get(name, name) for name in required}
    used = {target.split('.')[0] for targets in imports_of(ROOT).values() for target in targets}
    outside = {name for name in used - set(PACKAGES) - sys.stdlib_module_names if not is_ros(name)}
    assert outside <= declared


def test_every_imported_ros_package_is_in_the_manifest(manifest):
    used = {target.split('.')[0] for targets in imports_of(ROOT).values()
            for target in targets if is_ros(target)}
    assert used <= {element.text for element in manifest.iter('exec_depend')}


def test_ros_wheels_are_an_extra(described):
    keywords = described()
    assert not [line for line in keywords['install_requires'] if line.startswith('ros-')]
    assert {Requirement(line).name for line in keywords['extras_require']['ros']} == {
        'ros-jazzy-rclpy', 'ros-jazzy-rmw-fastrtps-cpp', 'ros-jazzy-common-interfaces'}
    assert not [line for line in keywords['extras_require']['test'] if line.startswith('ros-')]


@pytest.mark.skipif(not shutil.which('git') or not (ROOT / '.git').exists(), reason='no git')
def test_top_level_holds_what_a_repository_needs_and_no_more():
    command = ['git', 'ls-files', '--cached', '--others', '--exclude-standard']
    listed = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert {path.split('/')[0] for path in listed} <= ALLOWED_AT_THE_TOP


def test_install_data_lands_where_ros_looks(described, tmp_path):
    command = [sys.executable, '-W', 'ignore', 'setup.py', '--quiet', 'install_data',
               '--install-dir', str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    share = tmp_path / 'share'
    assert (share / 'ament_index/resource_index/packages/multicontact_control').is_file()
    assert (share / 'multicontact_control/package.xml').is_file()
    for source in filter(Path.is_file, (ROOT / 'config').rglob('*')):
        copy = share / 'multicontact_control' / source.relative_to(ROOT)
        assert copy.read_bytes() == source.read_bytes()
    for name in scripts_of(described()):
        assert os.access(tmp_path / 'lib/multicontact_control' / name, os.X_OK)


def test_wrapper_calls_the_script_in_bin_with_its_arguments(described, tmp_path):
    described('bdist_wheel')  # writes the wrappers
    wrapper = tmp_path / 'lib/multicontact_control/sim_node'
    script = tmp_path / 'bin/sim_node'
    for path in (wrapper, script):
        path.parent.mkdir(parents=True)
    shutil.copy(ROOT / 'build/ros2_run/sim_node', wrapper)
    script.write_text('#!/bin/sh\necho "$0|$1|$2"; exit 3\n', encoding='utf-8')
    script.chmod(0o755)
    result = subprocess.run(
        [wrapper, 'a b', 'c'], capture_output=True, text=True, check=False)
    assert result.stdout.strip().endswith('/bin/sim_node|a b|c')
    assert result.returncode == 3
