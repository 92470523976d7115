"""What `multicontact study map` draws: the grid, and the boundaries of the linear loops."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.presets.boundaries import arm_loop, ARM_RATIOS
from multicontact_control.experiment.study.study import Results, Study
import numpy as np
import pandas as pd

RATIO, DELAY = 'true / model stiffness', 'plant.actuator_delay_ticks'
VARIANCES = (0.6, 100.0)  # N^2, of the linear boundaries: at rest and in motion
COLOURS = ('#1f3b73', '#c26a00', '#777777')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale
Boundaries = Mapping[str, Mapping[int, float]]  # largest stable ratio by line and delay


class MapStudy(Study):
    """True stiffness over that of the model, and delay of the actuator."""

    @cached_property
    def boundaries(self) -> Mapping[str, Boundaries]:
        """Return the boundaries of the linear loops by plant: with R held, and of eq. 32 alone."""
        found: dict[str, dict[str, dict[int, float]]] = {}
        for cell in self.cells():
            plant, delay = cell.factors['plant'], cell.factors[DELAY]
            lines = found.setdefault(plant, {})
            if any(delay in line for line in lines.values()) or not isinstance(cell.job, RunJob):
                continue
            loop = arm_loop(cell.job.setup())
            for variance in VARIANCES:
                lines.setdefault(f'linear loop of the arm, R = {variance:g} N²', {})[delay] = (
                    loop.boundary(variance))
            lines.setdefault(f'eq. 32 alone, R = {VARIANCES[0]:g} N²', {})[delay] = (
                loop.paper_boundary(VARIANCES[0]))
        return found

    def findings(self, results: Results) -> list[str]:
        """Return how many runs settle, and the boundaries of the linear loops."""
        return [*super().findings(results), *(
            f'Plant {plant}, {name}: stable up to ' + ', '.join(
                f'{ARM_RATIOS[-1] if math.isinf(ratio) else ratio:.2f} (delay {delay})'
                for delay, ratio in line.items()) + '.'
            for plant, lines in self.boundaries.items() for name, line in lines.items())]

    def figure(self, results: Results) -> Figure:
        """
        Return the map, a panel for each plant and estimator.

        Squares are overshoots, crosses what does not settle, lines the linear boundaries.
        """
        groups = list(results.frame.groupby(['plant', 'estimator'], sort=False))
        columns = min(results.frame['estimator'].nunique(), 4)
        lines = math.ceil(len(groups) / columns)
        figure = Figure(figsize=(3.2 * columns + 1.2, 2.0 * lines + 1.0), layout='constrained')
        grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
        mesh: Any = None
        for axes in grid.flat[len(groups):]:
            axes.set_axis_off()
        for axes, ((plant, label), frame) in zip(grid.flat, groups):
            mesh = _panel(axes, frame, self.boundaries[plant])
            axes.set_title(f'{plant}: {label}', fontsize=9)
        for axes in grid[:, 0]:
            axes.set_ylabel('delay [periods]', fontsize=8)
        for axes in grid[-1]:
            axes.set_xlabel(RATIO, fontsize=8)
        figure.colorbar(mesh, ax=grid, label='overshoot [%]', extend='max')
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc='outside lower center', ncols=3, fontsize=8)
        return figure


def _panel(axes: Axes, frame: pd.DataFrame, boundaries: Boundaries) -> Any:
    worst = frame['overshoot_percent'].where(frame['settled']).astype(float).clip(lower=1.0)
    table = frame.assign(worst=worst).pivot(index=DELAY, columns=RATIO, values='worst')
    ratios, delays = table.columns.to_numpy(float), table.index.to_numpy(float)
    edges = np.sqrt(ratios[:-1] * ratios[1:])
    edges = np.concatenate([[ratios[0] ** 2 / edges[0]], edges, [ratios[-1] ** 2 / edges[-1]]])
    levels = np.append(delays, delays[-1] + 1.0) - 0.5
    mesh = axes.pcolormesh(edges, levels, table.to_numpy(), cmap='viridis_r',
                           norm=LogNorm(1.0, LARGEST_OVERSHOOT))
    axes.set_facecolor('#f3dcdc')
    unstable = frame[~frame['settled']]
    axes.plot(unstable[RATIO], unstable[DELAY], 'x', color='#c0262d', markersize=4,
              label='simulated: not settled')
    for (name, line), colour in zip(boundaries.items(), COLOURS):
        limits = [line[int(delay)] for delay in delays]
        axes.plot(np.repeat(limits, 2), np.repeat(levels, 2)[1:-1], color=colour, linewidth=1.6,
                  label=name)
    axes.set_xscale('log')
    axes.set_yticks(delays)
    return mesh
