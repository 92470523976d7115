"""The grid of a law's gains on one seed, the best of them, and how it does on other seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

from multicontact_control.config import merge, read_yaml
from multicontact_control.errors import ConfigError, counted
from multicontact_control.experiment.law_report import write_preset
from multicontact_control.experiment.overrides import overrides_of
from multicontact_control.experiment.scenario import preset_values
from multicontact_control.experiment.study.cells import Cell
from multicontact_control.experiment.study.config import FactorConfig, StudyConfig
from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.study import Results, Study
from multicontact_control.experiment.study.table import Listing, listing_of
from multicontact_control.paths import config_dir
import pandas as pd

JUDGED, JUDGED_ON = 'on other seeds', (1, 2, 3)
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
    """Return the sum of a run's figures over their scales; infinite if it is not stable."""
    total = sum(row[name] / scale for name, scale in SCALES.items())
    return float(total) if row['stable'] and total == total else math.inf


class TuneStudy(Study):
    """Every combination of a law's declared gains, on one seed."""

    def __init__(self, config: StudyConfig) -> None:
        self.preset = 'best' if config.law == 'aob' else f'laws/{config.law}'
        gains = {name: FactorConfig(values=tuple(values))
                 for name, values in read_ranges(config.law).items()}
        super().__init__(config.model_copy(update={
            'name': f'tune-{config.law}', 'parts': {
                title: part.model_copy(update={
                    'preset': self.preset, 'factors': {**gains, **part.factors}})
                for title, part in config.parts.items()}}))
        self.gains = list(gains)

    def complete(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the table with the cost of each run."""
        costs = frame.apply(lambda row: cost(row.fillna(math.nan)), axis=1)
        return frame.assign(cost=costs)

    def _ranking(self, frame: pd.DataFrame) -> pd.Series:
        """Return the cost of each combination on the worst plant, by its gains, least first."""
        tried = frame[frame['part'] != JUDGED]
        return tried.groupby(self.gains, sort=False)['cost'].max().sort_values(kind='stable')

    def _best(self, frame: pd.DataFrame) -> dict[str, Any] | None:
        ranking = self._ranking(frame)
        if math.isinf(ranking.iloc[0]):
            return None
        gains = ranking.index[0]
        return dict(zip(self.gains, gains if isinstance(gains, tuple) else (gains,)))

    def further(self, results: Results) -> list[Cell]:
        """Return the runs of the best combination on other seeds, none if it is not stable."""
        best = self._best(results.frame)
        if best is None:
            return []
        jobs = [(cell.factors, replace(cell.job, seed=seed)) for cell in self.cells()
                if isinstance(cell.job, RunJob)
                and all(cell.factors[name] == value for name, value in best.items())
                for seed in JUDGED_ON]
        return [Cell({**factors, 'part': JUDGED, 'seed': job.seed}, job, job.key())
                for factors, job in jobs]

    def listing(self, results: Results) -> Listing:
        """Return the best combinations, and the very best on other seeds."""
        frame = results.frame
        places = {gains: i for i, gains in enumerate(self._ranking(frame).index[:SHOWN])}
        keys = frame[self.gains].apply(
            lambda row: tuple(row) if len(row) > 1 else row.iloc[0], axis=1)
        shown = frame[keys.isin(places)].assign(place=keys.map(places))
        return listing_of(shown.sort_values('place', kind='stable'), self.config)

    def write_further(self, results: Results) -> None:
        """Write the best gains as a parameter file."""
        best, law = self._best(results.frame), self.config.law
        job = self.cells()[0].job
        if best is not None and isinstance(job, RunJob):
            plants = ', '.join(results.frame['plant'].unique())
            write_preset(
                merge(preset_values(self.preset), overrides_of(best, job.setup(), 'gains')),
                results.folder / f'{law}.yaml', f'{law}, tuned on seed {job.seed} of {plants}')

    def findings(self, results: Results) -> list[str]:
        """Return where the best gains are, and how they do on other seeds."""
        frame, law = results.frame, self.config.law
        if self._best(frame) is None:
            return [f'All combinations of {law} are unstable in the task, or lack a figure.']
        found = [f'{law}.yaml holds the best of '
                 f'{counted(len(self._ranking(frame)), "combinations")}.']
        for plant, runs in frame[frame['part'] == JUDGED].groupby('plant', sort=False):
            figures = runs[list(SCALES)].astype(float).median()
            found.append(f'On other seeds, plant {plant}: stable in {int(runs["stable"].sum())} '
                         f'of {len(runs)}, ' + ', '.join(
                             f'{name} {value:.3g}' for name, value in figures.items()) + '.')
        return found
