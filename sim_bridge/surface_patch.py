"""What is seen of a surface: a slab around a point of it, curved as it is, and its marker."""

from __future__ import annotations

from typing import NamedTuple

from geometry_msgs.msg import Point
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.nodes import messages, topics
import numpy as np
from sim_bridge.config import PlantConfig, SurfaceConfig
from sim_bridge.surface import track_direction
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

SIZE, THICKNESS = (
    (0.70, 0.34),
    0.016,
)  # m, along the track and across it; behind the surface
CELLS = (14, 6)  # of what is curved
LARGEST_ANGLE = 0.9  # sine of the angle up to which what is strongly curved is drawn
NAMESPACE = 'surfaces'
COLOURS = (
    (0.77, 0.73, 0.66),
    (0.69, 0.75, 0.80),
    (0.73, 0.78, 0.71),
    (0.80, 0.72, 0.75),
)
RATE = 25.0  # Hz, of surfaces that move


class Patch(NamedTuple):
    """A closed mesh."""

    vertices: Matrix  # from the point of the surface, world axes, shape (m, 3) [m]
    # Three vertices each, counterclockwise from outside, shape (k, 3).
    faces: np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def shape_surface_patch(
    normal_world: Vector, radius: float = 0.0, *, ball: bool = False
) -> Patch:
    """
    Return what a surface looks like, by its unit normal INTO the surface, shape (3,).

    The radius [m] is that of a `SurfaceConfig`; a `ball` is curved all around, and not along the
    track alone.
    """
    track = track_direction(normal_world)
    across = np.cross(normal_world, track)
    cells = CELLS if radius else (1, 1)
    reach = (
        LARGEST_ANGLE * abs(radius) * (np.sqrt(0.5) if ball else 1.0)
        if radius
        else np.inf
    )
    halves = (min(0.5 * SIZE[0], reach), min(0.5 * SIZE[1], reach if ball else np.inf))
    u, v = (np.linspace(-half, half, count + 1) for half, count in zip(halves, cells))
    along, aside = (grid.ravel()[:, None] for grid in np.meshgrid(u, v, indexing='ij'))
    away = along**2 + (aside**2 if ball else 0.0)
    depth = radius - np.sign(radius) * np.sqrt(np.maximum(radius**2 - away, 0.0))
    front = along * track + aside * across + depth * normal_world
    return Patch(
        np.concatenate([front, front + THICKNESS * normal_world]), _slab(*cells)
    )


def shape_configured_patch(surface: SurfaceConfig) -> Patch:
    """Return what a surface of the plant looks like."""
    return shape_surface_patch(
        np.array(surface.normal_world), surface.radius, ball=surface.shape == 'sphere'
    )


def _slab(rows: int, columns: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return the faces of a grid, of the same grid behind it, and of the sides between them."""
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    count = number.size
    a, b, c, d = (
        corner.ravel()
        for corner in (
            number[:-1, :-1],
            number[1:, :-1],
            number[1:, 1:],
            number[:-1, 1:],
        )
    )
    front = [(a, c, b), (a, d, c)]
    back = [(a + count, b + count, c + count), (a + count, c + count, d + count)]
    loop = np.concatenate(
        [number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]]
    )
    after = np.roll(loop, -1)
    sides = [(loop, after, after + count), (loop, after + count, loop + count)]
    return np.concatenate([np.column_stack(face) for face in front + back + sides])


class SurfaceMarkers:
    """The surfaces of a plant as slabs, one for the tips of an edge or plane together."""

    def __init__(self, config: PlantConfig, *, rate: float) -> None:
        surfaces = [config.surfaces[name] for name in config.drawn.values()]
        self._numbers = [config.met.index(name) for name in config.drawn.values()]
        self._every = max(1, round(rate / RATE))
        self._moving = any(surface.velocity for surface in surfaces)
        self._message = MarkerArray()
        for number, (name, surface) in enumerate(zip(config.drawn, surfaces)):
            patch = shape_configured_patch(surface)
            red, green, blue = COLOURS[number % len(COLOURS)]
            marker = Marker(
                ns=f'{NAMESPACE}/{name}',
                id=number,
                type=Marker.TRIANGLE_LIST,
                color=ColorRGBA(r=red, g=green, b=blue, a=1.0),
                points=[
                    Point(x=x, y=y, z=z)
                    for x, y, z in patch.vertices[patch.faces].reshape(-1, 3).tolist()
                ],
            )
            marker.header.frame_id = topics.WORLD_FRAME
            marker.pose.orientation.w = 1.0
            marker.scale.x = marker.scale.y = marker.scale.z = 1.0
            self._message.markers.append(marker)

    def due(self, tick: int) -> bool:
        """Return whether surfaces that move are to be shown with the sample `tick`."""
        return self._moving and tick % self._every == 0

    def message(self, stamp: int, places: Matrix) -> MarkerArray:
        """Return the slabs at a time [ns] and points of all surfaces, shape (no, 3) [m]."""
        time = messages.ns_to_stamp(stamp)
        for marker, number in zip(self._message.markers, self._numbers):
            marker.header.stamp = time
            position = marker.pose.position
            position.x, position.y, position.z = places[number].tolist()
        return self._message
