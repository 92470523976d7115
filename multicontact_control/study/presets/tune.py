"""The grid of a law's gains on one seed, the best of them, and how it does on other seeds."""

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

ON_OTHER_SEEDS = 'on other seeds'  # part
OTHER_SEEDS = (1, 2, 3)
# What each figure is divided by before they are added.
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

    A run without one of the figures costs infinitely much, too. Each scale is what the best laws
    reach, so that no figure outweighs the others (docs/force_laws.md).
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
            self.preset = 'best'
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
        Return the table with the cost of each run, by that of the worst plant, least first.

        So the first row has the best gains. Runs on other seeds come last, where they cannot
        decide.
        """
        rows = frame[['stable', *SCALES]].astype(float).to_dict('records')
        frame = frame.assign(cost=list(map(cost_of_run, rows)))
        costs = frame.groupby(['part', *self.gains])['cost']
        ranked = frame.assign(
            rank=costs.transform('max'), last=frame['part'] == ON_OTHER_SEEDS
        )
        ordered = ranked.sort_values(['last', 'rank'], kind='stable', ignore_index=True)
        return ordered.drop(columns=['last', 'rank'])

    def _find_best_gains(self, frame: pd.DataFrame) -> dict[str, Any] | None:
        """Return the gains with the least cost, None if no combination is stable."""
        best: dict[str, Any]
        (best,) = frame[self.gains].head(1).to_dict('records')
        runs = frame[(frame[self.gains] == pd.Series(best)).all(axis=1)]
        if (runs['cost'] < math.inf).all():
            return best
        return None

    def plan_further_cells(self, results: Results) -> list[Cell]:
        """
        Return the runs of the best combination on other seeds, none if it is not stable.

        A gain that is best for one realisation of the noise alone shows there. They run on every
        plant, with seeds 1, 2 and 3.
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
            gains = [f'{name} = {value:g}' for name, value in best.items()]
            finding = f'{law}.yaml holds the best: {", ".join(gains)}.'
        return [finding, *super().describe_findings(results)]
