"""
Values laid over a setup by dotted names, e.g. ``plant.surfaces.*.stiffness``.

The first part is the configuration; ``*`` stands for every contact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
import json
from types import NoneType
from typing import Any, cast, TypeVar

from multicontact_control.config import Config, merge, validate
from multicontact_control.errors import ConfigError, RosError
from multicontact_control.runs.scenario import External, Setup
from pydantic import BaseModel
import yaml

T = TypeVar('T')

ARGUMENTS = {  # of `resolve`, by section
    'controller': 'controller',
    'noise_estimator': 'noise_estimator',
    'plant': 'plant_overrides',
    'scenario': 'scenario_overrides',
}
EVERY = '*'
OF_THE_RUN = {  # parameters of nodes, and what sets them in a run
    'supervised': 'give --bare',
    'lockstep': 'give --free-running',
    'speed': 'give --speed',
    'reference_file': 'give --scenario',
    'ticks': 'give --duration',
    'seed': 'give --seed',
    'rate': 'set controller.rate and noise_estimator.rate',
    'startup_peers': 'a run has its own',
    'timing_file': 'a run has its own',
}


def read_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Read ``KEY=VALUE`` texts, values as in a YAML file; ConfigError for what is none."""
    values = {}
    for text in settings:
        key, sign, value = text.partition('=')
        if not sign or not key.strip():
            raise ConfigError(
                '--set', 'KEY=VALUE, e.g. plant.surfaces.*.stiffness=60000', f"'{text}'"
            )
        try:
            values[key.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ConfigError(
                f'--set {key.strip()}', 'a value as in a YAML file', f"'{value}'"
            ) from None
    return values


def paths_of(name: str, setup: Setup, field: str) -> list[tuple[str, ...]]:
    """Return the places of a parameter, several for a ``*``; ConfigError of a `field` if none."""
    section, *inner = name.split('.')
    if section not in ARGUMENTS or not inner:
        raise ConfigError(
            field, f'a dotted name that begins with {", ".join(ARGUMENTS)}', f"'{name}'"
        )
    if _is_foreign(name, setup):
        _refuse_of_node(section, inner[0], field)
    places: list[tuple[str, ...]] = [(section,)]
    for part in inner:
        places = [
            (*place, key)
            for place in places
            for key in _keys(setup, place, part, field)
        ]
    return places


def _refuse_of_node(section: str, parameter: str, field: str) -> None:
    """Refuse a parameter that only the node of a section knows; ConfigError of a `field`."""
    try:
        configs = node_configs()
    except RosError:
        return
    if section not in configs or parameter not in configs[section].model_fields:
        return
    if parameter in OF_THE_RUN:
        hint = f'a parameter of a node, which `run` sets: {OF_THE_RUN[parameter]}'
    else:
        hint = 'a parameter of a node: only `run` takes it, and `view` that starts one'
    raise ConfigError(field, hint=hint)


def _keys(setup: Setup, place: tuple[str, ...], part: str, field: str) -> list[str]:
    """Return the keys at a place that a part of a name stands for."""
    value = _value_at(setup, place)
    known = (
        list(type(value).model_fields)
        if isinstance(value, BaseModel)
        else [str(key) for key in value]
        if isinstance(value, Mapping)
        else []
    )
    if not known:
        raise ConfigError(
            field, f'a parameter; {".".join(place)} has no parts here', f"'{part}'"
        )
    if part not in (EVERY, *known):
        raise ConfigError(
            field, f'{".".join(place)} and one of {", ".join(known)}', f"'{part}'"
        )
    return known if part == EVERY else [part]


def _value_at(setup: Setup, place: tuple[str, ...]) -> Any:
    value: Any = setup
    for part in place:
        value = value[part] if isinstance(value, Mapping) else getattr(value, part)
    return value


def value_of(name: str, setup: Setup) -> Any:
    """Return a parameter, a list or mapping as JSON; None for a ``*`` whose values differ."""
    values = [_value_at(setup, place) for place in paths_of(name, setup, name)]
    if any(value != values[0] for value in values):
        return None
    return (
        values[0]
        if isinstance(values[0], (bool, int, float, str, NoneType))
        else json.dumps(
            values[0],
            separators=(',', ':'),
            default=lambda model: model.model_dump(mode='json'),
        )
    )


def unit_of(name: str, setup: Setup) -> str:
    """Return the unit that a parameter was declared with, empty if there is none."""
    *place, last = paths_of(name, setup, name)[0]
    model = _value_at(setup, tuple(place))
    extra = (
        type(model).model_fields[last].json_schema_extra
        if (isinstance(model, BaseModel))
        else None
    )
    return str(extra.get('unit', '')) if isinstance(extra, dict) else ''


def overrides_of(values: Mapping[str, Any], setup: Setup, field: str) -> dict[str, Any]:
    """Return the values of parameters by section, later ones over earlier; see `paths_of`."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        for place in paths_of(name, setup, field + name):
            branch: Any = value
            for part in reversed(place):
                branch = {part: branch}
            nested = merge(nested, branch)
    return nested


def node_configs() -> dict[str, type[Config]]:
    """Return what only the node of each section knows; RosError where ROS cannot be loaded."""
    from multicontact_control.nodes.controller_node import ControllerNodeConfig
    from multicontact_control.nodes.graph import StartupConfig
    from sim_bridge.sim_node import SimNodeConfig

    return {
        'controller': ControllerNodeConfig,
        'noise_estimator': StartupConfig,
        'plant': SimNodeConfig,
    }


def split_off_nodes(
    values: Mapping[str, Any],
    setup: Setup,
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """
    Return the values of a setup, and, nested by section, those that only a node knows.

    ConfigError if the node does not take one, or the run sets it.
    """
    foreign = [name for name in values if _is_foreign(name, setup)]
    configs = node_configs() if foreign else {}
    of_setup = dict(values)
    of_nodes: dict[str, dict[str, Any]] = {}
    for name in foreign:
        section, first, *inner = name.split('.')
        if section not in configs or first not in configs[section].model_fields:
            continue
        if first in OF_THE_RUN:
            raise ConfigError(f'--set {name}', hint=OF_THE_RUN[first])
        branch: Any = of_setup.pop(name)
        for part in reversed((section, first, *inner)):
            branch = {part: branch}
        of_nodes = merge(of_nodes, branch)
    for section, nested in of_nodes.items():
        validate(configs[section], nested, f'--set {section}')
    return of_setup, of_nodes


def _is_foreign(name: str, setup: Setup) -> bool:
    """Return whether a dotted name is in a section of a setup that does not know it."""
    section, *inner = name.split('.')
    config = getattr(setup, section, None) if section in ARGUMENTS else None
    return (
        isinstance(config, BaseModel)
        and bool(inner)
        and (inner[0] != EVERY and inner[0] not in type(config).model_fields)
    )


def resolve_with(
    resolver: Callable[..., T],
    arguments: Mapping[str, Any],
    settings: Sequence[str],
    *,
    nodes: bool = False,
) -> T:
    """
    Return what a function of `scenario` resolves, ``KEY=VALUE`` over its files; ConfigError.

    With `nodes` the values may be those that only a node of the graph knows, too.
    """
    resolved = resolver(**arguments)
    if not settings:
        return resolved
    setup: Any = getattr(resolved, 'setup', resolved)
    values = read_settings(settings)
    of_nodes: dict[str, dict[str, Any]] = {}
    if nodes:
        values, of_nodes = split_off_nodes(values, setup)
    nested = overrides_of(values, setup, '--set ')
    again: Any = resolver(
        **{
            **arguments,
            **{ARGUMENTS[section]: laid_over for section, laid_over in nested.items()},
        }
    )
    if isinstance(again, External):
        again = again._replace(setup=replace(again.setup, nodes=of_nodes))
    else:
        again = replace(again, nodes=of_nodes)
    return cast(T, again)
