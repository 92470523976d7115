"""Maps of the force along a path: over the surface of a contact, and pass by pass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import re
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.control.motions import surface_axes
from multicontact_control.judging.contact_metrics import ContactMetrics
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.passes import FORCE_BAND, RunPasses
import numpy as np
import pandas as pd

MAP_PREFIX = 'map_'
LEAST_CELL = 0.5  # mm of the path, whose mean force has a colour of its own
CELLS = 300  # at most, of the longest pass
LARGEST_LINE_SHARE = 0.05  # of its length, up to which a path is as wide as a line
SHOWN_PERCENTILE = 98.0  # of the errors, at which the colours end
COLOURS = 'coolwarm'
PATH_WIDTH = 6.0  # points
LARGEST_ROW = 40.0  # points, of a pass as a row
ROWS_HEIGHT = 150.0  # points, of all rows
ONE_PLACE = 5.0  # mm, within which passes begin at one place
MOST_NUMBERS = 20  # of passes, beside their rows


class Ribbon(NamedTuple):
    """The force of a contact on one pass, in k cells along the path."""

    number: int  # of the pass, from 1 on
    distance: Vector  # along the path from the start of the pass, shape (k,) [mm]
    places: Matrix  # u and v from the start of the path, shape (k, 2) [mm]
    error: Vector  # mean of the force less its command, shape (k,) [N]
    lost: Mask  # whether the contact was lost in the cell, shape (k,)


def draw_maps(run: RunMetrics, title: str) -> Iterator[tuple[str, Figure]]:
    """
    Yield the map of each contact that presses on a path: name of its file, and the sheet.

    Colours are the force less its command. A path over a surface is drawn in the coordinates u and
    v of the surface, and pass by pass beside it; one along a line pass by pass alone. Without a
    path, or a measured pose, there are no maps. `title` says what the run was.
    """
    path = RunPasses(run)
    for index, contact in enumerate(path.contacts):
        axes = _choose_axes(path, contact)
        ribbons = _collect_ribbons(path, index, axes)
        if ribbons:
            name = re.sub(r'[^\w.-]', '_', f'{MAP_PREFIX}{contact.name}')
            yield name, _draw_map(contact, ribbons, axes, title)


def _choose_axes(path: RunPasses, contact: ContactMetrics) -> Matrix:
    """
    Return the axes u and v of a contact's surface as rows, shape (2, 3).

    Of a recording that does not tell the normal, the surface is that of the two world axes that
    the path goes along most.
    """
    config = path.run.setup.controller
    if config.robot.urdf:
        normal = np.array(config.contacts[contact.name].normal_world)
    else:
        extents = np.zeros(3)
        for stretch in path.passes:
            poses = path.run.data.position_des[stretch.begin : stretch.end]
            extents = np.maximum(
                extents, np.nanmax(poses, axis=0) - np.nanmin(poses, axis=0)
            )
        normal = -np.eye(3)[np.argmin(extents)]
    return surface_axes(normal)[:2]


def _collect_ribbons(path: RunPasses, index: int, axes: Matrix) -> list[Ribbon]:
    """Return the passes of a contact, by its index, that its force and the pose are known of."""
    data = path.run.data
    contact = path.contacts[index]
    measured = np.isfinite(data.position).all(axis=1)
    longest = max((stretch.length for stretch in path.passes), default=0.0)
    cell = max(LEAST_CELL, 1e3 * longest / CELLS)
    ribbons: list[Ribbon] = []
    origin = None
    for number, stretch in enumerate(path.passes, start=1):
        window = path.list_windows(stretch)[index] & measured
        if not window.any():
            continue
        places = 1e3 * data.position[window] @ axes.T
        if origin is None:
            origin = places[0]
        distance = 1e3 * (path.distance[window] - path.distance[stretch.begin])
        samples = pd.DataFrame(places - origin, columns=['u', 'v'])
        samples['distance'] = distance
        samples['error'] = contact.error[window]
        samples['lost'] = contact.force[window] <= 0.0
        cells = samples.groupby(distance // cell)
        means = cells.mean()
        ribbons.append(
            Ribbon(
                number,
                means['distance'].to_numpy(),
                means[['u', 'v']].to_numpy(),
                means['error'].to_numpy(),
                cells['lost'].any().to_numpy(),
            )
        )
    return ribbons


def _draw_map(
    contact: ContactMetrics, ribbons: Sequence[Ribbon], axes: Matrix, title: str
) -> Figure:
    """Return the sheet of a contact's passes."""
    errors = np.concatenate([ribbon.error for ribbon in ribbons])
    largest = float(np.percentile(np.abs(errors), SHOWN_PERCENTILE))
    largest_band = FORCE_BAND * float(np.nanmax(contact.command))
    largest = max(largest, largest_band)
    colours = Normalize(-largest, largest)
    along = _find_line(ribbons)
    sheet = Figure(figsize=(9.5, 4.5), layout='constrained')
    if along is None:
        surface, rows = sheet.subplots(1, 2)
        _draw_surface(surface, ribbons, axes, colours)
        _draw_rows(rows, ribbons, [ribbon.distance for ribbon in ribbons], colours)
        rows.set_xlabel('way from the start of the pass [mm]')
    else:
        rows = sheet.subplots()
        ways = [ribbon.places @ along for ribbon in ribbons]
        _draw_rows(rows, ribbons, ways, colours)
        _mark_start(rows, 0.0, ribbons[0].number)
        rows.set_xlabel('place along the line, from the start of the path [mm]')
    kind = 'measured'
    if contact.has_truth:
        kind = 'true'
    bar = sheet.colorbar(rows.collections[0], ax=sheet.axes, extend='both', pad=0.02)
    bar.set_label(f'{kind} force less command [N]')
    sheet.suptitle(f'Force along the path: {contact.name}\n{title}', fontsize=10)
    return sheet


def _find_line(ribbons: Sequence[Ribbon]) -> Vector | None:
    """Return the direction of a path that is a line, as of its first pass, (2,), else None."""
    places = np.concatenate([ribbon.places for ribbon in ribbons])
    centred = places - places.mean(axis=0)
    _, widths, directions = np.linalg.svd(centred, full_matrices=False)
    if widths[1] > LARGEST_LINE_SHARE * widths[0]:
        return None
    first = ribbons[0].places
    sense = np.sign(directions[0] @ (first[-1] - first[0]))
    along: Vector = sense * directions[0]
    return along


def _draw_surface(
    canvas: Axes, ribbons: Sequence[Ribbon], axes: Matrix, colours: Normalize
) -> None:
    """Draw a path over the surface, with the number of each pass where it begins."""
    for ribbon in ribbons:
        _draw_ribbon(canvas, ribbon, ribbon.places, colours, PATH_WIDTH)
    for place, numbers in _list_starts(ribbons):
        canvas.annotate(
            numbers,
            tuple(place),
            xytext=(7, 7),
            textcoords='offset points',
            fontsize=8,
        )
    _mark_start(canvas, 0.0, 0.0)
    canvas.set_xlabel(_label_axis('u', axes[0]))
    canvas.set_ylabel(_label_axis('v', axes[1]))
    canvas.set_aspect('equal', adjustable='datalim')
    canvas.margins(0.08)
    canvas.grid(alpha=0.3)


def _list_starts(ribbons: Sequence[Ribbon]) -> list[tuple[Vector, str]]:
    """Return where passes begin, and their numbers: at one place the first and the last."""
    by_place: dict[tuple[float, ...], list[Ribbon]] = {}
    for ribbon in ribbons:
        place = np.round(ribbon.places[0] / ONE_PLACE).tolist()
        by_place.setdefault(tuple(place), []).append(ribbon)
    starts = []
    for first, *others in by_place.values():
        numbers = str(first.number)
        if others:
            numbers += f' ... {others[-1].number}'
        starts.append((first.places[0], numbers))
    return starts


def _mark_start(canvas: Axes, x: float, y: float) -> None:
    """Draw a ring where the path begins."""
    canvas.plot(x, y, 'o', color='black', fillstyle='none', markersize=11)


def _draw_rows(
    canvas: Axes, ribbons: Sequence[Ribbon], ways: Sequence[Vector], colours: Normalize
) -> None:
    """Draw passes as rows below each other, over a way along each [mm]."""
    width = min(LARGEST_ROW, ROWS_HEIGHT / len(ribbons))
    for ribbon, way in zip(ribbons, ways):
        points = np.column_stack([way, np.full(len(way), ribbon.number)])
        _draw_ribbon(canvas, ribbon, points, colours, width)
    canvas.set_ylabel('pass')
    canvas.set_ylim(ribbons[-1].number + 0.7, ribbons[0].number - 0.7)
    numbers = MaxNLocator(MOST_NUMBERS, integer=True, min_n_ticks=1)
    canvas.yaxis.set_major_locator(numbers)
    canvas.grid(alpha=0.3, axis='x')


def _draw_ribbon(
    canvas: Axes, ribbon: Ribbon, points: Matrix, colours: Normalize, width: float
) -> None:
    """Draw cells as a line of some width [points] in the colour of their error, (k, 2) [mm]."""
    bounds = np.vstack([points[:1], 0.5 * (points[1:] + points[:-1]), points[-1:]])
    cells = np.stack([bounds[:-1], points, bounds[1:]], axis=1)
    coloured = LineCollection(
        list(cells), array=ribbon.error, cmap=COLOURS, norm=colours, linewidth=width
    )
    canvas.add_collection(coloured)
    canvas.autoscale_view()
    lost = points[ribbon.lost]
    canvas.plot(lost[:, 0], lost[:, 1], 'x', color='black', markersize=6)


def _label_axis(name: str, axis: Vector) -> str:
    """Return what an axis of a surface is called, and where it points to in the world."""
    x, y, z = axis.round(2) + 0.0
    return f'{name} [mm], along ({x:g}, {y:g}, {z:g})'
