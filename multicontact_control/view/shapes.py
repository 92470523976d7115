"""What a URDF says of how an arm looks: meshes, boxes, cylinders and spheres of its links."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.dynamics.urdf import find_joint_ends, parse_urdf
from multicontact_control.errors import ConfigError
import numpy as np
from scipy.spatial.transform import Rotation
from sim_bridge.urdf_arm import find_mesh_file
import trimesh

NEUTRAL = [0.72, 0.74, 0.77]
BONE, TOOL = (
    0.03,
    0.008,
)  # m, radius of a link, and of a tool, of which only the ends are known
SECTIONS = 40  # of what is round
SMOOTH = np.radians(30.0)  # angle between faces up to which they are one surface


def read_shapes(urdf: Path) -> dict[str, trimesh.Scene]:
    """
    Return what the links of an arm look like, from its URDF; ConfigError if that is none.

    Links of which the URDF says nothing, or only meshes that are not here or in a format that
    trimesh does not read, become plain rods to the next joint.
    """
    root, shapes = (
        parse_urdf(urdf.read_bytes()),
        defaultdict[str, trimesh.Scene](trimesh.Scene),
    )
    colours = {
        material.get('name'): colour
        for material in root.iter('material')
        if (colour := _colour(material))
    }
    for link in root.findall('link'):
        for visual in link.findall('visual'):
            material = visual.find('material')
            colour = (
                None
                if material is None
                else _colour(material) or colours.get(material.get('name'))
            )
            for body in [
                body
                for shape in visual.iterfind('geometry/*')
                for body in _bodies(shape, colour, urdf)
            ]:
                shapes[str(link.get('name'))].add_geometry(
                    body, transform=_origin(visual)
                )
    seen = set(shapes)
    places = {
        link.get('name')
        for link in root.findall('link')
        if not len(link) or link.find("inertial/mass[@value='0.0']") is not None
    }
    for joint in root.findall('joint'):
        (name, child), end = find_joint_ends(joint), _origin(joint)[:3, 3]
        if (
            name not in seen
            and np.linalg.norm(end) >= BONE
            and not (joint.get('type') == 'fixed' and child in places)
        ):
            shapes[name].add_geometry(rod(np.zeros(3), end, BONE))
    return shapes


def rod(start: Vector, end: Vector, radius: float) -> trimesh.Trimesh:
    """Return a rod between two points, each of shape (3,) [m]."""
    return _painted(
        trimesh.creation.cylinder(radius, segment=[start, end], sections=SECTIONS),
        NEUTRAL,
    )


def _bodies(
    shape: ElementTree.Element,
    colour: list[float] | None,
    urdf: Path,
) -> list[trimesh.Trimesh]:
    """Return the bodies of a shape; a mesh with several has its own colours."""
    sizes = {key: _numbers(text) for key, text in shape.items() if key != 'filename'}
    if shape.tag == 'mesh':
        file = find_mesh_file(shape.get('filename', ''), urdf)
        if file is None or file.suffix[1:].lower() not in trimesh.available_formats():
            return []
        bodies = [
            body
            for body in trimesh.load_scene(file).dump()
            if isinstance(body, trimesh.Trimesh)
        ]
        for body in bodies:
            body.apply_transform(np.diag([*sizes.get('scale', np.ones(3)), 1.0]))
        return [
            _painted(body, colour or NEUTRAL)
            if (colour and len(bodies) == 1)
            or (body.visual is None or not body.visual.defined)
            else body
            for body in bodies
        ]
    if shape.tag == 'box':
        body = trimesh.creation.box(sizes['size'])
    elif shape.tag == 'cylinder':
        body = trimesh.creation.cylinder(
            sizes['radius'][0], sizes['length'][0], sections=SECTIONS
        )
    else:
        body = trimesh.creation.icosphere(radius=sizes['radius'][0])
    return [_painted(body, colour or NEUTRAL)]


def _painted(body: trimesh.Trimesh, colour: list[float]) -> trimesh.Trimesh:
    """Return a body in one colour, its edges sharp."""
    body = trimesh.graph.smooth_shade(body, angle=SMOOTH)
    body.visual = trimesh.visual.ColorVisuals(body, [round(255 * x) for x in colour])
    return body


def _origin(element: ElementTree.Element) -> Matrix:
    """Return where an element is, as a matrix of shape (4, 4)."""
    origin = element.find('origin')
    given: dict[str, str] = {} if origin is None else origin.attrib
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler(
        'xyz', _numbers(given.get('rpy', '0 0 0'))
    ).as_matrix()
    place[:3, 3] = _numbers(given.get('xyz', '0 0 0'))
    return place


def _colour(material: ElementTree.Element) -> list[float] | None:
    """Return red, green and blue, 0 to 1; None where they are not given."""
    colour = material.find('color')
    return None if colour is None else _numbers(colour.get('rgba', ''))[:3].tolist()


def _numbers(text: str) -> Vector:
    try:
        return np.array([float(part) for part in text.split()])
    except ValueError:
        raise ConfigError('robot.urdf', 'numbers', f"'{text}'") from None


def wxyz_of(rotation: Rotation) -> Vector:
    """Return a rotation as viser takes it: a quaternion, scalar first."""
    return np.roll(rotation.as_quat(), 1)
