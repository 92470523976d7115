"""The cells of a study: every combination of its factors with its plants and seeds, as jobs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

from multicontact_control.errors import ConfigError
from multicontact_control.runs import overrides
from multicontact_control.runs.scenario import resolve, Setup
from multicontact_control.study.config import FactorConfig, PartConfig, StudyConfig
from multicontact_control.study.jobs import Job, RunJob

FILE_CHOICES = ('robot', 'scenario', 'preset')  # factors that choose files


class Cell(NamedTuple):
    """
    A job, and the values of the factors for which its result stands in the table.

    Several cells may have the same job, which is then run once: `key` names its result.
    """

    factors: Mapping[str, Any]  # with part, plant and seed
    job: Job
    key: str


class Combination(NamedTuple):
    """
    One value of every factor of a part, on one of the part's plants.

    A label is what the table shows; the settings are what it stands for, which may be several
    parameters of one level.
    """

    plant: str
    labels: Mapping[str, Any]  # value, or label of a level, by factor
    settings: Mapping[str, Any]  # what the labels stand for, by dotted name


def combine_factors(part: PartConfig) -> Iterator[Combination]:
    """
    Yield every combination of a part's plants and factors; the last factor changes first.

    Plants are the outermost loop. Where two factors set the same parameter the later one wins.
    """
    settings_of_factors = [
        factor.settings(name) for name, factor in part.factors.items()
    ]
    for plant in part.plants:
        for chosen in product(*settings_of_factors):
            labels = {}
            settings: dict[str, Any] = {}
            for name, (label, values) in zip(part.factors, chosen):
                labels[name] = label
                settings |= values
            yield Combination(plant, labels, settings)


def split_file_choices(
    settings: Mapping[str, Any],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """
    Split settings into those that choose files and those that are values of parameters.

    The first are arguments of `resolve` (`FILE_CHOICES`), the second have dotted names.
    """
    files = {}
    parameters = dict(settings)
    for name in FILE_CHOICES:
        if name in parameters:
            files[name] = parameters.pop(name)
    return files, parameters


def lay_over_arguments(
    arguments: Mapping[str, Any], values: Mapping[str, Any], base: Setup
) -> dict[str, Any]:
    """
    Return arguments of `resolve` that lay values of parameters over the files.

    Parameters
    ----------
    arguments
        What is resolved without these values.
    values
        Values by dotted names, of which ``*`` stands for every contact.
    base
        What `arguments` are resolved to: it tells which contacts and parameters there are.

    Raises
    ------
    ConfigError
        If a name is none of a parameter.

    """
    by_section = overrides.nest_overrides(values, base, 'factors.')
    laid_over = dict(arguments)
    for section, nested in by_section.items():
        laid_over[overrides.ARGUMENTS[section]] = nested
    return laid_over


def plan_runs(study: StudyConfig) -> list[Cell]:
    """
    Return the runs of a study by part, plant, combination and seed.

    A parameter that is no factor of a part has the value of its files there; other factors are
    empty, or 1 if they are multiples.

    Raises
    ------
    ConfigError
        With the first value that is not acceptable, or if the conditions of the parts leave no
        run.

    """
    absent: dict[str, Any] = {}
    for part in study.parts.values():
        for name, factor in part.factors.items():
            absent[name] = ''
            if factor.multiples_of:
                absent[name] = 1.0
    cells = []
    for title, part in study.parts.items():
        for combination in combine_factors(part):
            job = _plan_run(study, part, combination)
            if job is None:
                continue
            setup = _resolve_job(job, title, combination)
            factors = {
                'part': title,
                'plant': setup.plant_name,
                **absent,
                **combination.labels,
            }
            for name in absent:
                if is_parameter_name(name):
                    factors[name] = overrides.read_value(name, setup)
            cells += cells_with_seeds(factors, job, part.seeds)
    if not cells:
        raise ConfigError(
            'parts', 'at least one run', 'none that fulfils the conditions'
        )
    return cells


def cells_with_seeds(
    factors: Mapping[str, Any], job: Any, seeds: Sequence[int]
) -> list[Cell]:
    """
    Return a cell for each seed: the run of a `RunJob` with this seed, and its factors.

    The seed is that of the plant: its noise, roughness and pushes. It is a factor of the cell,
    too, and a column of the table.
    """
    cells = []
    for seed in seeds:
        seeded = replace(job, arguments={**job.arguments, 'seed': seed})
        cells.append(Cell({**factors, 'seed': seed}, seeded, seeded.key()))
    return cells


def is_parameter_name(name: str) -> bool:
    """
    Return whether a factor is called like a parameter: a section, a dot, and what follows.

    Of such a factor the unit is known, and its value is also shown for the parts that do not vary
    it.
    """
    section, dot, _ = name.partition('.')
    return bool(dot) and section in overrides.ARGUMENTS


def _plan_run(
    study: StudyConfig, part: PartConfig, combination: Combination
) -> RunJob | None:
    """Return the run of a combination, None where the part's conditions are not fulfilled."""
    files, settings = split_file_choices(combination.settings)
    arguments = {
        'scenario': part.scenario,
        'plant': combination.plant,
        'preset': part.preset,
        'duration': part.duration,
        **files,
    }
    base = resolve(**arguments)
    if not _has_values(base, part.where):
        return None
    values = dict(part.fixed)
    for adjustment in study.adjustments:
        if _has_values(base, adjustment.where):
            values |= adjustment.values
    for name, factor in part.factors.items():
        if factor.multiples_of:
            parameter = factor.sets or name
            multiple = settings.pop(parameter)
            settings |= _list_multiples(factor, parameter, multiple, base)
    return RunJob(
        lay_over_arguments(arguments, {**values, **settings}, base),
        part.supervised,
        part.surface_gone,
    )


def _resolve_job(job: RunJob, title: str, combination: Combination) -> Setup:
    """Return the setup of a job; the ConfigError of a bad one names its part and factors."""
    try:
        return job.setup()
    except ConfigError as error:
        field = error.field
        factors = [f'{name} = {value}' for name, value in combination.labels.items()]
        if factors:
            field = f'{title} ({", ".join(factors)}): {field}'.strip()
        raise error.as_config_error(field) from None


def _has_values(setup: Setup, expected: Mapping[str, Any]) -> bool:
    """Return whether parameters of a setup have the values that a condition expects."""
    for name, value in expected.items():
        if overrides.read_value(name, setup) != value:
            return False
    return True


def _list_multiples(
    factor: FactorConfig, parameter: str, multiple: float, base: Setup
) -> dict[str, float]:
    """
    Return the values of a parameter that are a multiple of another one in the files.

    A ``*`` in both names stands for the same contact.
    """
    parts = parameter.split('.')
    values = {}
    for place in overrides.find_places(parameter, base, 'factors'):
        source = factor.multiples_of
        if overrides.EVERY in parts:
            contact = place[parts.index(overrides.EVERY)]
            source = source.replace(overrides.EVERY, contact)
        values['.'.join(place)] = multiple * overrides.read_value(source, base)
    return values
