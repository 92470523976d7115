"""Parameter files that commands write, for nodes (`--params-file`) and commands alike."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import re
from typing import Any

from multicontact_control.files import replace_text_file
import yaml


class _RosDumper(yaml.SafeDumper):
    """Quotes also the strings that rcl takes for numbers or booleans: y, 1e5, 007."""


_RosDumper.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'([-+.\d][\w.+-]*|y|n|nan|inf(inity)?)$', re.I),
    None,
)


def write_parameters(path: Path, nodes: Mapping[str, Any], head: str = '') -> None:
    """Replace a ROS 2 parameter file by the values of nodes, by name, below comments `head`."""
    content = {
        name: {'ros__parameters': _ros_values(values)} for name, values in nodes.items()
    }
    replace_text_file(
        path, head + yaml.dump(content, Dumper=_RosDumper, sort_keys=False)
    )


def _ros_values(value: Any) -> Any:
    """Return a value as rcl reads it: no empty mappings, and lists of numbers of one type."""
    if isinstance(value, Mapping):
        kept = {name: _ros_values(entry) for name, entry in value.items()}
        return {name: entry for name, entry in kept.items() if entry != {}}
    if isinstance(value, (list, tuple)):
        real = any(isinstance(entry, float) for entry in value)
        return [float(entry) if real else _ros_values(entry) for entry in value]
    return value
