"""What `multicontact study map` draws: the grid, and boundaries of loops of `force.margins`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
import math
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from multicontact_control.commissioning.arm_loop import ArmLoop, RATIOS
from multicontact_control.study.study import Results, Study
import numpy as np
import pandas as pd

RATIO = 'true / model stiffness'
DELAY = 'plant.actuator_delay_ticks'


class LinearLoop(NamedTuple):
    """
    A linear loop whose boundary of stability is drawn beside the simulated runs.

    The observer's gain goes with R, so the boundary does: it is drawn for an R as at rest and one
    as in motion.
    """

    name: str
    noise_variance: float  # R that is held, as at rest or in motion [N^2]
    of_paper: bool = False  # the plant of P04 eq. 32 alone, and not the arm's

    @property
    def label(self) -> str:
        """
        Return what sentences and the figure call it.

        Name and R [N^2] together: two of the `LINEAR_LOOPS` have one name. It is also the key of
        the loop's boundaries.
        """
        return f'{self.name} (R = {self.noise_variance:g} N²)'


LINEAR_LOOPS = (
    LinearLoop('The linear loop of the arm', 0.6),
    LinearLoop('The linear loop of the arm', 100.0),
    LinearLoop('The plant of eq. 32 alone', 0.6, of_paper=True),
)
STYLES = ('-', '--', ':')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale
Boundaries = Mapping[str, Mapping[int, float]]  # largest stable ratio by line and delay


class MapStudy(Study):
    """
    Overshoots over true by modelled stiffness, and delay of the actuator.

    Beside the simulated runs stand the boundaries at which the linear loops become unstable; these
    have neither noise nor friction, torque limits or a supervisor.
    """

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return where runs settle, and the boundaries of the linear loops.

        A loop that is stable over the whole range is given with the range's end, a ratio of 100.
        """
        sentences = super().describe_findings(results)
        for plant, boundaries in linear_boundaries(results).items():
            for name, ratios in boundaries.items():
                limits = []
                for delay, ratio in ratios.items():
                    limit = min(ratio, RATIOS[-1])
                    limits.append(f'{limit:.2f} with {delay}')
                sentences.append(
                    f'{name} is stable on {plant} up to {RATIO} = '
                    f'{", ".join(limits)} periods of delay.'
                )
        return sentences

    def draw_figure(self, results: Results) -> Figure:
        """
        Return the map of overshoots, a panel for each plant and estimator.

        Colours are logarithmic from 1 to 300 %; a cross marks a run that did not settle, and steps
        of lines are the boundaries, one for each delay.
        """
        groups = list(results.frame.groupby(['plant', 'estimator'], sort=False))
        columns = min(results.frame['estimator'].nunique(), 4)
        rows = math.ceil(len(groups) / columns)
        figure = Figure(
            figsize=(3.2 * columns + 1.2, 2.0 * rows + 1.0), layout='constrained'
        )
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        mesh: Any = None
        for axes in grid.flat[len(groups) :]:
            axes.set_axis_off()
        for axes, ((plant, label), runs) in zip(grid.flat, groups):
            mesh = _draw_overshoots(axes, runs, linear_boundaries(results)[plant])
            axes.set_title(f'{plant}: {label}', fontsize=9)
        figure.supylabel('delay [periods]', fontsize=8)
        figure.supxlabel(RATIO, fontsize=8)
        figure.colorbar(
            mesh, ax=grid, label='overshoot [%]', extend='max', format='{x:g}'
        )
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, names, loc='outside lower left', ncols=columns, fontsize=8
        )
        return figure


@lru_cache(maxsize=1)  # sentences and figure of a study show the same
def linear_boundaries(results: Results) -> Mapping[str, Boundaries]:
    """
    Return the boundaries of the `LINEAR_LOOPS` by plant, label and delay of the actuator.

    A boundary is the largest ratio of true and modelled stiffness at which the loop is stable. One
    cell of each plant and delay is enough, since no other factor enters the loop. The last answer
    is kept.
    """
    by_plant: dict[str, dict[str, dict[int, float]]] = {}
    cells = {}
    for cell in results.cells:
        cells[cell.factors['plant'], cell.factors[DELAY]] = cell
    for (plant, delay), cell in cells.items():
        arm_loop = ArmLoop(cell.job.setup())
        boundaries = by_plant.setdefault(plant, {})
        for linear in LINEAR_LOOPS:
            ratios = boundaries.setdefault(linear.label, {})
            ratios[delay] = arm_loop.largest_stable_ratio(
                linear.noise_variance, of_paper=linear.of_paper
            )
    return by_plant


def _draw_overshoots(axes: Axes, runs: pd.DataFrame, boundaries: Boundaries) -> Any:
    """Draw the overshoots of settled runs and the boundaries; return the coloured mesh."""
    overshoot = runs['overshoot_percent'].where(runs['settled']).astype(float)
    table = runs.assign(shown=overshoot.clip(lower=1.0)).pivot(
        index=DELAY, columns=RATIO, values='shown'
    )
    ratios = table.columns.to_numpy(float)
    delays = table.index.to_numpy(float)
    middles = np.sqrt(ratios[:-1] * ratios[1:])
    first_edge = ratios[0] ** 2 / middles[0]
    last_edge = ratios[-1] ** 2 / middles[-1]
    levels = np.append(delays, delays[-1] + 1.0) - 0.5
    edges = np.concatenate([[first_edge], middles, [last_edge]])
    mesh = axes.pcolormesh(
        edges,
        levels,
        table.to_numpy(),
        cmap='viridis_r',
        norm=LogNorm(1.0, LARGEST_OVERSHOOT),
    )
    unsettled = runs[~runs['settled']]
    axes.plot(
        unsettled[RATIO],
        unsettled[DELAY],
        'x',
        color='#c0262d',
        markersize=4,
        label='simulated: not settled',
    )
    for (name, largest), style in zip(boundaries.items(), STYLES):
        limits = [largest[int(delay)] for delay in delays]
        axes.plot(
            np.repeat(limits, 2),
            np.repeat(levels, 2)[1:-1],
            style,
            color='black',
            linewidth=1.6,
            label=name,
        )
    axes.set_xscale('log')
    axes.xaxis.set_major_formatter('{x:g}')
    axes.set_yticks(delays)
    return mesh
