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
    """
    Write, or replace, a ROS 2 parameter file.

    `nodes` are the nested parameters of each node by its name, or pattern such as ``/**``. `head`
    is text above them, each line of which is a comment.
    """
    content = {}
    for name, values in nodes.items():
        content[name] = {'ros__parameters': _ros_values(values)}
    replace_text_file(
        path, head + yaml.dump(content, Dumper=_RosDumper, sort_keys=False)
    )


def _ros_values(value: Any) -> Any:
    """Return a value as rcl reads it: no empty mappings, and lists of numbers of one type."""
    if isinstance(value, Mapping):
        kept = {}
        for name, entry in value.items():
            written = _ros_values(entry)
            if written != {}:
                kept[name] = written
        return kept
    if isinstance(value, (list, tuple)):
        if any(isinstance(entry, float) for entry in value):
            return [float(entry) for entry in value]
        return [_ros_values(entry) for entry in value]
    return value
