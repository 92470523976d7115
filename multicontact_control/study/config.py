"""A study's file: what is varied, what is run, and what is shown of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from multicontact_control.config import Config, parameter, read_yaml, validate
from multicontact_control.errors import ConfigError
from multicontact_control.paths import find_named_file
from multicontact_control.registry import FORCE_LAWS, NOISE_ESTIMATORS
from multicontact_control.runs.overrides import read_settings
from multicontact_control.runs.scenario import plant_source
import numpy as np
from pydantic import (
    field_validator,
    model_validator,
    NonNegativeInt,
    ValidationInfo,
)
from sim_bridge.robots import find_robot

Kind = Literal['sweep', 'compare', 'map', 'tune', 'faults', 'situations']
Aggregate = Literal['median', 'min', 'max', 'share', 'set', 'good_values']
Choices = Mapping[str, Sequence[Any]]  # values by factor
REGISTRIES: Mapping[str, Mapping[str, str]] = {
    'controller.force.law': FORCE_LAWS,
    'noise_estimator.estimator': NOISE_ESTIMATORS,
}  # of the names that a parameter chooses from


class FactorConfig(Config):
    """What is varied: values or a range of one parameter, or levels with values of several."""

    values: tuple[Any, ...] = parameter(
        (), 'Values of the parameter, or labels of levels.'
    )
    start: float | None = parameter(None, 'First value of a range.')
    stop: float | None = parameter(None, 'Last value of a range.')
    count: int = parameter(0, 'How many values a range has.')
    spacing: Literal['linear', 'log'] = parameter(
        'linear',
        'Whether neighbours in a range have the same difference, or the same ratio.',
    )
    sets: str = parameter(
        '', "Dotted name, `robot`, `scenario` or `preset`; the factor's name if empty."
    )
    multiples_of: str = parameter('', 'Parameter that the values are multiples of.')
    choices_of: Literal['', 'controller.force.law', 'noise_estimator.estimator'] = (
        parameter('', 'Parameter each registered value of which is a level, too.')
    )
    levels: dict[str, dict[str, Any]] = parameter(
        {}, 'Parameters and their values, by the label of the level.'
    )

    @model_validator(mode='before')
    @classmethod
    def _spell_out(cls, given: Any) -> Any:
        """Return the fields of a list of values, or of levels by label."""
        if isinstance(given, (list, tuple)):
            return {'values': given}
        if isinstance(given, Mapping) and not given.keys() <= cls.model_fields.keys():
            return {
                'levels': {str(label): level or {} for label, level in given.items()}
            }
        return given

    @field_validator('levels')
    @classmethod
    def _add_choices(
        cls, levels: dict[str, dict[str, Any]], info: ValidationInfo
    ) -> dict[str, dict[str, Any]]:
        """Put a level for every registered value of `choices_of` before those of the file."""
        name = info.data.get('choices_of', '')
        registered = {choice: {name: choice} for choice in REGISTRIES.get(name, ())}
        return registered | levels

    @model_validator(mode='after')
    def _check_values(self) -> FactorConfig:
        if self.start is None or self.stop is None:
            if not self.values and not self.levels:
                raise ValueError(
                    'a list of values, a range of start, stop and count, or values '
                    'by label'
                )
        elif (
            self.count < 2
            or self.spacing == 'log'
            and min(self.start, self.stop) <= 0.0
        ):
            raise ValueError(
                'a count of at least 2, and of spacing: log a start and stop above 0'
            )
        return self

    def settings(self, name: str) -> list[tuple[Any, dict[str, Any]]]:
        """Return each value or label of the factor with the parameters that it sets."""
        if self.levels:
            return list(self.levels.items())
        values = self.values
        if not values and self.start is not None and self.stop is not None:
            space = np.geomspace if self.spacing == 'log' else np.linspace
            values = tuple(
                float(f'{value:.12g}')  # such that 0.1 is not 0.09999999999999999
                for value in space(self.start, self.stop, self.count)
            )
        return [(value, {self.sets or name: value}) for value in values]

    def choose(self, values: Sequence[Any]) -> FactorConfig:
        """Return the factor with other values, or with some of its levels."""
        if not self.levels:
            return self.model_copy(update={'values': tuple(values)})
        return self.model_copy(
            update={
                'levels': {
                    label: level
                    for label, level in self.levels.items()
                    if label in map(str, values)
                }
            }
        )


class AdjustmentConfig(Config):
    """Parameters of those runs that fulfil a condition."""

    where: dict[str, Any] = parameter(..., 'Values that parameters must have.')
    values: dict[str, Any] = parameter(..., 'Parameters and their values.')


class PartConfig(Config):
    """What is run: every combination of the factors with every plant and seed."""

    where: dict[str, Any] = parameter(
        {}, 'Values that parameters must have; else nothing is run.'
    )
    scenario: str = parameter(
        '', 'What is run: a name from config/scenarios, or a path.'
    )
    plants: tuple[str, ...] = parameter(
        ('',),
        'Names or paths, everything is run on each; the default one if not given.',
        min_length=1,
    )
    seeds: tuple[NonNegativeInt, ...] = parameter(
        (0,),
        'Seeds, or how many of them, from 0; everything is run with each.',
        min_length=1,
    )
    duration: float | None = parameter(
        None, "Length of every run; the scenario's own if not given.", unit='s', ge=1.0
    )
    preset: str = parameter(
        '',
        'What is laid over the files first: paper, best, adaptive, or a path; nothing if '
        'empty.',
    )
    supervised: bool = parameter(
        True,
        'Whether contact states, watchdogs and limits are put around the controller, as '
        'in `simulate`; false is its `--bare`.',
    )
    surface_gone: tuple[float, float] | None = parameter(
        None, 'From when to when the last surface is away.', unit='s'
    )
    fixed: dict[str, Any] = parameter(
        {}, 'Parameters that differ from the files in every run.'
    )
    factors: dict[str, FactorConfig] = parameter(
        {},
        'What is varied, by parameter or by a name: a list of values, levels by label, or the '
        'fields below.',
    )

    @field_validator('seeds', mode='before')
    @classmethod
    def _count_seeds(cls, value: Any) -> Any:
        return tuple(range(value)) if isinstance(value, int) else value


class ColumnConfig(Config):
    """A column of the table; each of its lines stands for several runs."""

    name: str = parameter(..., 'Head of the column.')
    value: str = parameter(
        '',
        'Column of study.csv; `*` for the largest over the contacts; the head if empty.',
    )
    aggregate: Aggregate = parameter(
        'median',
        'What is shown of the runs of a line: a statistic, how many are true '
        '(`share`), all that there is (`set`), at which values of a factor all are good '
        '(`good_values`).',
    )
    scale: float = parameter(1.0, 'What values are multiplied by.')
    digits: int | None = parameter(
        None, 'After the point; four significant ones if not given.'
    )
    part: str = parameter('', 'Only runs of this part; of all parts if empty.')
    each: bool = parameter(False, 'Whether `*` shows every contact.')


class StudyConfig(PartConfig):
    """One study."""

    name: str = parameter(..., 'Name, as used in file names.', pattern=r'^[\w.-]+$')
    description: str = parameter(
        '', 'What it shows; up to the colon it is its line in lists.'
    )
    kind: Kind = parameter(
        'sweep', 'Which findings and figures it has beside the table.'
    )
    parts: dict[str, PartConfig] = parameter(
        {},
        'Several grids, by title; each has the values above, with its own laid over them.',
    )
    adjustments: tuple[AdjustmentConfig, ...] = parameter(
        (), 'Parameters of the runs that fulfil a condition.'
    )
    quick: dict[str, tuple[Any, ...]] = parameter(
        {}, 'Values of factors, and of `part`, `plant` and `seed`, with `--quick`.'
    )
    law: str = parameter('', 'Of kind `tune`: whose gains are tried.')
    lines: tuple[str, ...] = parameter(
        (),
        'Factors with a line of the table for each of their values; all if not given.',
    )
    sections: tuple[str, ...] = parameter(
        ('plant', 'part'),
        'Factors with a section of the table for each of their values.',
    )
    symbols: dict[str, str] = parameter(
        {},
        'What factors are called in tables and sentences; the last part of their names if not '
        'given.',
    )
    columns: tuple[ColumnConfig, ...] = parameter(
        (), 'Columns of the table; a choice if not given.'
    )
    truth: str = parameter('stable', 'Column that tells whether a run is good.')
    figure: bool = parameter(
        True,
        'Whether the columns are drawn over the first factor, by part and second factor.',
    )
    notes: str = parameter('', 'What stands below the table.')

    def whole_parts(self) -> dict[str, PartConfig]:
        """Return every part with what it has from the study; without parts the study itself."""
        own = {name: getattr(self, name) for name in PartConfig.model_fields}
        parts = {}
        for title, part in (self.parts or {'': PartConfig()}).items():
            given = {name: getattr(part, name) for name in part.model_fields_set}
            factors = dict(self.factors)
            for name, factor in part.factors.items():
                factors[name] = (
                    factors[name].choose(factor.values)
                    if (name in factors and not factor.levels)
                    else factor
                )
            parts[title] = PartConfig.model_construct(
                part.model_fields_set,
                **{
                    **own,
                    **given,
                    'factors': factors,
                    'fixed': {**self.fixed, **part.fixed},
                },
            )
        return parts


def read_study(name: str) -> StudyConfig:
    """Read a study by name or path, with whole parts; ConfigError if it is not acceptable."""
    path = find_named_file('study', 'studies', name)
    study = validate(StudyConfig, read_yaml(path), str(path))
    return study.model_copy(update={'parts': study.whole_parts()})


def read_choices(texts: Iterable[str]) -> dict[str, Sequence[Any]]:
    """Read ``FACTOR=VALUE,VALUE`` texts, the values as in a YAML file; ConfigError if bad."""
    choices: dict[str, Sequence[Any]] = {}
    for text in texts:
        name, _, values = text.partition('=')
        if not values:
            raise ConfigError('--set', 'FACTOR=VALUE,VALUE', f"'{text}'")
        choices |= read_settings([f'{name}=[{values}]'])
    return choices


def select(study: StudyConfig, choices: Choices, *, robot: str = '') -> StudyConfig:
    """
    Return a study of `read_study` with what a user chooses; ConfigError if there is no such thing.

    Choices are values or labels by factor, `part`, `plant` or `seed` (not of parts with their
    own); a parameter that is no factor becomes one. A robot has its own plants of those names.
    """
    parts = dict(study.parts)
    for name, values in choices.items():
        if name == 'part':
            parts = {title: part for title, part in parts.items() if title in values}
        elif name not in ('plant', 'seed'):
            parts = _with_choice(parts, name, values)
    if not parts:
        raise ConfigError(
            'part', f'some of {", ".join(study.parts)}', choices.get('part')
        )
    plants, seeds = choices.get('plant', ()), choices.get('seed', ())
    return study.model_copy(
        update={
            'parts': {
                title: part.model_copy(
                    update={
                        'plants': _plants(
                            robot, plants or part.plants, chosen=bool(plants)
                        ),
                        'seeds': part.seeds
                        if 'seeds' in part.model_fields_set or not seeds
                        else (tuple(seeds)),
                    }
                )
                for title, part in parts.items()
            }
        }
    )


def _with_choice(
    parts: Mapping[str, PartConfig],
    name: str,
    values: Sequence[Any],
) -> dict[str, PartConfig]:
    """Return the parts with values of a factor; one in which none of them is known goes."""
    known = [title for title, part in parts.items() if name in part.factors]
    labels = dict.fromkeys(
        label for title in known for label in parts[title].factors[name].levels
    )
    for value in values:
        if labels and str(value) not in labels:
            raise ConfigError(name, f'some of {", ".join(labels)}', f"'{value}'")
    selection = dict(parts)
    for title in known or parts:
        before = parts[title].factors.get(name, FactorConfig(values=('',)))
        factors = {**parts[title].factors, name: before.choose(values)}
        selection[title] = parts[title].model_copy(update={'factors': factors})
        if before.levels and not factors[name].levels:
            del selection[title]
    return selection


def _plants(robot: str, names: Sequence[str], *, chosen: bool) -> tuple[str, ...]:
    if robot and not chosen:
        known = find_robot(robot)
        names = [name for name in names if known.plant_name(name)] or ['']
    return tuple(dict.fromkeys(plant_source(name, robot).name for name in names))
