"""Curves over a sliding window: forces, R, innovation, and torque against its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.view.source import KINDS, POINTS, RATE
import numpy as np

FIRST = '10 s'
WINDOWS = {'5 s': 5.0, '10 s': 10.0, '30 s': 30.0, '60 s': 60.0}
DRAWN = 250  # points per curve at most
HEIGHT = 92  # px
LISTED = 8  # curves below a chart, at most
COLOURS = ('#e07a28', '#2e74be', '#34965c', '#8a5fb0', '#b04a5a', '#7a7f87')
JOINTS = ('#4c6a92', '#7a9cc6', '#5aa08c', '#c29b4b', '#c46f5a', '#8d6b94', '#6b7280')
# Of the forces on one contact, which lie upon each other: true, measured, estimated, desired.
STYLES = (
    {'width': 5.0, 'alpha': 0.35},
    {'width': 1.0},
    {'width': 1.5},
    {'width': 1.5, 'dash': (6, 6)},
)
GRID = {'stroke': '#eceef0', 'width': 1}
UNSEEN = {'label': '\u00a0', 'stroke': 'transparent', 'points': {'show': False}}
AXIS = {
    'font': '11px sans-serif',
    'stroke': '#6b7280',
    'grid': GRID,
    'ticks': {'show': False},
}
SPACE = 15  # px, between the lines of a grid at least: there are three or more
LOGARITHMIC = {'distr': 3}
FLOOR = 1e-4  # N^2, where a logarithm of R ends
# Of axes, by a curve that is not seen: N^2 of R at least, and room above the others.
SHOWN, HEADROOM = (0.1, 10.0), 1.1


class PointHistory:
    """
    The newest points of all curves, of as long as the longest of `WINDOWS`.

    Points have the columns of `Snapshot.points`, of which the first is time.
    """

    def __init__(self, width: int) -> None:
        self._count = round(max(WINDOWS.values()) * RATE * POINTS)
        self._points = np.empty((0, width))

    def add_points(self, points: Matrix) -> None:
        """Take points, shape (k, width); time that goes back begins anew."""
        if not len(points):
            return
        if len(self._points) and points[0, 0] <= self._points[-1, 0]:
            self._points = self._points[:0]
        self._points = np.concatenate([self._points, points])[-self._count :]

    def last_seconds(self, duration: float) -> Matrix:
        """Return the points of the last seconds [s], or their extremes where they are too many."""
        points = self._points
        if not len(points):
            return points
        points = points[points[:, 0] > points[-1, 0] - duration]
        return block_extremes(points, math.ceil(2 * len(points) / DRAWN))


def block_extremes(points: Matrix, size: int) -> Matrix:
    """
    Return the smallest and the largest value of every `size` points, in each column.

    Two points for each block, with the times of its first and its middle one; a last block that
    is not whole stays as it is.
    """
    if size <= 2:
        return points
    columns = points.shape[1]
    blocks = points[: len(points) // size * size].reshape(-1, size, columns)
    least = np.fmin.reduce(blocks, axis=1)
    greatest = np.fmax.reduce(blocks, axis=1)
    pairs = np.stack([least, greatest], axis=1)
    pairs[:, :, 0] = blocks[:, [0, size // 2], 0]
    rest = points[len(blocks) * size :]
    return np.concatenate([pairs.reshape(-1, columns), rest])


class Chart(NamedTuple):
    """What a chart shows: which columns of the points, and how each curve looks."""

    title: str
    labels: Sequence[str]  # of its curves
    columns: list[int]  # of the points
    colours: Sequence[str]
    y: dict[str, Any]  # its axis, as uPlot wants it
    scale: float = 1.0  # that values are multiplied by
    # Of its curves, where they are not all alike.
    styles: Sequence[Mapping[str, Any]] = ()


class CurveCharts:
    """
    The charts of a page for forces and couples, and joints by name; made where `gui` is.

    The user chooses how many seconds they show.
    """

    def __init__(
        self,
        gui: Any,
        names: Sequence[str],
        joints: Sequence[str],
        true_forces: bool,
    ) -> None:
        self._width = 1 + KINDS * len(names) + len(joints)
        self.history = PointHistory(self._width)
        self._gui = gui
        self._window = gui.add_dropdown('window', tuple(WINDOWS), initial_value=FIRST)
        self._charts = plan_charts(names, joints, true_forces)
        self._folder = gui.add_folder('last seconds, from now')
        self._plots: list[Any] = []
        self._add_plots()

        async def on_update(_event: Any) -> None:
            self._add_plots()

        self._window.on_update(on_update)

    def _add_plots(self) -> None:
        """Make the charts; anew for another window, as those of a browser keep their axes."""
        x_axis = {'size': 24, **AXIS}
        y_axis = {'size': 44, 'space': SPACE, **AXIS}
        with self._folder:
            for plot in self._plots:
                plot.remove()
            self._plots.clear()
            x = {'time': False, 'range': (-WINDOWS[self._window.value], 0.0)}
            for chart, series in zip(self._charts, self._series_of_charts()):
                plot = self._gui.add_uplot(
                    series,
                    ({'label': 's'}, *curve_options(chart), UNSEEN),
                    title=chart.title,
                    height=HEIGHT,
                    scales={'x': x, 'y': chart.y},
                    axes=(x_axis, y_axis),
                    legend={'show': len(chart.labels) <= LISTED, 'live': False},
                    padding=(6, 12, 0, 0),
                )
                self._plots.append(plot)

    def draw(self) -> None:
        """Show what has come since the charts were drawn last."""
        for plot, series in zip(self._plots, self._series_of_charts()):
            plot.data = series

    def _series_of_charts(self) -> list[tuple[Vector, ...]]:
        """Return what each chart shows: seconds from now, then its curves."""
        points = self.history.last_seconds(WINDOWS[self._window.value])
        if not len(points):
            points = np.zeros((1, self._width))
        time: Vector = points[:, 0] - points[-1, 0]
        series = []
        for chart in self._charts:
            # uPlot loses its axis over a single number that is none.
            values = chart.scale * np.nan_to_num(points[:, chart.columns])
            if chart.y == LOGARITHMIC:
                values = np.maximum(values, FLOOR)
                ends = SHOWN
            else:
                lowest = min(values.min(), 0.0)
                highest = max(values.max(), 0.0)
                ends = (HEADROOM * lowest, HEADROOM * highest)
            unseen = np.resize(ends, len(values))
            curves = [np.ascontiguousarray(column) for column in values.T]
            series.append((time, *curves, unseen))
        return series


def curve_options(chart: Chart) -> list[dict[str, Any]]:
    """Return how each curve of a chart is drawn, as uPlot wants it."""
    options = []
    for number, label in enumerate(chart.labels):
        style = chart.styles[number] if chart.styles else {'width': 1.5}
        colour = chart.colours[number % len(chart.colours)]
        curve = {'label': label, 'stroke': colour, 'points': {'show': False}}
        options.append({**curve, **style})
    return options


def plan_charts(
    names: Sequence[str], joints: Sequence[str], true_forces: bool
) -> list[Chart]:
    """
    Return the charts of some forces and couples (`names`) and joints.

    The true force is drawn below the others, if it is known.
    """
    first = 0 if true_forces else 1
    count = len(names)
    charts = []
    for number, name in enumerate(names):
        measured, estimated, desired, true = (
            1 + kind * count + number for kind in range(4)
        )
        charts.append(
            Chart(
                f'force on {name} [N]',
                ('true', 'measured', 'estimated', 'desired')[first:],
                [true, measured, estimated, desired][first:],
                (COLOURS[3], *COLOURS[:3])[first:],
                soft_axis(0.0, 5.0),
                styles=STYLES[first:],
            )
        )
    variance = list(range(1 + 4 * count, 1 + 5 * count))
    innovation = list(range(1 + 5 * count, 1 + 6 * count))
    torques = list(range(1 + KINDS * count, 1 + KINDS * count + len(joints)))
    return [
        *charts,
        Chart('R [N^2], logarithmic', names, variance, COLOURS, LOGARITHMIC),
        Chart('innovation [N]', names, innovation, COLOURS, soft_axis(-0.2, 0.2)),
        Chart(
            'torque of each joint, % of its limit',
            [str(number + 1) for number in range(len(joints))],
            torques,
            JOINTS,
            soft_axis(0.0, 100.0),
            100.0,
        ),
    ]


def soft_axis(lower: float, upper: float) -> dict[str, Any]:
    """Return an axis that holds two values at least, so that noise is not all there is to see."""
    return {
        'range': {
            'min': {'pad': 0.1, 'soft': lower, 'mode': 1},
            'max': {'pad': 0.1, 'soft': upper, 'mode': 1},
        }
    }
