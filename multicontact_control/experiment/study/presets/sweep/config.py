"""What a study's file says, and the runs that this makes, each checked before anything is run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

from multicontact_control.config import Config, parameter, read_yaml, Real, validate
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.overrides import ARGUMENTS, overrides_of, unit_of, value_of
from multicontact_control.experiment.scenario import plant_source, plants_of, resolve, Setup
from multicontact_control.experiment.study.jobs import job_of, RunJob
from multicontact_control.paths import named_file
import numpy as np
from pydantic import field_validator, model_validator
from sim_bridge.robots import find_robot

DIGITS = 12  # of the values of a range, such that 0.1 is not 0.09999999999999999
LISTED = 'a list of values, or a range of start, stop and count'


class RangeConfig(Config):
    """Evenly spaced values."""

    start: Real = parameter(..., 'First value.')
    stop: Real = parameter(..., 'Last value.')
    count: int = parameter(..., 'How many values.', ge=2)
    spacing: Literal['linear', 'log'] = parameter(
        'linear', 'Whether neighbours have the same difference, or the same ratio.')

    @model_validator(mode='after')
    def _check_sign(self) -> RangeConfig:
        if self.spacing == 'log' and min(self.start, self.stop) <= 0.0:
            raise ConfigError('start', 'a value above 0, for spacing: log',
                              min(self.start, self.stop))
        return self

    def values(self) -> tuple[float, ...]:
        """Return the values."""
        space = np.geomspace if self.spacing == 'log' else np.linspace
        return tuple(float(f'{value:.{DIGITS}g}')
                     for value in space(self.start, self.stop, self.count))


class StudyConfig(Config):
    """One sweep."""

    name: str = parameter(..., 'Name, as used in file names.', pattern=r'^[\w.-]+$')
    description: str = parameter('', 'What it is to show.')
    scenario: str = parameter(..., 'What is run: a name from config/scenarios, or a path.')
    plants: tuple[str, ...] = parameter(
        ('',), 'Names or paths, everything is run on each; the default one if not given.',
        min_length=1)
    seeds: tuple[int, ...] = parameter(
        (0,), 'Seeds, or how many of them, from 0; everything is run with each.', min_length=1)
    duration: Real | None = parameter(
        None, "Length of every run; the scenario's own if not given.", unit='s', gt=0.0)
    preset: str = parameter(
        '', 'What is laid over the files first: paper, best, adaptive, or a path; nothing if '
        'empty.')
    supervised: bool = parameter(
        True, 'Whether contact states, watchdogs and limits are put around the controller, as '
        'in `simulate`; false is its `--bare`.')
    fixed: dict[str, Any] = parameter({}, 'Parameters that differ from the files in every run.')
    grid: dict[str, tuple[Any, ...]] = parameter(
        {}, 'Values of each parameter; every combination is run.')
    points: tuple[dict[str, Any], ...] = parameter(
        (), 'Single combinations beside the grid; what one does not name is as in the files.')
    figures: tuple[str, ...] = parameter(
        (), 'Columns of the table to draw, `*` for the largest over the contacts; a choice if '
        'not given.')

    @field_validator('seeds', mode='before')
    @classmethod
    def _count_seeds(cls, value: Any) -> Any:
        if isinstance(value, int) and not isinstance(value, bool):
            if value < 1:
                raise ConfigError('seeds', 'a number of seeds of at least 1, or a list', value)
            return tuple(range(value))
        return value

    @field_validator('grid', mode='before')
    @classmethod
    def _spell_out_ranges(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        return {name: _values(f'grid.{name}', given) for name, given in value.items()}

    @model_validator(mode='after')
    def _check_across_fields(self) -> StudyConfig:
        for name in ('plants', 'seeds'):
            given = getattr(self, name)
            if len(set(given)) < len(given):
                raise ConfigError(name, 'each of them once', list(given))
        if min(self.seeds) < 0:
            raise ConfigError('seeds', 'whole numbers >= 0', min(self.seeds))
        for i, point in enumerate(self.points):
            if not point:
                raise ConfigError(f'points.{i}', 'at least one parameter', 'none')
        for name in self.fixed:
            if name in self.grid or any(name in point for point in self.points):
                raise ConfigError(f'fixed.{name}', 'a parameter that is not swept',
                                  'one of the grid or the points')
        return self


def _values(field: str, given: Any) -> tuple[Any, ...]:
    """Return the values of a list or a range."""
    if isinstance(given, Mapping):
        try:
            return validate(RangeConfig, given).values()
        except ConfigError as error:
            raise ConfigError(f'{field}.{error.field}', error.expected, error.found) from None
    if isinstance(given, (list, tuple)) and given:
        return tuple(given)
    raise ConfigError(field, LISTED, repr(given))


def study_path(name: str) -> Path:
    """Return the file of a study: of a name in config/studies, or a path; or a ConfigError."""
    return named_file('study', 'studies', name)


def read_study(
    path: Path, *, seeds: tuple[int, ...] | None = None, robot: str = '',
) -> StudyConfig:
    """
    Read and check a study; ConfigError if it is bad.

    With other seeds if they are given, and on another robot: on those of the study's plants that
    it has, or on its default one.
    """
    values = read_yaml(path)
    study = validate(
        StudyConfig, values if seeds is None else {**values, 'seeds': seeds}, str(path))
    plants = study.plants
    if robot:
        known = find_robot(robot)
        plants = tuple(name for name in plants if known.plant_name(name)) or ('',)
    plants = plants_of(robot, [name or plant_source('', robot).plant for name in plants])
    return study.model_copy(update={'plants': plants})


@dataclass(frozen=True)
class SweepRun:
    """One run of a study: its place from 0, the value of every swept parameter, and its job."""

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
        What they are made from.
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
    points = [(f'points.{i}', dict(point)) for i, point in enumerate(study.points)]
    combinations += points
    names = list(dict.fromkeys(name for _, values in combinations for name in values))
    runs: list[SweepRun] = []
    units: dict[str, str] = {}
    try:
        for plant in study.plants:
            base = resolve(study.scenario, plant=plant, seed=study.seeds[0],
                           duration=study.duration, preset=study.preset)
            overrides_of(study.fixed, base, 'fixed')
            for field, values in [('grid', study.grid), *points]:
                overrides_of(values, base, field)
            units = units or {name: unit_of(name, base) for name in names}
            seen: set[RunJob] = set()
            for field, combination in combinations:
                job, setup = _job(study, plant, base, field, combination)
                if job in seen:  # a point of the grid, once more
                    continue
                seen.add(job)
                swept = {name: value_of(name, setup) for name in names}
                runs += [SweepRun(len(runs) + i, swept, replace(job, seed=seed))
                         for i, seed in enumerate(study.seeds)]
    except ConfigError as error:
        raise ConfigError.of([error], source) from None
    return SweepPlan(study, tuple(runs), units)


def _job(
    study: StudyConfig, plant: str, base: Setup, field: str, combination: Mapping[str, Any],
) -> tuple[RunJob, Setup]:
    """Return the job of a combination for the first seed, and what it resolves to."""
    overrides = overrides_of({**study.fixed, **combination}, base, field)
    job = job_of(
        study.scenario, plant, study.seeds[0], duration=study.duration, preset=study.preset,
        supervised=study.supervised,
        **{ARGUMENTS[section]: values for section, values in overrides.items()})
    try:
        return job, job.setup()
    except ConfigError as error:
        where = ', '.join(f'{name} = {value}' for name, value in combination.items())
        raise ConfigError(f'{field} ({where}): {error.field}' if where else error.field,
                          error.expected, error.found) from None
