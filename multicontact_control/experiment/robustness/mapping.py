"""The robustness map: its cells, its table, its figure and its page."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
import math
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from multicontact_control.experiment.engine import Executor, run_cells, RunCell
from multicontact_control.experiment.html import image, table, write_page
from multicontact_control.experiment.measure import measure_cell
from multicontact_control.experiment.results import finite, write_json
from multicontact_control.experiment.robustness.boundaries import (
    DELAYS,
    linear_boundaries,
    map_cell,
    verdict,
)
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

matplotlib.use('Agg')

MAP_FILE = 'robustness.json'
MAP_FIGURE = 'robustness.png'
MAP_PAGE = 'robustness.html'
VARIANCES = (0.6, 100.0)  # N^2, of the linear boundaries: at rest and in motion
COLOURS = ('#1f3b73', '#c26a00', '#777777')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale
EXPLANATION = (
    'Each square is one simulated force step at rest, with the true stiffness of both surfaces '
    'over that of the model along the bottom and the delay of the '
    'actuator in periods of 2 ms upwards; the model keeps its T_d. Colour: the largest overshoot; '
    'crosses: not settled within 10 % of the command at the end. Lines: the boundary of the '
    'linear loop with R held, which knows neither loss of contact nor the flexible drives.')

Key = tuple[str, str, float, int]


@dataclass(frozen=True)
class MapLayout:
    """
    What is mapped.

    Attributes
    ----------
    plants, labels
        A panel each: plants downwards, estimators across.
    ratios
        True stiffness over the model's.
    delays
        Of the actuator [periods].

    """

    plants: tuple[str, ...]
    labels: tuple[str, ...]
    ratios: tuple[float, ...]
    delays: tuple[int, ...] = DELAYS

    def cells(self) -> dict[Key, RunCell]:
        """Return the runs by plant, estimator, ratio and delay."""
        return {(plant, label, ratio, delay): map_cell(ratio, delay, label, plant=plant)
                for plant in self.plants for label in self.labels
                for ratio in self.ratios for delay in self.delays}


def run_map(
    layout: MapLayout, folder: Path, *, executor: Executor | None = None,
    console: Console | None = None,
) -> dict[str, Any]:
    """Run a map and write ``robustness.json``; the arguments are those of `run_cells`."""
    cells = layout.cells()
    run = run_cells(list(cells.values()), folder, measure_cell, executor=executor,
                    console=console, title='map')
    points = []
    for (plant, label, ratio, delay), cell in cells.items():
        stable, overshoot = verdict(run.result(cell).metrics)
        points.append({'plant': plant, 'estimator': label, 'ratio': ratio, 'delay_ticks': delay,
                       'stable': stable, 'overshoot_percent': overshoot, 'key': run.keys[cell]})
    content = finite({
        'schema': 1, 'plants': layout.plants, 'estimators': layout.labels,
        'ratios': layout.ratios, 'delays': layout.delays, 'points': points,
        'linear': {plant: linear_boundaries(plant, layout.delays, VARIANCES)
                   for plant in layout.plants}})
    write_json(folder / MAP_FILE, content)
    return content


def stable_range(
    content: dict[str, Any], plant: str, label: str, delay: int,
) -> tuple[float, float] | None:
    """Return the smallest and largest stable ratio around 1, None if there is none."""
    known = sorted((point['ratio'], point['stable']) for point in content['points']
                   if (point['plant'], point['estimator'], point['delay_ticks'])
                   == (plant, label, delay))
    nearest = min(range(len(known)), key=lambda i: abs(math.log(known[i][0])))
    if not known[nearest][1]:
        return None
    low = high = nearest
    while low > 0 and known[low - 1][1]:
        low -= 1
    while high + 1 < len(known) and known[high + 1][1]:
        high += 1
    return known[low][0], known[high][0]


def _cells(content: dict[str, Any], plant: str) -> list[list[str]]:
    rows = []
    for label in content['estimators']:
        row = [label]
        for delay in content['delays']:
            found = stable_range(content, plant, label, delay)
            row.append('none' if found is None else f'{found[0]:g} - {found[1]:g}')
        rows.append(row)
    for line in content['linear'][plant]:
        rows.append([line['label'], *(
            'up to ' + ('100' if limit is None else f'{limit:.2f}')
            for limit in line['largest_ratio'])])
    return rows


def map_table(content: dict[str, Any], plant: str) -> Table:
    """Return the stable ranges of one plant for the terminal."""
    shown = Table(title=f'plant {plant}: true/model stiffness that is stable, on the grid',
                  box=SIMPLE_HEAD)
    shown.add_column('')
    for delay in content['delays']:
        shown.add_column(f'delay {delay}', justify='right')
    for row in _cells(content, plant):
        shown.add_row(*row)
    return shown


def write_map(content: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the map as PNG and write its page."""
    drawn = draw_map(content)
    png = folder / MAP_FIGURE
    drawn.savefig(png, dpi=130)
    page = folder / MAP_PAGE
    write_page(page, 'How wrong stiffness and delay may be', map_section(content, png))
    return [png, page]


def map_section(content: dict[str, Any], png: Path) -> str:
    """Return figure and tables as HTML."""
    parts = [f'<p>{escape(EXPLANATION)}</p>', image(png, 'Robustness map')]
    for plant in content['plants']:
        parts.append(f'<h2>Stable true/model stiffness, plant {escape(plant)}</h2>')
        parts.append(table(
            ('', *(f'delay {delay}' for delay in content['delays'])),
            [[escape(cell) for cell in row] for row in _cells(content, plant)]))
    return '\n'.join(parts)


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
