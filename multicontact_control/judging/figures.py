"""The figures of a run, each described once: drawn as files and on a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
import re
from textwrap import shorten
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.arrays import find_true_stretches, Mask, Vector
from multicontact_control.judging.display import headline
from multicontact_control.judging.metrics import NO_TRUTH, RunMetrics
from multicontact_control.judging.page import (
    COLOURS,
    COMMANDED,
    ESTIMATED,
    figure,
    Panel,
    Span,
    Trace,
    TRUE,
    WINDOWS,
)
from multicontact_control.judging.verdict import STABLE, verdict_text
from multicontact_control.runs.recording import RunData
from multicontact_control.runs.scenario import Setup
import numpy as np
from scipy.ndimage import binary_closing

matplotlib.use('Agg')

FORMATS = ('png', 'pdf')  # of every figure: to look at, and to print
TITLE_WIDTH = 110  # characters of the second line that fit
LEGEND_WIDTH = 90  # characters of a line of a legend
PAUSE = 0.1  # s between two windows of a kind, below which they are one
STEP_SHOWN = (0.05, 0.35)  # s before and after a step
LEAST_LABELLED = 0.02  # share of a run, from which on a window has room for its name,
LEAST_LEVEL = 0.06  # and from which on it need not stand upright
# What a vertical axis spans at least.
LEAST_FORCE, LEAST_MOTION, LEAST_ERROR = 1.0, 10.0, 1.0  # N, mm, mm


class RunFigure(NamedTuple):
    """One figure of a run: panels over time, below each other."""

    file: str
    title: str
    panels: Sequence[Panel]


def run_figures(data: RunData, setup: Setup) -> list[RunFigure]:
    """Return the figures of a run: contact forces, motion, noise variance, and the stiffness."""
    run = RunMetrics(data, setup)
    stiffness = np.where(data.stiffness_est > 0.0, data.stiffness_est, np.nan)
    drawn = [
        *(_force(data, i, truth) for i, truth in enumerate(run.truth)),
        _motion(data, run),
        RunFigure(
            'fig6_noise_variance',
            'Noise variance R found on-line',
            [
                Panel(
                    'R [N²]',
                    [
                        Trace(
                            _variance_label(run, i),
                            data.noise_variance[:, i],
                            COLOURS[i % len(COLOURS)],
                        )
                        for i in range(len(data.contact_names))
                    ],
                    logarithmic=True,
                )
            ],
        ),
        RunFigure(
            'stiffness',
            'Stiffness found on-line',
            [
                Panel(
                    f'{name} [N/m]',
                    (
                        Trace(
                            'model in use', data.stiffness[:, i], COMMANDED, dashed=True
                        ),
                        Trace('estimated', stiffness[:, i], ESTIMATED),
                        Trace(
                            'with 2 standard errors',
                            stiffness[:, i] + 2.0 * data.stiffness_std[:, i],
                            TRUE,
                            faint=True,
                        ),
                    ),
                    logarithmic=True,
                )
                for i, name in enumerate(data.contact_names)
            ],
        ),
    ]
    # What was not recorded is not drawn.
    figures = [
        each._replace(
            panels=[
                panel._replace(traces=known)
                for panel in each.panels
                if (
                    known := [
                        trace
                        for trace in panel.traces
                        if np.isfinite(trace.values).any()
                    ]
                )
            ]
        )
        for each in drawn
    ]
    return [each for each in figures if each.panels]


def _force(data: RunData, i: int, truth: bool) -> RunFigure:
    """Measured and estimated force of one contact (P04 Figs 3, 4)."""
    name, number = data.contact_names[i], 3 + i if i < 2 else f'3_{i + 1}'
    commanded = Trace('commanded', data.alpha_des[:, i], COMMANDED, dashed=True)
    label = 'force [N]' if truth else f'force [N], {NO_TRUTH}'
    return RunFigure(
        re.sub(r'[^\w.-]', '_', f'fig{number}_force_{name}'),
        f'Contact force: {name}',
        (
            Panel(
                label,
                (Trace('measured', data.alpha_meas[:, i]), commanded),
                least=LEAST_FORCE,
            ),
            Panel(
                label,
                (
                    Trace('true', data.alpha_true[:, i], TRUE, faint=True),
                    Trace('estimated', data.alpha_est[:, i], ESTIMATED),
                    commanded,
                ),
                least=LEAST_FORCE,
            ),
        ),
    )


def _variance_label(run: RunMetrics, i: int) -> str:
    """Return whose R a curve is, its medians, and the greatest from the motion's start on."""
    name, summary = run.data.contact_names[i], run.contact_summary(i)
    medians = [
        f'{median:.3g} {words}'
        for window, words in (('rest', 'at rest'), ('moving', 'moving'))
        if (median := summary[window]['noise_variance_median_n2']) is not None
    ]
    label = f'{name}: median {", ".join(medians)}' if medians else name
    started = run.data.noise_variance[_in_motion(run), i]
    if np.isfinite(started).any():
        label += f'; at most {np.nanmax(started):.3g} from the start of the motion on'
    return label


def _in_motion(run: RunMetrics) -> Mask:
    """Return the samples of the motion, of a scenario's from its start on, shape (m,)."""
    if run.setup.commanded_by_topic:
        return run.windows.moving
    return run.data.time >= run.motion_start


def _motion(data: RunData, run: RunMetrics) -> RunFigure:
    """Return the wrist's translation along its longest way and its error (P04 Fig. 5)."""
    under_load = data.position_des[run.windows.loaded]
    known = under_load[np.isfinite(under_load).all(axis=1)]
    axis = int(np.argmax(np.ptp(known, axis=0))) if len(known) else 0
    travelled, desired = 1e3 * data.position[:, axis], 1e3 * data.position_des[:, axis]
    return RunFigure(
        'fig5_motion',
        f'Position of the wrist along {"xyz"[axis]}',
        (
            Panel(
                f'{"xyz"[axis]} [mm]',
                (
                    Trace('commanded', desired, COMMANDED, broad=True),
                    Trace('measured', travelled, ESTIMATED),
                ),
                least=LEAST_MOTION,
            ),
            Panel(
                'error [mm]',
                (Trace('error', travelled - desired, TRUE),),
                least=LEAST_ERROR,
            ),
        ),
    )


def interactive_figures(data: RunData, setup: Setup, number: int) -> str:
    """Return the figures of a run as HTML; `number` is that of the run on the page."""
    shaded = _judged(data, setup)
    return '\n'.join(
        figure(
            f'run{number}-{drawn.file}', drawn.title, drawn.panels, data.time, shaded
        )
        for drawn in run_figures(data, setup)
    )


def draw_figures(
    data: RunData,
    setup: Setup,
    summary: Mapping[str, Any],
    folder: Path,
    formats: Sequence[str] = FORMATS,
) -> list[Path]:
    """Draw the figures of a run into a folder in some formats, titled with a bad verdict."""
    title, verdict = headline(summary), verdict_text(summary)
    if verdict != STABLE:
        title += '\n' + shorten(verdict, TITLE_WIDTH, placeholder=' ...')
    folder.mkdir(parents=True, exist_ok=True)
    shaded = _judged(data, setup)
    paths = []
    for drawn in run_figures(data, setup):
        count = len(drawn.panels)
        sheet = Figure(figsize=(9.0, 6.0 if count > 1 else 4.5), layout='constrained')
        sheet.suptitle(f'{drawn.title}\n{title}', fontsize=10)
        all_axes = np.atleast_1d(
            sheet.subplots(
                count,
                1,
                sharex=True,
                sharey=len({panel.label for panel in drawn.panels}) == 1,
            )
        )
        for panel, axes in zip(drawn.panels, all_axes):
            _draw_panel(axes, panel, data.time, shaded)
        all_axes[-1].set_xlabel('time [s]')
        for ending in formats:
            paths.append(folder / f'{drawn.file}.{ending}')
            sheet.savefig(paths[-1], dpi=130)
    return paths


def draw_side_by_side(
    runs: Sequence[tuple[str, RunData, Setup]],
    folder: Path,
    formats: Sequence[str] = FORMATS,
) -> list[Path]:
    """Draw the forces of named runs: all of a run, and its last step at rest."""
    count = max(len(data.contact_names) for _, data, _ in runs)
    sheet = Figure(figsize=(5.5 * len(runs), 2.4 * (count + 1)), layout='constrained')
    grid = sheet.subplots(count + 1, len(runs), squeeze=False, sharey='row')
    for column, (label, data, setup) in zip(grid.T, runs):
        column[0].set_title(label, fontsize=11, loc='left')
        run, indices = RunMetrics(data, setup), range(len(data.contact_names))
        for i, axes in zip(indices, column):
            measured = _force(data, i, True).panels[0]
            _draw_panel(
                axes, measured._replace(label=f'{data.contact_names[i]} [N]'), data.time
            )
        last = max(
            (step.time_s for i in indices for step in run.step_responses(i)),
            default=0.0,
        )
        shown = run.between(last - STEP_SHOWN[0], last + STEP_SHOWN[1])
        _draw_panel(
            column[count],
            Panel(
                'force [N]',
                [
                    *(
                        Trace(
                            data.contact_names[i],
                            run.force[shown, i],
                            COLOURS[i % len(COLOURS)],
                        )
                        for i in indices
                    ),
                    Trace(
                        'commanded', data.alpha_des[shown, 0], COMMANDED, dashed=True
                    ),
                ],
            ),
            1e3 * (data.time[shown] - last),
        )
        column[count].set_xlabel('time after the last step at rest [ms]')
        column[count - 1].set_xlabel('time [s]')
    paths = [folder / f'side_by_side.{ending}' for ending in formats]
    for path in paths:
        sheet.savefig(path, dpi=110)
    return paths


def _judged(data: RunData, setup: Setup) -> list[Span]:
    """
    Return the windows that the summary is of, without the pauses between setpoints.

    The start of a scenario's motion, up to its window, is one as well: R is greatest there.
    """
    run = RunMetrics(data, setup)
    start = _in_motion(run) & ~run.windows.moving
    closing = np.ones(round(PAUSE * data.rate), dtype=bool)
    return [
        (name, float(data.time[begin]), float(data.time[end - 1]))
        for name, mask in (
            ('rest', run.windows.rest),
            ('start', start),
            ('moving', run.windows.moving),
        )
        for begin, end in find_true_stretches(binary_closing(mask, closing) | mask)
    ]


def _draw_panel(
    axes: Axes,
    panel: Panel,
    time: Vector,
    shaded: Sequence[Span] = (),
) -> None:
    for name, start, end in shaded:
        axes.axvspan(start, end, color=WINDOWS[name], zorder=0)
        share = (end - start) / (time[-1] - time[0])
        if share > LEAST_LABELLED:
            axes.annotate(
                name,
                (start, 1.0),
                xycoords=('data', 'axes fraction'),
                fontsize=7,
                va='top',
                color='#555555',
                xytext=(2, -2),
                textcoords='offset points',
                rotation=0.0 if share > LEAST_LEVEL else 90.0,
            )
    for trace in panel.traces:
        style: dict[str, Any] = {'linewidth': 0.7}
        if trace.faint:
            style |= {'alpha': 0.6, 'zorder': 1.5}
        if trace.broad:
            style = {'linewidth': 4.0, 'alpha': 0.3, 'zorder': 1.5}
        axes.plot(
            time,
            trace.values,
            color=trace.colour,
            label=trace.label,
            linestyle='--' if trace.dashed else '-',
            **style,
        )
    axes.set(ylabel=panel.label, yscale='log' if panel.logarithmic else 'linear')
    low, high = axes.get_ylim()
    more = max(panel.least - (high - low), 0.0) / 2.0
    axes.set_ylim(low - more, high + more)
    axes.grid(alpha=0.3)
    if len(panel.traces) > 1:  # above, where it covers nothing
        room = LEGEND_WIDTH // max(len(trace.label) for trace in panel.traces)
        axes.legend(
            loc='lower right',
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.1,
            ncols=max(1, min(room, len(panel.traces))),
            frameon=False,
            fontsize=8,
        )
