"""The paper's Figures 3-6, drawn from a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from textwrap import shorten

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.experiment.judge import STABLE
from multicontact_control.experiment.metrics import windows
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np

matplotlib.use('Agg')

MEASURED = '#4c78a8'
ESTIMATED = '#54a24b'
COMMANDED = '#222222'
TRUE = '#e45756'
WINDOW = '#f2f2f2'
TITLE_WIDTH = 110  # characters of the second line that fit


def draw_figures(
    data: RunData, setup: Setup, folder: Path, *, verdict: str = STABLE,
    formats: Sequence[str] = ('png',),
) -> list[Path]:
    """
    Draw the figures of a run.

    Parameters
    ----------
    data
        The recording.
    setup
        The configuration, for names and the judged windows.
    folder
        Where the files go.
    verdict
        What the run is called, and why; in the titles if it is not stable.
    formats
        Endings of the files, one each.

    Returns
    -------
    list of Path
        The files written.

    """
    title = (f'{setup.scenario.name}, plant {setup.plant_name}, '
             f'{setup.noise_estimator.estimator}, seed {setup.seed}')
    if verdict != STABLE:
        title += '\n' + shorten(verdict, TITLE_WIDTH, placeholder=' ...')
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, draw in figure_set(data).items():
        figure = Figure(figsize=(9.0, 6.0), layout='constrained')
        draw(figure, data, setup)
        figure.suptitle(f'{figure.get_suptitle()}\n{title}', fontsize=10)
        for ending in formats:
            paths.append(folder / f'{name}.{ending}')
            figure.savefig(paths[-1], dpi=130)
    return paths


def figure_set(data: RunData) -> dict[str, Callable[[Figure, RunData, Setup], None]]:
    """Return the figures of a run by file name: Figures 3 and 4 for each contact, 5 and 6."""
    figures: dict[str, Callable[[Figure, RunData, Setup], None]] = {}
    for i, contact in enumerate(data.contact_names):
        number = 3 + i if i < 2 else f'3_{i + 1}'
        figures[f'fig{number}_force_{contact}'] = partial(draw_force, contact=i)
    figures['fig5_motion'] = draw_motion
    figures['fig6_noise_variance'] = draw_noise_variance
    return figures


def draw_force(figure: Figure, data: RunData, setup: Setup, contact: int) -> None:
    """Draw measured and estimated force of one contact (P04 Figs 3, 4)."""
    name = data.contact_names[contact]
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    figure.suptitle(f'Contact force {name}')
    for axes, series, label, colour in (
            (upper, data.alpha_meas, 'measured', MEASURED),
            (lower, data.alpha_est, 'estimated (AOB)', ESTIMATED)):
        _shade(axes, data, setup)
        axes.plot(data.time, series[:, contact], color=colour, linewidth=0.5, label=label)
        axes.plot(data.time, data.alpha_des[:, contact], color=COMMANDED, linewidth=1.0,
                  linestyle='--', label='commanded')
        axes.set_ylabel('force [N]')
        axes.grid(alpha=0.3)
        axes.legend(loc='upper left', fontsize=8)
    lower.plot(data.time, data.alpha_true[:, contact], color=TRUE, linewidth=0.4, alpha=0.6,
               label='true', zorder=1.5)
    lower.legend(loc='upper left', fontsize=8)
    top = max(1.6 * float(np.nanmax(data.alpha_des[:, contact])), 5.0)
    seen = float(np.nanmax(data.alpha_meas[:, contact], initial=0.0))
    upper.set_ylim(min(-2.0, float(np.nanmin(data.alpha_meas[:, contact], initial=0.0))),
                   max(top, 1.1 * seen))
    lower.set_xlabel('time [s]')


def draw_motion(figure: Figure, data: RunData, setup: Setup) -> None:
    """Draw the wrist's translation along the motion's direction and its error (P04 Fig. 5)."""
    motion = setup.scenario.reference.motion
    direction = np.asarray(motion.direction_world if motion else (1.0, 0.0, 0.0))
    axis = 'xyz'[int(np.argmax(np.abs(direction)))] if motion else 'x'
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    figure.suptitle(f'Wrist motion along {axis}')
    travelled = data.position @ direction
    commanded = data.position_des @ direction
    for axes in (upper, lower):
        _shade(axes, data, setup)
        axes.grid(alpha=0.3)
    upper.plot(data.time, travelled, color=MEASURED, linewidth=1.2, label='measured')
    upper.plot(data.time, commanded, color=COMMANDED, linewidth=1.0, linestyle='--',
               label='commanded')
    upper.set_ylabel(f'{axis} [m]')
    upper.legend(loc='upper left', fontsize=8)
    lower.plot(data.time, 1e3 * (travelled - commanded), color=TRUE, linewidth=0.7)
    lower.set_ylabel('error [mm]')
    lower.set_xlabel('time [s]')


def draw_noise_variance(figure: Figure, data: RunData, setup: Setup) -> None:
    """Draw the estimated noise variance of every contact on a log axis (P04 Fig. 6)."""
    figure.suptitle('Estimated noise variance R')
    axes_list = np.atleast_1d(
        figure.subplots(len(data.contact_names), 1, sharex=True, sharey=True))
    for i, (name, axes) in enumerate(zip(data.contact_names, axes_list)):
        _shade(axes, data, setup)
        axes.semilogy(data.time, data.noise_variance[:, i], color=MEASURED, linewidth=0.7)
        for level, text in ((0.6, 'paper, at rest'), (100.0, 'paper, moving')):
            axes.axhline(level, color=COMMANDED, linewidth=0.7, linestyle=':')
            axes.annotate(text, (1.0, level), xycoords=('axes fraction', 'data'), fontsize=7,
                          ha='right', va='bottom')
        axes.set_ylabel(f'{name} [N$^2$]')
        axes.grid(alpha=0.3, which='both')
    axes_list[-1].set_xlabel('time [s]')


def _shade(axes: Axes, data: RunData, setup: Setup) -> None:
    """Shade the windows that the numbers of ``summary.json`` are taken from."""
    judged = windows(setup.scenario.reference, data.time)
    for window, label in ((judged.rest, 'rest'), (judged.moving, 'moving')):
        if window.any():
            times = data.time[window]
            axes.axvspan(times[0], times[-1], color=WINDOW, zorder=0)
            axes.annotate(label, (times[0], 1.0), xycoords=('data', 'axes fraction'),
                          fontsize=7, va='top', color='#777777', xytext=(2, -2),
                          textcoords='offset points')
