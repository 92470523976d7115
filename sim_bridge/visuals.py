"""What a link looks like, in boxes, cylinders and spheres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import re
from typing import NamedTuple

from multicontact_control.config import Vector, Vector3

BOX, CYLINDER, SPHERE = 'box', 'cylinder', 'sphere'
IVORY, GREY, DARK, STEEL = 'ivory', 'grey', 'dark', 'steel'
COLOURS: dict[str, tuple[float, float, float, float]] = {
    IVORY: (0.90, 0.88, 0.83, 1.0), GREY: (0.62, 0.64, 0.67, 1.0),
    DARK: (0.23, 0.25, 0.29, 1.0), STEEL: (0.45, 0.52, 0.60, 1.0)}
UPRIGHT: Vector3 = (0.0, 0.0, 0.0)


class Visual(NamedTuple):
    """
    One body of what a link looks like.

    Attributes
    ----------
    shape
        `BOX`, `CYLINDER` or `SPHERE`.
    size
        Edges x, y, z; radius and length along z; or radius [m].
    position, rpy
        Of its centre and axes in the link's frame [m], [rad].
    colour
        One of `COLOURS`.

    """

    shape: str
    size: Vector
    position: Vector3
    rpy: Vector3 = UPRIGHT
    colour: str = IVORY


def with_visuals(urdf: str, visuals: Mapping[str, Sequence[Visual]]) -> str:
    """Return a URDF whose links look like something; those it does not have are left out."""
    def dressed(found: re.Match[str]) -> str:
        parts = [line for each in visuals.get(found['name'], ()) for line in _lines(each)]
        if not parts:
            return found[0]
        opening = f'  <link name="{found["name"]}">\n' + '\n'.join(parts)
        return f'{opening}\n  </link>' if found['empty'] else opening

    return re.sub(r'  <link name="(?P<name>\w+)"(?P<empty>/?)>', dressed, urdf)


def _lines(visual: Visual) -> list[str]:
    numbers = [repr(float(value)) for value in visual.size]
    shape = {BOX: f'<box size="{" ".join(numbers)}"/>',
             CYLINDER: f'<cylinder radius="{numbers[0]}" length="{numbers[-1]}"/>',
             SPHERE: f'<sphere radius="{numbers[0]}"/>'}[visual.shape]
    place, turn, colour = (' '.join(repr(float(value)) for value in values) for values in (
        visual.position, visual.rpy, COLOURS[visual.colour]))
    return [
        '    <visual>',
        f'      <origin xyz="{place}" rpy="{turn}"/>',
        f'      <geometry>{shape}</geometry>',
        f'      <material name="{visual.colour}"><color rgba="{colour}"/></material>',
        '    </visual>']
