"""What a URDF says of how an arm looks: meshes, boxes, cylinders and spheres of its links."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.dynamics.urdf import find_joint_ends, parse_urdf
from multicontact_control.errors import ConfigError
import numpy as np
from scipy.spatial.transform import Rotation
from sim_bridge.urdf_arm import find_mesh_file
import trimesh

NEUTRAL_COLOUR = [0.72, 0.74, 0.77]
# Radii of a link, and of a tool, of which only the ends are known.
LINK_RADIUS = 0.03  # m
TOOL_RADIUS = 0.008  # m
SECTIONS = 40  # around a cylinder
SMOOTH_ANGLE = np.radians(30.0)  # between faces, up to which they are one surface


def read_shapes(urdf: Path) -> dict[str, trimesh.Scene]:
    """
    Return what the links of an arm look like, by name, each in the frame of its link [m].

    Links of which the URDF says nothing, or only meshes that are not here or in a format that
    trimesh does not read, become plain rods to the next joint. Links that are no more than names
    of places are left out.

    Parameters
    ----------
    urdf
        The file; its meshes are sought relative to its folders and in ROS packages.

    Raises
    ------
    ConfigError
        If the file is no URDF, or has a text where numbers belong.

    """
    root = parse_urdf(urdf.read_bytes())
    shapes = defaultdict[str, trimesh.Scene](trimesh.Scene)
    named_colours = _read_named_colours(root)
    for link in root.findall('link'):
        name = str(link.get('name'))
        for visual in link.findall('visual'):
            colour = _find_colour(visual, named_colours)
            place = _read_origin(visual)
            for shape in visual.iterfind('geometry/*'):
                for body in _make_bodies(shape, colour, urdf):
                    shapes[name].add_geometry(body, transform=place)
    _add_rods(root, shapes)
    return shapes


def _add_rods(root: ElementTree.Element, shapes: dict[str, trimesh.Scene]) -> None:
    """Add a rod to each next joint for links that have no shape so far."""
    drawn = set(shapes)
    places = _find_places(root)
    for joint in root.findall('joint'):
        name, child = find_joint_ends(joint)
        end = _read_origin(joint)[:3, 3]
        is_fixed = joint.get('type') == 'fixed'
        leads_to_place = is_fixed and child in places
        is_long = np.linalg.norm(end) >= LINK_RADIUS
        if name not in drawn and is_long and not leads_to_place:
            rod = make_rod(np.zeros(3), end, LINK_RADIUS)
            shapes[name].add_geometry(rod)


def _find_places(root: ElementTree.Element) -> set[str | None]:
    """Return the links without a mass and a shape, which are no more than names of places."""
    places = set()
    for link in root.findall('link'):
        is_massless = link.find("inertial/mass[@value='0.0']") is not None
        if is_massless or not len(link):
            places.add(link.get('name'))
    return places


def make_rod(start: Vector, end: Vector, radius: float) -> trimesh.Trimesh:
    """
    Return a round rod of neutral colour, which stands for a body that has no shape of its own.

    Parameters
    ----------
    start, end
        The middles of its ends, each of shape (3,) [m].
    radius
        Its radius [m].

    """
    rod = trimesh.creation.cylinder(radius, segment=[start, end], sections=SECTIONS)
    return _paint_body(rod, NEUTRAL_COLOUR)


def _make_bodies(
    shape: ElementTree.Element, colour: list[float] | None, urdf: Path
) -> list[trimesh.Trimesh]:
    """Return the bodies of a shape, none for a mesh that cannot be read."""
    if shape.tag == 'mesh':
        return _read_mesh(shape, colour, urdf)
    sizes = {key: _read_numbers(text) for key, text in shape.items()}
    if shape.tag == 'box':
        body = trimesh.creation.box(sizes['size'])
    elif shape.tag == 'cylinder':
        radius = sizes['radius'][0]
        length = sizes['length'][0]
        body = trimesh.creation.cylinder(radius, length, sections=SECTIONS)
    else:
        radius = sizes['radius'][0]
        body = trimesh.creation.icosphere(radius=radius)
    return [_paint_body(body, colour)]


def _read_mesh(
    shape: ElementTree.Element, colour: list[float] | None, urdf: Path
) -> list[trimesh.Trimesh]:
    """Return the bodies of a mesh file; where they are several, each has its own colours."""
    file = find_mesh_file(shape.get('filename', ''), urdf)
    if file is None:
        return []
    file_format = file.suffix[1:].lower()
    if file_format not in trimesh.available_formats():
        return []
    scale = np.ones(4)
    scale[:3] = _read_numbers(shape.get('scale', '1 1 1'))
    parts = trimesh.load_scene(file).dump()
    bodies = [part for part in parts if isinstance(part, trimesh.Trimesh)]
    has_given_colour = colour is not None and len(bodies) == 1
    shown = []
    for body in bodies:
        body.apply_transform(np.diag(scale))
        has_own_colour = body.visual is not None and body.visual.defined
        if has_given_colour or not has_own_colour:
            body = _paint_body(body, colour)
        shown.append(body)
    return shown


def _paint_body(body: trimesh.Trimesh, colour: list[float] | None) -> trimesh.Trimesh:
    """Return a body in one colour, neutral if none is given, its edges sharp."""
    if colour is None:
        colour = NEUTRAL_COLOUR
    body = trimesh.graph.smooth_shade(body, angle=SMOOTH_ANGLE)
    levels = [round(255 * share) for share in colour]
    body.visual = trimesh.visual.ColorVisuals(body, levels)
    return body


def _read_origin(element: ElementTree.Element) -> Matrix:
    """Return where an element is in the frame of its parent, as a matrix of shape (4, 4)."""
    place = np.eye(4)
    origin = element.find('origin')
    if origin is not None:
        angles = _read_numbers(origin.get('rpy', '0 0 0'))
        place[:3, :3] = Rotation.from_euler('xyz', angles).as_matrix()
        place[:3, 3] = _read_numbers(origin.get('xyz', '0 0 0'))
    return place


def _read_named_colours(root: ElementTree.Element) -> dict[str | None, list[float]]:
    """Return the colours of the materials by name, to which other materials refer."""
    colours = {}
    for material in root.iter('material'):
        colour = _read_colour(material)
        if colour is not None:
            colours[material.get('name')] = colour
    return colours


def _find_colour(
    visual: ElementTree.Element, named_colours: Mapping[str | None, list[float]]
) -> list[float] | None:
    """Return the colour of a visual element, its own or by the name of its material."""
    material = visual.find('material')
    if material is None:
        return None
    colour = _read_colour(material)
    if colour is None:
        colour = named_colours.get(material.get('name'))
    return colour


def _read_colour(material: ElementTree.Element) -> list[float] | None:
    """Return red, green and blue, 0 to 1; None where they are not given."""
    colour = material.find('color[@rgba]')
    if colour is None:
        return None
    rgba: list[float] = _read_numbers(colour.attrib['rgba']).tolist()
    return rgba[:3]


def _read_numbers(text: str) -> Vector:
    try:
        return np.array(text.split(), dtype=float)
    except ValueError:
        raise ConfigError('robot.urdf', 'numbers', f"'{text}'") from None
