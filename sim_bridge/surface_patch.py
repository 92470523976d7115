"""What a surface looks like: a slab around a point of it, curved as it is."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
import numpy as np
from sim_bridge.config import SurfaceConfig
from sim_bridge.surface import track_direction

SIZE, THICKNESS = (0.70, 0.34), 0.016  # m, along the track and across it; behind the surface
CELLS = (14, 6)  # of what is curved
LARGEST_ANGLE = 0.9  # sine of the angle up to which what is strongly curved is drawn


class Patch(NamedTuple):
    """A closed mesh."""

    vertices: Matrix  # from the point of the surface, world axes, shape (m, 3) [m]
    # Three vertices each, counterclockwise from outside, shape (k, 3).
    faces: np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def surface_patch(normal_world: Vector, radius: float = 0.0, *, ball: bool = False) -> Patch:
    """
    Return what a surface looks like.

    Parameters
    ----------
    normal_world
        Unit normal INTO the surface at the point, shape (3,).
    radius
        As of a `SurfaceConfig`: 0 for a plane, below 0 for a bowl [m].
    ball
        Whether it is curved all around, or along the track alone.

    """
    track = track_direction(normal_world)
    across = np.cross(normal_world, track)
    cells = CELLS if radius else (1, 1)
    u, v = (np.linspace(-half, half, count + 1) for half, count in zip(
        half_size(radius, ball=ball), cells))
    along, aside = (grid.ravel()[:, None] for grid in np.meshgrid(u, v, indexing='ij'))
    away = along ** 2 + (aside ** 2 if ball else 0.0)
    depth = radius - np.sign(radius) * np.sqrt(np.maximum(radius ** 2 - away, 0.0))
    front = along * track + aside * across + depth * normal_world
    return Patch(np.concatenate([front, front + THICKNESS * normal_world]), _slab(*cells))


def patch_of(surface: SurfaceConfig) -> Patch:
    """Return what a surface of the plant looks like."""
    return surface_patch(
        np.array(surface.normal_world), surface.radius, ball=surface.shape == 'sphere')


def half_size(radius: float, *, ball: bool) -> tuple[float, float]:
    """Return how far a slab reaches along the track and across it [m]."""
    along, across = (0.5 * size for size in SIZE)
    if radius == 0.0:
        return along, across
    reach = LARGEST_ANGLE * abs(radius)
    if not ball:
        return min(along, reach), across
    return min(along, np.sqrt(0.5) * reach), min(across, np.sqrt(0.5) * reach)


def _slab(rows: int, columns: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return the faces of a grid, of the same grid behind it, and of the sides between them."""
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    count = number.size
    a, b, c, d = (corner.ravel() for corner in (
        number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    front = [(a, c, b), (a, d, c)]
    back = [(a + count, b + count, c + count), (a + count, c + count, d + count)]
    loop = np.concatenate(
        [number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    after = np.roll(loop, -1)
    sides = [(loop, after, after + count), (loop, after + count, loop + count)]
    return np.concatenate([np.column_stack(face) for face in front + back + sides])
