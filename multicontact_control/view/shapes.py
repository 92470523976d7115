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
# m, radius of a link, and of a tool, of which only the ends are known.
BONE = 0.03
TOOL_RADIUS = 0.008
SECTIONS = 40  # of what is round
SMOOTH = np.radians(30.0)  # angle between faces up to which they are one surface


def read_shapes(urdf: Path) -> dict[str, trimesh.Scene]:
    """
    Return what the links of an arm look like, from its URDF; ConfigError if that is none.

    Links of which the URDF says nothing, or only meshes that are not here or in a format that
    trimesh does not read, become plain rods to the next joint.
    """
    root = parse_urdf(urdf.read_bytes())
    shapes = defaultdict[str, trimesh.Scene](trimesh.Scene)
    colours = {
        material.get('name'): _read_colour(material)
        for material in root.iter('material')
        if material.find('color') is not None
    }
    for link in root.findall('link'):
        name = str(link.get('name'))
        for visual in link.findall('visual'):
            colour = None
            material = visual.find('material')
            if material is not None:
                named = colours.get(material.get('name'))
                colour = _read_colour(material) or named
            for shape in visual.iterfind('geometry/*'):
                for body in _make_bodies(shape, colour, urdf):
                    shapes[name].add_geometry(body, transform=_read_origin(visual))
    drawn = set(shapes)
    # Links without a mass and a shape are no more than names of places.
    places = {
        link.get('name')
        for link in root.findall('link')
        if not len(link) or link.find("inertial/mass[@value='0.0']") is not None
    }
    for joint in root.findall('joint'):
        name, child = find_joint_ends(joint)
        end = _read_origin(joint)[:3, 3]
        leads_to_place = joint.get('type') == 'fixed' and child in places
        is_long = np.linalg.norm(end) >= BONE
        if name not in drawn and is_long and not leads_to_place:
            shapes[name].add_geometry(make_rod(np.zeros(3), end, BONE))
    return shapes


def make_rod(start: Vector, end: Vector, radius: float) -> trimesh.Trimesh:
    """Return a rod between two points, each of shape (3,) [m]."""
    return _paint_body(
        trimesh.creation.cylinder(radius, segment=[start, end], sections=SECTIONS),
        NEUTRAL,
    )


def _make_bodies(
    shape: ElementTree.Element,
    colour: list[float] | None,
    urdf: Path,
) -> list[trimesh.Trimesh]:
    """Return the bodies of a shape; a mesh with several has its own colours."""
    sizes = {
        key: _read_numbers(text) for key, text in shape.items() if key != 'filename'
    }
    if shape.tag == 'mesh':
        file = find_mesh_file(shape.get('filename', ''), urdf)
        if file is None or file.suffix[1:].lower() not in trimesh.available_formats():
            return []
        parts = trimesh.load_scene(file).dump()
        bodies = [part for part in parts if isinstance(part, trimesh.Trimesh)]
        scale = np.diag([*sizes.get('scale', np.ones(3)), 1.0])
        has_given_colour = bool(colour) and len(bodies) == 1
        shown = []
        for body in bodies:
            body.apply_transform(scale)
            has_own_colour = body.visual is not None and body.visual.defined
            if has_given_colour or not has_own_colour:
                body = _paint_body(body, colour or NEUTRAL)
            shown.append(body)
        return shown
    if shape.tag == 'box':
        body = trimesh.creation.box(sizes['size'])
    elif shape.tag == 'cylinder':
        body = trimesh.creation.cylinder(
            sizes['radius'][0], sizes['length'][0], sections=SECTIONS
        )
    else:
        body = trimesh.creation.icosphere(radius=sizes['radius'][0])
    return [_paint_body(body, colour or NEUTRAL)]


def _paint_body(body: trimesh.Trimesh, colour: list[float]) -> trimesh.Trimesh:
    """Return a body in one colour, its edges sharp."""
    body = trimesh.graph.smooth_shade(body, angle=SMOOTH)
    levels = [round(255 * share) for share in colour]
    body.visual = trimesh.visual.ColorVisuals(body, levels)
    return body


def _read_origin(element: ElementTree.Element) -> Matrix:
    """Return where an element is, as a matrix of shape (4, 4)."""
    origin = element.find('origin')
    given: dict[str, str] = {} if origin is None else origin.attrib
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler(
        'xyz', _read_numbers(given.get('rpy', '0 0 0'))
    ).as_matrix()
    place[:3, 3] = _read_numbers(given.get('xyz', '0 0 0'))
    return place


def _read_colour(material: ElementTree.Element) -> list[float] | None:
    """Return red, green and blue, 0 to 1; None where they are not given."""
    colour = material.find('color')
    if colour is None:
        return None
    rgb: list[float] = _read_numbers(colour.get('rgba', ''))[:3].tolist()
    return rgb


def _read_numbers(text: str) -> Vector:
    try:
        return np.array([float(part) for part in text.split()])
    except ValueError:
        raise ConfigError('robot.urdf', 'numbers', f"'{text}'") from None


def viser_quaternion(rotation: Rotation) -> Vector:
    """Return a rotation as viser takes it: a quaternion, scalar first."""
    return np.roll(rotation.as_quat(), 1)
