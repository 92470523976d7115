"""Situations as jobs: every arm led to its limits, and what the surfaces and joints bore."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
import hashlib
import json
from typing import Any

from multicontact_control.config import validate
from multicontact_control.errors import ConfigError
from multicontact_control.faults.situation import (
    find_means,
    FOREIGN,
    foreign_robot,
    resolve_situation,
    SituationConfig,
)
from multicontact_control.faults.situation_run import run_situation
from multicontact_control.runs.scenario import resolve, Setup
from multicontact_control.study.cells import (
    Cell,
    Combination,
    combine_factors,
    lay_over_arguments,
    split_file_choices,
)
from multicontact_control.study.config import PartConfig, StudyConfig
from multicontact_control.study.jobs import outcome_key
from multicontact_control.study.study import Metrics, Results, Study
import pandas as pd

SECTION = 'situation.'  # of the names of a situation's own parameters


@dataclass(frozen=True)
class SituationJob:
    """
    One situation of one arm, from the start of a scenario to its end.

    Its fields are plain values, so that it can be pickled, written down and hashed; the situation
    is read from them anew.
    """

    what: str  # the situation in words
    arguments: Mapping[str, Any]  # of `resolve`; the robot may be `FOREIGN`
    situation: Mapping[str, Any]  # values of a `SituationConfig`

    def setup(self) -> Setup:
        """
        Return the setup of the run, without its course.

        Raises
        ------
        ConfigError
            If a value of the situation, or what follows from it, is not acceptable.

        """
        setup, _ = resolve_situation(self.arguments, read_situation(self.situation))
        return setup

    def key(self) -> str:
        """
        Return the hash of all that decides the outcome; see `outcome_key`.

        The situation enters with all defaults: bias, payload and timing of commands are no part of
        the setup.
        """
        situation = read_situation(self.situation).model_dump(mode='json')
        return outcome_key('situation', self.setup(), situation=situation)

    def run(self) -> dict[str, Any]:
        """
        Run it and return its row as a mapping; see `SituationRow`.

        A run that breaks off is a row that is not safe, and no exception.
        """
        situation = read_situation(self.situation)
        setup, course = resolve_situation(self.arguments, situation)
        return asdict(run_situation(self.what, setup, course, situation))


def read_situation(values: Mapping[str, Any]) -> SituationConfig:
    """
    Return a situation from values of its parameters, without the prefix ``situation.``.

    Raises
    ------
    ConfigError
        If one is unknown or not acceptable; it is named below `situation`.

    """
    return validate(SituationConfig, values, 'situation')


class SituationsStudy(Study):
    """
    Every combination of situations on every arm that is installed.

    Each has one of the study's seeds, in turn: with a single one, a share of them is run. The turn
    is a hash of the combination's name, so that a new combination leaves the others theirs.
    """

    def __init__(self, config: StudyConfig) -> None:
        super().__init__(config)
        self.missing: dict[str, str] = {}  # robots that are not installed, and why

    def plan_cells(self) -> list[Cell]:
        """
        Return the jobs whose seed is chosen, of robots that have what a situation takes.

        What a robot lacks (a plant, contacts, a joint) is left out without a word; a robot that is
        not installed is noted in `missing`.
        """
        cells: list[Cell] = []
        for title, part in self.config.parts.items():
            for combination in combine_factors(part):
                cells += self._plan_situation(title, part, combination)
        return cells

    def _plan_situation(
        self, title: str, part: PartConfig, combination: Combination
    ) -> Iterator[Cell]:
        """Yield the cell of a combination, if it is possible and its seed is chosen."""
        files, values = split_file_choices({**part.fixed, **combination.settings})
        plant = values.pop('plant', combination.plant)
        arguments = {'scenario': part.scenario, 'plant': plant, **files}
        situation = {}
        for name in list(values):
            if name.startswith(SECTION):
                situation[name.removeprefix(SECTION)] = values.pop(name)
        if not self._is_possible(files.get('robot', ''), plant, situation):
            return
        labels = dict(combination.labels)
        robot = labels.pop('robot', '')
        what = ', '.join(f'{name} {label}' for name, label in labels.items())
        seed = self._choose_seed([title, combination.plant, robot, what])
        if seed not in part.seeds:
            return
        arguments = _lay_over_values(arguments, values)
        job = SituationJob(what, {**arguments, 'seed': seed}, situation)
        factors = {'part': title, 'robot': robot, 'plant': plant, 'seed': seed}
        yield Cell(factors, job, job.key())

    def _choose_seed(self, names: list[str]) -> int:
        """Return whose turn it is, whatever else is chosen of the study."""
        digest = hashlib.sha256(json.dumps(names).encode()).digest()
        seeds = self.config.seeds
        return seeds[digest[0] % len(seeds)]

    def _is_possible(
        self, robot: str, plant: str, situation: Mapping[str, Any]
    ) -> bool:
        """Return whether the robot is installed and has what the situation takes."""
        if robot in self.missing:
            return False
        try:
            means = find_means(robot)
        except ConfigError as error:
            if error.field not in ('urdf', 'engine'):
                raise
            self.missing[robot] = str(error)
            return False
        return means.allow(plant, read_situation(situation))

    def table_rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """
        Return the row of a situation; see `SituationRow`.

        A job measures nothing else, so its metrics are the row.
        """
        return [dict(metrics)]

    def complete_table(self, frame: pd.DataFrame) -> pd.DataFrame:
        """
        Return the table with what went wrong, and in what, as the `error` of a row.

        `error` is None where nothing did. The page then lists each as a remark in the situation's
        own words.
        """
        error = frame['what'] + ': ' + frame['problems']
        return frame.assign(error=error.where(frame['problems'] != '', None))

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return how many situations are safe, what is wrong in the others, and what is absent.

        Problems are counted one by one, the commonest first: a run with two of them counts for
        both.
        """
        frame = results.frame
        finding = f'{int(frame["safe"].sum())} of {len(frame)} situations are safe'
        problems = frame['problems'].str.split(', ').explode()
        counts = problems[problems != ''].value_counts()
        if len(counts):
            wrong = [f'{count} x {problem}' for problem, count in counts.items()]
            finding += f': {", ".join(wrong)}'
        absent = [f'{robot} is not run: {why}' for robot, why in self.missing.items()]
        return [f'{finding}.', *absent]


def _lay_over_values(
    arguments: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of `resolve` with values of parameters by dotted names."""
    if not values:
        return dict(arguments)
    named = dict(arguments)
    if named.get('robot') == FOREIGN:
        named['robot'] = foreign_robot()
    return lay_over_arguments(arguments, values, resolve(**named))
