"""Tune a law: try each combination of its gains on one seed, judge the best on other seeds."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Any

from multicontact_control.commissioning.law_report import write_preset
from multicontact_control.config import merge, read_yaml
from multicontact_control.errors import ConfigError
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.overrides import nest_overrides
from multicontact_control.runs.scenario import preset_values
from multicontact_control.study.cells import Cell, cells_with_seeds
from multicontact_control.study.config import FactorConfig, StudyConfig
from multicontact_control.study.study import Results, Study
import pandas as pd

ON_OTHER_SEEDS = 'on other seeds'  # name of the part in which the best gains are judged
OTHER_SEEDS = (1, 2, 3)
# What each figure is divided by before they are added: about what a tuned law reaches here. The
# notes of config/studies/tune.yaml have the same numbers, for the page.
SCALES = {
    'rest_rms_n': 0.05,
    'moving_rms_n': 0.65,
    'rise_s': 0.04,
    'overshoot_percent': 8.0,
    'push_peak_n': 0.6,
    'activity_nm': 0.3,
}


def cost_of_run(row: Mapping[str, Any]) -> float:
    """
    Return the sum of a run's figures over their scales; infinite if it is not stable.

    A run without one of the figures costs infinitely much, too. Each scale is about what a
    tuned law reaches, so that no figure outweighs the others.
    """
    total = 0.0
    for name, scale in SCALES.items():
        total += row[name] / scale
    if not row['stable'] or math.isnan(total):
        return math.inf
    return total


class TuneStudy(Study):
    """
    Every combination of a law's declared gains, on one seed; the best are judged on others.

    The gains and their values are those of ``tuning.yaml``, laid over the law's preset, in every
    part of the study. The best is the combination whose worst plant costs least.
    """

    def __init__(self, config: StudyConfig) -> None:
        ranges = read_yaml(find_config_folder() / 'tuning.yaml')
        law = config.law
        if law not in ranges:
            raise ConfigError(
                'law', f'one of {", ".join(ranges)} (tuning.yaml)', f"'{law}'"
            )
        self.gains = list(ranges[law])
        self.preset = f'laws/{law}'
        if law == 'aob':
            self.preset = 'best'  # the tuned preset of the active observers
        gains = {}
        for name, values in ranges[law].items():
            gains[name] = FactorConfig(values=values)
        parts = {}
        for title, part in config.parts.items():
            changes = {'preset': self.preset, 'factors': {**gains, **part.factors}}
            parts[title] = part.model_copy(update=changes)
        super().__init__(
            config.model_copy(update={'name': f'tune-{law}', 'parts': parts})
        )

    def complete_table(self, frame: pd.DataFrame) -> pd.DataFrame:
        """
        Return the table with each run's cost, sorted by the worst cost among runs of equal gains.

        So the first row has the best gains. Runs on other seeds come last, where they cannot
        decide.
        """
        rows = frame[['stable', *SCALES]].astype(float).to_dict('records')
        frame = frame.assign(cost=list(map(cost_of_run, rows)))
        costs = frame.groupby(['part', *self.gains])['cost']
        ranked = frame.assign(
            worst_cost=costs.transform('max'),
            on_other_seeds=frame['part'] == ON_OTHER_SEEDS,
        )
        order = ['on_other_seeds', 'worst_cost']
        ordered = ranked.sort_values(order, kind='stable', ignore_index=True)
        return ordered.drop(columns=order)

    def _find_best_gains(self, frame: pd.DataFrame) -> dict[str, Any] | None:
        """
        Return the gains of the first row, where `complete_table` has put the best.

        They are None if one of their runs in the grid costs infinitely much; what they do on other
        seeds does not count.
        """
        grid = frame[frame['part'] != ON_OTHER_SEEDS]
        best: dict[str, Any]
        (best,) = grid[self.gains].head(1).to_dict('records')
        runs = grid[(grid[self.gains] == pd.Series(best)).all(axis=1)]
        if (runs['cost'] < math.inf).all():
            return best
        return None

    def plan_further_cells(self, results: Results) -> list[Cell]:
        """
        Return the runs of the best combination on `OTHER_SEEDS`, none if it is not stable.

        A gain that is best for one realisation of the noise alone shows there. They run on every
        plant.
        """
        best = self._find_best_gains(results.frame)
        cells = []
        for factors, job, _ in results.cells:
            gains = {name: factors[name] for name in self.gains}
            if gains == best:
                elsewhere = {**factors, 'part': ON_OTHER_SEEDS}
                cells += cells_with_seeds(elsewhere, job, OTHER_SEEDS)
        return cells

    def write_files(self, results: Results, folder: Path) -> None:
        """
        Write the best gains as a parameter file, beside the files of every study.

        It is the law's preset with the gains laid over it, `<law>.yaml`, which `--preset` takes as
        a path. Without a stable combination there is none.
        """
        super().write_files(results, folder)
        best = self._find_best_gains(results.frame)
        if best is None:
            return
        law = self.config.law
        first = results.cells[0]
        gains = nest_overrides(best, first.job.setup(), 'gains.')
        preset = merge(preset_values(self.preset), gains)
        plants = ', '.join(results.frame['plant'].unique())
        title = f'{law}, tuned on seed {first.factors["seed"]} of {plants}'
        write_preset(preset, folder / f'{law}.yaml', title)

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return what the best gains are, and what every study finds.

        Without a combination whose runs are all stable, and have all figures of `SCALES`, the
        sentence says so instead.
        """
        best = self._find_best_gains(results.frame)
        law = self.config.law
        if best is None:
            finding = (
                f'All combinations of {law} are unstable in the task, or lack a figure.'
            )
        else:
            gains = ', '.join(_write_gain(name, value) for name, value in best.items())
            finding = f'{law}.yaml holds the best: {gains}.'
        findings = [finding, *super().describe_findings(results)]
        refuted = self._list_refuting_seeds(results.frame)
        if refuted:
            seeds = ', '.join(map(str, refuted))
            findings.insert(1, f'They are unstable, or lack a figure, on seed {seeds}.')
        return findings

    def _list_refuting_seeds(self, frame: pd.DataFrame) -> list[int]:
        """Return the other seeds on which a run of the best gains costs infinitely much."""
        elsewhere = frame[frame['part'] == ON_OTHER_SEEDS]
        refuting = elsewhere[elsewhere['cost'] == math.inf]
        return sorted(refuting['seed'].unique().tolist())


def _write_gain(name: str, value: float | str) -> str:
    """Return a gain as `name = value`; a value may be the name of a choice."""
    if isinstance(value, str):
        return f'{name} = {value}'
    return f'{name} = {value:g}'
