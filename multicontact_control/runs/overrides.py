"""
Values laid over a setup by dotted names, e.g. ``plant.surfaces.*.stiffness``.

The first part is the configuration; ``*`` stands for every contact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
import json
from typing import Any

from multicontact_control.config import Config, merge, validate
from multicontact_control.errors import ConfigError, RosError
from multicontact_control.runs.scenario import Setup
from pydantic import BaseModel
import yaml

ARGUMENTS = {  # of `resolve`, by section
    'controller': 'controller',
    'noise_estimator': 'noise_estimator',
    'plant': 'plant_overrides',
    'scenario': 'scenario_overrides',
}
EVERY = '*'
SET_BY_RUN = {  # parameters of nodes, and what sets them in a run
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
    """
    Read ``KEY=VALUE`` texts, values as in a YAML file; ConfigError for what is none.

    Returns the values by their dotted names, in the order of the texts; the last of several with
    one name counts.
    """
    values = {}
    for text in settings:
        key, sign, value = text.partition('=')
        name = key.strip()
        if not sign or not name:
            raise ConfigError(
                '--set', 'KEY=VALUE, e.g. plant.surfaces.*.stiffness=60000', f"'{text}'"
            )
        try:
            values[name] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ConfigError(
                f'--set {name}', 'a value as in a YAML file', f"'{value}'"
            ) from None
    return values


def find_places(name: str, setup: Setup, field: str) -> list[tuple[str, ...]]:
    """
    Return the places of a parameter in a setup, several for a ``*``.

    `name` is dotted, and a place has a key for each of its parts. Raises ConfigError, of `field`,
    if there is no such parameter.
    """
    section, *inner = name.split('.')
    if section not in ARGUMENTS or not inner:
        raise ConfigError(
            field, f'a dotted name that begins with {", ".join(ARGUMENTS)}', f"'{name}'"
        )
    with suppress(RosError):
        if _is_of_node(name, setup):
            raise ConfigError(field, hint=_explain_node_parameter(inner[0]))
    places: list[tuple[str, ...]] = [(section,)]
    for part in inner:
        longer = []
        for place in places:
            for key in _matching_keys(setup, place, part, field):
                longer.append((*place, key))
        places = longer
    return places


def _explain_node_parameter(parameter: str) -> str:
    """Return why a parameter that only a node knows is refused, and what sets it."""
    if parameter in SET_BY_RUN:
        return f'a parameter of a node, which `run` sets: {SET_BY_RUN[parameter]}'
    return 'a parameter of a node: only `run` takes it, and `view` that starts one'


def _matching_keys(
    setup: Setup, place: tuple[str, ...], part: str, field: str
) -> list[str]:
    """Return the keys at a place that a part of a name stands for; ConfigError if none."""
    value = _value_at(setup, place)
    known: list[str] = []
    if isinstance(value, BaseModel):
        known = list(type(value).model_fields)
    elif isinstance(value, Mapping):
        known = list(value)
    where = '.'.join(place)
    if not known:
        raise ConfigError(field, f'a parameter; {where} has no parts here', f"'{part}'")
    if part == EVERY:
        return known
    if part not in known:
        raise ConfigError(field, f'{where} and one of {", ".join(known)}', f"'{part}'")
    return [part]


def _value_at(setup: Setup, place: Sequence[str]) -> Any:
    value: Any = setup
    for part in place:
        if isinstance(value, Mapping):
            value = value[part]
        else:
            value = getattr(value, part)
    return value


def read_value(name: str, setup: Setup) -> Any:
    """
    Return a parameter of a setup by its dotted name, as a cell of a table has it.

    A list or mapping is JSON; the value is None for a ``*`` whose values differ. Raises
    ConfigError for a name that the setup does not have.
    """
    first, *others = [
        _value_at(setup, place) for place in find_places(name, setup, name)
    ]
    if any(value != first for value in others):
        return None
    if first is None or isinstance(first, (bool, int, float, str)):
        return first
    return json.dumps(
        first,
        separators=(',', ':'),
        default=lambda model: model.model_dump(mode='json'),
    )


def find_unit(name: str, setup: Setup) -> str:
    """Return the SI unit that a parameter was declared with, empty if there is none."""
    *place, last = find_places(name, setup, name)[0]
    model = _value_at(setup, place)
    if not isinstance(model, BaseModel):
        return ''
    declared = type(model).model_fields[last].json_schema_extra
    return str(declared['unit']) if isinstance(declared, dict) else ''


def nest_overrides(
    values: Mapping[str, Any], setup: Setup, field: str
) -> dict[str, Any]:
    """
    Return the values of parameters, by dotted name, nested by section, later ones over earlier.

    Raises ConfigError of a parameter that the setup does not have; its name follows `field`.
    """
    nested: dict[str, Any] = {}
    for name, value in values.items():
        for place in find_places(name, setup, field + name):
            nested = merge(nested, _nest_value(value, place))
    return nested


def _nest_value(value: Any, place: Sequence[str]) -> dict[str, Any]:
    """Return a mapping in which a value is at a place, and nothing else is."""
    for key in reversed(place):
        value = {key: value}
    nested: dict[str, Any] = value
    return nested


def node_configs() -> dict[str, type[Config]]:
    """
    Return the parameters that only the node of each section knows, as configurations.

    Raises RosError where ROS cannot be loaded: nodes are declared where they run.
    """
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
    of_setup: dict[str, Any] = {}
    of_nodes: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        if not _is_of_node(name, setup):
            of_setup[name] = value
            continue
        place = name.split('.')
        if place[1] in SET_BY_RUN:
            raise ConfigError(f'--set {name}', hint=SET_BY_RUN[place[1]])
        of_nodes = merge(of_nodes, _nest_value(value, place))
    for section, nested in of_nodes.items():
        validate(node_configs()[section], nested, f'--set {section}')
    return of_setup, of_nodes


def _is_of_node(name: str, setup: Setup) -> bool:
    """Return whether only the node of a section knows a dotted name; RosError without ROS."""
    section, *inner = name.split('.')
    if section not in ARGUMENTS or not inner or inner[0] == EVERY:
        return False
    config = getattr(setup, section)
    if not isinstance(config, BaseModel) or inner[0] in type(config).model_fields:
        return False
    of_node = node_configs().get(section)
    return of_node is not None and inner[0] in of_node.model_fields


def resolve_with(
    resolver: Callable[..., Setup],
    arguments: Mapping[str, Any],
    settings: Sequence[str],
    *,
    nodes: bool = False,
) -> Setup:
    """
    Return what a function of `scenario` resolves, with ``KEY=VALUE`` settings over its files.

    Parameters
    ----------
    resolver
        `resolve` or `resolve_external`.
    arguments
        Its arguments, by name.
    settings
        Texts as for `read_settings`.
    nodes
        Whether the settings may be those that only a node of the graph knows, too.

    Raises
    ------
    ConfigError
        With each value that is not acceptable, and each name that is not known.

    """
    setup = resolver(**arguments)
    if not settings:
        return setup
    values = read_settings(settings)
    of_nodes: dict[str, dict[str, Any]] = {}
    if nodes:
        values, of_nodes = split_off_nodes(values, setup)
    result = lay_values_over(resolver, arguments, values, setup, '--set ')
    return replace(result, nodes=merge(result.nodes, of_nodes))


def lay_values_over(
    resolver: Callable[..., Setup],
    arguments: Mapping[str, Any],
    values: Mapping[str, Any],
    setup: Setup,
    field: str,
) -> Setup:
    """
    Return what a resolver makes of its arguments with values, by dotted names, over its files.

    The names are those of `setup`, which it makes of the arguments alone; the values may lead to
    another one. ConfigError as of `nest_overrides` and of the resolver.
    """
    overridden = dict(arguments)
    for section, nested in nest_overrides(values, setup, field).items():
        overridden[ARGUMENTS[section]] = nested
    return resolver(**overridden)
