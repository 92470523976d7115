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

LENGTH = 0.70  # m, along the track
WIDTH = 0.34  # m, across the track
THICKNESS = 0.016  # m, behind the surface
CURVED_CELLS = (14, 6)  # of a curved surface, along and across; a plane has one
LARGEST_SINE = 0.9  # of the angle up to which a strongly curved surface is drawn
NAMESPACE = 'surfaces'
COLOURS = (
    (0.77, 0.73, 0.66),
    (0.69, 0.75, 0.80),
    (0.73, 0.78, 0.71),
    (0.80, 0.72, 0.75),
)

Faces = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


class Patch(NamedTuple):
    """A closed mesh of triangles."""

    vertices: Matrix  # from the point of the surface, world axes, shape (m, 3) [m]
    faces: Faces  # three vertices each, counterclockwise from outside, shape (k, 3)


def shape_surface_patch(
    normal_world: Vector, radius: float = 0.0, *, ball: bool = False
) -> Patch:
    """
    Return what a surface looks like: a slab whose front is the surface.

    Parameters
    ----------
    normal_world
        Unit normal INTO the surface, world axes, shape (3,).
    radius
        As that of a `SurfaceConfig`: 0 for a plane, above 0 with its centre behind it [m].
    ball
        Whether a curved surface is curved all around, or along the track alone.

    """
    track = track_direction(normal_world)
    across = np.cross(normal_world, track)
    half_length = 0.5 * LENGTH
    half_width = 0.5 * WIDTH
    rows, columns = 1, 1
    if radius:
        rows, columns = CURVED_CELLS
        reach = LARGEST_SINE * abs(radius)
        if ball:
            reach *= np.sqrt(0.5)
            half_width = min(half_width, reach)
        half_length = min(half_length, reach)
    lengths = np.linspace(-half_length, half_length, rows + 1)
    widths = np.linspace(-half_width, half_width, columns + 1)
    along = np.repeat(lengths, len(widths))[:, np.newaxis]
    aside = np.tile(widths, len(lengths))[:, np.newaxis]
    squared = along**2
    if ball:
        squared += aside**2
    cap = np.sqrt(np.maximum(radius**2 - squared, 0.0))
    depth = radius - np.sign(radius) * cap
    front = along * track + aside * across + depth * normal_world
    back = front + THICKNESS * normal_world
    return Patch(np.concatenate([front, back]), _slab_faces(rows, columns))


def shape_configured_patch(surface: SurfaceConfig) -> Patch:
    """Return what a surface of a plant looks like, around its `point_world`."""
    return shape_surface_patch(
        np.array(surface.normal_world), surface.radius, ball=surface.shape == 'sphere'
    )


def _slab_faces(rows: int, columns: int) -> Faces:
    """Return the faces of a grid, of the same grid behind it, and of the sides between them."""
    front = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    behind = front.size  # from the number of a vertex to that of the one behind it
    a = front[:-1, :-1].ravel()
    b = front[1:, :-1].ravel()
    c = front[1:, 1:].ravel()
    d = front[:-1, 1:].ravel()
    front_faces = _join_corners((a, c, b), (a, d, c))
    back_faces = behind + _join_corners((a, b, c), (a, c, d))
    first_side = front[:-1, 0]
    second_side = front[-1, :-1]
    third_side = front[:0:-1, -1]
    fourth_side = front[0, :0:-1]
    rim = np.concatenate([first_side, second_side, third_side, fourth_side])
    following = np.roll(rim, -1)
    following_behind = following + behind
    side_faces = _join_corners(
        (rim, following, following_behind), (rim, following_behind, rim + behind)
    )
    return np.concatenate([front_faces, back_faces, side_faces])


def _join_corners(*triangles: tuple[Faces, Faces, Faces]) -> Faces:
    """Return faces of which each triple has the first, second and third vertices."""
    return np.concatenate([np.column_stack(corners) for corners in triangles])


def _make_marker(patch: Patch) -> Marker:
    """Return a marker of the triangles of a patch."""
    marker = Marker(type=Marker.TRIANGLE_LIST)
    marker.header.frame_id = topics.WORLD_FRAME
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    corners = patch.vertices[patch.faces].reshape(-1, 3)
    for x, y, z in corners.tolist():
        marker.points.append(Point(x=x, y=y, z=z))
    return marker


class SurfaceMarkers:
    """
    The surfaces of a plant as slabs for RViz and the page, one for each contact or obstacle.

    Parameters
    ----------
    config
        The surfaces; the tips of an edge or plane share a slab.
    rate
        Samples per second [Hz].

    """

    def __init__(self, config: PlantConfig, *, rate: float) -> None:
        surfaces = [config.surfaces[name] for name in config.drawn.values()]
        self._numbers = [config.met.index(name) for name in config.drawn.values()]
        self._period = max(1, round(rate / topics.MARKER_RATE))  # ticks
        self._moving = any(surface.velocity for surface in surfaces)
        self._message = MarkerArray()
        for number, (name, surface) in enumerate(zip(config.drawn, surfaces)):
            marker = _make_marker(shape_configured_patch(surface))
            marker.ns = f'{NAMESPACE}/{name}'
            marker.id = number
            red, green, blue = COLOURS[number % len(COLOURS)]
            marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
            self._message.markers.append(marker)

    def is_due(self, tick: int) -> bool:
        """Return whether surfaces that move are to be shown with the sample `tick`."""
        return self._moving and tick % self._period == 0

    def build_message(self, stamp: int, places: Matrix) -> MarkerArray:
        """
        Return the slabs as they are at a time.

        Parameters
        ----------
        stamp
            The time [ns].
        places
            A point of each surface in the order of `PlantConfig.met`, shape (no, 3) [m].

        """
        time = messages.ns_to_stamp(stamp)
        for marker, number in zip(self._message.markers, self._numbers):
            marker.header.stamp = time
            position = marker.pose.position
            position.x, position.y, position.z = places[number].tolist()
        return self._message
