"""Curves over a sliding window: forces, R, innovation, and torque against its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
import math
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.view.source import (
    count_point_columns,
    KINDS,
    POINTS,
    RATE,
    Scene,
)
import numpy as np

WINDOWS = {'5 s': 5.0, '10 s': 10.0, '30 s': 30.0, '60 s': 60.0}
FIRST_WINDOW = '10 s'
MOST_POINTS = 250  # per curve
CHART_HEIGHT = 92  # px
LONGEST_LEGEND = 8  # curves; a chart with more has no legend
COLOURS = ('#e07a28', '#2e74be', '#34965c', '#8a5fb0', '#b04a5a', '#7a7f87')
JOINT_COLOURS = (
    '#4c6a92',
    '#7a9cc6',
    '#5aa08c',
    '#c29b4b',
    '#c46f5a',
    '#8d6b94',
    '#6b7280',
)
# Styles of curves, as uPlot wants them. The forces on a contact lie upon each other.
PLAIN = {'width': 1.5}
THIN = {'width': 1.0}
WIDE = {'width': 5.0, 'alpha': 0.35}
DASHED = {'width': 1.5, 'dash': (6, 6)}
NO_POINTS = {'show': False}
# Each chart has a curve that is not seen, so that its axis holds two values at least.
UNSEEN = {'label': '\u00a0', 'stroke': 'transparent', 'points': NO_POINTS}
HEADROOM = 1.1  # of the values on the axis over those of the curves
GRID = {'stroke': '#eceef0', 'width': 1}
AXIS = {
    'font': '11px sans-serif',
    'stroke': '#6b7280',
    'grid': GRID,
    'ticks': {'show': False},
}
TIME_AXIS = {'size': 24, **AXIS}
VALUE_AXIS = {
    'size': 44,
    'space': 15,  # px, between grid lines at least: there are three or more
    **AXIS,
}
LOGARITHMIC = {'distr': 3}
SMALLEST_VARIANCE = 1e-4  # N^2, where a logarithm of R ends
SHOWN_VARIANCES = (0.1, 10.0)  # N^2, of R at least


class PointHistory:
    """
    The newest points of all curves, for as long as the longest of `WINDOWS`.

    Parameters
    ----------
    width
        Number of columns of `Snapshot.points`, of which the first is time [s].

    """

    def __init__(self, width: int) -> None:
        longest = max(WINDOWS.values())
        self._capacity = round(longest * RATE * POINTS)
        self._points = np.empty((0, width))

    def add_points(self, points: Matrix) -> None:
        """
        Append points, shape (k, width), and forget the oldest beyond the longest window.

        If their time is not after that of the points before, a recording was searched: the
        history begins anew.
        """
        if not len(points):
            return
        if len(self._points) and points[0, 0] <= self._points[-1, 0]:
            self._points = self._points[:0]
        joined = np.concatenate([self._points, points])
        self._points = joined[-self._capacity :]

    def select_last_seconds(self, duration: float) -> Matrix:
        """
        Return the points of the last seconds, shape (k, width).

        More than `MOST_POINTS` are thinned out to the extremes of blocks, which keep each peak.
        Without any point k is 0.

        Parameters
        ----------
        duration
            Length of time before the newest point [s].

        """
        points = self._points
        if not len(points):
            return points
        times = points[:, 0]
        points = points[times > times[-1] - duration]
        size = math.ceil(2 * len(points) / MOST_POINTS)
        return find_block_extremes(points, size)


def find_block_extremes(points: Matrix, size: int) -> Matrix:
    """
    Return the smallest and the largest value of every `size` points, in each column.

    Two points stand for each block, with the times of its first and its middle one; a last block
    that is not whole stays as it is, and so do all points if `size` is at most 2.

    Parameters
    ----------
    points
        Points with time in the first column, shape (k, width).
    size
        Number of points in a block.

    """
    if size <= 2:
        return points
    columns = points.shape[1]
    whole = len(points) // size * size
    blocks = points[:whole].reshape(-1, size, columns)
    least = np.fmin.reduce(blocks, axis=1)
    greatest = np.fmax.reduce(blocks, axis=1)
    pairs = np.stack([least, greatest], axis=1)
    pairs[:, 0, 0] = blocks[:, 0, 0]
    pairs[:, 1, 0] = blocks[:, size // 2, 0]
    return np.concatenate([pairs.reshape(-1, columns), points[whole:]])


class Curve(NamedTuple):
    """
    One curve of a chart.

    Attributes
    ----------
    label
        Its name in the legend.
    column
        Column of `Snapshot.points` that it shows.
    colour
        Colour of the line in HTML.
    style
        How the line is drawn, in the words of uPlot.

    """

    label: str
    column: int
    colour: str
    style: Mapping[str, Any] = PLAIN


class Chart(NamedTuple):
    """
    What a chart shows, and how.

    Attributes
    ----------
    title
        Quantity and unit.
    curves
        The curves, those at the bottom first.
    y
        Scale of the vertical axis, in the words of uPlot.
    factor
        What values are multiplied by to get the unit of the title.

    """

    title: str
    curves: list[Curve]
    y: dict[str, Any]
    factor: float = 1.0


class CurveCharts:
    """
    The charts of the page; the user chooses how many seconds they show.

    Parameters
    ----------
    gui
        The folder or tab of a viser server in which the charts are made.
    scene
        The contact forces, couples and joints to show, and whether true forces are known.

    Attributes
    ----------
    history
        The points that the charts show when they are drawn next.

    """

    def __init__(self, gui: Any, scene: Scene) -> None:
        self._width = count_point_columns(scene.config)
        self.history = PointHistory(self._width)
        self._gui = gui
        self._window = gui.add_dropdown(
            'window', tuple(WINDOWS), initial_value=FIRST_WINDOW
        )
        self._charts = plan_charts(scene)
        self._folder = gui.add_folder('last seconds, from now')
        self._plots: list[Any] = []
        self._replace_plots()

        async def show_window(_event: Any) -> None:
            """Draw the charts for the window that the user has chosen."""
            self._replace_plots()

        self._window.on_update(show_window)

    def _replace_plots(self) -> None:
        """Make the charts; anew for another window, as those of a browser keep their axes."""
        for plot in self._plots:
            plot.remove()
        self._plots.clear()
        x = {'time': False, 'range': (-WINDOWS[self._window.value], 0.0)}
        with self._folder:
            for chart, series in zip(self._charts, self._list_series_of_charts()):
                has_legend = len(chart.curves) <= LONGEST_LEGEND
                plot = self._gui.add_uplot(
                    series,
                    list_curve_options(chart),
                    title=chart.title,
                    height=CHART_HEIGHT,
                    scales={'x': x, 'y': chart.y},
                    axes=(TIME_AXIS, VALUE_AXIS),
                    legend={'show': has_legend, 'live': False},
                    padding=(6, 12, 0, 0),
                )
                self._plots.append(plot)

    def draw_curves(self) -> None:
        """
        Show the points that the history has now in every chart.

        Each chart is sent to the browsers as a whole, so that the page calls this less often than
        it adds points.
        """
        for plot, series in zip(self._plots, self._list_series_of_charts()):
            plot.data = series

    def _list_series_of_charts(self) -> list[tuple[Vector, ...]]:
        points = self.history.select_last_seconds(WINDOWS[self._window.value])
        if not len(points):
            points = np.zeros((1, self._width))
        return [compute_series(chart, points) for chart in self._charts]


def compute_series(chart: Chart, points: Matrix) -> tuple[Vector, ...]:
    """
    Return what a chart shows: the seconds from now, its curves, and the curve that is not seen.

    Parameters
    ----------
    chart
        The chart, with k curves.
    points
        Points of the window as in `Snapshot.points`, one at least, shape (m, width).

    Returns
    -------
    tuple[Vector, ...]
        As many as k + 2 vectors, each of shape (m,). Values that are not known become 0, as
        uPlot loses its axis over a NaN.

    """
    times = points[:, 0]
    seconds: Vector = times - times[-1]
    columns = [curve.column for curve in chart.curves]
    values = chart.factor * np.nan_to_num(points[:, columns])
    if chart.y == LOGARITHMIC:
        values = np.maximum(values, SMALLEST_VARIANCE)
        ends = SHOWN_VARIANCES
    else:
        lowest = min(values.min(), 0.0)
        highest = max(values.max(), 0.0)
        ends = (HEADROOM * lowest, HEADROOM * highest)
    unseen = np.resize(ends, len(values))
    curves = [np.ascontiguousarray(column) for column in values.T]
    return (seconds, *curves, unseen)


def list_curve_options(chart: Chart) -> tuple[dict[str, Any], ...]:
    """
    Return how each vector of `compute_series` is drawn, in the words of uPlot.

    The first are the seconds from now, the last is the curve that is not seen; its label is a
    space, as the legend lists it too.
    """
    options: list[dict[str, Any]] = [{'label': 's'}]
    for curve in chart.curves:
        line = {'label': curve.label, 'stroke': curve.colour, 'points': NO_POINTS}
        options.append({**line, **curve.style})
    options.append(UNSEEN)
    return tuple(options)


def plan_charts(scene: Scene) -> list[Chart]:
    """
    Return the charts of a scene from top to bottom.

    Each contact force or couple has a chart of its measured, estimated and desired value [N], with
    the true one below them where a simulator publishes it. Then come the noise variance R of all
    of them [N^2], their innovations [N], and the torque of each joint over its limit [%].
    """
    names = scene.config.column_names
    count = len(names)
    # `Snapshot.points` has a column for time, then `count` columns for each kind of curve.
    kinds = np.arange(1, 1 + KINDS * count).reshape(KINDS, count).tolist()
    measured, estimated, desired, true, variances, innovations = kinds
    torques = range(1 + KINDS * count, count_point_columns(scene.config))
    joints = [str(number + 1) for number in range(len(torques))]
    charts = []
    for i, name in enumerate(names):
        curves = []
        if scene.true_forces:
            curves.append(Curve('true', true[i], COLOURS[3], WIDE))
        curves.append(Curve('measured', measured[i], COLOURS[0], THIN))
        curves.append(Curve('estimated', estimated[i], COLOURS[1]))
        curves.append(Curve('desired', desired[i], COLOURS[2], DASHED))
        charts.append(Chart(f'force on {name} [N]', curves, build_soft_axis(0.0, 5.0)))
    variance_curves = _colour_curves(names, variances, COLOURS)
    innovation_curves = _colour_curves(names, innovations, COLOURS)
    torque_curves = _colour_curves(joints, torques, JOINT_COLOURS)
    return [
        *charts,
        Chart('R [N^2], logarithmic', variance_curves, LOGARITHMIC),
        Chart('innovation [N]', innovation_curves, build_soft_axis(-0.2, 0.2)),
        Chart(
            'torque of each joint, % of its limit',
            torque_curves,
            build_soft_axis(0.0, 100.0),
            factor=100.0,
        ),
    ]


def _colour_curves(
    labels: Sequence[str], columns: Sequence[int], colours: Sequence[str]
) -> list[Curve]:
    """Return a curve for each column; colours repeat if there are too few."""
    return [Curve(*parts) for parts in zip(labels, columns, cycle(colours))]


def build_soft_axis(lower: float, upper: float) -> dict[str, Any]:
    """
    Return the scale of an axis that reaches from `lower` to `upper` at least, for uPlot.

    Values beyond them widen it. Without them the axis would shrink to the noise of a force that
    does not change.
    """
    least = {'pad': 0.1, 'soft': lower, 'mode': 1}
    greatest = {'pad': 0.1, 'soft': upper, 'mode': 1}
    return {'range': {'min': least, 'max': greatest}}
