"""The grid of a law's gains on one seed, the best of them, and how it does on other seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
import math
from pathlib import Path
from typing import Any

from multicontact_control.config import merge, read_yaml
from multicontact_control.errors import check_all, ConfigError, RunError
from multicontact_control.experiment.law_report import write_preset
from multicontact_control.experiment.overrides import overrides_of
from multicontact_control.experiment.scenario import plant_source, preset_values
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.laws.jobs import (
    LawJob,
    run_law_job,
    TASK,
)
from multicontact_control.experiment.study.presets.laws.results import law_rows
from multicontact_control.experiment.study.study import Study
from multicontact_control.experiment.study.table import Column, Line, Listing
from multicontact_control.paths import config_dir
from multicontact_control.wording import counted

TUNED_ON = 0  # seed
JUDGED_ON = (1, 2, 3)
SHOWN = 12  # combinations in the table
# What each figure is divided by before they are added: about what the best laws reach.
SCALES = {'rest_rms_n': 0.05, 'moving_rms_n': 0.65, 'rise_s': 0.04, 'overshoot_percent': 8.0,
          'push_peak_n': 0.6, 'activity_nm': 0.3}
FIGURES = ('rest_rms_n', 'moving_rms_n', 'rise_s', 'overshoot_percent', 'push_peak_n',
           'activity_nm')


def read_ranges(law: str) -> dict[str, list[Any]]:
    """Return what is tried for a law, by dotted name; ConfigError if nothing is declared."""
    path = config_dir() / 'tuning.yaml'
    ranges = read_yaml(path)
    if law not in ranges:
        raise ConfigError('law', f'one of {", ".join(ranges)} ({path.name})', f"'{law}'")
    found: dict[str, list[Any]] = ranges[law]
    return found


def cost(row: Mapping[str, Any]) -> float:
    """Return the sum of a row's figures over their scales; infinite if it is not stable."""
    if row['stable'] < row['runs'] or any(row[name] is None for name in SCALES):
        return math.inf
    return float(sum(row[name] / scale for name, scale in SCALES.items()))


@dataclass(frozen=True)
class TuneStudy(Study[LawJob, list[dict[str, Any]]]):
    """
    Every combination of a law's declared gains, on one seed.

    Attributes
    ----------
    law
        As in config/tuning.yaml.
    plants
        On which it is tried; the worst counts.

    """

    law: str
    plants: tuple[str, ...] = ('',)

    title = 'tune'
    name = 'tuning'
    measure = staticmethod(run_law_job)
    takes_long = True

    @property
    def preset(self) -> str:
        """Return what the gains are laid over."""
        return 'best' if self.law == 'aob' else f'laws/{self.law}'

    def folder(self) -> Path:
        """Return a folder of the law's own."""
        return Path('runs') / f'tune-{self.law}'

    def check(self) -> None:
        """Check law and plants; ConfigError with all that are not acceptable."""
        check_all(lambda: read_ranges(self.law), lambda: [*map(plant_source, self.plants)])

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return the ranges, and plants and seed."""
        return {**read_ranges(self.law), 'plants': self.plants, 'seeds': (TUNED_ON,)}

    def jobs(self) -> list[LawJob]:
        """Return a run for each combination on each plant."""
        ranges = read_ranges(self.law)
        return [LawJob(self.preset, plant, TUNED_ON, TASK, settings=tuple(
            zip(ranges, values))) for values in product(*ranges.values())
            for plant in self.plants]

    def further(self, run: JobRun[LawJob]) -> list[LawJob]:
        """Return the runs of the best combination on other seeds."""
        return self._judging(self._combinations(run)[0])

    def _judging(self, best: Mapping[str, Any]) -> list[LawJob]:
        """Return the runs that the best combination is judged by, none if it is not stable."""
        if best['cost'] is None:
            return []
        job = next(job for job in self.jobs() if dict(job.settings) == best['settings'])
        return [replace(job, plant=plant, seed=seed)
                for plant in self.plants for seed in JUDGED_ON]

    def content(self, run: JobRun[LawJob]) -> list[dict[str, Any]]:
        """
        Return every combination by its cost, the least first.

        The figures of the first, if it is stable, on other seeds are `judged`.
        """
        found = self._combinations(run)
        judging = self._judging(found[0])
        if judging:
            found[0]['judged'] = [dict(row) for row in law_rows(
                run.kept(judging), lambda job: run.result(job).metrics)]
        return found

    def _combinations(self, run: JobRun[LawJob]) -> list[dict[str, Any]]:
        """Return every combination without lost runs by its cost; RunError if there is none."""
        combinations: dict[tuple[Any, ...], list[LawJob]] = {}
        for job in self.jobs():
            combinations.setdefault(job.settings, []).append(job)
        found = []
        for settings, jobs in combinations.items():
            if any(job in run.lost for job in jobs):
                continue  # the worst of its plants may be the one that is not known
            rows = law_rows(jobs, lambda job: run.result(job).metrics)
            worst = max(rows, key=cost)
            found.append({'settings': dict(settings), 'cost': cost(worst), **worst})
        if not found:
            raise RunError(f'{self.title}: expected a combination with results on every plant, '
                           f'found {len(run.lost)} of {len(run.keys)} jobs lost')
        found.sort(key=lambda row: row['cost'])
        for row in found:
            row['cost'] = None if math.isinf(row['cost']) else row['cost']
        return found

    def tables(
        self, content: list[dict[str, Any]], run: JobRun[LawJob],
    ) -> Mapping[str, Any]:
        """Return ``tuning.json``; a parameter file with the best gains is written beside it."""
        if content[0]['cost'] is not None:
            setup = next(iter(self.jobs())).setup()
            given = overrides_of(content[0]['settings'], setup, 'settings')
            write_preset(
                merge(preset_values(self.preset), given), run.folder / f'{self.law}.yaml',
                f'{self.law}, tuned on seed {TUNED_ON} of {", ".join(self.plants)}')
        return {f'{self.name}.json': {'law': self.law, 'combinations': content}}

    def page(self, content: list[dict[str, Any]], folder: Path) -> Page:
        """Return the best combinations, and how the best one does on other seeds."""
        return Page(
            f'Gains of {self.law}', [Section('The best combinations', _listing(content))],
            introduction=[f'Tried on seed {TUNED_ON}; the cost is the sum of ' + ', '.join(
                f'{name} / {scale:g}' for name, scale in SCALES.items()) + '.'],
            findings=_findings(content, self.law))


def _listing(content: Sequence[Mapping[str, Any]]) -> Listing:
    names = list(content[0]['settings'])
    columns = [Column('cost'), *(Column(name, name.rpartition('.')[2]) for name in names),
               *(Column(name) for name in FIGURES)]
    lines = [Line([_no_cost(row) if row['cost'] is None else f'{row["cost"]:.2f}',
                   *(str(value) for value in row['settings'].values()),
                   *('-' if row[name] is None else f'{row[name]:.3g}' for name in FIGURES)],
                  row['cost'] is not None) for row in content[:SHOWN]]
    return Listing(columns, lines, verdict=0)


def _no_cost(row: Mapping[str, Any]) -> str:
    """Return why a combination has no cost: it is not stable, or it has not every figure."""
    if row['stable'] < row['runs']:
        return 'not stable'
    return 'without ' + ', '.join(name for name in SCALES if row[name] is None)


def _findings(content: Sequence[Mapping[str, Any]], law: str) -> list[str]:
    best = content[0]
    if best['cost'] is None:
        return [f'No combination of {law} is stable in the whole task and has every figure.']
    said = [f'{law}.yaml holds the best of {counted(len(content), "combinations")}.']
    for row in best.get('judged', ()):
        said.append(f'On other seeds, plant {row["plant"]}: stable in {row["stable"]} of '
                    f'{row["runs"]}, ' + ', '.join(
                        f'{name} {"-" if row[name] is None else format(row[name], ".3g")}'
                        for name in FIGURES) + '.')
    return said
