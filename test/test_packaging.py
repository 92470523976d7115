"""What setup.py and package.xml promise, held against the sources."""

from importlib.util import find_spec
from pathlib import Path
import runpy
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
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def keywords():
    """Return what setup.py hands to setuptools."""
    received = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(sys, 'argv', ['setup.py'])
        patch.setattr(setuptools, 'setup', lambda **keywords: received.update(keywords))
        runpy.run_path(str(ROOT / 'setup.py'))
    return received


def test_both_packages_are_installed_with_all_files(keywords):
    assert keywords['version'] == MANIFEST.findtext('version') == multicontact_control.__version__
    assert {name.split('.')[0] for name in keywords['packages']} == set(PACKAGES)
    assert {path.parent for name in PACKAGES for path in (ROOT / name).rglob('*.py')
            if not (path.parent / '__init__.py').is_file()} == set()
    package = ROOT / 'multicontact_control'
    beside = [path.relative_to(package) for path in package.rglob('*') if path.is_file()
              and path.suffix != '.py' and '__pycache__' not in path.parts]
    patterns = keywords['package_data']['multicontact_control']
    assert beside and all(any(map(path.match, patterns)) for path in beside)


def test_console_scripts_exist(keywords):
    scripts = dict(line.split(' = ') for line in keywords['entry_points']['console_scripts'])
    assert set(scripts) == NODES | {'multicontact'}
    for target in scripts.values():
        module, function = target.split(':')
        assert function in Path(find_spec(module).origin).read_text(encoding='utf-8')


def test_every_import_is_declared(keywords):
    extras = keywords['extras_require']
    declared = {Requirement(line).name.lower() for line in sum(
        (extras.get(name, []) for name in ('dask', 'mujoco', 'view')),
        keywords['install_requires'])}
    outside = {target.split('.')[0] for targets in imports_of(ROOT).values()
               for target in targets} - set(PACKAGES) - sys.stdlib_module_names
    assert {name for name in outside if not is_ros(name)} <= {
        IMPORT_NAMES.get(name, name) for name in declared}
    assert {name for name in outside if is_ros(name)} <= {
        element.text for element in MANIFEST.iter('exec_depend')}
