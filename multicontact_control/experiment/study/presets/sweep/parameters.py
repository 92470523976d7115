"""
Parameters by their dotted names, e.g. ``controller.force.input_delay``.

The first part is the configuration, the others lead to the value as in the YAML files. ``*``
stands for every contact: ``plant.surfaces.*.stiffness``.
"""

from __future__ import annotations

from collections.abc import Mapping
import json
from typing import Any

from multicontact_control.config import merge
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.scenario import Setup
from pydantic import BaseModel

SECTIONS = ('controller', 'noise_estimator', 'plant', 'scenario')
OVER_OTHERS = ('controller', 'noise_estimator', 'plant')  # what a scenario lays over these
EVERY = '*'


def paths_of(name: str, setup: Setup, field: str) -> list[tuple[str, ...]]:
    """
    Return where a parameter is, several places if there is a ``*`` in its name.

    Parameters
    ----------
    name
        The dotted name.
    setup
        Where it is looked for.
    field
        What to call it in an error.

    Raises
    ------
    ConfigError
        If there is no such parameter.

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

    Parameters
    ----------
    values
        By dotted name; of two that fit the same place the later one holds.
    setup
        Where the names are looked up.
    field
        What they belong to, for an error.

    """
    nested: dict[str, Any] = {}
    for name, value in values.items():
        for place in paths_of(name, setup, f'{field}.{name}'):
            branch: Any = value
            for part in reversed(place):
                branch = {part: branch}
            nested = merge(nested, branch)
    return nested
