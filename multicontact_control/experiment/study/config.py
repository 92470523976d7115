"""A study's file: what is varied, what is run, and what is shown of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from multicontact_control.config import Config, parameter, read_yaml, Real, validate
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.scenario import plant_source
from multicontact_control.paths import config_dir, named_file
import numpy as np
from pydantic import field_validator, model_validator
from sim_bridge.robots import find_robot
import yaml

DIGITS = 12  # of the values of a range, such that 0.1 is not 0.09999999999999999
LISTED = 'a list of values, a range of start, stop and count, or values by label'
Kind = Literal['sweep', 'compare', 'laws', 'map', 'robots', 'tune', 'faults']
Aggregate = Literal[
    'median', 'max', 'count', 'share', 'true', 'set', 'times', 'survived', 'stable_range']


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


class FactorConfig(Config):
    """What is varied: values of one parameter, or levels, each with values of several."""

    values: tuple[Any, ...] = parameter((), 'Values of the parameter, or labels of levels.')
    sets: str = parameter(
        '', "Dotted name, `robot`, `scenario` or `preset`; the factor's name if empty.")
    multiples_of: str = parameter('', 'Parameter that the values are multiples of.')
    levels: dict[str, dict[str, Any]] = parameter(
        {}, 'Parameters and their values, by the label of the level.')

    def settings(self, name: str) -> list[tuple[Any, dict[str, Any]]]:
        """Return each value or label of the factor with the parameters that it sets."""
        if self.levels:
            return list(self.levels.items())
        return [(value, {self.sets or name: value}) for value in self.values]

    def choose(self, chosen: FactorConfig) -> FactorConfig:
        """Return the factor with the chosen values, or with those of its levels chosen."""
        if chosen.levels:
            return chosen
        if not self.levels:
            return self.model_copy(update={'values': chosen.values})
        labels = [str(value) for value in chosen.values]
        return self.model_copy(update={'levels': {
            label: level for label, level in self.levels.items() if label in labels}})


def _factor(field: str, given: Any) -> Any:
    """Return the fields of a factor from a list, a range, values by label, or its fields."""
    if isinstance(given, (list, tuple)) and given:
        return {'values': tuple(given)}
    if not isinstance(given, Mapping) or not given:
        raise ConfigError(field, LISTED, repr(given))
    if given.keys() <= RangeConfig.model_fields.keys():
        try:
            return {'values': validate(RangeConfig, given).values()}
        except ConfigError as error:
            raise ConfigError(f'{field}.{error.field}', error.expected, error.found) from None
    if given.keys() <= FactorConfig.model_fields.keys():
        inner = given.get('values')
        return {**given, **(_factor(field, inner) if isinstance(inner, Mapping) else {})}
    return {'levels': {str(label): level or {} for label, level in given.items()}}


class ConditionConfig(Config):
    """What parameters must be for something to hold."""

    where: dict[str, Any] = parameter({}, 'Values that parameters must have.')
    unless: dict[str, Any] = parameter({}, 'Values that parameters must not have.')


class AdjustmentConfig(ConditionConfig):
    """Parameters of those runs that fulfil a condition."""

    values: dict[str, Any] = parameter(..., 'Parameters and their values.')


class PartConfig(ConditionConfig):
    """What is run: every combination of the factors with every plant and seed."""

    scenario: str = parameter('', 'What is run: a name from config/scenarios, or a path.')
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
    surface_gone: tuple[Real, Real] | None = parameter(
        None, 'From when to when the last surface is away.', unit='s')
    fixed: dict[str, Any] = parameter({}, 'Parameters that differ from the files in every run.')
    factors: dict[str, FactorConfig] = parameter(
        {}, 'What is varied, by parameter or by a name: a list, a range, values by label, or the '
        'fields below.')

    @field_validator('seeds', mode='before')
    @classmethod
    def _count_seeds(cls, value: Any) -> Any:
        if isinstance(value, int) and not isinstance(value, bool):
            if value < 1:
                raise ConfigError('seeds', 'a number of seeds of at least 1, or a list', value)
            return tuple(range(value))
        return value

    @field_validator('factors', mode='before')
    @classmethod
    def _spell_out_factors(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        return {name: _factor(f'factors.{name}', given) for name, given in value.items()}

    @model_validator(mode='after')
    def _check_across_fields(self) -> PartConfig:
        for name in ('plants', 'seeds'):
            given = getattr(self, name)
            if len(set(given)) < len(given):
                raise ConfigError(name, 'each of them once', list(given))
        if min(self.seeds) < 0:
            raise ConfigError('seeds', 'whole numbers >= 0', min(self.seeds))
        for name in self.fixed.keys() & self.factors.keys():
            raise ConfigError(f'fixed.{name}', 'a parameter that is not varied', 'a factor')
        return self


class QuickConfig(Config):
    """What a study has instead with `--quick`."""

    plants: tuple[str, ...] = parameter((), 'Plants; all if not given.')
    seeds: int = parameter(1, 'How many of the seeds.', ge=1)
    factors: dict[str, FactorConfig] = parameter({}, 'Values of factors, or labels of levels.')
    without: tuple[str, ...] = parameter((), 'Parts that are left out.')
    fault_pairs: int = parameter(0, 'Of kind `faults`.', ge=0)

    _spell_out_factors = field_validator('factors', mode='before')(
        PartConfig._spell_out_factors.__func__)  # type: ignore[attr-defined]


class ColumnConfig(Config):
    """A column of the table; each of its lines stands for several cells."""

    name: str = parameter(..., 'Head of the column.')
    value: str = parameter(
        '', 'Column of study.csv; `*` for the largest over the contacts; the head if empty.')
    aggregate: Aggregate = parameter(
        'median', 'What is shown of the cells of a line: a statistic, how many there are '
        '(`count`) or are true (`share`, `true`), all that there is (`set`), first and last time '
        '(`times`), at which values of a factor all are stable (`survived`, `stable_range`).')
    scale: Real = parameter(1.0, 'What values are multiplied by.')
    digits: int | None = parameter(None, 'After the point; four significant ones if not given.')
    part: str = parameter('', 'Only cells of this part; of all parts if empty.')
    each: bool = parameter(False, 'Whether `*` shows every contact.')
    wide: bool = parameter(False, 'Left out where the terminal is narrow.')
    rank: str = parameter('', 'What is good where this is small, for the findings of `laws`.')


class FigureConfig(Config):
    """Medians of some columns against a factor, with a line for each value of another."""

    x: str = parameter('', 'Factor along the horizontal axis; the first if empty.')
    lines: str = parameter('', 'Factor with a line for each value; the second if empty.')
    values: tuple[str, ...] = parameter((), 'Columns; those of the table if not given.')
    parts: tuple[str, ...] = parameter((), 'Parts that are drawn; all if not given.')


class StudyConfig(PartConfig):
    """One study."""

    name: str = parameter(..., 'Name, as used in file names.', pattern=r'^[\w.-]+$')
    description: str = parameter('', 'What it shows; the first sentence is its line in lists.')
    kind: Kind = parameter('sweep', 'Which findings and figures it has beside the table.')
    parts: dict[str, PartConfig] = parameter(
        {}, 'Several grids, by title; each has the values above, with its own laid over them.')
    adjustments: tuple[AdjustmentConfig, ...] = parameter(
        (), 'Parameters of the runs that fulfil a condition.')
    quick: QuickConfig = QuickConfig()
    law: str = parameter('', 'Of kind `tune`: whose gains are tried.')
    fault_pairs: int = parameter(0, 'Of kind `faults`: how many pairs at the same time.', ge=0)
    lines: tuple[str, ...] = parameter(
        (), 'Factors with a line of the table for each of their values; all if not given.')
    sections: tuple[str, ...] = parameter(
        ('plant', 'part'), 'Factors with a section of the table for each of their values.')
    columns: tuple[ColumnConfig, ...] = parameter(
        (), 'Columns of the table, by their values alone or with the fields below; a choice if '
        'not given.')
    truth: str = parameter('stable', 'Column that tells whether a run is good.')
    medians: Literal['stable', 'all'] = parameter(
        'stable', 'Which runs the statistics are of.')
    figure: FigureConfig | None = FigureConfig()
    notes: str = parameter('', 'What stands below the table.')

    @field_validator('columns', mode='before')
    @classmethod
    def _name_columns(cls, value: Any) -> Any:
        return [{'name': each} if isinstance(each, str) else each for each in value] if (
            isinstance(value, (list, tuple))) else value

    def whole_parts(self) -> dict[str, PartConfig]:
        """Return every part with what it has from the study; without parts the study itself."""
        own = {name: getattr(self, name) for name in PartConfig.model_fields}
        parts = {}
        for title, part in (self.parts or {'': PartConfig()}).items():
            given = {name: getattr(part, name) for name in part.model_fields_set}
            factors = dict(self.factors)
            for name, factor in part.factors.items():
                factors[name] = factors[name].choose(factor) if name in factors else factor
            parts[title] = PartConfig.model_construct(part.model_fields_set, **{
                **own, **given, 'factors': factors, 'fixed': {**self.fixed, **part.fixed}})
        return parts


def study_path(name: str) -> Path:
    """Return the file of a study: of a name in config/studies, or a path; or a ConfigError."""
    return named_file('study', 'studies', name)


def study_names() -> list[str]:
    """Return the names of the studies in config/studies."""
    return sorted(path.stem for path in (config_dir() / 'studies').glob('*.yaml'))


def read_study(path: Path) -> StudyConfig:
    """Read a study's file and give every part what it has from the study; ConfigError if bad."""
    study = validate(StudyConfig, read_yaml(path), str(path))
    return study.model_copy(update={'parts': study.whole_parts()})


def read_choice(text: str) -> tuple[str, FactorConfig]:
    """Read ``FACTOR=VALUE,VALUE``, the values as in a YAML file; ConfigError if it is bad."""
    name, sign, values = text.partition('=')
    try:
        given = yaml.safe_load(f'[{values}]')
    except yaml.YAMLError:
        given = None
    if not sign or not name.strip() or not given:
        raise ConfigError('--set', 'FACTOR=VALUE,VALUE', f"'{text}'")
    return name.strip(), FactorConfig(values=tuple(given))


def select(
    study: StudyConfig, *, quick: bool = False, robot: str = '', plants: tuple[str, ...] = (),
    seeds: tuple[int, ...] | int | None = None,
    choices: Iterable[tuple[str, FactorConfig]] = (),
) -> StudyConfig:
    """
    Return a study of `read_study` with what a user chooses.

    Parameters
    ----------
    study
        The study.
    quick
        Whether its quick form is taken.
    robot
        Name or path: the study's plants that this robot has, or its default one.
    plants
        Instead of the study's.
    seeds
        Instead of the study's: a list, or how many from its first one on.
    choices
        Values of factors, or labels of their levels; a parameter that is no factor becomes one.

    Raises
    ------
    ConfigError
        If there is no such robot, plant or level.

    """
    short, parts, pairs = study.quick, dict(study.parts), study.fault_pairs
    if quick:
        parts = {title: part for title, part in parts.items() if title not in short.without}
        choices = [*short.factors.items(), *choices]
        plants, pairs = plants or short.plants, short.fault_pairs
        seeds = short.seeds if seeds is None else seeds
    for name, chosen in choices:
        parts = _with_choice(parts, name, chosen)
    return study.model_copy(update={'fault_pairs': pairs, 'parts': {
        title: part.model_copy(update={
            'plants': _plants(part, robot, plants), 'seeds': _seeds(part, seeds)})
        for title, part in parts.items()}})


def _with_choice(
    parts: Mapping[str, PartConfig], name: str, chosen: FactorConfig,
) -> dict[str, PartConfig]:
    """Return the parts with values of a factor; one in which none of them is known goes."""
    known = [title for title, part in parts.items() if name in part.factors]
    labels = dict.fromkeys(
        label for title in known for label in parts[title].factors[name].levels)
    unknown = [value for value in chosen.values if labels and str(value) not in labels]
    if unknown:
        raise ConfigError(name, f'some of {", ".join(labels)}', f"'{unknown[0]}'")
    found = {}
    for title, part in parts.items():
        factor = part.factors[name].choose(chosen) if title in known else chosen
        if known and title not in known or factor.levels or factor.values:
            factors = part.factors if known and title not in known else {
                **part.factors, name: factor}
            found[title] = part.model_copy(update={'factors': factors})
    return found


def _plants(part: PartConfig, robot: str, plants: tuple[str, ...]) -> tuple[str, ...]:
    names = plants or part.plants
    if robot and not plants:
        known = find_robot(robot)
        names = tuple(name for name in names if known.plant_name(name)) or ('',)
    return tuple(dict.fromkeys(plant_source(name, robot).name for name in names))


def _seeds(part: PartConfig, seeds: tuple[int, ...] | int | None) -> tuple[int, ...]:
    if seeds is None or 'seeds' in part.model_fields_set:  # of its own
        return part.seeds
    if isinstance(seeds, int):
        return tuple(range(part.seeds[0], part.seeds[0] + seeds))
    return seeds
