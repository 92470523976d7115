"""The figures of a run, each described once, to be drawn as files and on a page."""

from __future__ import annotations

import re

from multicontact_control.arrays import find_true_stretches, Mask
from multicontact_control.judging.contact_metrics import ContactMetrics
from multicontact_control.judging.metrics import NO_TRUTH, RunMetrics
from multicontact_control.judging.panels import (
    choose_colour,
    COMMANDED_COLOUR,
    ESTIMATED_COLOUR,
    Panel,
    RunFigure,
    ShadedSpan,
    Trace,
    TRUE_COLOUR,
)
from multicontact_control.judging.run_series import RunSeries, statistic_within
import numpy as np
from scipy.ndimage import binary_closing

LONGEST_PAUSE = 0.1  # s between two windows of a kind, up to which they are one
# What a vertical axis spans at least.
LEAST_FORCE_SPAN = 1.0  # N
LEAST_WAY_SPAN = 10.0  # mm
LEAST_ERROR_SPAN = 1.0  # mm


def describe_figures(run: RunMetrics) -> list[RunFigure]:
    """
    Return the figures of a run: contact forces, motion, noise variance, and the stiffness.

    What was not recorded is left out: traces, panels, and whole figures.
    """
    figures = [describe_force(contact) for contact in run.contacts]
    figures.append(_describe_motion(run))
    figures.append(_describe_variance(run))
    figures.append(_describe_stiffness(run))
    known = map(_drop_unknown, figures)
    return [figure for figure in known if figure.panels]


def _drop_unknown(figure: RunFigure) -> RunFigure:
    """Return a figure without the traces of which no value is known."""
    panels = []
    for panel in figure.panels:
        known = [each for each in panel.traces if np.isfinite(each.values).any()]
        if known:
            panels.append(panel._replace(traces=known))
    return figure._replace(panels=panels)


def describe_force(contact: ContactMetrics) -> RunFigure:
    """
    Return the figure of a contact's measured and estimated force (P04 Figs 3, 4).

    The upper panel has the measured force, the lower one the true and the estimated one, each with
    the command. Further contacts are numbered 3_3, 3_4, ...
    """
    data = contact.run.data
    column = contact.column
    number = f'{3 + column}'
    if column >= 2:
        number = f'3_{column + 1}'
    label = 'force [N]'
    if not contact.has_truth:
        label = f'force [N], {NO_TRUTH}'
    desired = data.alpha_des[:, column]
    commanded = Trace('commanded', desired, COMMANDED_COLOUR, dashed=True)
    measured = Trace('measured', data.alpha_meas[:, column])
    true = Trace('true', data.alpha_true[:, column], TRUE_COLOUR, faint=True)
    estimated = Trace('estimated', data.alpha_est[:, column], ESTIMATED_COLOUR)
    return RunFigure(
        re.sub(r'[^\w.-]', '_', f'fig{number}_force_{contact.name}'),
        f'Contact force: {contact.name}',
        (
            Panel(label, (measured, commanded), least_span=LEAST_FORCE_SPAN),
            Panel(label, (true, estimated, commanded), least_span=LEAST_FORCE_SPAN),
        ),
    )


def _describe_motion(run: RunMetrics) -> RunFigure:
    """Return the wrist's translation along its longest way and its error (P04 Fig. 5)."""
    data = run.data
    under_load = data.position_des[run.windows.loaded]
    known = under_load[np.isfinite(under_load).all(axis=1)]
    axis = 0
    if len(known):
        axis = int(np.argmax(np.ptp(known, axis=0)))
    name = 'xyz'[axis]
    position = 1e3 * data.position[:, axis]
    desired = 1e3 * data.position_des[:, axis]
    commanded = Trace('commanded', desired, COMMANDED_COLOUR, broad=True)
    measured = Trace('measured', position, ESTIMATED_COLOUR)
    error = Trace('error', position - desired, TRUE_COLOUR)
    return RunFigure(
        'fig5_motion',
        f'Position of the wrist along {name}',
        (
            Panel(f'{name} [mm]', (commanded, measured), least_span=LEAST_WAY_SPAN),
            Panel('error [mm]', (error,), least_span=LEAST_ERROR_SPAN),
        ),
    )


def _describe_variance(run: RunMetrics) -> RunFigure:
    """Return the noise variance of all contacts (P04 Fig. 6)."""
    traces = []
    for contact in run.contacts:
        colour = choose_colour(contact.column)
        label = _label_variance(contact)
        traces.append(Trace(label, contact.noise_variance, colour))
    panel = Panel('R [N²]', traces, logarithmic=True)
    return RunFigure('fig6_noise_variance', 'Noise variance R found on-line', (panel,))


def _label_variance(contact: ContactMetrics) -> str:
    """Return whose R a curve is, its medians, and the greatest from the motion's start on."""
    variance = contact.noise_variance
    medians = []
    words = {'rest': 'at rest', 'moving': 'moving'}
    for name, window in contact.asked_windows.items():
        median = statistic_within(window, variance, np.median)
        if median is not None:
            medians.append(f'{median:.3g} {words[name]}')
    label = contact.name
    if medians:
        label = f'{label}: median {", ".join(medians)}'
    started = variance[_find_motion(contact.run)]
    if np.isfinite(started).any():
        greatest = np.nanmax(started)
        label += f'; at most {greatest:.3g} from the start of the motion on'
    return label


def _find_motion(run: RunSeries) -> Mask:
    """Return the samples of the motion, of a scenario's from its start on, shape (m,)."""
    if run.setup.commanded_by_topic:
        return run.windows.moving
    return run.data.time >= run.motion_start


def _describe_stiffness(run: RunMetrics) -> RunFigure:
    """Return the stiffness that was found on-line, with its errors, and that in use."""
    data = run.data
    found = np.where(data.stiffness_est > 0.0, data.stiffness_est, np.nan)
    upper = found + 2.0 * data.stiffness_std
    panels = []
    for i, name in enumerate(data.contact_names):
        in_use = data.stiffness[:, i]
        traces = (
            Trace('model in use', in_use, COMMANDED_COLOUR, dashed=True),
            Trace('estimated', found[:, i], ESTIMATED_COLOUR),
            Trace('with 2 standard errors', upper[:, i], TRUE_COLOUR, faint=True),
        )
        panels.append(Panel(f'{name} [N/m]', traces, logarithmic=True))
    return RunFigure('stiffness', 'Stiffness found on-line', panels)


def list_shaded_spans(run: RunMetrics) -> list[ShadedSpan]:
    """
    Return the windows that the summary is of, without the pauses between setpoints.

    Two of a kind less than 0.1 s apart are one. The start of a scenario's motion, up to its
    window, is one as well: R is greatest there.
    """
    windows = {
        'rest': run.windows.rest,
        'start': _find_motion(run) & ~run.windows.moving,
        'moving': run.windows.moving,
    }
    time = run.data.time
    pause = np.ones(round(LONGEST_PAUSE * run.data.rate), dtype=bool)
    spans = []
    for name, window in windows.items():
        for begin, end in find_true_stretches(binary_closing(window, pause) | window):
            spans.append(ShadedSpan(name, float(time[begin]), float(time[end - 1])))
    return spans
