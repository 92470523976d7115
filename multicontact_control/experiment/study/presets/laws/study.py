"""`multicontact compare --laws`: laws x plants x seeds x what a contact may meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from multicontact_control.errors import check_all
from multicontact_control.experiment.scenario import (
    law_presets,
    plant_source,
    plants_of,
    preset_values,
    resolve,
)
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.measure import largest, middle
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.laws.jobs import (
    DELAY,
    FRICTION,
    GONE_FOR,
    LawJob,
    run_law_job,
    STIFFNESS,
    TASK,
    VANISHING,
)
from multicontact_control.experiment.study.study import check_seeds, Study
from multicontact_control.experiment.study.table import Column, format_number, Line, Listing

FIRST_SEED = 1  # laws are tuned on seed 0
SEEDS, QUICK_SEEDS = 3, 1
VALUES = {STIFFNESS: (0.05, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0, 20.0), DELAY: (0.0, 2.0, 3.0),
          FRICTION: (0.0, 2.0, 4.0)}
QUICK_VALUES = {STIFFNESS: (0.2, 5.0), DELAY: (3.0,), FRICTION: (4.0,)}
NEAR_BEST = 1.25  # times the best figure, that counts as about as good
FAR_FROM_BEST = 3.0
LEAST = {'rest_rms_n': 0.02, 'neighbour_n': 0.2, 'push_off_s': 0.01, 'overshoot_percent': 3.0}
CAPTION = ('medians over the seeds, of the worse contact. k, delay, friction: values at which the '
           'run was stable, in brackets those without an oscillation or another limit cycle only')
INTRODUCTION = (
    'Every law runs with the same plant, decoupling and supervisor, tuned on seed 0 by '
    '`multicontact tune` (its grid is in config/presets/laws) and judged on others. paper, best '
    'and adaptive are the active observer. Task: force steps, pushes at rest, sliding. A '
    f'surface vanishes for {GONE_FOR:g} s; the true stiffness over that of the model, the delay '
    'of the actuator in periods and the joint friction over that of the plant are varied.')

Row = Mapping[str, Any]


class Figure(NamedTuple):
    """A figure of a law: its column, and what it is called where laws are ranked by it."""

    name: str
    column: Column
    digits: int
    scale: float = 1.0
    text: str = ''  # smaller is better; empty if it does not rank
    unit: str = ''


FIGURES = (
    Figure('rest_rms_n', Column('rest rms [N]', 'rest\n[N]'), 2, 1.0, 'error at rest', 'N'),
    Figure('moving_rms_n', Column('moving rms [N]', 'move\n[N]'), 2, 1.0, 'error while sliding',
           'N'),
    Figure('rise_s', Column('rise of a step [ms]', 'rise\n[ms]'), 0, 1e3, 'quick steps', 'ms'),
    Figure('overshoot_percent', Column('overshoot [%]', 'over\n[%]'), 0, 1.0,
           'steps without overshoot', '%'),
    Figure('push_peak_n', Column('push: peak [N]', 'push\n[N]'), 1, 1.0, 'pushes', 'N'),
    Figure('push_off_s', Column('off for [ms]', 'off\n[ms]'), 0, 1e3),
    Figure('activity_nm', Column('torque activity [N m]', 'torque\n[N m]'), 2, 1.0,
           'smooth torque', 'N m'),
    Figure('neighbour_n', Column('neighbour of a vanishing surface [N]', 'gone\n[N]', spare=True),
           1, 1.0, 'a surface that vanishes', 'N'))
COLUMNS = (
    Column('law', number=False), Column('stable', number=False),
    *(figure.column for figure in FIGURES),
    Column('true/modelled stiffness', 'k', number=False),
    Column('delay [periods]', 'delay', number=False),
    Column('joint friction x', 'friction', number=False))


@dataclass(frozen=True)
class LawStudy(Study[LawJob, list[Mapping[str, Any]]]):
    """Presets that make force laws, plants, seeds and situations."""

    plants: tuple[str, ...] = field(default_factory=plants_of)
    presets: tuple[str, ...] = field(default_factory=law_presets)
    seeds: int | None = None  # how many, from 1; None for 3, or 1 of the quick race
    quick: bool = False  # with fewer situations

    title = 'laws'
    name = 'laws'
    measure = staticmethod(run_law_job)

    @property
    def seed_range(self) -> range:
        """Return the seeds."""
        count = self.seeds if self.seeds is not None else QUICK_SEEDS if self.quick else SEEDS
        return range(FIRST_SEED, FIRST_SEED + count)

    @property
    def situations(self) -> list[tuple[str, float]]:
        """Return every situation with its value."""
        return [(TASK, 1.0), (VANISHING, 1.0), *(
            (situation, value)
            for situation, values in (QUICK_VALUES if self.quick else VALUES).items()
            for value in values)]

    def check(self) -> None:
        """Check the options; ConfigError with all that are not acceptable."""
        check_all(*(partial(plant_source, name) for name in self.plants),
                  *(partial(preset_values, name) for name in self.presets),
                  partial(check_seeds, len(self.seed_range)))

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return laws, plants, seeds and situations."""
        return {'laws': self.presets, 'plants': self.plants, 'seeds': self.seed_range,
                'situations': [name if name in (TASK, VANISHING) else f'{name} {value:g}'
                               for name, value in self.situations]}

    def jobs(self) -> list[LawJob]:
        """Return the runs; joint friction is varied where there is some."""
        rubbing = {plant for plant in self.plants
                   if resolve('quick', plant=plant).plant.joint_friction_scale > 0.0}
        return [LawJob(preset, plant, seed, situation, value)
                for plant in self.plants for preset in self.presets for seed in self.seed_range
                for situation, value in self.situations
                if situation != FRICTION or plant in rubbing]

    def content(self, run: JobRun[LawJob]) -> list[Mapping[str, Any]]:
        """Return a row for each law on each plant."""
        return law_rows(self.jobs(), run.metrics)

    def tables(
        self, content: list[Mapping[str, Any]], run: JobRun[LawJob],
    ) -> Mapping[str, Any]:
        """Return ``laws.json``: the rows, and what was measured in every run."""
        return {f'{self.name}.json': {'laws': content, 'runs': [
            {**job.describe(), **run.metrics(job)} for job in self.jobs()]}}

    def page(self, content: list[Mapping[str, Any]], folder: Path) -> Page:
        """Return a table for each plant, and what each law is good for."""
        return Page(
            'Force laws compared',
            [Section(f'Plant {plant}', law_listing(content, plant)) for plant in self.plants],
            introduction=[INTRODUCTION], findings=law_findings(content))


def law_rows(jobs: Sequence[LawJob], metrics_of: Callable[[LawJob], Row]) -> list[Row]:
    """Return one row for each law on each plant: medians over runs, of the worse contact."""
    rows: list[Row] = []
    for preset, plant in dict.fromkeys((job.preset, job.plant) for job in jobs):
        runs = [(job, metrics_of(job)) for job in jobs
                if (job.preset, job.plant) == (preset, plant)]
        task = [metrics for job, metrics in runs if job.situation == TASK]
        rows.append({
            'law': preset, 'plant': plant,
            'stable': sum(bool(metrics['stable']) for metrics in task), 'runs': len(task),
            **{name: middle(largest(_figure(contact, name)
                                    for contact in metrics['contacts'].values())
                            for metrics in task)
               for name in ('rest_rms_n', 'moving_rms_n', 'rise_s', 'overshoot_percent',
                            'push_peak_n', 'push_off_s')},
            'activity_nm': middle(metrics['activity_nm'] for metrics in task),
            'neighbour_n': middle(metrics['neighbour_n'] for job, metrics in runs
                                  if job.situation == VANISHING),
            **{situation: _survived(runs, situation)
               for situation in (STIFFNESS, DELAY, FRICTION)}})
    return rows


def _figure(contact: Row, name: str) -> float | None:
    """Return a figure of a contact, the largest of its steps where it is one of theirs."""
    values = [contact] if name in contact else contact['steps']
    return largest(value[name] for value in values)


def _survived(runs: Sequence[tuple[Any, Row]], situation: str) -> list[dict[str, Any]]:
    """Return for each value how many runs were stable, and how many did not oscillate."""
    found: dict[float, list[Row]] = {}
    for job, metrics in runs:
        if job.situation == situation:
            found.setdefault(job.value, []).append(metrics)
    return [{'value': value, 'runs': len(group),
             'stable': sum(bool(metrics['stable']) for metrics in group),
             'calm': sum(not metrics['oscillates'] for metrics in group)}
            for value, group in sorted(found.items())]


def law_listing(rows: Sequence[Row], plant: str) -> Listing:
    """Return the table of one plant."""
    lines = [Line([
        row['law'], f'{row["stable"]}/{row["runs"]}',
        *(format_number(row[figure.name], figure.digits, figure.scale) for figure in FIGURES),
        *(_values(row[situation]) for situation in (STIFFNESS, DELAY, FRICTION))],
        row['stable'] == row['runs']) for row in rows if row['plant'] == plant]
    return Listing(COLUMNS, lines, caption=CAPTION)


def _values(survived: Sequence[Row]) -> str:
    """Return the values at which all runs were stable, with those that were only calm."""
    if not survived:
        return '-'
    parts = []
    for each in survived:
        text = f'{each["value"]:g}'
        if each['stable'] == each['runs']:
            parts.append(text)
        elif each['calm'] == each['runs']:
            parts.append(f'({text})')
    return ' '.join(parts) or 'none'


def law_findings(rows: Sequence[Row]) -> list[str]:
    """Return in plain sentences what each law is good for, on each plant."""
    said = []
    for row in rows:
        name = f'{row["plant"]}, {row["law"]}'
        if row['stable'] < row['runs']:
            said.append(f'{name}: not stable in {row["runs"] - row["stable"]} of {row["runs"]} '
                        'runs of the task.')
            continue
        good, bad = [], []
        for figure in FIGURES:
            values = [each[figure.name] for each in rows if each['plant'] == row['plant']
                      and each['stable'] == each['runs'] and each[figure.name] is not None]
            if not figure.text or not values:
                continue
            value = row[figure.name]
            best = max(min(values), LEAST.get(figure.name, 0.0))
            if value is None or value > FAR_FROM_BEST * best:
                bad.append(f'{figure.text} ({format_number(value, figure.digits, figure.scale)} '
                           f'{figure.unit})')
            elif value <= NEAR_BEST * best:
                good.append(figure.text)
        said.append(f'{name}: good at {", ".join(good) or "nothing above all"}'
                    + (f'; not at {", ".join(bad)}' if bad else '') + '.')
    return said
