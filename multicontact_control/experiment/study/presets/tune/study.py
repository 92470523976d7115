"""The grid of a law's gains on one seed, the best of them, and how it does on other seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
import math
from pathlib import Path
from typing import Any

from multicontact_control.config import merge, read_yaml
from multicontact_control.errors import check_all, ConfigError, counted
from multicontact_control.experiment.law_report import write_preset
from multicontact_control.experiment.overrides import overrides_of
from multicontact_control.experiment.scenario import plant_source, preset_values
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.laws.jobs import LawJob, run_law_job, TASK
from multicontact_control.experiment.study.presets.laws.study import law_rows
from multicontact_control.experiment.study.study import Study
from multicontact_control.experiment.study.table import Column, format_number, Line, Listing
from multicontact_control.files import finite
from multicontact_control.paths import config_dir

TUNED_ON = 0  # seed
JUDGED_ON = (1, 2, 3)
SHOWN = 12  # combinations in the table
# What each figure is divided by before they are added.
SCALES = {'rest_rms_n': 0.05, 'moving_rms_n': 0.65, 'rise_s': 0.04, 'overshoot_percent': 8.0,
          'push_peak_n': 0.6, 'activity_nm': 0.3}


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
    """Every combination of a law's declared gains, on one seed."""

    law: str  # as in config/tuning.yaml
    plants: tuple[str, ...] = ('',)  # the worst counts

    title = 'tune'
    name = 'tuning'
    measure = staticmethod(run_law_job)

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
        """Return the runs of the best combination on other seeds, none if it is not stable."""
        best = self._combinations(run)[0]
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
        judging = self.further(run)
        if judging:
            found[0]['judged'] = [dict(row) for row in law_rows(judging, run.metrics)]
        return found

    def _combinations(self, run: JobRun[LawJob]) -> list[dict[str, Any]]:
        """Return every combination by its cost on the worst plant, None if it has none."""
        combinations: dict[tuple[Any, ...], list[LawJob]] = {}
        for job in self.jobs():
            combinations.setdefault(job.settings, []).append(job)
        found = []
        for settings, jobs in combinations.items():
            worst = max(law_rows(jobs, run.metrics), key=cost)
            found.append({'settings': dict(settings), 'cost': cost(worst), **worst})
        found.sort(key=lambda row: row['cost'])
        return [{**row, 'cost': finite(row['cost'])} for row in found]

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
               *(Column(name) for name in SCALES)]
    lines = [Line([_no_cost(row) if row['cost'] is None else format_number(row['cost'], 2),
                   *(str(value) for value in row['settings'].values()),
                   *(_figure(row, name) for name in SCALES)],
                  row['cost'] is not None) for row in content[:SHOWN]]
    return Listing(columns, lines, verdict=0)


def _no_cost(row: Mapping[str, Any]) -> str:
    """Return why a combination has no cost: it is not stable, or it has not every figure."""
    if row['stable'] < row['runs']:
        return 'not stable'
    return 'without ' + ', '.join(name for name in SCALES if row[name] is None)


def _figure(row: Mapping[str, Any], name: str) -> str:
    return '-' if row[name] is None else f'{row[name]:.3g}'


def _findings(content: Sequence[Mapping[str, Any]], law: str) -> list[str]:
    best = content[0]
    if best['cost'] is None:
        return [f'No combination of {law} is stable in the whole task and has every figure.']
    return [f'{law}.yaml holds the best of {counted(len(content), "combinations")}.', *(
        f'On other seeds, plant {row["plant"]}: stable in {row["stable"]} of {row["runs"]}, '
        + ', '.join(f'{name} {_figure(row, name)}' for name in SCALES) + '.'
        for row in best.get('judged', ()))]
