"""A first configuration of a robot from its URDF, with all that follows from it filled in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import xml.etree.ElementTree as ElementTree

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.dynamics.robot import check_torques, load_model
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.parameter_file import write_parameters
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, parse_urdf
from sim_bridge.posture import condition, limits_of, reach
from sim_bridge.robot_file import ToolData
from sim_bridge.robots import find_robot, SCHEME, urdf_name
from sim_bridge.urdf_arm import ends_of, Mount, read_arm, read_urdf

MARK = 'PLACEHOLDER'
GUESSED_TOOL = {
    'face_offset': 0.0, 'face_mass': 0.001, 'mass': 0.5, 'com': [0.0, 0.0, 0.08],
    'inertia': [0.002, 0.002, 0.001]}
GUESSED_TIP = [0.0, 0.0, 0.15]  # m, where the URDF has the tip at the sensor itself
GUESSED_TORQUE, GUESSED_SPEED, GUESSED_ARMATURE = 50.0, 1.0, 0.1  # N m, rad/s, kg m^2
# Places of the operational point that are tried for home, as shares of the arm's length: how far
# out and how high, on the four sides.
PLACES = ((0.45, 0.35), (0.35, 0.3), (0.5, 0.2), (0.4, 0.45), (0.3, 0.2))
STARTS = 4  # postures from which each is tried


@dataclass(frozen=True)
class NewRobot:
    """A configuration that was written."""

    path: Path
    missing: tuple[str, ...]  # what it still needs, in sentences
    found: tuple[str, ...]  # what was found out, in sentences


def new_robot(urdf: Path, sensor: str, tip: str, out: Path) -> NewRobot:
    """
    Write a file for a robot, check it, and say what is missing.

    Parameters
    ----------
    urdf
        The vendor's, with or without a tool.
    sensor, tip
        Links of it: the one that carries the wrist sensor, and the one that is to touch.
    out
        The file.

    Raises
    ------
    ConfigError
        If the URDF is not that of an arm, has no such links, or has impossible figures.

    """
    text, suspicious = read_urdf(urdf), list[str]()
    root = parse_urdf(text)
    joints, locked = _joints(root, sensor)
    if tip not in _links(root):
        raise ConfigError('tip', f'a link of the URDF among {", ".join(_links(root))}',
                          f"'{tip}'")
    missing: list[str] = []
    try:
        arm = read_arm(urdf, joints, Mount(sensor, tip_links=[tip]), locked)
        tool = ''
    except ConfigError as error:
        if error.field not in ('tool', 'tip_links'):
            raise
        tip = f'{tip}_tip'  # the arm may have a link or joint of that name
        tool = _guessed_tool(tip)
        missing.append('tool: weigh it (`multicontact calibrate` shows how) and measure the tip')
        arm = read_arm(urdf, joints, Mount(sensor, tool=ToolData.model_validate(
            {**GUESSED_TOOL, 'tips': {tip: GUESSED_TIP}})), locked)
    load_model(text, locked, suspicious)
    suspicious += check_torques(arm.model(), np.array(_own(arm, 'torque_limit')))
    home, reached = _home(arm, np.array(arm.tips[tip]))
    if not reached:
        missing.append('home: no posture with the tool straight down was found; this one is the '
                       "middle of the joints' range")
    out.parent.mkdir(parents=True, exist_ok=True)
    text = _text(urdf, out, joints, locked, sensor, tip, tool, arm, home, missing)
    out.write_text(text, encoding='utf-8')
    missing += ['armature: rotor inertia x gear ratio squared of each joint',
                'contacts: the surfaces your tip really meets, and their stiffness']
    return NewRobot(out, tuple(missing), (
        *(f'suspicious: {text}' for text in suspicious), *_found(out)))


def write_controller(made: NewRobot, out: Path) -> None:
    """
    Write what the controller on the real arm needs, beside the URDF of the arm with its tool.

    Parameters
    ----------
    made
        The robot's file; what it still needs is guessed here, too, and told in the head.
    out
        Parameter file to write; the URDF is written next to it.

    Raises
    ------
    ConfigError
        If a value in the robot's file is not acceptable.

    """
    robot = find_robot(str(made.path))
    values = robot.controller_base()
    urdf = out.with_name(f'{made.path.stem}_with_tool.urdf')
    source = robot.urdf_dir() / values['robot']['urdf']
    values['robot'] = {**values['robot'], 'urdf': urdf.name}
    # Nothing of the sensor that is simulated; and no contact before this one is known to be right.
    values['sensor'], values['watchdog'] = {'require_push_test': True}, {}
    validate(ControllerConfig, values, str(out))
    out.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(source.read_text(encoding='utf-8'), encoding='utf-8')
    guesses = '\n'.join(f'# - {text}' for text in made.missing)
    write_parameters(
        out, {'/**': values},
        f'# Written by `multicontact new-robot` beside {made.path.name}, yours from here on.\n'
        "# Check every contact's normal and point, what hangs on the sensor, the torque limits\n"
        "# and the sensor's frame. Guessed or not known, and yours to replace:\n"
        f'{guesses}\n')


def _links(root: ElementTree.Element) -> list[str]:
    return [link.get('name', '') for link in root.findall('link')]


def _joints(root: ElementTree.Element, sensor: str) -> tuple[list[str], dict[str, float]]:
    """Return the joints between base and sensor, and where all others are to stay."""
    if sensor not in _links(root):
        raise ConfigError('sensor', f'a link of the URDF among {", ".join(_links(root))}',
                          f"'{sensor}'")
    carried = {}
    for joint in root.findall('joint'):
        parent, child = ends_of(joint)
        if child:
            carried[child] = parent, joint
    chain: list[str] = []
    link = sensor
    while link in carried:
        link, joint = carried[link]
        if joint.get('type') != 'fixed':
            chain.insert(0, joint.get('name', ''))
    if not chain:
        raise ConfigError('sensor', 'a link that joints carry', f"'{sensor}'")
    locked = {}
    for joint in root.findall('joint'):
        name, limit = joint.get('name', ''), joint.find('limit')
        if joint.get('type') == 'fixed' or name in chain:
            continue
        lower, upper = (0.0, 0.0) if limit is None else (
            float(limit.get('lower', 0.0)), float(limit.get('upper', 0.0)))
        locked[name] = min(max(0.0, lower), upper) if lower <= upper else 0.0
    return chain, locked


def _guessed_tool(tip: str) -> str:
    units = {'face_offset': 'm, mount_link to sensor along z', 'face_mass': 'kg', 'mass': 'kg',
             'com': 'm', 'inertia': 'kg m^2'}
    return '\n'.join([
        f'# {MARK}: the URDF has no tool with a mass beyond the sensor link.',
        'tool:  # in the frame of the sensor',
        *(f'  {name}: {value}  # {units[name]}' for name, value in GUESSED_TOOL.items()),
        f'  tips: {{{tip}: {GUESSED_TIP}}}  # m'])


def _home(arm: Arm, tip: Vector) -> tuple[Vector, bool]:
    """Return a posture with the tip straight below the sensor, or the middle of the range."""
    model = arm.model()
    lower, upper = limits_of(model)
    ends = np.isfinite(lower) & np.isfinite(upper)
    middle = np.where(ends, 0.5 * (np.where(ends, lower, 0.0) + np.where(ends, upper, 0.0)), 0.0)
    span = np.where(ends, np.where(ends, upper, 0.0) - np.where(ends, lower, 0.0), np.pi)
    length = sum(float(np.linalg.norm(link.placement.position)) for link in arm.links)
    down = _turned_down(tip)
    random, best, found = np.random.default_rng(0), math.inf, None
    starts = [middle, *(middle + random.uniform(-0.25, 0.25, len(middle)) * span
                        for _ in range(STARTS - 1))]
    for out, high in PLACES:
        for side in range(4):
            turn = pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi * side)
            pose = pin.SE3(turn @ down, turn @ np.array([out * length, 0.0, high * length]))
            for start in starts:
                q = reach(model, pose, start)
                value = math.inf if q is None else condition(model, q)
                if value < best:
                    best, found = value, q
        if found is not None and best < 20.0:
            break
    return (middle, False) if found is None else (found, True)


def _turned_down(tip: Vector) -> Vector:
    """Return axes in which the way to the tip points down."""
    size = float(np.linalg.norm(tip))
    way = np.array([0.0, 0.0, 1.0]) if size < 1e-6 else tip / size
    across = np.cross(way, [0.0, 0.0, -1.0])
    sine = float(np.linalg.norm(across))
    if sine < 1e-9:
        return np.eye(3) if way[2] < 0.0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(pin.exp3(across / sine * np.arctan2(sine, -way[2])))


def _text(
    urdf: Path, out: Path, joints: Sequence[str], locked: dict[str, float], sensor: str,
    tip: str, tool: str, arm: Arm, home: Vector, missing: list[str],
) -> str:
    """Return the file, and add to what is missing."""
    name = urdf_name(urdf, out.parent)
    relative = '' if name.startswith(SCHEME) else '  # relative to this file'
    lines = [
        f'# Written by `multicontact new-robot {urdf.name}`; what is marked {MARK} is a guess.',
        '# SI units. What is not here follows from the URDF (docs/your_robot.md).',
        f'urdf: {name}{relative}', f'joint_names: {_list(joints)}']
    if locked:
        lines += ['# Joints that are no part of the arm, and where they stay.',
                  f'locked_joints: {_list(list(locked))}',
                  f'locked_positions: {_list(list(locked.values()))}  # rad or m']
    lines += [f'mount_link: {sensor}  # carries the wrist sensor; operational point and sensor '
              'frame',
              'mount_rpy: [0.0, 0.0, 0.0]  # rad, axes of the sensor in that link']
    lines += [tool] if tool else [f'tip_links: [{tip}]  # of the tool, which is in the URDF']
    n = len(joints)
    lines += [f'armature: {_list([GUESSED_ARMATURE] * n)}  # kg m^2, {MARK}']
    for name, unit, guess in (('torque_limit', 'N m', GUESSED_TORQUE),
                              ('speed_limit', 'rad/s', GUESSED_SPEED)):
        own = _own(arm, name)
        lacking = ', '.join(joint for joint, value in zip(joints, own) if math.isnan(value))
        values = _list([guess if math.isnan(value) else value for value in own])
        if lacking:
            lines.append(f'{name}: {values}  # {unit}, {MARK} for {lacking}: the URDF has none')
            missing.append(f'{name} of {lacking}: the URDF has none')
        else:
            lines.append(f'# {name}: {values}  # {unit}, those of the URDF')
    lines += [
        f'home: {_list([round(float(x), 9) for x in home])}  # rad',
        f'contacts:  # {MARK}: a table 7 mm below the tip at home; the normal points INTO it',
        f'  table: {{tip: {tip}, normal_world: [0.0, 0.0, -1.0], gap: 0.007, stiffness: 6000.0}}',
        '# plants:  # with flexible drives beside the rigid ones, where stiffness is known',
        '#   rigid: {}', '#   flexible:',
        '#     plant: {drives: flexible, joint_sensing: motor, substep: 2.5e-4, '
        'drive_stiffness: [...], drive_damping: [...]}', '']
    return '\n'.join(lines)


def _own(arm: Arm, name: str) -> list[float]:
    """Return a limit of each joint, nan where the URDF has none."""
    values = [float(getattr(link, name)) for link in arm.links]
    return [value if 0.0 < value < 1e6 else math.nan for value in values]


def _list(values: Sequence[object]) -> str:
    return f'[{", ".join(str(value) for value in values)}]'


def _found(out: Path) -> tuple[str, ...]:
    """Check the file by reading it, and return what it makes."""
    robot = find_robot(str(out))
    arm, home = robot.arm, np.array(robot.file.home)
    model = arm.model()
    robot.plant_values('rigid')
    robot.controller_base()
    gravity = np.abs(pin.computeGeneralizedGravity(model, model.createData(), home))
    share = gravity / np.array([link.torque_limit for link in arm.links])
    return (
        f'{len(arm.links)} joints, {sum(body.mass for body in arm.bodies):.3g} kg, of which '
        f'{arm.carried_mass:.3g} kg hang on the sensor',
        f'at home gravity takes {100.0 * share.max():.0f} % of the torque limit at most, and the '
        f'Jacobian has the condition {condition(model, home):.3g} (below 20 is good)')
