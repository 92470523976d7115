"""What setup.py, package.xml and the Makefile promise, held against the sources."""

from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import multicontact_control
from packaging.requirements import Requirement
import pytest
import setuptools
from source_imports import imports_of, is_ros, PACKAGES

ROOT = Path(__file__).resolve().parents[1]
NODES = {'controller_node', 'noise_estimator_node', 'recorder_node', 'sim_node'}
IMPORT_NAMES = {'pin': 'pinocchio', 'pyyaml': 'yaml', 'mcap-ros2-support': 'mcap_ros2'}


@pytest.fixture
def describe(monkeypatch):
    """Return what tells what setup.py hands to setuptools when it is run with some arguments."""
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


def test_name_version_and_maintainer_are_the_same_everywhere(describe, manifest):
    keywords, version = describe(), multicontact_control.__version__
    assert keywords['version'] == manifest.findtext('version') == version
    assert re.fullmatch(r'\d+\.\d+\.\d+', version)
    assert keywords['name'] == manifest.findtext('name')
    assert (ROOT / 'resource' / keywords['name']).is_file()
    addresses = [element.get('email') for element in manifest.iter('maintainer')]
    assert addresses == [keywords['maintainer_email']]
    assert re.fullmatch(r'[\w.+-]+@[\w-]+\.[\w.-]+', addresses[0]), 'colcon accepts no other'


def test_both_packages_are_installed_with_all_files(describe):
    keywords = describe()
    assert {name.split('.')[0] for name in keywords['packages']} == set(PACKAGES)
    bare = {path.parent for name in PACKAGES for path in (ROOT / name).rglob('*.py')
            if not (path.parent / '__init__.py').is_file()}
    assert bare == set()
    package = ROOT / 'multicontact_control'
    beside = [path.relative_to(package) for path in package.rglob('*') if path.is_file()
              and path.suffix != '.py' and '__pycache__' not in path.parts]
    patterns = keywords['package_data']['multicontact_control']
    assert len(beside) > 1 and all(any(map(path.match, patterns)) for path in beside)


def test_console_scripts_exist(describe):
    scripts = scripts_of(describe())
    assert set(scripts) == NODES | {'multicontact'}
    for name, target in scripts.items():
        module, function = target.split(':')
        text = Path(find_spec(module).origin).read_text(encoding='utf-8')
        assert re.search(rf'^def {function}\b|import .*\b{function}\b', text, re.M), name


def test_every_dependency_has_bounds_and_the_installed_is_inside(describe):
    keywords = describe()
    for line in (*keywords['install_requires'], *sum(keywords['extras_require'].values(), [])):
        requirement = Requirement(line)
        operators = {specifier.operator for specifier in requirement.specifier}
        assert operators == {'=='} or operators == {'>=', '<'}, line
        if line in keywords['install_requires']:
            assert requirement.specifier.contains(metadata.version(requirement.name)), line


def test_every_import_is_declared(describe, manifest):
    keywords = describe()
    extras = keywords['extras_require']
    declared = {Requirement(line).name.lower() for line in sum(
        (extras[name] for name in ('dask', 'mujoco', 'view')), keywords['install_requires'])}
    used = {target.split('.')[0] for module, targets in imports_of(ROOT).items()
            for target in targets}
    outside = used - set(PACKAGES) - sys.stdlib_module_names
    assert {name for name in outside if not is_ros(name)} <= {
        IMPORT_NAMES.get(name, name) for name in declared}
    assert {name for name in outside if is_ros(name)} <= {
        element.text for element in manifest.iter('exec_depend')}
    assert not [line for line in keywords['install_requires'] if line.startswith('ros-')]


def test_wrappers_are_left_to_colcon_when_it_builds(describe):
    keywords = describe('egg_info', 'build', 'install', 'install_data')
    assert 'lib/multicontact_control' not in dict(keywords['data_files'])


def test_install_data_lands_where_ros_looks(describe, tmp_path):
    command = [sys.executable, '-W', 'ignore', 'setup.py', '--quiet', 'install_data',
               '--install-dir', str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    share = tmp_path / 'share'
    assert (share / 'ament_index/resource_index/packages/multicontact_control').is_file()
    assert (share / 'multicontact_control/package.xml').is_file()
    for source in filter(Path.is_file, (ROOT / 'config').rglob('*')):
        copy = share / 'multicontact_control' / source.relative_to(ROOT)
        assert copy.read_bytes() == source.read_bytes()
    wrappers = tmp_path / 'lib/multicontact_control'
    assert {path.name for path in wrappers.iterdir()} == set(scripts_of(describe()))
