"""The rules of who may import whom, held against the sources."""

from __future__ import annotations

from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

from source_imports import imports_of, is_ros, module_paths

ROOT = Path(__file__).resolve().parents[1]
# What is not listed (config, errors, arrays, paths, ...) lies at the bottom.
LAYERS = {
    'dynamics': 1, 'contact': 1, 'force': 1, 'control': 2, 'sensor': 3, 'supervision': 3,
    'sampling': 4, 'loop': 4, 'nodes': 5, 'experiment': 6, 'client': 6, 'view': 7,
    'cli': 8, '__main__': 8}
PINOCCHIO_HOME = 'multicontact_control.dynamics.robot'
STEPPED = 'multicontact_control.supervision.supervisor'
# Lines of a room, docstrings included: who adds an idea makes room for it.
SLACK = 1.1
TOP, LOOP = 'top', 'loop and sampling'
BUDGETS = {
    TOP: 1000, 'dynamics': 600, 'contact': 650, 'force': 1950, 'control': 1100, LOOP: 450,
    'supervision': 2150, 'sensor': 550, 'config': 850, 'nodes': 2600}
MOST_LINES = 12_800  # of all these rooms
MOST_COMPILED = 80  # functions


def area(module: str) -> str:
    """Return the part of the package a module belongs to, e.g. 'force'; '' for another package."""
    package, *inner = module.split('.')
    return (inner[0] if inner else '__init__') if package == 'multicontact_control' else ''


def layer(module: str) -> int:
    return LAYERS.get(area(module), 0)


def is_core(module: str) -> bool:
    return area(module) != '' and layer(module) <= LAYERS['loop']


def broken_rule(module: str, target: str) -> str:
    """Return what an import breaks, or nothing."""
    top = target.split('.')[0]
    if is_core(module) and (is_ros(target) or top in ('pybullet', 'sim_bridge')):
        return 'the core knows neither ROS nor the simulation'
    if top in ('viser', 'websockets') and area(module) != 'view':
        return 'the page is an extra, known to view/ alone'
    if top == 'pinocchio' and module != PINOCCHIO_HOME and not module.startswith('sim_bridge'):
        return 'pinocchio is wrapped in dynamics/robot.py'
    if target.startswith(STEPPED) and area(module) not in ('supervision', 'loop'):
        return 'samples become torques in loop.py'
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


def test_sources_keep_the_rules_of_the_architecture():
    graph = imports_of(ROOT)
    assert len(graph) > 100
    assert [f'{module} imports {target}: {rule}'
            for module, targets in graph.items() for target in sorted(targets)
            if (rule := broken_rule(module, target))] == []
    TopologicalSorter(graph).prepare()  # CycleError names an import cycle


def room(module: str) -> str:
    """Return the room of a module of the core and the nodes, or nothing."""
    package, *inner = module.split('.')
    if package != 'multicontact_control':
        return ''
    if inner in (['loop'], ['sampling']):
        return LOOP
    if inner and inner[0] in BUDGETS:
        return inner[0]
    return '' if inner and inner[0] in ('experiment', 'view', 'cli', '__main__') else TOP


def sources() -> dict[str, list[str]]:
    return {module: path.read_text(encoding='utf-8').splitlines()
            for module, path in module_paths(ROOT).items()}


def test_rooms_stay_within_their_budgets():
    lines: Counter[str] = Counter()
    for module, text in sources().items():
        lines[room(module)] += len(text)
    rooms = {name: lines[name] for name in BUDGETS}
    assert all(rooms.values())
    assert [f'{name}: {count} lines' for name, count in rooms.items()
            if count > SLACK * BUDGETS[name]] == []
    assert sum(rooms.values()) <= MOST_LINES


def test_compiled_functions_are_few():
    assert sum(line.strip() == '@compiled'
               for text in sources().values() for line in text) <= MOST_COMPILED
