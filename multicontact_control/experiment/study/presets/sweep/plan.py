"""
The runs of a study, in their order, each checked before anything is run.

Parameters go by dotted names, e.g. ``controller.force.input_delay``. The first part is the
configuration, the others lead to the value as in the YAML files. ``*`` stands for every contact:
``plant.surfaces.*.stiffness``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
import json
from typing import Any

from multicontact_control.config import merge
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.experiment.study.jobs import job_of, RunJob
from multicontact_control.experiment.study.presets.sweep.config import StudyConfig
from pydantic import BaseModel

SECTIONS = ('controller', 'noise_estimator', 'plant', 'scenario')
OVER_OTHERS = ('controller', 'noise_estimator', 'plant')  # what a scenario lays over these
EVERY = '*'
DURATION = 'scenario.duration'


@dataclass(frozen=True)
class SweepRun:
    """
    One run of a study.

    Attributes
    ----------
    number
        Its place, from 0.
    values
        Of every swept parameter, as scalars.
    job
        What is run.

    """

    number: int
    values: Mapping[str, Any]
    job: RunJob


@dataclass(frozen=True)
class SweepPlan:
    """
    The runs of a study.

    Attributes
    ----------
    study
        What they were made from.
    runs
        By plant, then by combination as in the file, then by seed.
    units
        Of every swept parameter.

    """

    study: StudyConfig
    runs: tuple[SweepRun, ...]
    units: Mapping[str, str]


def plan_sweep(study: StudyConfig, source: str = '') -> SweepPlan:
    """
    Return the runs of a study.

    Raises
    ------
    ConfigError
        With the first parameter or value that is not acceptable, and the file name `source`.

    """
    combinations = [
        ('grid', dict(zip(study.grid, values))) for values in product(*study.grid.values())
    ] if study.grid or not study.points else []
    combinations += [(f'points.{i}', dict(point)) for i, point in enumerate(study.points)]
    names = list(dict.fromkeys(name for _, values in combinations for name in values))
    runs: list[SweepRun] = []
    units: dict[str, str] = {}
    for plant in study.plants:
        base = _base(study, plant, names, source)
        units = units or {name: unit_of(name, base) for name in names}
        seen: set[RunJob] = set()
        for field, combination in combinations:
            job, setup = _job(study, plant, base, field, combination, source)
            if job in seen:  # a point of the grid, once more
                continue
            seen.add(job)
            values = {name: value_of(name, setup) for name in names}
            runs += [SweepRun(len(runs) + i, values, replace(job, seed=seed))
                     for i, seed in enumerate(study.seeds)]
    return SweepPlan(study, tuple(runs), units)


def _base(study: StudyConfig, plant: str, names: Sequence[str], source: str) -> Setup:
    """Return the setup on which all names of parameters are looked up, and look them up."""
    try:
        base = resolve(study.scenario, plant=plant, seed=study.seeds[0], duration=study.duration)
        if study.duration is not None and DURATION in names:
            raise ConfigError('duration', f'nothing, since {DURATION} is swept', study.duration)
        overrides_of(study.fixed, base, 'fixed')
        for field, values in [('grid', study.grid), *(
                (f'points.{i}', point) for i, point in enumerate(study.points))]:
            overrides_of(values, base, field)
    except ConfigError as error:
        raise ConfigError(error.field, error.expected, error.found, source) from None
    return base


def _job(
    study: StudyConfig, plant: str, base: Setup, field: str, combination: Mapping[str, Any],
    source: str,
) -> tuple[RunJob, Setup]:
    """Return the job of a combination for the first seed, and what it resolves to."""
    overrides = overrides_of({**study.fixed, **combination}, base, field)
    job = job_of(
        study.scenario, plant, study.seeds[0], duration=study.duration,
        noise_estimator=overrides.get('noise_estimator'), controller=overrides.get('controller'),
        plant_overrides=overrides.get('plant'), scenario_overrides=overrides.get('scenario'),
        supervised=study.supervised)
    try:
        return job, job.setup()
    except ConfigError as error:
        where = ', '.join(f'{name} = {value}' for name, value in combination.items())
        raise ConfigError(f'{field} ({where}): {error.field}', error.expected, error.found,
                          source) from None


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
