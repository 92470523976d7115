"""`multicontact map`: how wrong stiffness and delay may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from multicontact_control.errors import check_all
from multicontact_control.experiment.claims import MATCHED
from multicontact_control.experiment.scenario import plants_of
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.measure import measure_run
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.compare.matrix import LABELS, name_checks
from multicontact_control.experiment.study.presets.robustness.boundaries import (
    ARM_RATIOS,
    DELAYS,
    linear_boundaries,
    map_job,
    ratios,
    SETTLED,
    verdict,
)
from multicontact_control.experiment.study.study import Study
from multicontact_control.experiment.study.table import Column, Line, Listing
from multicontact_control.files import finite
import numpy as np

MAP_LABELS = tuple(label for label in LABELS if label != MATCHED)  # those of one Q
QUICK_LABELS = ('lead_window', 'fixed')
RATIOS, QUICK_RATIOS = 13, 8  # how many
VARIANCES = (0.6, 100.0)  # N^2, of the linear boundaries: at rest and in motion
EXPLANATION = (
    'Each square is one simulated force step at rest, with the true stiffness of both surfaces '
    'over that of the model along the bottom and the delay of the '
    'actuator in control periods upwards; the model keeps its T_d. Colour: the largest overshoot; '
    f'crosses: not settled within {100.0 * SETTLED:g} % of the command at the end. Lines: the '
    'boundary of the linear loop with R held, which knows neither loss of contact nor the '
    'flexible drives.')
COLOURS = ('#1f3b73', '#c26a00', '#777777')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale

Point = tuple[str, str, float, int]


@dataclass(frozen=True)
class RobustnessStudy(Study[RunJob, dict[str, Any]]):
    """Plants, estimators, true stiffness over that of the model, and actuator delay."""

    plants: tuple[str, ...]
    estimators: tuple[str, ...]
    ratios: tuple[float, ...]
    delays: tuple[int, ...] = DELAYS  # periods

    title = 'map'
    name = 'robustness'
    measure = staticmethod(measure_run)

    def check(self) -> None:
        """Check plants and estimators; ConfigError with all that are not acceptable."""
        check_all(*name_checks(self.plants, self.estimators))

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return plants, estimators, ratios and delays: every combination is run."""
        return {'plants': self.plants, 'estimators': self.estimators,
                'stiffness ratios': self.ratios, 'delays': self.delays}

    def points(self) -> dict[Point, RunJob]:
        """Return the runs by plant, estimator, ratio and delay."""
        return {(plant, label, ratio, delay): map_job(ratio, delay, label, plant=plant)
                for plant in self.plants for label in self.estimators
                for ratio in self.ratios for delay in self.delays}

    def jobs(self) -> list[RunJob]:
        """Return the runs."""
        return list(self.points().values())

    def content(self, run: JobRun[RunJob]) -> dict[str, Any]:
        """Return the content of ``robustness.json``."""
        points = [{
            'plant': plant, 'estimator': label, 'ratio': ratio, 'delay_ticks': delay,
            **verdict(run.metrics(job)), 'key': run.keys[job]}
            for (plant, label, ratio, delay), job in self.points().items()]
        content: dict[str, Any] = finite({
            'plants': self.plants, 'estimators': self.estimators,
            'ratios': self.ratios, 'delays': self.delays, 'points': points,
            'linear': {plant: linear_boundaries(plant, self.delays, VARIANCES)
                       for plant in self.plants}})
        return content

    def page(self, content: dict[str, Any], folder: Path) -> Page:
        """Return the map and its stable ranges."""
        return Page(
            'How wrong stiffness and delay may be',
            [Section(f'Plant {plant}: true/model stiffness that is stable, on the grid',
                     _listing(content, plant)) for plant in self.plants],
            introduction=[EXPLANATION], figure=draw_map(content))


def robustness_study(
    plants: tuple[str, ...] = (), estimators: tuple[str, ...] = (), *, quick: bool = False,
) -> RobustnessStudy:
    """Return the map of some plants and estimators, none for all, or those of the quick map."""
    return RobustnessStudy(
        plants or (plants_of()[:1] if quick else plants_of()),
        estimators or (QUICK_LABELS if quick else MAP_LABELS),
        tuple(ratios(QUICK_RATIOS if quick else RATIOS)))


def stable_range(
    content: dict[str, Any], plant: str, label: str, delay: int,
) -> tuple[float, float] | None:
    """Return the smallest and largest stable ratio around 1, None if there is none."""
    known = sorted((point['ratio'], point['stable']) for point in content['points']
                   if (point['plant'], point['estimator'], point['delay_ticks'])
                   == (plant, label, delay))
    nearest = min(range(len(known)), key=lambda i: abs(math.log(known[i][0])), default=None)
    if nearest is None or not known[nearest][1]:
        return None
    low = high = nearest
    while low > 0 and known[low - 1][1]:
        low -= 1
    while high + 1 < len(known) and known[high + 1][1]:
        high += 1
    return known[low][0], known[high][0]


def _listing(content: dict[str, Any], plant: str) -> Listing:
    lines = []
    for label in content['estimators']:
        ranges = [stable_range(content, plant, label, delay) for delay in content['delays']]
        lines.append(Line([label, *(
            'none' if span is None else f'{span[0]:g} - {span[1]:g}' for span in ranges)]))
    lines += [Line([line['label'], *(
        f'up to {ARM_RATIOS[-1] if limit is None else limit:.2f}'
        for limit in line['largest_ratio'])]) for line in content['linear'][plant]]
    return Listing([Column('', number=False), *(
        Column(f'delay {delay}') for delay in content['delays'])], lines)


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
