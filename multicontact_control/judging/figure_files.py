"""The figures of a run as files: PNG to look at, PDF to print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.arrays import Vector
from multicontact_control.judging.display import describe_run
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.panels import (
    choose_colour,
    COMMANDED_COLOUR,
    Panel,
    ShadedSpan,
    Trace,
    WINDOW_COLOURS,
)
from multicontact_control.judging.path_maps import draw_maps
from multicontact_control.judging.run_figures import (
    describe_figures,
    describe_force,
    list_shaded_spans,
)
from multicontact_control.judging.verdict import describe_verdict, STABLE

matplotlib.use('Agg')

FIGURE_FORMATS = ('png', 'pdf')
TITLE_WIDTH = 110  # characters of the second line that fit
LEGEND_WIDTH = 90  # characters of a line of a legend
SHOWN_BEFORE_STEP = 0.05  # s
SHOWN_AFTER_STEP = 0.35  # s
LEAST_LABELLED_SHARE = 0.02  # of a run, from which on a window has room for its name,
LEAST_LEVEL_SHARE = 0.06  # and from which on it need not stand upright


def draw_figures(
    run: RunMetrics, summary: Mapping[str, Any], folder: Path
) -> list[Path]:
    """
    Draw the figures of a run into a folder and return the files.

    Parameters
    ----------
    run
        The run with its metrics.
    summary
        The content of its ``summary.json``: a verdict other than `stable` is a part of the titles.
    folder
        Where to write; it is made if it does not exist.

    """
    title = describe_run(summary)
    verdict = describe_verdict(summary)
    if verdict != STABLE:
        title += '\n' + shorten(verdict, TITLE_WIDTH, placeholder=' ...')
    shaded = list_shaded_spans(run)
    paths = []
    for figure in describe_figures(run):
        count = len(figure.panels)
        height = 4.5
        if count > 1:
            height = 6.0
        sheet = Figure(figsize=(9.0, height), layout='constrained')
        sheet.suptitle(f'{figure.title}\n{title}', fontsize=10)
        labels = {panel.label for panel in figure.panels}
        same_unit = len(labels) == 1
        grid = sheet.subplots(count, 1, squeeze=False, sharex=True, sharey=same_unit)
        for panel, axes in zip(figure.panels, grid[:, 0]):
            _draw_panel(axes, panel, run.data.time, shaded)
        grid[-1, 0].set_xlabel('time [s]')
        paths += _save_sheet(sheet, folder / figure.file, dpi=130)
    for file, sheet in draw_maps(run, title):
        paths += _save_sheet(sheet, folder / file, dpi=130)
    return paths


def draw_side_by_side(
    names: Sequence[str], runs: Sequence[RunMetrics], folder: Path
) -> list[Path]:
    """
    Draw the forces of runs beside each other: all of a run, and its last step at rest.

    A column of panels for each run, a row for each contact, on common force axes; names stand
    above the columns. The files are ``side_by_side`` in `folder`, one of each of
    `FIGURE_FORMATS`, and are returned.
    """
    count = max(len(run.contacts) for run in runs)
    sheet = Figure(figsize=(5.5 * len(runs), 2.4 * (count + 1)), layout='constrained')
    grid = sheet.subplots(count + 1, len(runs), squeeze=False, sharey='row')
    for column, name, run in zip(grid.T, names, runs):
        column[0].set_title(name, fontsize=11, loc='left')
        for contact, axes in zip(run.contacts, column):
            measured = describe_force(contact).panels[0]
            panel = measured._replace(label=f'{contact.name} [N]')
            _draw_panel(axes, panel, run.data.time)
        column[count - 1].set_xlabel('time [s]')
        _draw_last_step(column[count], run)
    return _save_sheet(sheet, folder / 'side_by_side', dpi=110)


def _save_sheet(sheet: Figure, path: Path, *, dpi: int) -> list[Path]:
    """Write a sheet to a path without an ending in all formats, and return the files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    paths = []
    for ending in FIGURE_FORMATS:
        file = Path(f'{path}.{ending}')
        sheet.savefig(file, dpi=dpi)
        paths.append(file)
    return paths


def _draw_last_step(axes: Axes, run: RunMetrics) -> None:
    """Draw the forces of all contacts around the last step at rest, over time since then."""
    last = 0.0
    for contact in run.contacts:
        for step in contact.step_responses:
            last = max(last, step.time_s)
    shown = run.between(last - SHOWN_BEFORE_STEP, last + SHOWN_AFTER_STEP)
    traces = []
    for contact in run.contacts:
        colour = choose_colour(contact.column)
        traces.append(Trace(contact.name, contact.force[shown], colour))
    desired = run.data.alpha_des[shown, 0]
    traces.append(Trace('commanded', desired, COMMANDED_COLOUR, dashed=True))
    _draw_panel(axes, Panel('force [N]', traces), 1e3 * (run.data.time[shown] - last))
    axes.set_xlabel('time after the last step at rest [ms]')


def _draw_panel(
    axes: Axes, panel: Panel, time: Vector, shaded: Sequence[ShadedSpan] = ()
) -> None:
    """Draw the traces of a panel over time, with windows shaded behind them."""
    for span in shaded:
        axes.axvspan(span.start, span.end, color=WINDOW_COLOURS[span.name], zorder=0)
        share = (span.end - span.start) / (time[-1] - time[0])
        if share > LEAST_LABELLED_SHARE:
            _label_span(axes, span, upright=share <= LEAST_LEVEL_SHARE)
    for trace in panel.traces:
        axes.plot(time, trace.values, **_choose_style(trace))
    axes.set_ylabel(panel.label)
    if panel.logarithmic:
        axes.set_yscale('log')
    low, high = axes.get_ylim()
    margin = max(panel.least_span - (high - low), 0.0) / 2.0
    axes.set_ylim(low - margin, high + margin)
    axes.grid(alpha=0.3)
    if len(panel.traces) > 1:  # above, where it covers nothing
        widest = max(len(trace.label) for trace in panel.traces)
        columns = min(LEGEND_WIDTH // widest, len(panel.traces))
        axes.legend(
            loc='lower right',
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.1,
            ncols=max(1, columns),
            frameon=False,
            fontsize=8,
        )


def _label_span(axes: Axes, span: ShadedSpan, *, upright: bool) -> None:
    rotation = 0.0
    if upright:
        rotation = 90.0
    axes.annotate(
        span.name,
        (span.start, 1.0),
        xycoords=('data', 'axes fraction'),
        fontsize=7,
        va='top',
        color='#555555',
        xytext=(2, -2),
        textcoords='offset points',
        rotation=rotation,
    )


def _choose_style(trace: Trace) -> dict[str, Any]:
    """Return the keywords of matplotlib for a trace."""
    style: dict[str, Any] = {
        'color': trace.colour,
        'label': trace.label,
        'linewidth': 0.7,
    }
    if trace.dashed:
        style['linestyle'] = '--'
    if trace.broad:
        style |= {'linewidth': 4.0, 'alpha': 0.3, 'zorder': 1.5}
    elif trace.faint:
        style |= {'alpha': 0.6, 'zorder': 1.5}
    return style
