"""Any arm from its vendor's URDF: cut off where our sensor and tool go, joints turned to z."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import xml.etree.ElementTree as ElementTree

from multicontact_control.config import Vector3
from multicontact_control.dynamics.robot import load_model
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, arm_of_urdf, Body, Link, parse_urdf, Placement
from sim_bridge.robot_file import ToolData

FACE_MASS = 1e-3  # kg, of a sensor whose tool is in the URDF
SMALLEST_INERTIA = 1e-7  # kg m^2, for what has a mass and is given none
ALONG_Z = 1e-9  # how far an axis may be from z to be taken for it


@dataclass(frozen=True)
class Mount:
    """Where an arm ends and what hangs there."""

    link: str  # of the URDF, which carries the sensor; empty for one that has sensor and tool
    rpy: Vector3 = (0.0, 0.0, 0.0)  # axes of operational frame and sensor in the link [rad]
    tool: ToolData | None = None  # instead of all that the URDF has beyond the link
    tip_links: Sequence[str] = ()  # of a tool in the URDF, those that may touch


def read_arm(
    path: Path, joint_names: Sequence[str], mount: Mount, locked: Mapping[str, float],
) -> Arm:
    """
    Read an arm from a URDF.

    Parameters
    ----------
    path
        The URDF.
    joint_names
        Joints of the arm, base to wrist, all revolute or continuous.
    mount
        Where it ends.
    locked
        Positions of all other joints [rad or m].

    Raises
    ------
    ConfigError
        If the URDF is not such an arm.

    """
    text = read_urdf(path)
    if not mount.link:
        arm = arm_of_urdf(text)
        _check_names(list(arm.joint_names), joint_names)
        return arm
    name = parse_urdf(text).get('name') or 'arm'
    bare = _without(text, _beyond(text, mount.link))
    model = load_model(bare, {name: locked[name] for name in locked if f'"{name}"' in bare})
    _check_chain(model, joint_names, mount.link)
    turns = [_turn(model, joint) for joint in range(1, model.njoints)]
    # 0 is what a URDF has for a speed or torque that is not known.
    limits = zip(*(map(float, values) for values in (
        model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit,
        model.effortLimit)))
    links = []
    before = pin.SE3.Identity()
    for number, (turn, limit) in enumerate(zip(turns, limits)):
        placement = before.inverse() * model.jointPlacements[number + 1] * turn
        body = _body(turn.actInv(model.inertias[number + 1]), joint_names[number])
        links.append(Link(joint_names[number], Placement.of(placement), body, *limit))
        before = turn
    flange = turns[-1].inverse() * _frame(model, mount.link).placement
    sensor = flange * pin.SE3(pin.rpy.rpyToMatrix(*mount.rpy), np.zeros(3))
    tool = mount.tool
    if tool is None:
        return _with_tool_of_urdf(text, locked, model, turns[-1], Arm(
            name, tuple(links), Placement.of(sensor), Placement.of(sensor), FACE_MASS,
            links[-1].body, {}), mount)
    face = sensor * pin.SE3(np.eye(3), np.array([0.0, 0.0, tool.face_offset]))
    return Arm(name, tuple(links), Placement.of(sensor), Placement.of(face),
               tool.face_mass, tool.body, tool.tips)


def read_urdf(path: Path) -> str:
    """Return the text of a URDF without comments; ConfigError if it is not readable."""
    try:
        return ElementTree.tostring(parse_urdf(path.read_bytes()), encoding='unicode')
    except OSError as error:
        raise ConfigError('urdf', 'a readable URDF file', f'{path} ({error.strerror})') from None


def ends_of(joint: ElementTree.Element) -> tuple[str, str]:
    """Return parent and child link of a joint; empty where it does not say."""
    found = (joint.find('parent'), joint.find('child'))
    parent, child = ('' if end is None else end.get('link', '') for end in found)
    return parent, child


def _beyond(text: str, link: str) -> set[str]:
    """Return the links that hang on one, that one left out; ConfigError if there is none."""
    root = parse_urdf(text)
    known = [element.get('name', '') for element in root.findall('link')]
    if link not in known:
        raise ConfigError('mount_link', f'a link of the URDF among {", ".join(known)}',
                          f"'{link}'")
    joints = [ends_of(joint) for joint in root.findall('joint')]
    found, ahead = set(), [link]
    while ahead:
        parent = ahead.pop()
        children = [child for start, child in joints if start == parent]
        found.update(children)
        ahead += children
    return found


def _without(text: str, links: set[str]) -> str:
    """Return a URDF without some links and the joints that carry them."""
    root = parse_urdf(text)
    for element in list(root):
        if (element.tag == 'link' and element.get('name') in links) or (
                element.tag == 'joint' and ends_of(element)[1] in links):
            root.remove(element)
        elif element.tag not in ('link', 'joint'):
            root.remove(element)  # names joints that may be gone
    return ElementTree.tostring(root, encoding='unicode')


def _check_names(names: list[str], joint_names: Sequence[str]) -> None:
    if names != list(joint_names):
        others = [name for name in names if name not in joint_names]
        raise ConfigError(
            'joint_names', f'the joints up to mount_link, {names}' + (
                f', or {others} in locked_joints' if others else ''), list(joint_names))


def _check_chain(model: pin.Model, joint_names: Sequence[str], mount: str) -> None:
    _check_names(list(model.names)[1:], joint_names)
    if list(model.parents)[1:] != list(range(model.njoints - 1)):
        raise ConfigError('joint_names', 'one joint after the other', 'a tree')
    if _frame(model, mount).parentJoint != model.njoints - 1:
        raise ConfigError('mount_link', 'a link carried by the last joint', f"'{mount}'")


def _frame(model: pin.Model, link: str) -> pin.Frame:
    """Return the frame of a link, of which a joint may have the name."""
    return model.frames[model.getFrameId(link, pin.FrameType.BODY)]


def _turn(model: pin.Model, joint: int) -> pin.SE3:
    """Return the frame whose z is a joint's axis, in the joint's own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    column = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, joint - 1]
    if np.abs(column[:3]).max() > ALONG_Z:
        raise ConfigError('joint_names', 'joints that turn, or sliding ones in locked_joints',
                          f"'{model.names[joint]}'")
    axis, z = column[3:], np.array([0.0, 0.0, 1.0])
    across = np.cross(z, axis)
    sine = float(np.linalg.norm(across))
    if sine <= ALONG_Z:
        turn = np.eye(3) if axis[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    else:
        turn = pin.exp3(across / sine * np.arctan2(sine, axis[2]))
    return pin.SE3(turn, np.zeros(3))


def _body(inertia: pin.Inertia, joint: str) -> Body:
    if inertia.mass <= 0.0:
        raise ConfigError('urdf', 'a mass for what every joint moves', f"none beyond '{joint}'")
    body = Body.of(inertia)
    x, y, z = (max(moment, SMALLEST_INERTIA) for moment in body.inertia)
    return replace(body, inertia=(x, y, z))


def _with_tool_of_urdf(
    text: str, locked: Mapping[str, float], bare: pin.Model, turn: pin.SE3, arm: Arm,
    mount: Mount,
) -> Arm:
    """Return an arm with the tool that its URDF has beyond the mount."""
    full = load_model(text, locked)
    last, sensor = bare.njoints - 1, arm.sensor.se3
    if full.njoints != bare.njoints:
        others = [name for name in full.names if name not in bare.names]
        raise ConfigError('locked_joints', f'also {", ".join(others)}', sorted(locked))
    if full.inertias[last].mass - bare.inertias[last].mass <= 0.0:
        raise ConfigError('tool', f"a tool, or one with a mass beyond '{mount.link}' in the URDF",
                          'neither')
    tool = (turn * sensor).actInv(full.inertias[last] - bare.inertias[last])
    tips = {}
    for link in mount.tip_links:
        if not full.existFrame(link, pin.FrameType.BODY):
            raise ConfigError('tip_links', 'links of the URDF', f"'{link}'")
        frame = _frame(full, link)
        if frame.parentJoint != last:
            raise ConfigError('tip_links', 'links that the last joint carries', f"'{link}'")
        x, y, z = (turn * sensor).actInv(frame.placement.translation)
        tips[link] = (float(x), float(y), float(z))
    return replace(arm, tool=_body(tool, mount.link), tips=tips)
