"""The runs of a study, in their order, each checked before anything is run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.overrides import overrides_of, unit_of, value_of
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.experiment.study.jobs import job_of, RunJob
from multicontact_control.experiment.study.presets.sweep.config import StudyConfig


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
        base = _base(study, plant, source)
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


def _base(study: StudyConfig, plant: str, source: str) -> Setup:
    """Return the setup on which all names of parameters are looked up, and look them up."""
    try:
        base = resolve(study.scenario, plant=plant, seed=study.seeds[0], duration=study.duration,
                       preset=study.preset)
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
        preset=study.preset, supervised=study.supervised)
    try:
        return job, job.setup()
    except ConfigError as error:
        where = ', '.join(f'{name} = {value}' for name, value in combination.items())
        raise ConfigError(f'{field} ({where}): {error.field}' if where else error.field,
                          error.expected, error.found, source) from None
