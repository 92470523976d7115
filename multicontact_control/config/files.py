"""From files to configurations and back, with one clear line per bad value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, get_args, TypeVar

from multicontact_control.config.base import Config
from multicontact_control.errors import ConfigError
from pydantic import BaseModel, ValidationError
import yaml

ModelT = TypeVar('ModelT', bound='Config')
EVERY_NODE = '**'  # in the place of a node's name


def validate(model: type[ModelT], values: Mapping[str, Any], source: str = '') -> ModelT:
    """
    Build a configuration from nested plain values, as a YAML file gives them.

    Raises
    ------
    ConfigError
        With every field that is not acceptable, a line for each, and the file name `source`. What
        depends on several fields is looked at once each of them is a value of its kind.

    """
    errors: list[ConfigError] = []
    config = None
    try:
        config = model.model_validate(values, context=errors)
    except ConfigError as error:
        errors.append(error)
    except ValidationError as error:
        errors[:0] = [_field_error(detail, model) for detail in error.errors(include_url=False)]
    if config is None or errors:
        raise ConfigError.of(errors).with_source(source) from None
    return config


def _field_error(detail: Mapping[str, Any], model: type[Config]) -> ConfigError:
    field = '.'.join(str(part) for part in detail['loc']) or model.__name__
    kind, message = detail['type'], detail['msg']
    if kind == 'extra_forbidden':
        return ConfigError(field, f'a known key ({_known_keys(model, detail["loc"])})',
                           f"unknown key '{detail['loc'][-1]}'")
    if kind == 'missing':
        return ConfigError(field, 'a value', 'nothing')
    expected = message.removeprefix('Value error, ').removeprefix('Input should be ')
    return ConfigError(field, expected.removeprefix('expected '), repr(detail['input']))


def _known_keys(model: type[Config], location: tuple[int | str, ...]) -> str:
    """Return the keys that are known at the level of the unknown one."""
    current: Any = model
    for part in location[:-1]:
        if isinstance(current, type) and issubclass(current, BaseModel):
            field = current.model_fields.get(str(part))
            current = field.annotation if field else None
        else:  # the values of a mapping or the items of a sequence
            arguments = [x for x in get_args(current) if x is not Ellipsis]
            current = arguments[-1] if arguments else None
        if type(None) in get_args(current):
            current = next(x for x in get_args(current) if x is not type(None))
    if isinstance(current, type) and issubclass(current, BaseModel):
        return ', '.join(current.model_fields)
    return 'see the documentation'


def read_yaml(path: Path) -> dict[str, Any]:
    """
    Read a YAML mapping.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML, or does not hold a mapping.

    """
    try:
        data = deepcopy(_parse(path.read_text(encoding='utf-8')))
    except OSError as error:
        raise ConfigError(str(path), 'a readable file', error.strerror or error) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = str(error).replace('\n', ' ')
        raise ConfigError(str(path), 'valid YAML', line) from None
    if not isinstance(data, dict):
        raise ConfigError(str(path), 'a mapping of keys to values', type(data).__name__)
    return data


@lru_cache(maxsize=32)
def _parse(text: str) -> Any:
    # A sweep resolves the same files for each of its runs.
    return yaml.safe_load(text)


def read_parameters(path: Path) -> dict[str, Any]:
    """
    Read the parameters of a ROS 2 parameter file with one `ros__parameters` section.

    Raises
    ------
    ConfigError
        If the file cannot be read or has no such section.

    """
    data = read_yaml(path)
    sections = [value for value in data.values() if isinstance(value, dict)]
    if len(data) != 1 or not sections or not isinstance(sections[0].get('ros__parameters'), dict):
        raise ConfigError(str(path), "one node key holding 'ros__parameters'", list(data))
    parameters: dict[str, Any] = sections[0]['ros__parameters']
    return parameters


def read_node_parameters(path: Path, nodes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """
    Read a ROS 2 parameter file with a section for each of several nodes.

    Parameters
    ----------
    path
        The file.
    nodes
        Names that a section may be for, with `/**/` before them or without; `EVERY_NODE` for one
        that is for every node.

    Returns
    -------
    dict
        Parameters by the name of their node; nothing where there is no section.

    Raises
    ------
    ConfigError
        If the file cannot be read, or has a section of another form or for another node, or two
        for one.

    """
    found: dict[str, dict[str, Any]] = {}
    for key, section in read_yaml(path).items():
        name = str(key).rpartition('/')[2]
        if name not in nodes or not isinstance(section, dict) or not isinstance(
                section.get('ros__parameters'), dict):
            names = ', '.join(x.replace(EVERY_NODE, f'/{EVERY_NODE}') for x in nodes)
            raise ConfigError(f'{path}: {key}', f'a section of {names} holding '
                              "'ros__parameters'", section)
        if name in found:
            raise ConfigError(f'{path}: {key}', f'one section of {name}', 'another')
        found[name] = section['ros__parameters']
    return found


def merge(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the nested `overrides` laid over it."""
    merged = dict(base)
    for key, value in overrides.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged


def write_parameters(path: Path, config: Config, node_name: str = '') -> None:
    """
    Write a configuration as a ROS 2 parameter file that reads back to the same values.

    It is for the node of a name, in any namespace, or for every node.
    """
    values, node = config.model_dump(mode='json'), f'/**/{node_name}'.rstrip('/')
    text = yaml.safe_dump({node: {'ros__parameters': values}}, sort_keys=False)
    path.write_text(text, encoding='utf-8')
