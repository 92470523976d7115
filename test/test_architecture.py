"""The rules of who may import whom, held against the sources and against trees that break them."""

from __future__ import annotations

from pathlib import Path

import pytest
from source_imports import find_cycle, imports_of, is_ros, PACKAGES, STRANGER

ROOT = Path(__file__).resolve().parents[1]
# What is not listed (config, errors, arrays, paths, sampling, ...) lies at the bottom.
LAYERS = {
    'dynamics': 1, 'contact': 1, 'force': 1, 'control': 2, 'sensor': 3, 'supervision': 3,
    'control_loop': 4, 'nodes': 5, 'experiment': 6, 'client': 6, 'view': 7,
    'cli': 8, '__main__': 8}
PINOCCHIO_HOME = 'multicontact_control.dynamics.robot'
STEPPED = (
    'multicontact_control.supervision.supervisor', 'multicontact_control.supervision.bumpless')


def area(module: str) -> str:
    """Return the part of the package a module belongs to, e.g. 'force'; '' for another package."""
    package, *inner = module.split('.')
    return (inner[0] if inner else '__init__') if package == 'multicontact_control' else ''


def layer(module: str) -> int:
    return LAYERS.get(area(module), 0)


def is_core(module: str) -> bool:
    return area(module) != '' and layer(module) <= LAYERS['control_loop']


def broken_rule(module: str, target: str) -> str:
    """Return what an import breaks, or nothing."""
    top = target.split('.')[0]
    if is_core(module) and (is_ros(target) or top in ('pybullet', 'sim_bridge')):
        return 'the core knows neither ROS nor the simulation'
    if module == STRANGER:
        return 'it runs where this package is not' if top in PACKAGES else ''
    if top in ('viser', 'websockets') and area(module) != 'view':
        return 'the page is an extra, known to view/ alone'
    if top == 'pinocchio' and module != PINOCCHIO_HOME and not module.startswith('sim_bridge'):
        return 'pinocchio is wrapped in dynamics/robot.py'
    if target.startswith(STEPPED) and area(module) not in ('supervision', 'control_loop'):
        return 'samples become torques in control_loop.py'
    if area(module) in ('control', 'supervision') and f'{target}.'.startswith(
            'multicontact_control.force.noise.'):
        return 'R reaches the controller as a number'
    if area(module) and area(target):
        if layer(module) < layer(target):
            return 'imports flow downwards'
        if layer(module) == layer(target) in (1, 3) and area(module) != area(target):
            return 'dynamics, contact and force know nothing of each other, nor do sensor and ' \
                'supervision'
    return ''


def violations(root: Path) -> list[str]:
    graph = imports_of(root)
    broken = [
        f'{module} imports {target}: {rule}'
        for module, targets in graph.items() for target in sorted(targets)
        if (rule := broken_rule(module, target))]
    cycle = find_cycle(graph)
    return broken + ([f'import cycle: {" > ".join(cycle)}'] if cycle else [])


def test_sources_keep_the_rules_of_the_architecture():
    assert imports_of(ROOT), 'no sources found'
    assert violations(ROOT) == []


GOOD = {
    '__init__.py': "__version__ = '1'", 'errors.py': '', 'dynamics/__init__.py': '',
    'config.py': 'from multicontact_control.errors import ConfigError',
    'dynamics/robot.py': 'import numpy\nimport pinocchio',
    'contact/geometry.py': 'from multicontact_control import config', 'force/noise.py': '',
    'force/observer.py': 'from . import noise',
    'control/controller.py': 'import multicontact_control.force.observer', 'control_loop.py': '',
    'nodes/node.py': 'import rclpy\nfrom multicontact_control.control.controller import Law',
    'nodes/qos.py': '', 'experiment/loop.py': 'from sim_bridge.plant import Plant',
    'view/__init__.py': '', 'cli/__init__.py': '',
    'cli/run.py': 'def run():\n    import multicontact_control.experiment.loop',
    '../sim_bridge/plant.py':
        'import pybullet\nimport pinocchio\nimport multicontact_control.config'}


def write_tree(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = root / 'multicontact_control' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding='utf-8')


@pytest.mark.parametrize(('path', 'text', 'complaint'), [
    ('errors.py', '', ''),  # nothing is wrong
    ('config.py', 'import rclpy', 'the core knows neither'),
    ('control_loop.py', 'from sensor_msgs.msg import JointState', 'the core knows neither'),
    ('control/controller.py', 'def f():\n    import sim_bridge.plant', 'the core knows neither'),
    ('nodes/node.py', 'import pinocchio as pin', 'pinocchio is wrapped'),
    ('experiment/loop.py', 'from multicontact_control.supervision.supervisor import Supervisor',
     'in control_loop.py'),
    ('control/controller.py', 'from multicontact_control.force import noise', 'as a number'),
    ('control/controller.py', 'from ..force.noise import f', 'as a number'),
    ('dynamics/__init__.py', 'from ..contact.geometry import N', 'of each other'),
    ('control_loop.py', 'from multicontact_control.nodes import qos', 'flow downwards'),
    ('experiment/loop.py', 'from multicontact_control import view', 'imports flow downwards'),
    ('cli/run.py', 'import viser', 'known to view/ alone'),
    ('experiment/bench/tsid_tick.py', 'import multicontact_control.errors', 'this package is not'),
    ('force/noise.py', 'from .observer import Observer', 'import cycle'),
    ('../sim_bridge/plant.py', 'import multicontact_control.experiment.loop', 'import cycle')])
def test_broken_rule_is_found(tmp_path, path, text, complaint):
    write_tree(tmp_path, GOOD)
    write_tree(tmp_path, {path: text})
    found = violations(tmp_path)
    assert any(complaint in each for each in found) if complaint else found == []
