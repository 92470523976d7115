"""What a URDF says of how an arm looks: boxes, cylinders and spheres of its links."""

from __future__ import annotations

from typing import NamedTuple
from xml.etree import ElementTree

from multicontact_control.config import Vector
from multicontact_control.errors import ConfigError
import numpy as np
from scipy.spatial.transform import Rotation

BOX, CYLINDER, SPHERE = 'box', 'cylinder', 'sphere'
FIELDS = {BOX: ('size',), CYLINDER: ('radius', 'length'), SPHERE: ('radius',)}
NEUTRAL = (0.72, 0.74, 0.77)
BONE = 0.03  # m, radius of a link of which nothing is known but where it goes


class Shape(NamedTuple):
    """A body to draw."""

    link: str  # that carries it
    kind: str
    size: Vector  # edges of a box; radius, and length along z; radius of a sphere [m]
    position: Vector  # in the link's frame [m]
    wxyz: Vector
    colour: tuple[float, float, float]  # red, green, blue, 0 to 1


def read_shapes(urdf: str | bytes) -> list[Shape]:
    """
    Return what an arm looks like, from the XML of its URDF; ConfigError if that is none.

    Links of which the URDF says nothing, or that look like a mesh, become plain rods to the next
    joint.
    """
    try:
        root = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise ConfigError('robot.urdf', 'XML', error) from None
    colours = {name: colour for material in root.iter('material')
               if (name := material.get('name')) and (colour := _colour(material))}
    shapes = [shape for link in root.findall('link') for visual in link.findall('visual')
              if (shape := _shape(str(link.get('name')), visual, colours)) is not None]
    seen = {shape.link for shape in shapes}
    rods = [rod for joint in root.findall('joint') for rod in _rod(joint)]
    return shapes + [rod for rod in rods if rod.link not in seen]


def _shape(
    link: str, visual: ElementTree.Element, colours: dict[str, tuple[float, float, float]],
) -> Shape | None:
    geometry = visual.find('geometry')
    if geometry is None:
        return None
    position, rotation = _origin(visual)
    material = visual.find('material')
    colour = NEUTRAL if material is None else _colour(material) or colours.get(
        material.get('name', ''), NEUTRAL)
    for kind, fields in FIELDS.items():
        found = geometry.find(kind)
        if found is not None:
            size = tuple(x for name in fields for x in _numbers(found.get(name, '')))
            return Shape(link, kind, size, position, wxyz_of(rotation), colour)
    return None


def _rod(joint: ElementTree.Element) -> list[Shape]:
    """Return a rod from a link's frame to that of the next one, if that is elsewhere."""
    parent = joint.find('parent')
    position, _ = _origin(joint)
    length = float(np.linalg.norm(position))
    if parent is None or length < BONE:
        return []
    rotation, _ = Rotation.align_vectors([np.array(position) / length], [[0.0, 0.0, 1.0]])
    middle = tuple(0.5 * x for x in position)
    return [Shape(str(parent.get('link')), CYLINDER, (BONE, length), middle, wxyz_of(rotation),
                  NEUTRAL)]


def _origin(element: ElementTree.Element) -> tuple[Vector, Rotation]:
    origin = element.find('origin')
    given: dict[str, str] = {} if origin is None else origin.attrib
    return (_numbers(given.get('xyz', '0 0 0')),
            Rotation.from_euler('xyz', _numbers(given.get('rpy', '0 0 0'))))


def _colour(material: ElementTree.Element) -> tuple[float, float, float] | None:
    colour = material.find('color')
    numbers = () if colour is None else _numbers(colour.get('rgba', ''))
    return (numbers[0], numbers[1], numbers[2]) if len(numbers) >= 3 else None


def _numbers(text: str) -> Vector:
    try:
        return tuple(float(part) for part in text.split())
    except ValueError:
        raise ConfigError('robot.urdf', 'numbers', f"'{text}'") from None


def wxyz_of(rotation: Rotation) -> Vector:
    """Return a rotation as viser takes it: a quaternion, scalar first."""
    x, y, z, w = rotation.as_quat().tolist()
    return (w, x, y, z)
