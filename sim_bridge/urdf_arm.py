"""
An arm from a URDF.

Either of its vendor, cut off where our sensor and tool go and its joints turned to z, or a whole
one as `compose_urdf` writes it, with the links ft_face, tool, wrist_point and tips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
import os
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote
import xml.etree.ElementTree as ElementTree

from multicontact_control.config import Vector3
from multicontact_control.dynamics.robot import load_model
from multicontact_control.dynamics.urdf import (
    check_link_tree,
    find_joint_ends,
    parse_urdf,
)
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import (
    Arm,
    as_triple,
    BASE_LINK,
    Body,
    format_numbers,
    Link,
    OPERATIONAL_FRAME,
    Placement,
    SENSOR_FRAME,
    TOOL_LINK,
)
from sim_bridge.posture import rotation_between
from sim_bridge.robot_file import RobotFile

FACE_MASS = 1e-3  # kg, of a sensor whose tool is in the URDF
SMALLEST_INERTIA = 1e-7  # kg m^2, for what has a mass and is given none
# Share of a joint's axis along which it slides, from which on the joint is refused.
SLIDING = 1e-9
Z_AXIS = np.array([0.0, 0.0, 1.0])


class CarriedFrame(NamedTuple):
    """A frame of our URDF, in the frame of the vendor's joint that carries it."""

    link: str
    placement: pin.SE3


def read_robot_arm(path: Path, file: RobotFile) -> Arm:
    """
    Read an arm from a URDF, without the limits and friction that the robot's file may have.

    Parameters
    ----------
    path
        Of the URDF.
    file
        Names of joints and links, axes of the sensor, and the tool.

    Returns
    -------
    Arm
        With limits of 0 where the URDF has no speed or torque limit.

    Raises
    ------
    ConfigError
        If the URDF cannot be read, or joints, links or tool do not fit the file.

    """
    text = read_urdf(path)
    if not file.mount_link:
        arm = arm_of_urdf(text)
        _require_joint_names(arm.joint_names, file)
        return arm
    bare = _load_bare_model(text, file)
    last = bare.njoints - 1
    mount = _frame_of_link(bare, file.mount_link)
    if mount.parentJoint != last:
        raise ConfigError(
            'mount_link', 'a link carried by the last joint', f"'{file.mount_link}'"
        )
    turned = [_frame_with_axis_z(bare, joint) for joint in range(1, last + 1)]
    in_mount = pin.SE3(pin.rpy.rpyToMatrix(*file.mount_rpy), np.zeros(3))
    sensor = turned[-1].inverse() * mount.placement * in_mount
    operational = Placement.from_transform(sensor)
    frames = [CarriedFrame(BASE_LINK, pin.SE3.Identity())]
    for number, frame in enumerate(turned, start=1):
        frames.append(CarriedFrame(f'link{number}', frame))
    whole = bare
    tool = file.tool
    if tool is None:
        whole = load_model(text, file.locked)
        sensor_in_joint = turned[-1] * operational.transform
        frames.append(CarriedFrame(TOOL_LINK, sensor_in_joint))
        face = operational
        face_mass = FACE_MASS
        body = _tool_in_urdf(whole, bare, sensor_in_joint, file)
        tips = _tips_in_urdf(whole, sensor_in_joint, file)
    else:
        to_face = pin.SE3(np.eye(3), np.array([0.0, 0.0, tool.face_offset]))
        face = Placement.from_transform(sensor * to_face)
        face_mass = tool.face_mass
        body = tool.body
        tips = tool.tips
    return Arm(
        parse_urdf(text).get('name') or 'arm',
        _links_of_model(bare, turned),
        operational,
        face,
        face_mass,
        body,
        tips,
        visuals=_collect_visuals(path, text, bare, whole, frames),
    )


def read_urdf(path: Path) -> str:
    """
    Return the text of a URDF without its comments.

    ConfigError if it is not readable, is xacro, or its links are not one tree.
    """
    try:
        root = parse_urdf(path.read_bytes())
    except OSError as error:
        raise ConfigError(
            'urdf', 'a readable URDF file', f'{path} ({error.strerror})'
        ) from None
    if any('xacro' in element.tag for element in root.iter()):
        raise ConfigError(
            'urdf',
            'a URDF',
            f'{path}, which is xacro',
            hint=f'write one with `xacro {path.name} > arm.urdf`',
        )
    check_link_tree(root)
    return ElementTree.tostring(root, encoding='unicode')


def joints_up_to(
    root: ElementTree.Element, link: str
) -> dict[str, ElementTree.Element]:
    """Return the joints of a URDF from the base to a link, each under the link it carries."""
    carriers = {find_joint_ends(joint)[1]: joint for joint in root.findall('joint')}
    from_link = {}
    while link in carriers:
        joint = carriers.pop(link)
        from_link[link] = joint
        link, _ = find_joint_ends(joint)
    return dict(reversed(from_link.items()))


def _load_bare_model(text: str, file: RobotFile) -> pin.Model:
    """Return the model of a chain of joints up to the mount, without what hangs there."""
    bare = _remove_tool(parse_urdf(text), file.mount_link)
    kept = {joint.get('name') for joint in bare.findall('joint')}
    locked = {name: q for name, q in file.locked.items() if name in kept}
    model = load_model(ElementTree.tostring(bare, encoding='unicode'), locked)
    _require_joint_names(list(model.names)[1:], file)
    if list(model.parents)[1:] != list(range(model.njoints - 1)):
        raise ConfigError('joint_names', 'one joint after the other', 'a tree')
    return model


def _remove_tool(root: ElementTree.Element, mount: str) -> ElementTree.Element:
    """Return a URDF without what hangs on a link; ConfigError if it has no such link."""
    known = [element.get('name', '') for element in root.findall('link')]
    if mount not in known:
        raise ConfigError(
            'mount_link', f'a link of the URDF among {", ".join(known)}', f"'{mount}'"
        )
    beyond = {
        link for link in known if link != mount and mount in joints_up_to(root, link)
    }
    for element in list(root):
        carried = ''
        if element.tag == 'link':
            carried = element.get('name', '')
        elif element.tag == 'joint':
            _, carried = find_joint_ends(element)
        # Other elements name joints that may be gone.
        if element.tag not in ('link', 'joint') or carried in beyond:
            root.remove(element)
    return root


def _require_joint_names(names: Sequence[str], file: RobotFile) -> None:
    if list(names) == list(file.joint_names):
        return
    expected = f'the joints up to mount_link, {list(names)}'
    others = [name for name in names if name not in file.joint_names]
    if others:
        expected += f', or {others} in locked_joints'
    raise ConfigError('joint_names', expected, list(file.joint_names))


def _frame_of_link(model: pin.Model, link: str) -> pin.Frame:
    """Return the frame of a link, of which a joint may have the name."""
    return model.frames[model.getFrameId(link, pin.FrameType.BODY)]


def _frame_with_axis_z(model: pin.Model, joint: int) -> pin.SE3:
    """Return the frame whose z is a joint's axis, in the joint's own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    column = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, joint - 1]
    if np.abs(column[:3]).max() > SLIDING:
        raise ConfigError(
            'joint_names',
            'joints that turn, or sliding ones in locked_joints',
            f"'{model.names[joint]}'",
        )
    return pin.SE3(rotation_between(Z_AXIS, column[3:]), np.zeros(3))


def _links_of_model(model: pin.Model, turned: Sequence[pin.SE3]) -> tuple[Link, ...]:
    """Return the links of a chain; `turned` are their frames, in those of the model's joints."""
    links = []
    before = pin.SE3.Identity()
    for index, frame in enumerate(turned):
        joint = index + 1
        name = model.names[joint]
        placement = before.inverse() * model.jointPlacements[joint] * frame
        inertia = frame.actInv(model.inertias[joint])
        links.append(
            Link(
                name,
                Placement.from_transform(placement),
                _require_mass(inertia, name),
                float(model.lowerPositionLimit[index]),
                float(model.upperPositionLimit[index]),
                float(model.velocityLimit[index]),
                float(model.effortLimit[index]),
            )
        )
        before = frame
    return tuple(links)


def _require_mass(inertia: pin.Inertia, carrier: str) -> Body:
    """Return a body with a mass and moments that engines accept."""
    if inertia.mass <= 0.0:
        raise ConfigError(
            'urdf', 'a mass for what every joint moves', f"none beyond '{carrier}'"
        )
    body = Body.from_inertia(inertia)
    moments = as_triple(max(moment, SMALLEST_INERTIA) for moment in body.inertia)
    return replace(body, inertia=moments)


def _collect_visuals(
    path: Path,
    text: str,
    bare: pin.Model,
    whole: pin.Model,
    frames: Sequence[CarriedFrame],
) -> dict[str, str]:
    """
    Return the `<visual>` elements of a URDF under the names and in the frames of our links.

    `frames` are those of the bare model's joints, base first, and last that of the tool, whose
    links are in the whole model alone.
    """
    root = parse_urdf(text)
    colours = {
        material.get('name'): material.findall('color')
        for material in root.iter('material')
        if len(material)
    }
    visuals: dict[str, str] = {}
    for link in root.findall('link'):
        link_name = link.get('name', '')
        if not whole.existFrame(link_name, pin.FrameType.BODY):
            continue
        frame = _frame_of_link(whole, link_name)
        carrier = frames[-1]
        if bare.existFrame(link_name, pin.FrameType.BODY):
            carrier = frames[frame.parentJoint]
        in_carrier = carrier.placement.actInv(frame.placement)
        for visual in link.findall('visual'):
            _move_visual(visual, in_carrier)
            for material in visual.findall('material'):
                material[:] = colours.get(material.get('name'), material[:])
            for mesh in visual.iter('mesh'):
                file = find_mesh_file(mesh.get('filename', ''), path)
                if file is not None:
                    mesh.set('filename', file.as_uri())
            drawn = ElementTree.tostring(visual, 'unicode')
            visuals[carrier.link] = visuals.get(carrier.link, '') + drawn
    return visuals


def _move_visual(visual: ElementTree.Element, frame: pin.SE3) -> None:
    """Give a shape in one frame its origin in another, in which that `frame` is placed."""
    origin = visual.find('origin')
    if origin is None:
        origin = ElementTree.SubElement(visual, 'origin')
    position = as_triple(origin.get('xyz', '0 0 0').split())
    rpy = as_triple(origin.get('rpy', '0 0 0').split())
    place = Placement.from_transform(frame * Placement(position, rpy).transform)
    origin.set('xyz', format_numbers(place.position))
    origin.set('rpy', format_numbers(place.rpy))


def find_mesh_file(name: str, urdf: Path) -> Path | None:
    """
    Return the file of a mesh that a URDF names by a path or a URI.

    It is sought relative to each folder above the URDF, and in the share folders of the ament
    workspaces. None if it is not there.
    """
    inside = unquote(name.partition('://')[2]) or name
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    shares = [Path(prefix) / 'share' for prefix in prefixes]
    for folder in (*urdf.absolute().parents, *shares):
        file = folder / inside
        if file.is_file():
            return file
    return None


def _tool_in_urdf(
    whole: pin.Model, bare: pin.Model, sensor: pin.SE3, file: RobotFile
) -> Body:
    """Return what the URDF has beyond the mount; the sensor is in the last joint's frame."""
    last = bare.njoints - 1
    if whole.njoints != bare.njoints:
        others = [name for name in whole.names if name not in bare.names]
        raise ConfigError(
            'locked_joints', f'also {", ".join(others)}', sorted(file.locked)
        )
    if whole.inertias[last].mass - bare.inertias[last].mass <= 0.0:
        raise ConfigError(
            'tool',
            f"a tool, or one with a mass beyond '{file.mount_link}' in the URDF",
            'neither',
        )
    inertia = sensor.actInv(whole.inertias[last] - bare.inertias[last])
    return _require_mass(inertia, file.mount_link)


def _tips_in_urdf(
    whole: pin.Model, sensor: pin.SE3, file: RobotFile
) -> dict[str, Vector3]:
    """Return the tips in the sensor's frame [m]; the sensor is in the last joint's frame."""
    tips = {}
    for name, link in file.tip_links.items():
        exists = whole.existFrame(link, pin.FrameType.BODY)
        if not exists or _frame_of_link(whole, link).parentJoint != whole.nv:
            raise ConfigError(
                'tip_links',
                'links of the URDF that the last joint carries',
                f"'{link}'",
            )
        place = _frame_of_link(whole, link).placement.translation
        tips[name] = as_triple(sensor.actInv(place))
    return tips


def arm_of_urdf(text: str) -> Arm:
    """
    Return the arm of a URDF with sensor, tool and tips, as `compose_urdf` writes it.

    Its numbers are taken as they are written, to the last digit. ConfigError names what is
    missing, or what a URDF of another kind has.
    """
    root = parse_urdf(text)
    carriers = {
        _attribute(joint, 'child', 'link'): joint for joint in root.findall('joint')
    }
    bodies = {link.get('name', ''): link for link in root.findall('link')}
    missing = {SENSOR_FRAME, TOOL_LINK, OPERATIONAL_FRAME} - carriers.keys()
    if missing:
        raise ConfigError(
            'mount_link',
            f'a link of a URDF that lacks {", ".join(sorted(missing))}',
            'nothing',
        )
    links = []
    tips = {}
    for child, joint in carriers.items():
        if joint.get('type') in ('revolute', 'continuous'):
            links.append(_link_of_joint(joint, bodies[child]))
        if _attribute(joint, 'parent', 'link') == TOOL_LINK:
            tips[child] = _placement(joint).position
    return Arm(
        root.get('name', 'arm'),
        tuple(links),
        _placement(carriers[OPERATIONAL_FRAME]),
        _placement(carriers[SENSOR_FRAME]),
        _body(bodies[SENSOR_FRAME]).mass,
        _body(bodies[TOOL_LINK]),
        tips,
        source_urdf=text,
    )


def _link_of_joint(joint: ElementTree.Element, body: ElementTree.Element) -> Link:
    """Return the link behind a joint that turns about its z axis."""
    if _numbers(joint, 'axis', 'xyz') != (0.0, 0.0, 1.0):
        raise ConfigError(
            'mount_link',
            'a link, for joints that turn about another axis than z',
            'nothing',
        )
    lower = -math.inf
    upper = math.inf
    if joint.get('type') == 'revolute':
        lower = _number(joint, 'limit', 'lower')
        upper = _number(joint, 'limit', 'upper')
    return Link(
        joint.get('name', ''),
        _placement(joint),
        _body(body),
        lower,
        upper,
        _number(joint, 'limit', 'velocity'),
        _number(joint, 'limit', 'effort'),
    )


def _attribute(element: ElementTree.Element, path: str, name: str) -> str:
    child = element.find(path)
    if child is None or name not in child.attrib:
        raise ConfigError(
            'urdf', f"{path} with {name} in '{element.get('name')}'", 'none'
        )
    return child.attrib[name]


def _numbers(element: ElementTree.Element, path: str, name: str) -> tuple[float, ...]:
    return tuple(float(number) for number in _attribute(element, path, name).split())


def _number(element: ElementTree.Element, path: str, name: str) -> float:
    return float(_attribute(element, path, name))


def _placement(element: ElementTree.Element, path: str = 'origin') -> Placement:
    return Placement(
        as_triple(_numbers(element, path, 'xyz')),
        as_triple(_numbers(element, path, 'rpy')),
    )


def _body(link: ElementTree.Element) -> Body:
    """Return the body of a link, whose inertial frame must be along the principal axes."""
    moments = [
        _number(link, 'inertial/inertia', name) for name in ('ixx', 'iyy', 'izz')
    ]
    products = [
        _number(link, 'inertial/inertia', name) for name in ('ixy', 'ixz', 'iyz')
    ]
    if any(products):
        raise ConfigError(
            'urdf',
            f"an inertial frame along the principal axes in '{link.get('name')}'",
            f'ixy ixz iyz = {products}',
        )
    mass = _number(link, 'inertial/mass', 'value')
    return Body(mass, _placement(link, 'inertial/origin'), as_triple(moments))
