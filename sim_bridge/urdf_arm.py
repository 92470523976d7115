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
from urllib.parse import unquote
import xml.etree.ElementTree as ElementTree

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
SLIDING = (
    1e-9  # share of an axis along which a joint slides, from which on it is refused
)


def read_robot_arm(path: Path, file: RobotFile) -> Arm:
    """Read an arm from a URDF, without the limits and friction of its file; ConfigError."""
    text = read_urdf(path)
    if not file.mount_link:
        arm = arm_of_urdf(text)
        _check_names(list(arm.joint_names), file.joint_names)
        return arm
    name, joints = parse_urdf(text).get('name') or 'arm', file.joint_names
    bare = _without_tool(text, file.mount_link)
    there = {joint.get('name') for joint in parse_urdf(bare).findall('joint')}
    model = load_model(
        bare, {key: file.locked[key] for key in file.locked if key in there}
    )
    _check_names(list(model.names)[1:], joints)
    last = model.njoints - 1
    if list(model.parents)[1:] != list(range(last)):
        raise ConfigError('joint_names', 'one joint after the other', 'a tree')
    mount = _frame(model, file.mount_link)
    if mount.parentJoint != last:
        raise ConfigError(
            'mount_link', 'a link carried by the last joint', f"'{file.mount_link}'"
        )
    # 0 is what a URDF has for a speed or torque that is not known.
    limits = zip(
        *(
            map(float, values)
            for values in (
                model.lowerPositionLimit,
                model.upperPositionLimit,
                model.velocityLimit,
                model.effortLimit,
            )
        )
    )
    links, before, frames = [], pin.SE3.Identity(), [(BASE_LINK, pin.SE3.Identity())]
    for number, limit in enumerate(limits, start=1):
        turn = _turn(model, number)
        placement = before.inverse() * model.jointPlacements[number] * turn
        body = _body(turn.actInv(model.inertias[number]), joints[number - 1])
        links.append(
            Link(joints[number - 1], Placement.from_transform(placement), body, *limit)
        )
        before = turn
        frames.append((f'link{number}', turn))
    sensor = (
        before.inverse()
        * mount.placement
        * pin.SE3(pin.rpy.rpyToMatrix(*file.mount_rpy), np.zeros(3))
    )
    tool, whole = file.tool, model
    if tool is None:
        arm = Arm(
            name,
            tuple(links),
            Placement.from_transform(sensor),
            Placement.from_transform(sensor),
            FACE_MASS,
            links[-1].body,
            {},
        )
        whole, sensor = load_model(text, file.locked), before * arm.sensor.transform
        arm = _with_tool_of_urdf(arm, whole, model, sensor, file)
        frames.append((TOOL_LINK, sensor))
    else:
        face = sensor * pin.SE3(np.eye(3), np.array([0.0, 0.0, tool.face_offset]))
        arm = Arm(
            name,
            tuple(links),
            Placement.from_transform(sensor),
            Placement.from_transform(face),
            tool.face_mass,
            tool.body,
            tool.tips,
        )
    return replace(arm, visuals=_visuals(path, text, model, whole, frames))


def read_urdf(path: Path) -> str:
    """Return the text of a URDF without comments; ConfigError if it is not readable."""
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
    carried = {find_joint_ends(joint)[1]: joint for joint in root.findall('joint')}
    way = {}
    while joint := carried.pop(link, None):
        way[link] = joint
        link = find_joint_ends(joint)[0]
    return dict(reversed(way.items()))


def _without_tool(text: str, mount: str) -> str:
    """Return a URDF without what hangs on a link; ConfigError if it has no such link."""
    root = parse_urdf(text)
    known = [element.get('name', '') for element in root.findall('link')]
    if mount not in known:
        raise ConfigError(
            'mount_link', f'a link of the URDF among {", ".join(known)}', f"'{mount}'"
        )
    beyond = {
        link for link in known if link != mount and mount in joints_up_to(root, link)
    }
    for element in list(root):
        name = (
            element.get('name')
            if element.tag == 'link'
            else find_joint_ends(element)[1]
        )
        # What is neither link nor joint names joints that may be gone.
        if element.tag not in ('link', 'joint') or name in beyond:
            root.remove(element)
    return ElementTree.tostring(root, encoding='unicode')


def _check_names(names: list[str], joint_names: Sequence[str]) -> None:
    if names != list(joint_names):
        others = [name for name in names if name not in joint_names]
        raise ConfigError(
            'joint_names',
            f'the joints up to mount_link, {names}'
            + (f', or {others} in locked_joints' if others else ''),
            list(joint_names),
        )


def _frame(model: pin.Model, link: str) -> pin.Frame:
    """Return the frame of a link, of which a joint may have the name."""
    return model.frames[model.getFrameId(link, pin.FrameType.BODY)]


def _turn(model: pin.Model, joint: int) -> pin.SE3:
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
    return pin.SE3(rotation_between(np.array([0.0, 0.0, 1.0]), column[3:]), np.zeros(3))


def _body(inertia: pin.Inertia, joint: str) -> Body:
    if inertia.mass <= 0.0:
        raise ConfigError(
            'urdf', 'a mass for what every joint moves', f"none beyond '{joint}'"
        )
    body = Body.from_inertia(inertia)
    return replace(
        body, inertia=as_triple(max(x, SMALLEST_INERTIA) for x in body.inertia)
    )


def _visuals(
    path: Path,
    text: str,
    bare: pin.Model,
    whole: pin.Model,
    frames: Sequence[tuple[str, pin.SE3]],
) -> dict[str, str]:
    """Return the `<visual>` elements of a URDF by our links; `frames` are those of the joints."""
    root, visuals = parse_urdf(text), dict[str, str]()
    colours = {
        material.get('name'): material.findall('color')
        for material in root.iter('material')
        if len(material)
    }
    links = [
        link
        for link in root.findall('link')
        if whole.existFrame(link.get('name', ''), pin.FrameType.BODY)
    ]
    for link in links:
        frame = _frame(whole, link.get('name', ''))
        of_arm = bare.existFrame(frame.name, pin.FrameType.BODY)
        name, own = frames[frame.parentJoint if of_arm else -1]
        for visual in link.findall('visual'):
            origin = visual.find('origin')
            if origin is None:
                origin = ElementTree.SubElement(visual, 'origin')
            given = Placement(
                *(as_triple(origin.get(x, '0 0 0').split()) for x in ('xyz', 'rpy'))
            )
            place = Placement.from_transform(
                own.actInv(frame.placement * given.transform)
            )
            origin.attrib.update(
                xyz=format_numbers(place.position), rpy=format_numbers(place.rpy)
            )
            for material in visual.findall('material'):
                material[:] = colours.get(material.get('name'), material[:])
            for mesh in visual.iter('mesh'):
                if file := find_mesh_file(mesh.get('filename', ''), path):
                    mesh.set('filename', file.as_uri())
            visuals[name] = visuals.get(name, '') + ElementTree.tostring(
                visual, 'unicode'
            )
    return visuals


def find_mesh_file(name: str, urdf: Path) -> Path | None:
    """Return the file of a mesh in a URDF, by its path or URI; None if it is not there."""
    inside = unquote(name.partition('://')[2]) or name
    shares = [
        Path(prefix) / 'share'
        for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    ]
    files = (folder / inside for folder in (*urdf.absolute().parents, *shares))
    return next(filter(Path.is_file, files), None)


def _with_tool_of_urdf(
    arm: Arm,
    full: pin.Model,
    bare: pin.Model,
    sensor: pin.SE3,
    file: RobotFile,
) -> Arm:
    """Return an arm with the tool of its URDF; the sensor is placed in the last joint's frame."""
    last = bare.njoints - 1
    if full.njoints != bare.njoints:
        others = [name for name in full.names if name not in bare.names]
        raise ConfigError(
            'locked_joints', f'also {", ".join(others)}', sorted(file.locked)
        )
    if full.inertias[last].mass - bare.inertias[last].mass <= 0.0:
        raise ConfigError(
            'tool',
            f"a tool, or one with a mass beyond '{file.mount_link}' in the URDF",
            'neither',
        )
    tips = {}
    for name, link in file.tip_links.items():
        if (
            not full.existFrame(link, pin.FrameType.BODY)
            or _frame(full, link).parentJoint != last
        ):
            raise ConfigError(
                'tip_links',
                'links of the URDF that the last joint carries',
                f"'{link}'",
            )
        tips[name] = as_triple(sensor.actInv(_frame(full, link).placement.translation))
    tool = sensor.actInv(full.inertias[last] - bare.inertias[last])
    return replace(arm, tool=_body(tool, file.mount_link), tips=tips)


def arm_of_urdf(text: str) -> Arm:
    """Return the arm of a URDF with sensor, tool and tips; ConfigError names what is missing."""
    root = parse_urdf(text)
    joints = {_value(joint, 'child', 'link'): joint for joint in root.findall('joint')}
    bodies = {link.get('name', ''): link for link in root.findall('link')}
    missing = {SENSOR_FRAME, TOOL_LINK, OPERATIONAL_FRAME} - joints.keys()
    if missing:
        raise ConfigError(
            'mount_link',
            f'a link of a URDF that lacks {", ".join(sorted(missing))}',
            'nothing',
        )
    links = []
    for child, joint in joints.items():
        kind = joint.get('type')
        if kind not in ('revolute', 'continuous'):
            continue
        if _numbers(joint, 'axis', 'xyz') != (0.0, 0.0, 1.0):
            raise ConfigError(
                'mount_link',
                'a link, for joints that turn about another axis than z',
                'nothing',
            )
        range_of = [
            _numbers(joint, 'limit', end)[0] if kind == 'revolute' else sign * math.inf
            for end, sign in (('lower', -1.0), ('upper', 1.0))
        ]
        links.append(
            Link(
                joint.get('name', ''),
                _placement(joint),
                _own_body(bodies[child]),
                *range_of,
                *_numbers(joint, 'limit', 'velocity'),
                *_numbers(joint, 'limit', 'effort'),
            )
        )
    tips = {
        child: _placement(joint).position
        for child, joint in joints.items()
        if _value(joint, 'parent', 'link') == TOOL_LINK
    }
    return Arm(
        root.get('name', 'arm'),
        tuple(links),
        _placement(joints[OPERATIONAL_FRAME]),
        _placement(joints[SENSOR_FRAME]),
        _own_body(bodies[SENSOR_FRAME]).mass,
        _own_body(bodies[TOOL_LINK]),
        tips,
        text,
    )


def _value(element: ElementTree.Element, path: str, name: str) -> str:
    child = element.find(path)
    if child is None or name not in child.attrib:
        raise ConfigError(
            'urdf', f"{path} with {name} in '{element.get('name')}'", 'none'
        )
    return child.attrib[name]


def _numbers(element: ElementTree.Element, path: str, name: str) -> tuple[float, ...]:
    return tuple(float(number) for number in _value(element, path, name).split())


def _placement(element: ElementTree.Element, path: str = 'origin') -> Placement:
    return Placement(
        *(as_triple(_numbers(element, path, name)) for name in ('xyz', 'rpy'))
    )


def _own_body(link: ElementTree.Element) -> Body:
    moments = [
        _numbers(link, 'inertial/inertia', name)[0]
        for name in ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
    ]
    if any(moments[3:]):
        raise ConfigError(
            'urdf',
            f"an inertial frame along the principal axes in '{link.get('name')}'",
            f'ixy ixz iyz = {moments[3:]}',
        )
    (mass,) = _numbers(link, 'inertial/mass', 'value')
    return Body(mass, _placement(link, 'inertial/origin'), as_triple(moments[:3]))
