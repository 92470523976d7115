"""Situations as jobs: every arm led to its limits, and what the surfaces and joints bore."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
import hashlib
from itertools import product
import json
from typing import Any

from multicontact_control.config import validate
from multicontact_control.errors import ConfigError
from multicontact_control.faults.situation import (
    FOREIGN,
    foreign_robot,
    means_of,
    situated,
    SituationConfig,
)
from multicontact_control.faults.situation_run import run_situation
from multicontact_control.runs import overrides
from multicontact_control.runs.scenario import resolve, Setup
from multicontact_control.study.cells import Cell, CHOSEN
from multicontact_control.study.config import PartConfig, StudyConfig
from multicontact_control.study.jobs import content_key, setup_content
from multicontact_control.study.study import Metrics, Results, Study
import pandas as pd

SECTION = 'situation.'  # of the names of a situation's own parameters


@dataclass(frozen=True)
class SituationJob:
    """One situation of one arm."""

    what: str
    arguments: Mapping[str, Any]  # of `resolve`; the robot may be `FOREIGN`
    situation: Mapping[str, Any]  # values of a `SituationConfig`

    def setup(self) -> Setup:
        """Return the setup of the run."""
        return situated(self.arguments, self._config())[0]

    def key(self) -> str:
        """Return the hash of all that decides the outcome."""
        return content_key(
            'situation',
            {
                **setup_content(self.setup()),
                'situation': self._config().model_dump(mode='json'),
            },
        )

    def run(self) -> dict[str, Any]:
        """Run it and return its row."""
        config = self._config()
        setup, course = situated(self.arguments, config)
        return asdict(run_situation(self.what, setup, course, config))

    def _config(self) -> SituationConfig:
        return validate(SituationConfig, self.situation, 'situation')


class SituationsStudy(Study):
    """
    Every combination of situations on every arm that is installed.

    Each has one of the study's seeds, in turn: with a single one, a share of them is run.
    """

    def __init__(self, config: StudyConfig) -> None:
        super().__init__(config)
        self.missing: dict[str, str] = {}  # robots that are not installed, and why

    def cells(self) -> list[Cell]:
        """Return the jobs of the chosen seeds."""
        return [
            cell
            for title, part in self.config.parts.items()
            for cell in self._cells_of(title, part)
        ]

    def _cells_of(self, title: str, part: PartConfig) -> Iterator[Cell]:
        choices = [
            [(name, *setting) for setting in factor.settings(name)]
            for name, factor in part.factors.items()
        ]
        for plant, *chosen in product(part.plants, *choices):
            settings = dict(part.fixed)
            for _, _, values in chosen:
                settings |= values
            arguments = {
                'scenario': part.scenario,
                'plant': plant,
                **{
                    name: settings.pop(name)
                    for name in (*CHOSEN, 'plant')
                    if name in settings
                },
            }
            situation = {
                name.removeprefix(SECTION): settings.pop(name)
                for name in list(settings)
                if name.startswith(SECTION)
            }
            if not self._is_possible(arguments, situation):
                continue
            labels = {name: label for name, label, _ in chosen}
            robot = labels.pop('robot', '')
            what = ', '.join(f'{name} {label}' for name, label in labels.items())
            seed = self._seed_of([title, plant, robot, what])
            if seed not in part.seeds:
                continue
            job = SituationJob(what, _laid_over(arguments, settings, seed), situation)
            factors = {
                'part': title,
                'robot': robot,
                'plant': arguments['plant'],
                'seed': seed,
            }
            yield Cell(factors, job, job.key())

    def _seed_of(self, names: list[str]) -> int:
        """Return whose turn it is, whatever else is chosen of the study."""
        digest = hashlib.sha256(json.dumps(names).encode()).digest()
        every = self.config.seeds
        return every[digest[0] % len(every)]

    def _is_possible(
        self, arguments: Mapping[str, Any], situation: Mapping[str, Any]
    ) -> bool:
        """Return whether the robot is installed and has what the situation takes."""
        robot = arguments.get('robot', '')
        if robot in self.missing:
            return False
        try:
            means = means_of(robot)
        except ConfigError as error:
            if error.field not in ('urdf', 'engine'):
                raise
            self.missing[robot] = str(error)
            return False
        config = validate(SituationConfig, situation, 'situation')
        return means.allow(arguments['plant'], config)

    def rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """Return the row of a situation."""
        return [dict(metrics)]

    def complete(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the table with what went wrong, and in what, as the `error` of a row."""
        error = frame['what'] + ': ' + frame['problems']
        return frame.assign(error=error.where(frame['problems'] != '', None))

    def findings(self, results: Results) -> list[str]:
        """Return how many situations are safe, what is wrong in the others, and what is absent."""
        frame = results.frame
        problems = frame['problems'].str.split(', ').explode()
        counts = problems[problems != ''].value_counts()
        wrong = [f'{count} x {problem}' for problem, count in counts.items()]
        return [
            f'{int(frame["safe"].sum())} of {len(frame)} situations are safe'
            + (f': {", ".join(wrong)}.' if wrong else '.'),
            *(f'{robot} is not run: {error}' for robot, error in self.missing.items()),
        ]


def _laid_over(
    arguments: Mapping[str, Any],
    settings: Mapping[str, Any],
    seed: int,
) -> dict[str, Any]:
    """Return the arguments of `resolve` with values of parameters by dotted names."""
    robot = arguments.get('robot', '')
    named = {**arguments, 'robot': foreign_robot() if robot == FOREIGN else robot}
    nested = (
        overrides.nest_overrides(settings, resolve(**named), 'factors.')
        if settings
        else {}
    )
    return {
        **arguments,
        'seed': seed,
        **{overrides.ARGUMENTS[section]: values for section, values in nested.items()},
    }
