"""The surfaces of the plant for viewers, where they are now."""

from __future__ import annotations

from geometry_msgs.msg import Point
from multicontact_control.arrays import Matrix
from multicontact_control.nodes import messages, topics
from sim_bridge.config import PlantConfig
from sim_bridge.surface_patch import patch_of
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

NAMESPACE = 'surfaces'
COLOURS = ((0.77, 0.73, 0.66), (0.69, 0.75, 0.80), (0.73, 0.78, 0.71), (0.80, 0.72, 0.75))
RATE = 25.0  # Hz, of surfaces that move


class SurfaceMarkers:
    """The surfaces of a plant as slabs, one for the tips of an edge or plane together."""

    def __init__(self, config: PlantConfig, *, rate: float) -> None:
        surfaces = [config.surfaces[name] for name in config.drawn.values()]
        self._numbers = [config.met.index(name) for name in config.drawn.values()]
        self._every = max(1, round(rate / RATE))
        self._moving = any(surface.moves for surface in surfaces)
        self._message = MarkerArray()
        for number, (name, surface) in enumerate(zip(config.drawn, surfaces)):
            patch = patch_of(surface)
            red, green, blue = COLOURS[number % len(COLOURS)]
            marker = Marker(
                ns=f'{NAMESPACE}/{name}', id=number, type=Marker.TRIANGLE_LIST,
                color=ColorRGBA(r=red, g=green, b=blue, a=1.0), points=[
                    Point(x=x, y=y, z=z)
                    for x, y, z in patch.vertices[patch.faces].reshape(-1, 3).tolist()])
            marker.header.frame_id = topics.WORLD_FRAME
            marker.pose.orientation.w = 1.0
            marker.scale.x = marker.scale.y = marker.scale.z = 1.0
            self._message.markers.append(marker)

    def due(self, tick: int) -> bool:
        """Return whether surfaces that move are to be shown with the sample `tick`."""
        return self._moving and tick % self._every == 0

    def message(self, stamp: int, places: Matrix) -> MarkerArray:
        """
        Return the slabs, in a message that the next call changes.

        At a time [ns], with a point of each surface that may be met, shape (no, 3) [m].
        """
        time = messages.ns_to_stamp(stamp)
        for marker, number in zip(self._message.markers, self._numbers):
            marker.header.stamp = time
            position = marker.pose.position
            position.x, position.y, position.z = places[number].tolist()
        return self._message
