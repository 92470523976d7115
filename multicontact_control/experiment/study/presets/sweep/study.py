"""`multicontact sweep`: parameters times seeds, from a study's file to a table of summaries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from multicontact_control.experiment.judge import HELD
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.measure import summarise_run
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.sweep.config import read_study, study_path
from multicontact_control.experiment.study.presets.sweep.plan import plan_sweep, SweepPlan
from multicontact_control.experiment.study.presets.sweep.results import (
    chosen_metrics,
    draw_sweep,
    Row,
    row_of,
    sweep_listing,
    sweep_table,
)
from multicontact_control.experiment.study.study import Study
from multicontact_control.wording import counted
import pyarrow as pa

SHOWN = 40  # lines of the table over the seeds that still fit a terminal
NOTE = ('Every line stands for the runs that differ in their seed only: how many were stable, and '
        'the median of the stable ones; a star is the worst contact. Every single run is in '
        'sweep.parquet.')


@dataclass(frozen=True)
class SweepStudy(Study[RunJob, pa.Table]):
    """The runs of a study's file; made by `sweep_study`."""

    plan: SweepPlan

    title = 'sweep'
    name = 'sweep'
    measure = staticmethod(summarise_run)

    def folder(self) -> Path:
        """Return a folder that is called like the study."""
        return Path('runs') / f'sweep-{self.plan.study.name}'

    def headline(self) -> str:
        """Return how many combinations and seeds there are."""
        study, seeds = self.plan.study, len(self.plan.study.seeds)
        return (f'study {study.name}: {counted(len(self.plan.runs) // seeds, "combinations")} '
                f'with {counted(seeds, "seeds")}')

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return plants, seeds, and the values of every parameter that is swept."""
        return {'plants': self.plan.study.plants, 'seeds': self.plan.study.seeds, **{
            f'{name} [{unit}]' if unit else name:
            list(dict.fromkeys(run.values[name] for run in self.plan.runs))
            for name, unit in self.plan.units.items()}}

    def jobs(self) -> list[RunJob]:
        """Return the runs."""
        return [run.job for run in self.plan.runs]

    def content(self, run: JobRun[RunJob]) -> pa.Table:
        """Return the table: a row for each run, also for those that failed or were lost."""
        rows: list[Row] = []
        for job in self.jobs():
            lost = run.lost.get(job, '')
            row = row_of({}, lost) if lost else row_of(run.result(job).metrics)
            rows.append(row | {'key': run.keys[job]})
        return sweep_table(self.plan, rows)

    def tables(self, content: pa.Table, run: JobRun[RunJob]) -> Mapping[str, Any]:
        """Return the table, the wall times and the study."""
        # Wall times apart from the table, which shall be the same whatever ran it.
        walls = [{'run': one.number, 'key': run.keys[one.job],
                  'wall_s': f'{run.result(one.job).wall_time:.4f}'}
                 for one in self.plan.runs if one.job not in run.lost]
        return {'sweep.parquet': content, 'timings.csv': walls,
                'study.yaml': self.plan.study.model_dump(mode='json')}

    def page(self, content: pa.Table, folder: Path) -> Page:
        """Return the medians over the seeds, and the picture of them."""
        study = self.plan.study
        metrics, missing = chosen_metrics(content, study.figures)
        listing = sweep_listing(self.plan, content, metrics)
        return Page(
            f'Sweep {study.name}',
            [Section(f'{study.name}: stable runs and their medians over the seeds', listing,
                     in_terminal=len(listing.lines) <= SHOWN,
                     before=f'<p class=note>{NOTE}</p>')],
            introduction=[study.description,
                          f'{counted(len(self.plan.runs), "runs")} of the scenario '
                          f'{study.scenario}, '
                          f'{len(study.seeds)} with each combination.'],
            warnings=[f'figures: the table has no numbers under {name}' for name in missing],
            findings=[_counts(content)],
            figure=draw_sweep(self.plan, content, metrics) if metrics else None)


def sweep_study(
    name: str, seeds: tuple[int, ...] | None = None, robot: str = '',
) -> SweepStudy:
    """
    Return the study of a file.

    Parameters
    ----------
    name
        Name of a file in config/studies, or a path.
    seeds
        Instead of the study's; None for those.
    robot
        Instead of the study's; empty for that.

    """
    path = study_path(name)
    return SweepStudy(plan_sweep(read_study(path, seeds=seeds, robot=robot), str(path)))


def _counts(table: pa.Table) -> str:
    stable = sum(table['stable'].to_pylist())
    ended = sum(error is not None for error in table['error'].to_pylist())
    held = table['verdict'].to_pylist().count(HELD)
    return (f'{counted(table.num_rows, "runs")}: {stable} stable, {table.num_rows - stable} not, '
            f'of which {ended} ended early and {held} were held by the supervisor')
