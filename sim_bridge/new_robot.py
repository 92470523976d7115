"""A first configuration of a robot from its URDF, with all that follows from it filled in."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, NamedTuple
import xml.etree.ElementTree as ElementTree

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.dynamics.robot import check_torques, load_model
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.parameter_file import write_parameters
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm
from sim_bridge.posture import condition, limits_of, middle_of, reach, turn_onto
from sim_bridge.robot_file import RobotFile
from sim_bridge.robots import find_robot
from sim_bridge.urdf_arm import ends_of, parse_urdf, read_arm, read_urdf
import yaml

MARK = 'PLACEHOLDER'
GUESSED_TOOL = {
    'face_offset': 0.0, 'face_mass': 0.001, 'mass': 0.5, 'com': [0.0, 0.0, 0.08],
    'inertia': [0.002, 0.002, 0.001]}
GUESSED_TIP = [0.0, 0.0, 0.15]  # m, where the URDF has no tool
GUESSED_LIMITS = {'torque_limit': (50.0, 'N m'), 'speed_limit': (1.0, 'rad/s')}
GUESSED_ARMATURE = 0.1  # kg m^2
LARGEST_LIMIT = 1e6  # N m or rad/s, from which on a limit is none
# Places of the operational point that are tried for home, as shares of the arm's length: how far
# out and how high, on the four sides.
PLACES = ((0.45, 0.35), (0.35, 0.3), (0.5, 0.2), (0.4, 0.45), (0.3, 0.2))
STARTS = 4  # postures from which each is tried
GOOD_CONDITION = 20.0  # of the Jacobian


class NewRobot(NamedTuple):
    """A configuration that was written."""

    path: Path
    missing: tuple[str, ...]  # what it still needs, in sentences
    remarks: tuple[str, ...]  # what is known of it, in sentences


def new_robot(urdf: Path, sensor: str, tip: str, out: Path) -> NewRobot:
    """
    Write a file for a robot from its vendor's URDF, check it, and say what is missing.

    `sensor` is the link that carries the wrist sensor, `tip` the one that touches. Raises
    ConfigError if the URDF is not that of an arm, has no such links, or has impossible figures.
    """
    text, suspicious = read_urdf(urdf), list[str]()
    joints, locked = _joints(parse_urdf(text), sensor, tip)
    values: dict[str, Any] = {
        'urdf': os.path.relpath(urdf.resolve(), out.parent.resolve()), 'joint_names': joints,
        'mount_link': sensor, 'tip_links': [tip], 'home': [0.0] * len(joints),
        'contacts': _contacts(tip), 'armature': [GUESSED_ARMATURE] * len(joints)}
    if locked:
        values |= {'locked_joints': list(locked), 'locked_positions': list(locked.values())}
    missing: list[str] = []
    try:
        arm = read_arm(urdf, RobotFile(**values))
    except ConfigError as error:
        if error.field not in ('tool', 'tip_links'):
            raise
        tip = f'{tip}_tip'  # the arm may have a link or joint of that name
        missing.append('tool: weigh it (`multicontact calibrate` shows how) and measure the tip')
        del values['tip_links']
        values |= {'tool': {**GUESSED_TOOL, 'tips': {tip: GUESSED_TIP}},
                   'contacts': _contacts(tip)}
        arm = read_arm(urdf, RobotFile(**values))
    load_model(text, locked, suspicious)
    limits = {name: [value if 0.0 < (value := getattr(link, name)) < LARGEST_LIMIT else math.nan
                     for link in arm.links] for name in GUESSED_LIMITS}
    suspicious += check_torques(arm.model(), np.array(limits['torque_limit']))
    home = _home(arm, np.array(arm.tips[tip]))
    if home is None:
        home = middle_of(arm.model(), np.zeros(len(joints)))
        missing.append('home: no posture with the tool straight down was found; this one is the '
                       "middle of the joints' range")
    values['home'] = [round(float(angle), 9) for angle in home]
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(_text(urdf.name, values, limits, missing), encoding='utf-8')
    missing += ['armature: rotor inertia x gear ratio squared of each joint',
                'contacts: the surfaces your tip really meets, and their stiffness']
    return NewRobot(out, tuple(missing), (
        *(f'suspicious: {remark}' for remark in suspicious), *_remarks(out)))


def write_controller(made: NewRobot, out: Path) -> None:
    """
    Write what the controller on the real arm needs, beside the URDF of the arm with its tool.

    What the robot's file still needs is guessed here, too, and listed in the head. Raises
    ConfigError if a value in it is not acceptable.
    """
    robot = find_robot(str(made.path))
    values = robot.controller_base()
    urdf = out.with_name(f'{made.path.stem}_with_tool.urdf')
    values['robot'] = {**values['robot'], 'urdf': urdf.name}
    # Nothing of the simulated sensor; and no contact before this one is proven by a push test.
    values['sensor'], values['watchdog'] = {'require_push_test': True}, {}
    validate(ControllerConfig, values, str(out))
    out.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(robot.arm.urdf, encoding='utf-8')
    guesses = '\n'.join(f'# - {text}' for text in made.missing)
    write_parameters(
        out, {'/**': values},
        f'# Written by `multicontact new-robot` beside {made.path.name}, yours from here on.\n'
        "# Check every contact's normal and point, what hangs on the sensor, the torque limits\n"
        "# and the sensor's frame. Guessed or not known, and yours to replace:\n"
        f'{guesses}\n')


def _joints(
    root: ElementTree.Element, sensor: str, tip: str,
) -> tuple[list[str], dict[str, float]]:
    """Return the joints between base and sensor, and where all others are to stay."""
    links = [link.get('name', '') for link in root.findall('link')]
    for field, name in (('sensor', sensor), ('tip', tip)):
        if name not in links:
            raise ConfigError(field, f'a link of the URDF among {", ".join(links)}', f"'{name}'")
    moving = [joint for joint in root.findall('joint') if joint.get('type') != 'fixed']
    carried = {ends_of(joint)[1]: joint for joint in root.findall('joint')}
    chain: list[str] = []
    link = sensor
    while joint := carried.get(link):
        link = ends_of(joint)[0]
        if joint in moving:
            chain.insert(0, joint.get('name', ''))
    if not chain:
        raise ConfigError('sensor', 'a link that joints carry', f"'{sensor}'")
    locked = {}
    for joint in moving:
        limit = joint.find('limit')
        ends = {} if limit is None else limit.attrib
        lower, upper = (float(ends.get(end, 0.0)) for end in ('lower', 'upper'))
        locked[joint.get('name', '')] = min(max(0.0, lower), upper) if lower <= upper else 0.0
    return chain, {name: place for name, place in locked.items() if name not in chain}


def _contacts(tip: str) -> dict[str, Any]:
    return {'table': {
        'tip': tip, 'normal_world': [0.0, 0.0, -1.0], 'gap': 0.007, 'stiffness': 6000.0}}


def _home(arm: Arm, tip: Vector) -> Vector | None:
    """Return a posture with the tip straight below the sensor, or None."""
    model = arm.model()
    lower, upper = limits_of(model)
    middle = middle_of(model, np.zeros(model.nv))
    span = np.where(np.isfinite(upper - lower), upper - lower, np.pi)
    length = sum(float(np.linalg.norm(link.placement.position)) for link in arm.links)
    size = float(np.linalg.norm(tip))
    z = np.array([0.0, 0.0, 1.0])
    down = turn_onto(z if size < 1e-6 else tip / size, -z)
    random, best, home = np.random.default_rng(0), math.inf, None
    starts = [middle, *(middle + random.uniform(-0.25, 0.25, model.nv) * span
                        for _ in range(STARTS - 1))]
    for out, high in PLACES:
        for side in range(4):
            turn = pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi * side)
            pose = pin.SE3(turn @ down, turn @ np.array([out * length, 0.0, high * length]))
            for start in starts:
                q = reach(model, pose, start)
                if q is not None and (value := condition(model, q)) < best:
                    best, home = value, q
        if best < GOOD_CONDITION:
            break
    return home


def _text(
    urdf: str, values: dict[str, Any], limits: dict[str, list[float]], missing: list[str],
) -> str:
    """Return the text of the file, and add the limits to what is missing."""
    comments = {
        'locked_positions': 'rad or m', 'mount_link': 'carries the wrist sensor',
        'tip_links': 'of the tool, which is in the URDF', 'armature': f'kg m^2, {MARK}',
        'home': 'rad'}
    heads = {
        'locked_joints': 'Joints that are no part of the arm, and where they stay.',
        'tool': f'{MARK}: the URDF has no tool with a mass beyond the sensor link. In the frame '
                'of the sensor; m, kg, kg m^2.',
        'contacts': f'{MARK}: a table 7 mm below the tip at home; the normal points INTO it.'}
    lines = [
        f'# Written by `multicontact new-robot {urdf}`; what is marked {MARK} is a guess.',
        '# SI units. What is not here follows from the URDF (docs/your_robot.md).']
    for name, value in values.items():
        if name in heads:
            lines.append(f'# {heads[name]}')
        comment = f'  # {comments[name]}' if name in comments else ''
        lines.append(_entry(name, value) + comment)
    for name, (guess, unit) in GUESSED_LIMITS.items():
        lacking = ', '.join(joint for joint, value in zip(values['joint_names'], limits[name])
                            if math.isnan(value))
        entry = _entry(name, [guess if math.isnan(x) else x for x in limits[name]])
        if lacking:
            missing.append(f'{name} of {lacking}: the URDF has none')
        lines.append(f'{entry}  # {unit}, {MARK} for {lacking}: the URDF has none' if lacking
                     else f'# {entry}  # {unit}, those of the URDF')
    return '\n'.join([*lines, '# mount_rpy: [0.0, 0.0, 0.0]  # rad, axes of the sensor', ''])


def _entry(name: str, value: Any) -> str:
    """Return an entry of a YAML file, its lists in one line each."""
    style = None if isinstance(value, (list, dict)) else False
    return yaml.safe_dump({name: value}, default_flow_style=style, sort_keys=False,
                          width=math.inf).strip()


def _remarks(out: Path) -> tuple[str, ...]:
    """Check the file by reading it, and return what it makes."""
    robot = find_robot(str(out))
    arm, home = robot.arm, np.array(robot.file.home)
    model = arm.model()
    robot.plant_values('rigid')
    robot.controller_base()
    gravity = np.abs(pin.computeGeneralizedGravity(model, model.createData(), home))
    share = gravity / np.array(arm.torque_limit)
    return (
        f'{len(arm.links)} joints, {sum(body.mass for body in arm.bodies):.3g} kg, of which '
        f'{arm.carried_mass:.3g} kg hang on the sensor',
        f'at home gravity takes {100.0 * share.max():.0f} % of the torque limit at most, and the '
        f'condition of the Jacobian is {condition(model, home):.3g} (good below '
        f'{GOOD_CONDITION:g})')
