"""The figure of the robustness map."""

from __future__ import annotations

import math
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
import numpy as np

matplotlib.use('Agg')

COLOURS = ('#1f3b73', '#c26a00', '#777777')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale


def draw_map(content: dict[str, Any]) -> Figure:
    """Return the map, a panel for each plant and estimator."""
    plants, labels = content['plants'], content['estimators']
    columns = min(len(labels), 4)
    lines = math.ceil(len(labels) / columns)
    figure = Figure(figsize=(3.2 * columns + 1.2, 2.0 * lines * len(plants) + 1.0),
                    layout='constrained')
    grid = np.atleast_1d(figure.subplots(
        lines * len(plants), columns, sharex=True, sharey=True, squeeze=False))
    mesh: Any = None
    for number, plant in enumerate(plants):
        for i in range(lines * columns):
            axes = grid[number * lines + i // columns, i % columns]
            if i >= len(labels):
                axes.set_axis_off()
                continue
            mesh = _panel(axes, content, plant, labels[i])
            axes.set_title(f'{plant}: {labels[i]}', fontsize=9)
            if i % columns == 0:
                axes.set_ylabel('delay [periods]', fontsize=8)
    for axes in grid[-1]:
        axes.set_xlabel('true / model stiffness', fontsize=8)
    figure.colorbar(mesh, ax=grid, label='overshoot [%]', extend='max')
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc='outside lower center', ncols=3, fontsize=8)
    return figure


def _panel(axes: Axes, content: dict[str, Any], plant: str, label: str) -> Any:
    ratios, delays = content['ratios'], content['delays']
    overshoot = np.full((len(delays), len(ratios)), np.nan)
    unstable = []
    for point in content['points']:
        if (point['plant'], point['estimator']) != (plant, label):
            continue
        where = delays.index(point['delay_ticks']), ratios.index(point['ratio'])
        if point['stable'] and point['overshoot_percent'] is not None:
            overshoot[where] = max(point['overshoot_percent'], 1.0)
        if not point['stable']:
            unstable.append((point['ratio'], point['delay_ticks']))
    edges = np.sqrt(np.array(ratios[:-1]) * np.array(ratios[1:]))
    edges = np.concatenate([[ratios[0] ** 2 / edges[0]], edges, [ratios[-1] ** 2 / edges[-1]]])
    levels = np.array([*delays, delays[-1] + 1]) - 0.5
    mesh = axes.pcolormesh(edges, levels, overshoot, cmap='viridis_r',
                           norm=LogNorm(1.0, LARGEST_OVERSHOOT))
    axes.set_facecolor('#f3dcdc')
    axes.plot(*(zip(*unstable) if unstable else ((), ())), 'x', color='#c0262d', markersize=4,
              label='simulated: not settled')
    for line, colour in zip(content['linear'][plant], COLOURS):
        limits = [np.nan if limit is None else limit for limit in line['largest_ratio']]
        axes.plot(np.repeat(limits, 2), np.repeat(levels, 2)[1:-1], color=colour, linewidth=1.6,
                  label=line['label'])
    axes.set_xscale('log')
    axes.set_yticks(delays)
    return mesh
