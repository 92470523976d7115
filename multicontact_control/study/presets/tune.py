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
from multicontact_control.study.cells import Cell, seeded
from multicontact_control.study.config import FactorConfig, StudyConfig
from multicontact_control.study.study import Results, Study
import pandas as pd

JUDGED, JUDGED_ON = 'on other seeds', (1, 2, 3)
# What each figure is divided by before they are added.
SCALES = {
    'rest_rms_n': 0.05,
    'moving_rms_n': 0.65,
    'rise_s': 0.04,
    'overshoot_percent': 8.0,
    'push_peak_n': 0.6,
    'activity_nm': 0.3,
}


def cost(row: Mapping[str, Any]) -> float:
    """Return the sum of a run's figures over their scales; infinite if it is not stable."""
    total = sum(row[name] / scale for name, scale in SCALES.items())
    return float(total) if row['stable'] and total == total else math.inf


class TuneStudy(Study):
    """Every combination of a law's declared gains, on one seed."""

    def __init__(self, config: StudyConfig) -> None:
        ranges = read_yaml(find_config_folder() / 'tuning.yaml')
        if config.law not in ranges:
            raise ConfigError(
                'law', f'one of {", ".join(ranges)} (tuning.yaml)', f"'{config.law}'"
            )
        self.gains = list(ranges[config.law])
        self.preset = 'best' if config.law == 'aob' else f'laws/{config.law}'
        gains = {
            name: FactorConfig(values=tuple(values))
            for name, values in ranges[config.law].items()
        }
        super().__init__(
            config.model_copy(
                update={
                    'name': f'tune-{config.law}',
                    'parts': {
                        title: part.model_copy(
                            update={
                                'preset': self.preset,
                                'factors': {**gains, **part.factors},
                            }
                        )
                        for title, part in config.parts.items()
                    },
                }
            )
        )

    def complete(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the table with the cost of each run, by that of the worst plant, least first."""
        frame = frame.assign(
            cost=[
                cost(row)
                for row in frame[['stable', *SCALES]].astype(float).to_dict('records')
            ]
        )
        worst = frame.groupby(['part', *self.gains])['cost'].transform('max')
        return (
            frame.assign(rank=worst, last=frame['part'] == JUDGED)
            .sort_values(['last', 'rank'], kind='stable', ignore_index=True)
            .drop(columns=['last', 'rank'])
        )

    def _best(self, frame: pd.DataFrame) -> dict[str, Any] | None:
        """Return the gains with the least cost, None if no combination is stable."""
        best = {name: frame[name].tolist()[0] for name in self.gains}
        runs = frame[(frame[self.gains] == pd.Series(best)).all(axis=1)]
        return best if (runs['cost'] < math.inf).all() else None

    def further(self, results: Results) -> list[Cell]:
        """Return the runs of the best combination on other seeds, none if it is not stable."""
        best, cells = self._best(results.frame), []
        for factors, job, _ in results.cells:
            if best == {name: factors[name] for name in self.gains}:
                cells += seeded({**factors, 'part': JUDGED}, job, JUDGED_ON)
        return cells

    def write(self, results: Results, folder: Path) -> None:
        """Write the best gains as a parameter file, beside the files of every study."""
        super().write(results, folder)
        best, first, law = self._best(results.frame), results.cells[0], self.config.law
        if best:
            plants = ', '.join(results.frame['plant'].unique())
            write_preset(
                merge(
                    preset_values(self.preset),
                    nest_overrides(best, first.job.setup(), 'gains.'),
                ),
                folder / f'{law}.yaml',
                f'{law}, tuned on seed {first.factors["seed"]} of {plants}',
            )

    def findings(self, results: Results) -> list[str]:
        """Return what the best gains are."""
        best, law = self._best(results.frame), self.config.law
        return [
            f'{law}.yaml holds the best: '
            + ', '.join(f'{name} = {value:g}' for name, value in best.items())
            + '.'
            if best
            else f'All combinations of {law} are unstable in the task, or lack a figure.',
            *super().findings(results),
        ]
