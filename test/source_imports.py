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
    modules, imports = module_paths(root), {}
    for name, path in modules.items():
        targets: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'), str(path))):
            if isinstance(node, ast.Import):
                targets.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f'{name}: a relative import'
                inner = {f'{node.module}.{alias.name}' for alias in node.names} & modules.keys()
                targets.update(inner or {node.module})
        imports[name] = targets - {name}
    return imports


def is_ros(module: str) -> bool:
    """Return whether a module is one of ROS 2."""
    top = module.split('.')[0]
    return top in ('rclpy', 'ament_index_python', 'rosidl_runtime_py', 'rosidl_parser') or (
        top.endswith(('_msgs', '_srvs', '_interfaces')))
