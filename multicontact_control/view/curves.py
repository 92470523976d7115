"""Curves over a sliding window: forces, R, innovation, and torque against its limit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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


class History:
    """The newest points of all curves, of as long as the longest of `WINDOWS`."""

    def __init__(self, width: int) -> None:
        self._count = round(max(WINDOWS.values()) * RATE * POINTS)
        self._points = np.empty((0, width))

    def add(self, points: Matrix) -> None:
        """Take points; time that goes back begins anew."""
        if len(points):
            later = len(self._points) and points[0, 0] > self._points[-1, 0]
            kept = self._points if later else self._points[:0]
            self._points = np.concatenate([kept, points])[-self._count :]

    def last(self, time: float) -> Matrix:
        """Return the points of the last seconds [s], or their extremes where they are too many."""
        points = self._points
        if not len(points):
            return points
        points = points[points[:, 0] > points[-1, 0] - time]
        return extremes(points, -(-2 * len(points) // DRAWN))


def extremes(points: Matrix, size: int) -> Matrix:
    """Return the smallest and the largest value of every `size` points, in each column."""
    if size <= 2:
        return points
    whole = points[: len(points) // size * size].reshape(-1, size, points.shape[1])
    pairs = np.stack(
        [np.fmin.reduce(whole, axis=1), np.fmax.reduce(whole, axis=1)], axis=1
    )
    pairs[:, :, 0] = whole[:, [0, size // 2], 0]
    return np.concatenate(
        [pairs.reshape(-1, points.shape[1]), points[len(whole) * size :]]
    )


class Chart(NamedTuple):
    """What a chart shows."""

    title: str
    labels: Sequence[str]  # of its curves
    columns: list[int]  # of the points
    colours: Sequence[str]
    y: dict[str, Any]  # its axis, as uPlot wants it
    scale: float = 1.0  # that values are multiplied by
    styles: Sequence[
        Mapping[str, Any]
    ] = ()  # of its curves, where they are not all alike


class Curves:
    """The charts of a page for forces and couples, and joints by name; made where `gui` is."""

    def __init__(
        self,
        gui: Any,
        names: Sequence[str],
        joints: Sequence[str],
        true_forces: bool,
    ) -> None:
        self._width = 1 + KINDS * len(names) + len(joints)
        self.history = History(self._width)
        self._gui = gui
        self._window = gui.add_dropdown('window', tuple(WINDOWS), initial_value=FIRST)
        self._charts = charts_of(names, joints, true_forces)
        self._folder = gui.add_folder('last seconds, from now')
        self._plots: list[Any] = []
        self._make()

        async def changed(_event: Any) -> None:
            self._make()

        self._window.on_update(changed)

    def _make(self) -> None:
        """Make the charts; anew for another window, as those of a browser keep their axes."""
        with self._folder:
            for plot in self._plots:
                plot.remove()
            x = {'time': False, 'range': (-WINDOWS[self._window.value], 0.0)}
            self._plots = [
                self._gui.add_uplot(
                    data,
                    ({'label': 's'}, *series_of(chart), UNSEEN),
                    title=chart.title,
                    height=HEIGHT,
                    scales={'x': x, 'y': chart.y},
                    axes=({'size': 24, **AXIS}, {'size': 44, 'space': SPACE, **AXIS}),
                    legend={'show': len(chart.labels) <= LISTED, 'live': False},
                    padding=(6, 12, 0, 0),
                )
                for chart, data in zip(self._charts, self._data())
            ]

    def draw(self) -> None:
        """Show what has come."""
        for plot, data in zip(self._plots, self._data()):
            plot.data = data

    def _data(self) -> list[tuple[Vector, ...]]:
        """Return what each chart shows: seconds from now, then its curves."""
        points = self.history.last(WINDOWS[self._window.value])
        if not len(points):
            points = np.zeros((1, self._width))
        time: Vector = points[:, 0] - points[-1, 0]
        series = []
        for chart in self._charts:
            # uPlot loses its axis over a single number that is none.
            values = chart.scale * np.nan_to_num(points[:, chart.columns])
            shown = HEADROOM * min(values.min(), 0.0), HEADROOM * max(values.max(), 0.0)
            if chart.y == LOGARITHMIC:
                values, shown = np.maximum(values, FLOOR), SHOWN
            values = np.column_stack([values, np.resize(shown, len(values))])
            series.append(
                (time, *(np.ascontiguousarray(column) for column in values.T))
            )
        return series


def series_of(chart: Chart) -> Iterator[dict[str, Any]]:
    """Yield how each curve of a chart is drawn, as uPlot wants it."""
    for i, label in enumerate(chart.labels):
        style = chart.styles[i] if chart.styles else {'width': 1.5}
        yield {
            'label': label,
            'stroke': chart.colours[i % len(chart.colours)],
            'points': {'show': False},
            **style,
        }


def charts_of(
    names: Sequence[str], joints: Sequence[str], true_forces: bool
) -> list[Chart]:
    """Return what there is to show of these forces, couples and joints."""
    first = 0 if true_forces else 1  # the true force is drawn below the others
    *columns, torques = np.split(
        1 + np.arange(KINDS * len(names) + len(joints)),
        len(names) * np.arange(1, KINDS + 1),
    )
    *forces, variance, innovation = columns
    return [
        *(
            Chart(
                f'force on {name} [N]',
                ('true', 'measured', 'estimated', 'desired')[first:],
                [true, *each][first:],
                (COLOURS[3], *COLOURS[:3])[first:],
                axis(0.0, 5.0),
                styles=STYLES[first:],
            )
            for name, *each, true in zip(names, *forces)
        ),
        Chart('R [N^2], logarithmic', names, variance.tolist(), COLOURS, LOGARITHMIC),
        Chart('innovation [N]', names, innovation.tolist(), COLOURS, axis(-0.2, 0.2)),
        Chart(
            'torque of each joint, % of its limit',
            [str(k + 1) for k in range(len(joints))],
            torques.tolist(),
            JOINTS,
            axis(0.0, 100.0),
            100.0,
        ),
    ]


def axis(lower: float, upper: float) -> dict[str, Any]:
    """Return an axis that holds two values at least, so that noise is not all there is to see."""
    return {
        'range': {
            'min': {'pad': 0.1, 'soft': lower, 'mode': 1},
            'max': {'pad': 0.1, 'soft': upper, 'mode': 1},
        }
    }
