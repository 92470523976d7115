"""
Values laid over a setup by dotted names, e.g. ``controller.force.input_delay``.

The first part is the configuration, the others lead to the value as in the YAML files. ``*``
stands for every contact: ``plant.surfaces.*.stiffness``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import json
from typing import Any, cast, TypeVar

from multicontact_control.config import merge
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.scenario import Setup
from pydantic import BaseModel
import yaml

T = TypeVar('T')

SECTIONS = ('controller', 'noise_estimator', 'plant', 'scenario')
OVER_OTHERS = ('controller', 'noise_estimator', 'plant')  # what a scenario lays over these
EVERY = '*'
ARGUMENTS = {  # of `resolve`, by section
    'controller': 'controller', 'noise_estimator': 'noise_estimator', 'plant': 'plant_overrides',
    'scenario': 'scenario_overrides'}


def read_settings(settings: Sequence[str]) -> dict[str, Any]:
    """
    Read ``KEY=VALUE`` texts, the values as in a YAML file.

    Raises
    ------
    ConfigError
        If one has no key, or its value is no YAML.

    """
    found = {}
    for text in settings:
        key, sign, value = text.partition('=')
        if not sign or not key.strip():
            raise ConfigError('--set', 'KEY=VALUE, e.g. plant.surfaces.*.stiffness=60000',
                              f"'{text}'")
        try:
            found[key.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ConfigError(f'--set {key.strip()}', 'a value as in a YAML file',
                              f"'{value}'") from None
    return found


def paths_of(name: str, setup: Setup, field: str) -> list[tuple[str, ...]]:
    """
    Return where a parameter is, several places if there is a ``*`` in its name.

    Raises
    ------
    ConfigError
        If there is none in the setup; `field` says what was looked for.

    """
    section, *inner = name.split('.')
    if section not in SECTIONS or not inner:
        raise ConfigError(field, f'a dotted name that begins with {", ".join(SECTIONS)}',
                          f"'{name}'")
    if section == 'scenario' and inner[0] in OVER_OTHERS:
        raise ConfigError(field, f"the parameter's own name, {'.'.join(inner)}", f"'{name}'")
    places: list[tuple[str, ...]] = [(section,)]
    for part in inner:
        places = [(*place, found) for place in places
                  for found in _matching(place, part, setup, field)]
    return places


def _matching(place: tuple[str, ...], part: str, setup: Setup, field: str) -> list[str]:
    """Return the keys at a place that a part of a name stands for."""
    known = _keys(_value_at(setup, place))
    if not known:
        raise ConfigError(field, f'a parameter; {".".join(place)} has no parts here', f"'{part}'")
    if part == EVERY:
        return known
    if part not in known:
        raise ConfigError(field, f'{".".join(place)} and one of {", ".join(known)}', f"'{part}'")
    return [part]


def _keys(value: Any) -> list[str]:
    if isinstance(value, BaseModel):
        return list(type(value).model_fields)
    return [str(key) for key in value] if isinstance(value, Mapping) else []


def _value_at(setup: Setup, place: tuple[str, ...]) -> Any:
    value: Any = setup
    for part in place:
        value = value[part] if isinstance(value, Mapping) else getattr(value, part)
    return value


def value_of(name: str, setup: Setup) -> Any:
    """
    Return the value of a parameter in a setup as a scalar.

    Lists and mappings as JSON text; None for a ``*`` whose values differ.
    """
    values = [_scalar(_value_at(setup, place)) for place in paths_of(name, setup, name)]
    return values[0] if all(value == values[0] for value in values) else None


def _scalar(value: Any) -> Any:
    if isinstance(value, BaseModel):
        value = value.model_dump(mode='json')
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        value = {key: _plain(item) for key, item in value.items()}
    else:
        value = [_plain(item) for item in value]
    return json.dumps(value, separators=(',', ':'))


def _plain(value: Any) -> Any:
    return value.model_dump(mode='json') if isinstance(value, BaseModel) else value


def unit_of(name: str, setup: Setup) -> str:
    """Return the unit that a parameter was declared with, empty if there is none."""
    *place, last = paths_of(name, setup, name)[0]
    model = _value_at(setup, tuple(place))
    if not isinstance(model, BaseModel):
        return ''
    extra = type(model).model_fields[last].json_schema_extra
    return str(extra.get('unit', '')) if isinstance(extra, dict) else ''


def overrides_of(values: Mapping[str, Any], setup: Setup, field: str) -> dict[str, Any]:
    """
    Return the values of parameters as nested overrides, by section.

    Of two that fit the same place the later one holds; `field` is what they belong to.
    """
    nested: dict[str, Any] = {}
    for name, value in values.items():
        for place in paths_of(name, setup, f'{field}.{name}'):
            branch: Any = value
            for part in reversed(place):
                branch = {part: branch}
            nested = merge(nested, branch)
    return nested


def overridden(
    options: Mapping[str, Any], settings: Sequence[str], setup: Setup,
) -> dict[str, Any]:
    """
    Return arguments of `resolve` with ``KEY=VALUE`` texts laid over them.

    Parameters
    ----------
    options
        Arguments of `resolve` by name.
    settings
        As for `read_settings`.
    setup
        What the arguments resolve to, in which the names are looked up.

    Raises
    ------
    ConfigError
        If a text or a name is not acceptable.

    """
    given = overrides_of(read_settings(settings), setup, '--set')
    changed = {ARGUMENTS[section]: merge(options.get(ARGUMENTS[section]) or {}, values)
               for section, values in given.items()}
    return {**options, **changed}


def resolve_with(
    resolver: Callable[..., T], arguments: Mapping[str, Any], settings: Sequence[str],
) -> T:
    """Return what `resolve` or `resolve_external` does, ``KEY=VALUE`` texts over its files."""
    resolved: Any = resolver(**arguments)
    if settings:
        setup = getattr(resolved, 'setup', resolved)
        resolved = resolver(**overridden(arguments, settings, setup))
    return cast(T, resolved)
