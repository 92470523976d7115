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

Kind = Literal['sweep', 'compare', 'map', 'tune', 'faults', 'situations', 'sanding']
Aggregate = Literal['median', 'mean', 'min', 'max', 'share', 'set', 'good_values']
Choices = Mapping[str, Sequence[Any]]  # values by factor
REGISTRIES: Mapping[str, Mapping[str, str]] = {  # by parameter that chooses from one
    'controller.force.law': FORCE_LAWS,
    'noise_estimator.estimator': NOISE_ESTIMATORS,
}


class FactorConfig(Config):
    """
    What is varied: values or a range of one parameter, or levels with values of several.

    In a file a bare list stands for `values`, and a mapping with other keys than the fields
    below for `levels`.
    """

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
    def _spell_out_fields(cls, given: Any) -> Any:
        """Return the fields of a list of values, or of levels by label."""
        if isinstance(given, (list, tuple)):
            return {'values': given}
        if isinstance(given, Mapping) and not given.keys() <= cls.model_fields.keys():
            levels = {}
            for label, level in given.items():
                levels[str(label)] = level or {}
            return {'levels': levels}
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
            return self
        no_ratio = self.spacing == 'log' and min(self.start, self.stop) <= 0.0
        if self.count < 2 or no_ratio:
            raise ValueError(
                'a count of at least 2, and of spacing: log a start and stop above 0'
            )
        return self

    def settings(self, name: str) -> list[tuple[Any, dict[str, Any]]]:
        """
        Return each value or label of the factor with the parameters that it sets.

        Values set the parameter `sets`, or else the one that the factor is called like (`name`).
        A range is rounded to 12 digits, such that 0.1 is not 0.09999999999999999.
        """
        if self.levels:
            return list(self.levels.items())
        values = self.values
        if not values and self.start is not None and self.stop is not None:
            if self.spacing == 'log':
                numbers = np.geomspace(self.start, self.stop, self.count)
            else:
                numbers = np.linspace(self.start, self.stop, self.count)
            values = tuple(float(f'{number:.12g}') for number in numbers)
        return [(value, {self.sets or name: value}) for value in values]

    def with_choice(self, values: Sequence[Any]) -> FactorConfig:
        """Return the factor with other values; of one with levels, those with these labels."""
        if not self.levels:
            return self.model_copy(update={'values': tuple(values)})
        chosen = set(map(str, values))
        levels = {}
        for label, level in self.levels.items():
            if label in chosen:
                levels[label] = level
        return self.model_copy(update={'levels': levels})


class AdjustmentConfig(Config):
    """Parameters of those runs that fulfil a condition, whichever part they are of."""

    where: dict[str, Any] = parameter(..., 'Values that parameters must have.')
    values: dict[str, Any] = parameter(..., 'Parameters and their values.')


class PartConfig(Config):
    """
    What is run: every combination of the factors with every plant and seed.

    A part of a study says only in what it differs from the study.
    """

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
        if isinstance(value, int):
            return tuple(range(value))
        return value


class ColumnConfig(Config):
    """A column of the table: a value of the runs, and what a line shows of several of them."""

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
    """
    One study: its grids of runs, and what its table, figure and page show of them.

    What it says of a run itself holds for all of its parts.
    """

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
        """
        Return every part with what it has from the study; without parts the study itself.

        A part's own fields take the place of the study's, except that `fixed` parameters and
        factors are added to them. Values that a part gives to a factor of the study choose among
        its levels.
        """
        inherited = {name: getattr(self, name) for name in PartConfig.model_fields}
        parts = {}
        for title, part in (self.parts or {'': PartConfig()}).items():
            own = {name: getattr(part, name) for name in part.model_fields_set}
            factors = dict(self.factors)
            for name, factor in part.factors.items():
                if name in factors and not factor.levels:
                    factors[name] = factors[name].with_choice(factor.values)
                else:
                    factors[name] = factor
            fields = {
                **inherited,
                **own,
                'factors': factors,
                'fixed': {**self.fixed, **part.fixed},
            }
            parts[title] = PartConfig.model_construct(part.model_fields_set, **fields)
        return parts


def read_study(name: str) -> StudyConfig:
    """
    Read a study by name or path; its parts are whole.

    Raises
    ------
    ConfigError
        If there is no such file, or a value in it is not acceptable.

    """
    path = find_named_file('study', 'studies', name)
    study = validate(StudyConfig, read_yaml(path), str(path))
    return study.model_copy(update={'parts': study.whole_parts()})


def read_choices(texts: Iterable[str]) -> dict[str, Sequence[Any]]:
    """
    Read ``FACTOR=VALUE,VALUE`` texts: values by factor, as they would stand in a YAML file.

    Raises
    ------
    ConfigError
        If a text has no factor or no values.

    """
    choices: dict[str, Sequence[Any]] = {}
    for text in texts:
        name, _, values = text.partition('=')
        if not values:
            raise ConfigError('--set', 'FACTOR=VALUE,VALUE', f"'{text}'")
        choices |= read_settings([f'{name}=[{values}]'])
    return choices


def apply_choices(
    study: StudyConfig, choices: Choices, *, robot: str = ''
) -> StudyConfig:
    """
    Return a study with what a user chooses of it.

    Parameters
    ----------
    study
        What `read_study` gives.
    choices
        Values or labels by factor, `part`, `plant` or `seed`; seeds do not reach parts with
        their own. A parameter that is no factor becomes one.
    robot
        Whose plants of the study's names are meant; the default robot if empty.

    Raises
    ------
    ConfigError
        If there is no such part, label, plant or robot.

    """
    parts = dict(study.parts)
    for name, values in choices.items():
        if name == 'part':
            parts = {title: part for title, part in parts.items() if title in values}
        elif name not in ('plant', 'seed'):
            parts = _choose_values(parts, name, values)
    if not parts:
        raise ConfigError(
            'part', f'some of {", ".join(study.parts)}', choices.get('part')
        )
    for title, part in parts.items():
        if 'plant' in choices:
            plants = choices['plant']
        elif robot:
            plants = _list_plants_of_robot(robot, part.plants)
        else:
            plants = part.plants
        names = [plant_source(plant, robot).name for plant in plants]
        changes = {'plants': tuple(dict.fromkeys(names))}
        if 'seed' in choices and 'seeds' not in part.model_fields_set:
            changes['seeds'] = tuple(choices['seed'])
        parts[title] = part.model_copy(update=changes)
    return study.model_copy(update={'parts': parts})


def _choose_values(
    parts: Mapping[str, PartConfig],
    name: str,
    values: Sequence[Any],
) -> dict[str, PartConfig]:
    """
    Return the parts with values of a factor, which all get if none has it.

    A part in which no level has one of these labels goes.
    """
    with_factor = [title for title, part in parts.items() if name in part.factors]
    labels: list[str] = []
    for title in with_factor:
        labels += parts[title].factors[name].levels
    for value in values:
        if labels and str(value) not in labels:
            known = ', '.join(dict.fromkeys(labels))
            raise ConfigError(name, f'some of {known}', f"'{value}'")
    chosen = dict(parts)
    for title in with_factor or parts:
        part = parts[title]
        before = part.factors.get(name, FactorConfig(values=('',)))
        factor = before.with_choice(values)
        if before.levels and not factor.levels:
            del chosen[title]
        else:
            factors = {**part.factors, name: factor}
            chosen[title] = part.model_copy(update={'factors': factors})
    return chosen


def _list_plants_of_robot(robot: str, names: Sequence[str]) -> list[str]:
    """Return those plants of some names that a robot has, its default one if it has none."""
    known = find_robot(robot)
    return list(filter(known.plant_name, names)) or ['']
