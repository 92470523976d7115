"""The surfaces of a simulator that runs: where they are, and how stiff and rough it makes them."""

from __future__ import annotations

import time
from typing import Any

from multicontact_control.config import Vector3
from multicontact_control.nodes import topics
from multicontact_control.nodes.link import ControllerLink
from multicontact_control.view.source import DrawnSurface, SurfaceState
import numpy as np
from rcl_interfaces.srv import ListParameters
from sim_bridge.surface_patch import Patch
from visualization_msgs.msg import Marker

# Time without markers of surfaces after which a graph has no simulator [s].
SIMULATOR_WAIT = 3.0
MARKER_PERIOD = 0.01  # s, of looking for these markers
STIFFNESS = '.stiffness'  # ends one parameter of each surface
# Normal of a surface whose triangles say where it faces.
INTO_SURFACE = (0.0, 0.0, -1.0)


class SimulatedSurfaces:
    """
    Finds the surfaces of a simulator by its markers and parameters, and changes them.

    A drawn surface is a contact or an obstacle. Several surfaces of the simulator can make up one
    contact, as tips make up an edge: they are drawn as one, and change together.

    Parameters
    ----------
    link
        Connection that hears `topics.SURFACE_MARKERS`. Without a simulator, the constructor waits
        `SIMULATOR_WAIT` for these markers, and there are no surfaces.

    Attributes
    ----------
    drawn
        The surfaces as they are at the start, in the order of the markers.
    states
        Stiffness and friction of each drawn surface by name, as the page set them last.

    Raises
    ------
    RunError
        If the simulator does not answer.

    """

    def __init__(self, link: ControllerLink) -> None:
        self._link = link
        self._parts: dict[str, list[str]] = {}  # the simulator's, by the drawn surface
        self.drawn: tuple[DrawnSurface, ...] = ()
        self.states: dict[str, SurfaceState] = {}
        message = self._await_markers()
        if message is not None:
            self.drawn = tuple(map(_read_surface, message.markers))
            self._read_states()

    def _await_markers(self) -> Any | None:
        """Return the message of the markers, None if none comes within `SIMULATOR_WAIT`."""
        give_up = time.monotonic() + SIMULATOR_WAIT
        while True:
            message = self._link.get_newest(topics.SURFACE_MARKERS)
            if message is not None or time.monotonic() > give_up:
                return message
            time.sleep(MARKER_PERIOD)

    def _read_states(self) -> None:
        """Ask the simulator for the parameters of the surfaces that are drawn."""
        drawn_names = {surface.name for surface in self.drawn}
        listed = self._link.ask_service(
            topics.SIM,
            ListParameters,
            'list_parameters',
            ListParameters.Request(prefixes=['surfaces']),
        )
        for parameter in listed.result.names:
            if not parameter.endswith(STIFFNESS):
                continue
            surface = parameter.removesuffix(STIFFNESS)
            stiffness, friction, contact = self._link.get_parameters(
                topics.SIM, parameter, f'{surface}.friction', f'{surface}.contact'
            )
            name = contact if contact else surface.split('.')[1]
            if name in drawn_names:
                self._parts.setdefault(name, []).append(surface)
                self.states[name] = SurfaceState(stiffness, friction)

    def change_surface(self, name: str, stiffness: float, friction: float) -> str:
        """
        Change all parts of a drawn surface in the simulator, and say so in words.

        Parameters
        ----------
        name
            Name of the drawn surface, one of `states`.
        stiffness
            Normal stiffness [N/m].
        friction
            Coefficient of Coulomb friction.

        Returns
        -------
        str
            Name and new values, for the user.

        Raises
        ------
        RunError
            If the simulator refuses a value, with its reason.

        """
        values = {}
        for part in self._parts[name]:
            values[f'{part}.stiffness'] = stiffness
            values[f'{part}.friction'] = friction
        self._link.set_parameters(topics.SIM, values)
        self.states[name] = SurfaceState(stiffness, friction)
        return f'{name}: {stiffness:g} N/m, friction {friction:g}'

    def locate_surfaces(self) -> dict[str, Vector3]:
        """
        Return the point on each drawn surface where the simulator has it now, world axes [m].

        It comes from the newest markers; without a simulator it is empty.
        """
        message = self._link.get_newest(topics.SURFACE_MARKERS)
        if message is None:
            return {}
        return {_read_name(marker): _read_place(marker) for marker in message.markers}


def _read_name(marker: Marker) -> str:
    _, _, name = marker.ns.rpartition('/')
    return str(name)


def _read_place(marker: Marker) -> Vector3:
    place = marker.pose.position
    return place.x, place.y, place.z


def _read_surface(marker: Marker) -> DrawnSurface:
    """Return the surface of a marker, whose points are the corners of triangles."""
    corners = np.array([(point.x, point.y, point.z) for point in marker.points])
    triangles = np.arange(len(corners)).reshape(-1, 3)
    return DrawnSurface(
        _read_name(marker),
        INTO_SURFACE,
        _read_place(marker),
        Patch(corners, triangles),
    )
