"""What the modules of a source tree import, read from the text without running any of it."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGES = ('multicontact_control', 'sim_bridge')


def module_paths(root: Path) -> dict[str, Path]:
    """Return the path of every module of the two packages in `root`, by dotted name."""
    modules = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob('*.py')):
            parts = path.relative_to(root).with_suffix('').parts
            modules['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = path
    return modules


def imports_of(root: Path) -> dict[str, set[str]]:
    """Return the modules that each module imports, wherever in the module it does so."""
    modules = module_paths(root)
    return {
        name: _imports(path, name, path.name == '__init__.py', set(modules))
        for name, path in modules.items()}


def _imports(path: Path, name: str, is_package: bool, modules: set[str]) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'), str(path))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(node, name, is_package)
            for alias in node.names:
                target = f'{base}.{alias.name}'
                found.add(target if target in modules else base)
    return found - {name}


def _absolute(node: ast.ImportFrom, name: str, is_package: bool) -> str:
    if node.level == 0:
        return node.module or ''
    parts = name.split('.')
    parts = parts[:len(parts) - node.level + (1 if is_package else 0)]
    return '.'.join([*parts, *([node.module] if node.module else [])])


def is_ros(module: str) -> bool:
    """Return whether a module is one of ROS 2."""
    top = module.split('.')[0]
    return top in ('rclpy', 'ament_index_python', 'rosidl_runtime_py', 'rosidl_parser') or (
        top.endswith(('_msgs', '_srvs', '_interfaces')))
