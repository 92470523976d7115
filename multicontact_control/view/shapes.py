"""What a URDF says of how an arm looks: meshes, boxes, cylinders and spheres of its links."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from multicontact_control.arrays import Vector as Array
from multicontact_control.config import Vector
from multicontact_control.errors import ConfigError
import numpy as np
from scipy.spatial.transform import Rotation
from sim_bridge.urdf_arm import ends_of, mesh_file, parse_urdf
import trimesh

BOX, CYLINDER, SPHERE, MESH = 'box', 'cylinder', 'sphere', 'mesh'
FIELDS = {BOX: ('size',), CYLINDER: ('radius', 'length'), SPHERE: ('radius',)}
NEUTRAL = (0.72, 0.74, 0.77)
BONE, TOOL = 0.03, 0.008  # m, radius of a link, and of a tool, of which only the ends are known


class Shape(NamedTuple):
    """A body to draw."""

    link: str  # that carries it
    kind: str
    size: Vector  # edges of a box; radius, and length along z; radius of a sphere [m]; scale
    position: Vector  # in the link's frame [m]
    wxyz: Vector
    colour: tuple[float, float, float]  # red, green, blue, 0 to 1
    glb: bytes = b''  # of a mesh, with its own colours


def read_shapes(urdf: Path) -> list[Shape]:
    """
    Return what an arm looks like, from its URDF; ConfigError if that is none.

    Links of which the URDF says nothing, or only meshes that are not here or in a format that
    trimesh does not read, become plain rods to the next joint.
    """
    root = parse_urdf(urdf.read_bytes())
    colours = {name: colour for material in root.iter('material')
               if (name := material.get('name')) and (colour := _colour(material))}
    shapes = [shape for link in root.findall('link') for visual in link.findall('visual')
              if (shape := _shape(str(link.get('name')), visual, colours, urdf)) is not None]
    seen = {shape.link for shape in shapes}
    places = {link.get('name') for link in root.findall('link') if not len(link)
              or link.find("inertial/mass[@value='0.0']") is not None}
    for joint in root.findall('joint'):
        (link, child), end = ends_of(joint), np.array(_origin(joint)[0])
        if link not in seen and np.linalg.norm(end) >= BONE and not (
                joint.get('type') == 'fixed' and child in places):
            shapes.append(rod(link, np.zeros(3), end, BONE))
    return shapes


def _shape(
    link: str, visual: ElementTree.Element, colours: dict[str, tuple[float, float, float]],
    urdf: Path,
) -> Shape | None:
    geometry = visual.find('geometry')
    if geometry is None:
        return None
    position, rotation = _origin(visual)
    material = visual.find('material')
    given = None if material is None else _colour(material) or colours.get(
        material.get('name', ''))
    colour = given or NEUTRAL
    for kind, fields in FIELDS.items():
        found = geometry.find(kind)
        if found is not None:
            size = tuple(x for name in fields for x in _numbers(found.get(name, '')))
            return Shape(link, kind, size, position, wxyz_of(rotation), colour)
    mesh = geometry.find(MESH)
    file = None if mesh is None else mesh_file(mesh.get('filename', ''), urdf)
    if mesh is None or file is None or file.suffix[1:].lower() not in trimesh.available_formats():
        return None
    return Shape(link, MESH, _numbers(mesh.get('scale', '1 1 1')), position, wxyz_of(rotation),
                 colour, _glb(file, given))


def _glb(file: Path, colour: tuple[float, float, float] | None) -> bytes:
    """Return a mesh as viser takes it, in its own colours, or the given one if it has but one."""
    scene = trimesh.load_scene(file)
    for body in scene.geometry.values():
        if not body.visual.defined or (colour and len(scene.geometry) == 1):
            body.visual = trimesh.visual.ColorVisuals(
                body, [round(255 * x) for x in colour or NEUTRAL])
    return bytes(scene.export(file_type='glb'))


def rod(link: str, start: Array, end: Array, radius: float) -> Shape:
    """Return a rod between two points in the frame of a link, each of shape (3,) [m]."""
    length = float(np.linalg.norm(end - start))
    rotation, _ = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])
    middle = tuple(0.5 * (start + end))
    return Shape(link, CYLINDER, (radius, length), middle, wxyz_of(rotation), NEUTRAL)


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
