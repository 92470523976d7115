"""`multicontact compare --laws`: laws x plants x seeds x what a contact may meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from multicontact_control.errors import check_all, ConfigError
from multicontact_control.experiment.scenario import (
    law_presets,
    plant_source,
    plants_of,
    preset_values,
    resolve,
)
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.laws.jobs import (
    DELAY,
    FRICTION,
    LawJob,
    run_law_job,
    STIFFNESS,
    TASK,
    VANISHING,
)
from multicontact_control.experiment.study.presets.laws.results import (
    law_findings,
    law_listing,
    law_rows,
)
from multicontact_control.experiment.study.study import Study

FIRST_SEED = 1  # laws are tuned on seed 0
SEEDS, QUICK_SEEDS = 3, 1
VALUES = {STIFFNESS: (0.05, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0, 20.0), DELAY: (0.0, 2.0, 3.0),
          FRICTION: (0.0, 2.0, 4.0)}
QUICK_VALUES = {STIFFNESS: (0.2, 5.0), DELAY: (3.0,), FRICTION: (4.0,)}
INTRODUCTION = (
    'Every law runs with the same plant, decoupling and supervisor, tuned on seed 0 by '
    '`multicontact tune` (its grid is in config/presets/laws) and judged on others. paper, best '
    'and adaptive are the active observer. Task: force steps, pushes of 5 N at rest, sliding. A '
    'surface vanishes for 0.3 s; the true stiffness is 0.05 to 20 times that of the model, the '
    'actuator late by 0 to 3 periods, and joint friction up to 4 times that of the plant.')


@dataclass(frozen=True)
class LawStudy(Study[LawJob, list[Mapping[str, Any]]]):
    """
    Presets that make force laws, plants, seeds and situations.

    Attributes
    ----------
    plants, presets
        Names or paths.
    seeds
        How many, from 1; None for 3, or 1 of the quick race.
    quick
        Whether there are fewer situations.

    """

    plants: tuple[str, ...] = field(default_factory=plants_of)
    presets: tuple[str, ...] = field(default_factory=law_presets)
    seeds: int | None = None
    quick: bool = False

    title = 'laws'
    name = 'laws'
    measure = staticmethod(run_law_job)
    takes_long = True

    @property
    def seed_range(self) -> range:
        """Return the seeds."""
        count = self.seeds if self.seeds is not None else QUICK_SEEDS if self.quick else SEEDS
        return range(FIRST_SEED, FIRST_SEED + count)

    @property
    def values(self) -> Mapping[str, Sequence[float]]:
        """Return the values of stiffness, delay and friction."""
        return QUICK_VALUES if self.quick else VALUES

    def check(self) -> None:
        """Check the options; ConfigError with all that are not acceptable."""
        check_all(*(partial(plant_source, name) for name in self.plants),
                  *(partial(preset_values, name) for name in self.presets), self._check_seeds)

    def _check_seeds(self) -> None:
        if not self.seed_range:
            raise ConfigError('seeds', 'at least 1', self.seeds)

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return laws, plants, seeds and situations."""
        return {'laws': self.presets, 'plants': self.plants, 'seeds': self.seed_range,
                'situations': [TASK, VANISHING, *(
                    f'{situation} {value:g}' for situation, values in self.values.items()
                    for value in values)]}

    def jobs(self) -> list[LawJob]:
        """Return the runs; joint friction is varied where there is some."""
        rubbing = {plant for plant in self.plants
                   if resolve('quick', plant=plant).plant.joint_friction_scale > 0.0}
        situations = [(TASK, 1.0), (VANISHING, 1.0), *(
            (situation, value) for situation, values in self.values.items() for value in values)]
        return [LawJob(preset, plant, seed, situation, value)
                for plant in self.plants for preset in self.presets for seed in self.seed_range
                for situation, value in situations
                if situation != FRICTION or plant in rubbing]

    def content(self, run: JobRun[LawJob]) -> list[Mapping[str, Any]]:
        """Return a row for each law on each plant."""
        return law_rows(run.kept(self.jobs()), lambda job: run.result(job).metrics)

    def tables(
        self, content: list[Mapping[str, Any]], run: JobRun[LawJob],
    ) -> Mapping[str, Any]:
        """Return ``laws.json``: the rows, and what was measured in every run."""
        return {f'{self.name}.json': {'laws': content, 'runs': [
            {**job.describe(), **run.result(job).metrics} for job in run.kept(self.jobs())]}}

    def page(self, content: list[Mapping[str, Any]], folder: Path) -> Page:
        """Return a table for each plant, and what each law is good for."""
        return Page(
            'Force laws compared',
            [Section(f'Plant {plant}', law_listing(content, plant)) for plant in self.plants],
            introduction=[INTRODUCTION], findings=law_findings(content))
