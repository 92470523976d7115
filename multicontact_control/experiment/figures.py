"""The paper's Figures 3-6 of a recording: as files, and to move about in on a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
import re
from textwrap import shorten
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.arrays import Vector
from multicontact_control.experiment.judge import STABLE
from multicontact_control.experiment.metrics import (
    has_truth,
    judged_force,
    judged_windows,
    NO_TRUTH,
    step_responses,
    truth_lacking,
    without_truth,
)
from multicontact_control.experiment.oscillation import stretches
from multicontact_control.experiment.page import (
    COLOURS,
    COMMANDED,
    ESTIMATED,
    figure,
    MEASURED,
    Panel,
    plot,
    Span,
    Trace,
    TRUE,
    WINDOW,
)
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np

matplotlib.use('Agg')

TITLE_WIDTH = 110  # characters of the second line that fit
PAUSE = 0.1  # s between two windows of a kind, below which one is drawn
STEP_SHOWN = (0.05, 0.35)  # s before and after a step
LEGIBLE = {'facecolor': 'white', 'alpha': 0.8, 'edgecolor': 'none', 'pad': 1.0}  # over bars
PAPER_VARIANCE = ((0.6, 'paper, at rest'), (100.0, 'paper, moving'))  # N^2


class RunFigure(NamedTuple):
    """One figure of a run: in a file, several panels with a title; on a page, one."""

    file: str
    title: str
    panels: Sequence[Panel]
    name: str
    heading: str
    page: Panel


def run_figures(data: RunData, setup: Setup) -> list[RunFigure]:
    """Return the figures of a run: 3 and 4 for each contact, 5, 6, and the stiffness found."""
    forces = [_force(data, i, truth) for i, truth in enumerate(has_truth(data, setup))]
    figures = [*forces, _motion(data, setup), _noise_variance(data), _stiffness(data)]
    return [known for drawn in figures if (known := _known(drawn)) is not None]


def _known(drawn: RunFigure) -> RunFigure | None:
    """Return a figure without the series of which nothing is known, None if none is left."""
    page, *panels = [panel._replace(traces=[
        trace for trace in panel.traces if np.isfinite(trace.values).any()])
        for panel in (drawn.page, *drawn.panels)]
    panels = [panel for panel in panels if panel.traces]
    return drawn._replace(panels=panels, page=page) if panels and page.traces else None


def _force(data: RunData, i: int, truth: bool) -> RunFigure:
    """Measured and estimated force of one contact (P04 Figs 3, 4)."""
    name, desired, seen = data.contact_names[i], data.alpha_des[:, i], data.alpha_meas[:, i]
    measured = Trace('measured', seen)
    true = Trace('true', data.alpha_true[:, i], TRUE, 0.4, faint=True)
    estimated = Trace('estimated (AOB)', data.alpha_est[:, i], ESTIMATED)
    commanded = Trace('commanded', desired, COMMANDED, 1.0, dashed=True)
    limits = _force_limits([(data, i)])
    label = 'force [N]' if truth else f'force [N], {NO_TRUTH}'
    return RunFigure(
        re.sub(r'[^\w.-]', '_', f'fig{3 + i if i < 2 else f"3_{i + 1}"}_force_{name}'),
        f'Contact force {name}',
        (Panel(label, (measured, commanded), limits),
         Panel(label, (estimated, commanded, true), limits)),
        f'force{i}', f'Fig. {3 + i if i < 2 else "3/4"}: contact force {name}',
        Panel(label, (measured, true, estimated, commanded), limits))


def _force_limits(shown: Sequence[tuple[RunData, int]]) -> tuple[float, float]:
    """Return the limits of the axis of some contacts of runs [N]."""
    low, high = -2.0, 5.0
    for data, i in shown:
        for values, margin in ((data.alpha_des, 1.6), (data.alpha_meas, 1.1),
                               (data.alpha_true, 1.1)):
            known = values[np.isfinite(values[:, i]), i]
            low = min(low, margin * float(np.min(known, initial=0.0)))
            high = max(high, margin * float(np.max(known, initial=0.0)))
    return low, high


def _motion(data: RunData, setup: Setup) -> RunFigure:
    """Return the wrist's translation along the motion's direction and its error (P04 Fig. 5)."""
    direction = _direction(data, setup)
    axis = 'xyz'[int(np.argmax(np.abs(direction)))]
    travelled, wanted = data.position @ direction, data.position_des @ direction
    both = Panel(f'{axis} [m]', (
        Trace('measured', travelled, width=1.2),
        Trace('commanded', wanted, COMMANDED, 1.0, dashed=True)), height=3.0)
    error = Panel('error [mm]', (Trace('', 1e3 * (travelled - wanted), TRUE, 0.7),))
    return RunFigure('fig5_motion', f'Wrist motion along {axis}', (both, error), 'motion',
                     f'Fig. 5: wrist motion along {axis}', both)


def _direction(data: RunData, setup: Setup) -> Vector:
    """Return the direction of the motion: that of the scenario, or the axis of the longest way."""
    if not setup.commanded_by_topic:
        motion = setup.scenario.reference.motion
        return np.asarray(motion.direction_world if motion else (1.0, 0.0, 0.0))
    known = data.position_des[np.isfinite(data.position_des).all(axis=1)]
    return np.eye(3)[int(np.argmax(np.ptp(known, axis=0)))] if len(known) else np.eye(3)[0]


def _noise_variance(data: RunData) -> RunFigure:
    """Return the estimated noise variance of every contact on a log axis (P04 Fig. 6)."""
    series = list(zip(data.contact_names, data.noise_variance.T))
    return RunFigure(
        'fig6_noise_variance', 'Estimated noise variance R',
        [Panel(f'{name} [N$^2$]', (Trace('', values, width=0.7),), levels=PAPER_VARIANCE)
         for name, values in series],
        'variance', 'Fig. 6: estimated noise variance',
        Panel('R [N²]', [Trace(name, values, None) for name, values in series],
              levels=PAPER_VARIANCE))


def _stiffness(data: RunData) -> RunFigure:
    """Return the stiffness found on-line with its standard error, and that of the model."""
    panels, lines = [], []
    for i, name in enumerate(data.contact_names):
        estimate = np.where(data.stiffness_est[:, i] > 0.0, data.stiffness_est[:, i], np.nan)
        error = data.stiffness_std[:, i]
        model = Trace('model in use', data.stiffness[:, i], COMMANDED, 1.0, dashed=True)
        found = Trace('estimated', estimate, ESTIMATED, 1.0)
        panels.append(Panel(f'{name} [N/m]', (
            model, found, Trace('with 2 standard errors', estimate + 2.0 * error, TRUE, 0.5,
                                faint=True)), logarithmic=True))
        lines += [Trace(f'{name}, model', model.values, None, dashed=True),
                  Trace(f'{name}, estimated', estimate, None)]
    return RunFigure('stiffness', 'Stiffness found on-line', panels, 'stiffness',
                     'Stiffness found on-line', Panel('k [N/m]', lines, logarithmic=True))


def draw_figures(
    data: RunData, setup: Setup, folder: Path, *, verdict: str = STABLE,
    formats: Sequence[str] = ('png',),
) -> list[Path]:
    """
    Draw the figures of a run into a folder and return the files.

    `verdict` is that of the run with its reasons, in the titles if it is not stable; `formats` are
    the endings of the files, one each.
    """
    plant, seed = (f'plant {setup.plant_name}', f', seed {setup.seed}') if setup.simulated else (
        setup.plant_name, '')
    title = f'{setup.scenario.name}, {plant}, {setup.noise_estimator.estimator}{seed}'
    unknown = truth_lacking(without_truth(data, setup), data.contact_names)
    if unknown:
        title += f', {unknown}: errors are of the measured forces'
    if verdict != STABLE:
        title += '\n' + shorten(verdict, TITLE_WIDTH, placeholder=' ...')
    folder.mkdir(parents=True, exist_ok=True)
    shaded = _judged(data, setup)
    paths = []
    for drawn in run_figures(data, setup):
        sheet = Figure(figsize=(9.0, 6.0), layout='constrained')
        sheet.suptitle(f'{drawn.title}\n{title}', fontsize=10)
        all_axes = np.atleast_1d(sheet.subplots(
            len(drawn.panels), 1, sharex=True, height_ratios=[p.height for p in drawn.panels],
            sharey=len({panel.height for panel in drawn.panels}) == 1))
        for panel, axes in zip(drawn.panels, all_axes):
            _draw_panel(axes, panel, data.time, shaded)
        all_axes[-1].set_xlabel('time [s]')
        for ending in formats:
            paths.append(folder / f'{drawn.file}.{ending}')
            sheet.savefig(paths[-1], dpi=130)
    return paths


def draw_side_by_side(runs: Sequence[tuple[str, RunData, Setup]], path: Path) -> Path:
    """Draw the forces of named runs into a PNG file: all of a run, and its last step at rest."""
    count = max(len(data.contact_names) for _, data, _ in runs)
    sheet = Figure(figsize=(5.5 * len(runs), 2.4 * (count + 1)), layout='constrained')
    grid = sheet.subplots(count + 1, len(runs), squeeze=False, sharey='row')
    for column, (label, data, setup) in zip(grid.T, runs):
        column[0].set_title(label, fontsize=11)
        truth, forces = has_truth(data, setup), judged_force(data, setup)
        for i, (name, axes) in enumerate(zip(data.contact_names, column)):
            true = [Trace('true', data.alpha_true[:, i], TRUE, 0.3, faint=True)]
            _draw_panel(axes, Panel(f'{name} [N]', [
                Trace('measured', data.alpha_meas[:, i], width=0.4), *(true if truth[i] else ()),
                Trace('commanded', data.alpha_des[:, i], COMMANDED, 1.0, dashed=True)],
                _force_limits([(each, i) for _, each, _ in runs if i < len(each.contact_names)])),
                data.time, ())
        last = max((step.time for i in range(len(data.contact_names))
                    for step in step_responses(data, setup, i)), default=0.0)
        shown = (data.time >= last - STEP_SHOWN[0]) & (data.time < last + STEP_SHOWN[1])
        _draw_panel(column[count], Panel('force [N]', [
            *(Trace(f'{name}, {"true" if truth[i] else "measured"}', forces[shown, i],
                    COLOURS[i % len(COLOURS)], 1.2) for i, name in enumerate(data.contact_names)),
            *(Trace('commanded', desired, COMMANDED, 1.0, dashed=True)
              for desired in data.alpha_des[shown].T[:1])]), 1e3 * (data.time[shown] - last), ())
        column[count].set_xlabel('time after the last step at rest [ms]')
        column[count - 1].set_xlabel('time [s]')
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.savefig(path, dpi=110)
    return path


def draw_latency(summary: Mapping[str, Any], folder: Path) -> Path:
    """Draw how long the answers to samples took, from ``summary.json``; return the file."""
    timing = summary['timing']
    edges, counts = (np.array(timing['latency_histogram'][x]) for x in ('edges_us', 'counts'))
    sheet = Figure(figsize=(9.0, 4.0), layout='constrained')
    axes = sheet.subplots()
    axes.stairs(counts, edges, fill=True, color=MEASURED)
    marks = {name: timing['latency_us'][name] for name in ('p50', 'p99', 'max')}
    marks['period'] = 1e6 / summary['rate_hz']
    for (name, value), height in zip(marks.items(), (0.98, 0.91, 0.84, 0.77)):
        if value:
            colour = TRUE if name == 'period' else COMMANDED
            axes.axvline(value, color=colour, linewidth=0.8, linestyle='--')
            axes.annotate(f'{name} {value:.0f} us', (value, height), color=colour, fontsize=7,
                          xycoords=('data', 'axes fraction'), va='top', xytext=(3, 0),
                          textcoords='offset points', bbox=LEGIBLE)
    axes.set_xscale('log')
    axes.set_yscale('symlog', linthresh=1.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel('from a sample to its command [us]')
    axes.set_ylabel('samples')
    sheet.suptitle(f'Latency\n{summary["scenario"]}, plant {summary["plant"]}, seed '
                   f'{summary["seed"]}, {timing["deadline_misses"]} of {summary["ticks"]} '
                   'deadlines missed', fontsize=10)
    path = folder / 'latency.png'
    sheet.savefig(path, dpi=130)
    return path


def _judged(data: RunData, setup: Setup) -> list[Span]:
    """Return the windows that the summary is of, without the pauses between setpoints."""
    judged = judged_windows(data, setup)
    spans: list[Span] = []
    for name, mask in (('rest', judged.rest), ('moving', judged.moving)):
        for begin, end in zip(*stretches(mask)):
            span = Span(name, float(data.time[begin]), float(data.time[end - 1]))
            last = spans[-1] if spans else None
            if last is not None and last.name == name and span.start - last.end < PAUSE:
                span = spans.pop()._replace(end=span.end)
            spans.append(span)
    return spans


def _draw_panel(axes: Axes, panel: Panel, time: Vector, shaded: Sequence[Span]) -> None:
    for name, start, end in shaded:
        axes.axvspan(start, end, color=WINDOW, zorder=0)
        axes.annotate(name, (start, 1.0), xycoords=('data', 'axes fraction'), fontsize=7,
                      va='top', color='#777777', xytext=(2, -2), textcoords='offset points')
    if panel.on_log_axis:
        axes.set_yscale('log')
    for trace in panel.traces:
        style: dict[str, Any] = {'alpha': 0.6, 'zorder': 1.5} if trace.faint else {}
        axes.plot(time, trace.values, color=trace.colour, linewidth=trace.width,
                  linestyle='--' if trace.dashed else '-', label=trace.label, **style)
    for level, text in panel.levels:
        axes.axhline(level, color=COMMANDED, linewidth=0.7, linestyle=':')
        axes.annotate(text, (1.0, level), xycoords=('axes fraction', 'data'), fontsize=7,
                      ha='right', va='bottom')
    axes.set_ylabel(panel.label)
    axes.grid(alpha=0.3, which='both' if panel.levels else 'major')
    if len(panel.traces) > 1:
        axes.legend(loc='upper right' if panel.logarithmic else 'upper left', fontsize=8)
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)


def interactive_figures(data: RunData, setup: Setup, number: int) -> str:
    """Return the figures of a run as HTML; `number` is that of the run on the page."""
    shaded = _judged(data, setup)
    return '\n'.join(
        figure(f'run{number}-{drawn.name}',
               [plot(drawn.page, data.time, drawn.heading, shaded=shaded)])
        for drawn in run_figures(data, setup))
