"""The cells of a study: every combination of its factors with its plants and seeds, as jobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

from multicontact_control.errors import ConfigError
from multicontact_control.runs import overrides
from multicontact_control.runs.scenario import resolve, Setup
from multicontact_control.study.config import PartConfig, StudyConfig
from multicontact_control.study.jobs import Job, RunJob

CHOSEN = ('robot', 'scenario', 'preset')  # factors that choose files


class Cell(NamedTuple):
    """A job, and what of the factors it stands for; several cells may have the same job."""

    factors: Mapping[str, Any]  # with part, plant and seed
    job: Job
    key: str


def run_cells(study: StudyConfig) -> list[Cell]:
    """
    Return the runs of a study by part, plant, combination and seed.

    A parameter that is no factor of a part has the value of its files there; other factors are
    empty, or 1 if they are multiples. ConfigError with the first value that is not acceptable.
    """
    absent = {
        name: 1.0 if factor.multiples_of else ''
        for part in study.parts.values()
        for name, factor in part.factors.items()
    }
    cells = []
    for title, part in study.parts.items():
        for plant, *chosen in product(
            part.plants,
            *(
                [(name, *setting) for setting in factor.settings(name)]
                for name, factor in part.factors.items()
            ),
        ):
            job = _job(study, part, plant, chosen)
            if job is None:
                continue
            try:
                setup = job.setup()
            except ConfigError as error:
                where = ', '.join(f'{name} = {value}' for name, value, _ in chosen)
                field = (
                    f'{title} ({where}): {error.field}'.strip()
                    if where
                    else error.field
                )
                raise error.moved(field) from None
            factors = {
                'part': title,
                'plant': setup.plant_name,
                **absent,
                **{name: value for name, value, _ in chosen},
                **{
                    name: overrides.read_value(name, setup)
                    for name in absent
                    if is_parameter(name)
                },
            }
            cells += seeded(factors, job, part.seeds)
    if not cells:
        raise ConfigError(
            'parts', 'at least one run', 'none that fulfils the conditions'
        )
    return cells


def seeded(factors: Mapping[str, Any], job: Any, seeds: Sequence[int]) -> list[Cell]:
    """Return the cells of a `RunJob` with some seeds."""
    jobs = {
        seed: replace(job, arguments={**job.arguments, 'seed': seed}) for seed in seeds
    }
    return [
        Cell({**factors, 'seed': seed}, one, one.key()) for seed, one in jobs.items()
    ]


def is_parameter(name: str) -> bool:
    """Return whether the name of a factor is that of a parameter."""
    return '.' in name and name.partition('.')[0] in overrides.ARGUMENTS


def _job(
    study: StudyConfig,
    part: PartConfig,
    plant: str,
    chosen: Sequence[tuple[str, Any, Mapping[str, Any]]],
) -> RunJob | None:
    """Return the run of a combination, None where the part's conditions are not fulfilled."""
    settings = {
        name: value for _, _, values in chosen for name, value in values.items()
    }
    arguments = {
        'scenario': part.scenario,
        'plant': plant,
        'preset': part.preset,
        'duration': part.duration,
        **{name: settings.pop(name) for name in CHOSEN if name in settings},
    }
    base = resolve(**arguments)
    if not _fulfilled(part.where, base):
        return None
    values = dict(part.fixed)
    for adjustment in study.adjustments:
        if _fulfilled(adjustment.where, base):
            values |= adjustment.values
    for factor in part.factors.values():
        if factor.multiples_of:
            settings |= _multiples(
                factor.sets, settings.pop(factor.sets), factor.multiples_of, base
            )
    laid_over = overrides.nest_overrides({**values, **settings}, base, 'factors.')
    return RunJob(
        {
            **arguments,
            **{
                overrides.ARGUMENTS[section]: nested
                for section, nested in laid_over.items()
            },
        },
        part.supervised,
        part.surface_gone,
    )


def _fulfilled(where: Mapping[str, Any], setup: Setup) -> bool:
    return all(
        overrides.read_value(name, setup) == value for name, value in where.items()
    )


def _multiples(name: str, factor: float, of: str, setup: Setup) -> dict[str, float]:
    """Return a multiple of another parameter's value, for each contact where there is a ``*``."""
    star = name.split('.').index(overrides.EVERY) if overrides.EVERY in name else None
    return {
        '.'.join(place): factor
        * overrides.read_value(
            of if star is None else of.replace(overrides.EVERY, place[star]), setup
        )
        for place in overrides.find_places(name, setup, 'factors')
    }
