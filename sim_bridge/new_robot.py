"""A first configuration of a robot from its URDF, with all that follows from it filled in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any, NamedTuple
import xml.etree.ElementTree as ElementTree

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.dynamics.robot import (
    check_torques,
    find_followers,
    find_largest_gravity,
    Follower,
    load_model,
)
from multicontact_control.dynamics.urdf import parse_urdf
from multicontact_control.errors import ConfigError
from multicontact_control.runs.parameter_file import write_parameters
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm
from sim_bridge.posture import (
    find_posture_along,
    find_posture_at,
    jacobian_condition,
    joint_limits,
    middle_of_ranges,
    rotation_between,
)
from sim_bridge.robot_file import RobotFile
from sim_bridge.robots import Robot
from sim_bridge.urdf_arm import joints_up_to, read_robot_arm, read_urdf
from sim_bridge.workspace import find_reachable_box
import yaml

PLACEHOLDER = 'PLACEHOLDER'
TIP = 'tip'  # a name of its own, since the arm's links are named anew
GUESSED_CONTACTS = {
    'table': {
        'tip': TIP,
        'normal_world': [0.0, 0.0, -1.0],
        'gap': 0.007,
        'stiffness': 6000.0,
    }
}
GUESSED_TOOL = {
    'face_offset': 0.0,
    'face_mass': 0.001,
    'mass': 0.5,
    'com': [0.0, 0.0, 0.08],
    'inertia': [0.002, 0.002, 0.001],
    'tips': {TIP: [0.0, 0.0, 0.15]},
}  # where the URDF has none
GUESSED_TORQUE_LIMIT = 50.0  # N m
GUESSED_SPEED_LIMIT = 1.0  # rad/s
GUESSED_OVER_GRAVITY = 3.0  # torque limit at least, over what gravity takes at most
GUESSED_ARMATURE = 0.1  # kg m^2
LARGEST_LIMIT = 1e6  # N m or rad/s, from which on a limit is none
TURNING_KINDS = ('revolute', 'continuous')
DIGITS = 9  # behind the point, of a number that is written
FEWEST_JOINTS = 6  # for force and motion in six directions
# Places of the operational point that are tried for home, as shares of the arm's length: how far
# out and how high, on the four sides.
PLACES = ((0.45, 0.35), (0.35, 0.3), (0.5, 0.2), (0.4, 0.45), (0.3, 0.2))
STARTS = 4  # postures from which each is tried
# Postures whose tool is turned straight down where it is, if no such place is good.
RANDOM_POSTURES = 100
GOOD_CONDITION = 20.0  # of the Jacobian
GOOD_LOAD = 0.7  # share of the torque limit that gravity takes
DOWN = np.array([0.0, 0.0, -1.0])  # world axes
ENTRY_HEADS = {
    'locked_joints': 'Joints that are no part of the arm, and where they stay.',
    'tool': f'{PLACEHOLDER}: the URDF has no tool with a mass beyond the sensor link. '
    'In the frame of the sensor; m, kg, kg m^2.',
    'contacts': f'{PLACEHOLDER}: a table 7 mm below the tip at home; the normal points INTO it.',
}
ENTRY_COMMENTS = {
    'locked_positions': 'rad or m',
    'mount_link': 'carries the wrist sensor',
    'mount_rpy': 'rad, axes of the sensor in it',
    'tip_links': 'of the tool, which is in the URDF',
    'armature': f'kg m^2, {PLACEHOLDER}',
    'home': 'rad',
    'workspace_lower': 'm, what the operational point reaches with the tool as at home',
    'workspace_upper': 'm',
}


@dataclass
class Draft:
    """A robot's file as it comes into being, and what its user has to know of it."""

    values: dict[str, Any]  # the entries of the file, see `RobotFile`
    comments: dict[str, str] = field(default_factory=lambda: dict(ENTRY_COMMENTS))
    suspicious: list[str] = field(default_factory=list)  # figures of the URDF

    # Entries that are guessed or left out.
    missing: list[str] = field(default_factory=list)


class ArmJoints(NamedTuple):
    """Which joints of a URDF are the arm, and where the others stay."""

    chain: list[str]  # from the base to the sensor
    locked: dict[str, float]  # positions [rad or m]


def new_robot(
    urdf: Path,
    sensor: str,
    tip: str,
    out: Path,
    controller: Path,
    lock: Sequence[str] = (),
) -> tuple[str, ...]:
    """
    Write the files of a robot from its vendor's URDF, and return what they are and lack.

    Parameters
    ----------
    urdf
        Of the vendor.
    sensor
        Link that carries the wrist sensor.
    tip
        Link that touches.
    out
        The robot's file, for the simulation.
    controller
        The file of the controller on the real arm, beside which the URDF of the arm with its tool
        is written.
    lock
        Joints that are no part of the arm, and where they stay, as ``JOINT=POSITION`` [rad or m].

    Returns
    -------
    tuple
        Lines for the user: suspicious figures, what the robot is, and what is missing.

    Raises
    ------
    ConfigError
        If the URDF is not that of an arm, has no such links or joints, or has impossible figures.

    """
    text = read_urdf(urdf)
    joints = _find_arm_joints(parse_urdf(text), sensor, tip, _parse_positions(lock))
    folder = out.parent.resolve()
    draft = Draft(_first_values(urdf.resolve(), folder, joints, sensor, tip))
    arm = _read_or_guess_tool(urdf, draft)
    load_model(text, joints.locked, draft.suspicious)
    _choose_limits(arm, draft)
    _choose_home(arm, draft)
    _choose_workspace(arm, draft)
    draft.missing += [
        'armature: rotor inertia x gear ratio squared of each joint',
        'contacts: the surfaces your tip really meets, and their stiffness',
    ]
    robot = Robot(str(out), validate(RobotFile, draft.values, str(out)), folder)
    remarks = _describe_robot(robot)
    _write_controller(robot, controller, draft.missing)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(_compose_robot_file(urdf.name, draft), encoding='utf-8')
    suspicious = [f'suspicious: {remark}' for remark in draft.suspicious]
    missing = [f'missing: {entry}' for entry in draft.missing]
    return (*suspicious, *remarks, *missing)


def _first_values(
    urdf: Path, folder: Path, joints: ArmJoints, sensor: str, tip: str
) -> dict[str, Any]:
    """Return the entries of a file in a folder before anything is chosen, with a tool in it."""
    if urdf.is_relative_to(folder):
        urdf = urdf.relative_to(folder)
    joint_count = len(joints.chain)
    values: dict[str, Any] = {
        'urdf': str(urdf),
        'joint_names': joints.chain,
        'mount_link': sensor,
        'mount_rpy': [0.0] * 3,
        'tip_links': {TIP: tip},
        'home': [0.0] * joint_count,
        'contacts': GUESSED_CONTACTS,
        'armature': [GUESSED_ARMATURE] * joint_count,
    }
    if joints.locked:
        values['locked_joints'] = list(joints.locked)
        values['locked_positions'] = list(joints.locked.values())
    return values


def _read_or_guess_tool(urdf: Path, draft: Draft) -> Arm:
    """Read the arm with the tool of its URDF, or with a guessed one where that has none."""
    try:
        return read_robot_arm(urdf, RobotFile(**draft.values))
    except ConfigError as error:
        if error.field != 'tool':
            raise
    draft.missing.append(
        'tool: weigh it (`multicontact calibrate` shows how) and measure the tip'
    )
    del draft.values['tip_links']
    draft.values['tool'] = GUESSED_TOOL
    return read_robot_arm(urdf, RobotFile(**draft.values))


def _choose_limits(arm: Arm, draft: Draft) -> None:
    """Take torque and speed limits from the URDF, and guess those that it does not have."""
    model = arm.model()
    known = np.array(arm.torque_limit)
    known[(known <= 0.0) | (known >= LARGEST_LIMIT)] = np.nan
    draft.suspicious += check_torques(model, known)
    over_gravity = np.ceil(GUESSED_OVER_GRAVITY * find_largest_gravity(model))
    speeds = [link.speed_limit for link in arm.links]
    guessed_torques = np.maximum(GUESSED_TORQUE_LIMIT, over_gravity)
    guessed_speeds = np.full(len(speeds), GUESSED_SPEED_LIMIT)
    for name, unit, limits, guesses in (
        ('torque_limit', 'N m', arm.torque_limit, guessed_torques),
        ('speed_limit', 'rad/s', speeds, guessed_speeds),
    ):
        chosen = np.array(limits)
        unknown = (chosen <= 0.0) | (chosen >= LARGEST_LIMIT)
        chosen[unknown] = guesses[unknown]
        draft.values[name] = chosen.tolist()
        draft.comments[name] = unit
        if unknown.any():
            joints = ', '.join(np.array(arm.joint_names)[unknown])
            draft.comments[name] = (
                f'{unit}, {PLACEHOLDER} for {joints}: the URDF has none'
            )
            draft.missing.append(f'{name} of {joints}: the URDF has none')


def _choose_home(arm: Arm, draft: Draft) -> None:
    """Choose a home with the tip straight below the sensor, or the best of random postures."""
    model = arm.model()
    limit = np.array(draft.values['torque_limit'])
    home = _find_home(arm, limit)
    if home is None:
        home = min(_random_postures(model), key=lambda q: _badness(model, q, limit))
        draft.missing.append(
            'home: no posture with the tool straight down was found; this one is the '
            'farthest from singular, and from the torque limits, of '
            f'{RANDOM_POSTURES}'
        )
    draft.values['home'] = home.round(DIGITS).tolist()


def _choose_workspace(arm: Arm, draft: Draft) -> None:
    """Choose the box that the arm reaches around home, if there is one."""
    box = find_reachable_box(arm.model(), np.array(draft.values['home']))
    if box is None:
        draft.missing.append(
            'workspace_lower, workspace_upper: around home the tool reaches no box; '
            'limits.workspace_* are 0.4 to 0.6 m from it'
        )
        return
    lower, upper = box
    draft.values['workspace_lower'] = lower.round(3).tolist()
    draft.values['workspace_upper'] = upper.round(3).tolist()


def _write_controller(robot: Robot, out: Path, missing: Sequence[str]) -> None:
    """Write what the controller needs, beside the URDF of the arm with its tool."""
    name = Path(robot.name)
    urdf = out.with_name(f'{name.stem}_with_tool.urdf')
    values = robot.controller_base()
    values['robot'] = {**values['robot'], 'urdf': urdf.name}
    # Nothing of the simulated sensor; and no contact before this one is proven by a push test.
    values['sensor'] = {'require_push_test': True}
    values['watchdog'] = {}
    validate(ControllerConfig, values, str(out))
    out.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(robot.arm.urdf, encoding='utf-8')
    guesses = '\n'.join(f'# - {entry}' for entry in missing)
    write_parameters(
        out,
        {'/**': _round_numbers(values)},
        f'# Written by `multicontact new-robot` beside {name.name}, yours from here '
        "on.\n# Check every contact's normal and point, what hangs on the sensor, the torque "
        "limits\n# and the sensor's frame. Guessed or not known, and yours to replace:\n"
        f'{guesses}\n',
    )


def _round_numbers(value: Any) -> Any:
    """Return values without what rounding has left in them, such as 8.2e-18."""
    if isinstance(value, Mapping):
        return {name: _round_numbers(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_round_numbers(entry) for entry in value]
    if isinstance(value, float):
        return round(value, DIGITS) + 0.0  # which makes 0.0 of -0.0
    return value


def _parse_positions(lock: Sequence[str]) -> dict[str, float]:
    """Return positions by joint, of texts as JOINT=POSITION."""
    positions = {}
    for text in lock:
        joint, _, position = text.rpartition('=')
        try:
            positions[joint] = float(position)
        except ValueError:
            raise ConfigError(
                '--lock', 'JOINT=POSITION [rad or m]', f"'{text}'"
            ) from None
    return positions


def _find_arm_joints(
    root: ElementTree.Element,
    sensor: str,
    tip: str,
    lock: Mapping[str, float],
) -> ArmJoints:
    """Find the joints between base and sensor, and where all others are to stay; ConfigError."""
    links = [link.get('name', '') for link in root.findall('link')]
    moving = {
        joint.get('name', ''): joint
        for joint in root.findall('joint')
        if joint.get('type') != 'fixed'
    }
    _require_known('--sensor', [sensor], links)
    _require_known('--tip', [tip], links)
    _require_known('--lock', lock, moving)
    way = [joint.get('name', '') for joint in joints_up_to(root, sensor).values()]
    chain = [name for name in way if name in moving and name not in lock]
    _require_turning_chain(sensor, chain, moving)
    if tip != sensor and sensor not in joints_up_to(root, tip):
        raise ConfigError('--tip', f"'{sensor}' or a link beyond it", f"'{tip}'")
    coupled = find_followers(root)
    locked = dict(lock)
    for name, joint in moving.items():
        if name not in chain and name not in coupled and name not in locked:
            locked[name] = _nearest_to_zero(joint)
    _lock_followers(coupled, chain, locked)
    in_their_order = {name: locked[name] for name in moving if name in locked}
    return ArmJoints(chain, in_their_order)


def _require_known(option: str, names: Iterable[str], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            raise ConfigError(option, f'one of {", ".join(known)}', f"'{name}'")


def _require_turning_chain(
    sensor: str, chain: Sequence[str], moving: Mapping[str, ElementTree.Element]
) -> None:
    """Require enough joints that turn, and no others but sliding ones beyond the chain."""
    turning = [name for name in chain if moving[name].get('type') in TURNING_KINDS]
    if len(turning) < FEWEST_JOINTS:
        raise ConfigError(
            '--sensor',
            f'a link carried by {FEWEST_JOINTS} or more joints that turn, for force '
            'and motion in six directions',
            f"'{sensor}', carried by {len(turning)} ({', '.join(turning) or 'none'})",
        )
    for name, joint in moving.items():
        kind = joint.get('type')
        sliding = kind == 'prismatic'
        if kind in TURNING_KINDS or (sliding and name not in chain):
            continue
        hint = 'make it fixed in the URDF'
        if sliding:
            hint = f'add --lock {name}=POSITION'
        raise ConfigError(
            '--sensor',
            'an arm of joints that turn',
            f"'{name}', which is {kind}",
            hint=hint,
        )


def _nearest_to_zero(joint: ElementTree.Element) -> float:
    """Return the position in a joint's range that is nearest to 0 [rad or m]."""
    limit = joint.find('limit')
    if limit is None:
        return 0.0
    lower = float(limit.get('lower', 0.0))
    upper = float(limit.get('upper', 0.0))
    if lower > upper:
        return 0.0
    return min(max(0.0, lower), upper)


def _lock_followers(
    coupled: Mapping[str, Follower],
    chain: Sequence[str],
    locked: dict[str, float],
) -> None:
    """
    Lock joints that mimic locked ones, as the fingers of a gripper do, where that leads them.

    ConfigError if one is a joint of the arm, or follows one: then it moves, without a motor of its
    own that the law could command.
    """
    waiting = {name: each for name, each in coupled.items() if name not in locked}
    for (
        _
    ) in coupled:  # each pass locks at least the next of the longest chain of followers
        for name, follower in list(waiting.items()):
            if name not in chain and follower.leader in locked:
                led = follower.multiplier * locked[follower.leader]
                locked[name] = led + follower.offset
                del waiting[name]
    for name, follower in waiting.items():
        raise ConfigError(
            '--sensor',
            'an arm whose joints each have a motor of their own',
            f'{name} follows {follower.leader}, no motor of its own',
            hint=f'add --lock {name}=POSITION if it stays there',
        )


def _find_home(arm: Arm, limit: Vector) -> Vector | None:
    """
    Return a posture with the tip straight below the sensor, or None.

    It is the best one at the first of the places where one is good, or else the best of all.
    """
    model = arm.model()
    tip = np.array(arm.tips[TIP])
    size = float(np.linalg.norm(tip))
    along = np.array([0.0, 0.0, 1.0])
    if size >= 1e-6:
        along = tip / size
    length = sum(float(np.linalg.norm(link.placement.position)) for link in arm.links)
    best = math.inf
    home = None
    for postures in (
        *_postures_at_places(model, rotation_between(along, DOWN), length),
        _postures_turned_along(model, along, DOWN),
    ):
        for q in postures:
            badness = _badness(model, q, limit)
            if badness < best:
                best = badness
                home = q
        if best < 1.0:
            break
    return home


def _postures_at_places(
    model: pin.Model, tool_down: Matrix, length: float
) -> Iterator[Iterator[Vector]]:
    """Yield for each place above the floor, round an upright base, the postures that reach it."""
    middle = middle_of_ranges(model, np.zeros(model.nv))
    random = np.random.default_rng(0)
    starts = [middle]
    for _ in range(STARTS - 1):
        shares = random.uniform(-0.25, 0.25, model.nv)
        starts.append(middle + shares * _sizes_of_ranges(model))
    turns = [pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi * side) for side in range(4)]
    for out, high in PLACES:
        point = np.array([out * length, 0.0, high * length])
        poses = [pin.SE3(turn @ tool_down, turn @ point) for turn in turns]
        yield _postures_at(model, poses, starts)


def _postures_at(
    model: pin.Model, poses: Sequence[pin.SE3], starts: Sequence[Vector]
) -> Iterator[Vector]:
    """Yield the postures at some poses that are found from some starts."""
    for pose in poses:
        for start in starts:
            q = find_posture_at(model, pose, start)
            if q is not None:
                yield q


def _postures_turned_along(
    model: pin.Model, axis: Vector, direction_world: Vector
) -> Iterator[Vector]:
    """Yield postures wherever they are: of an arm on a wall, a ceiling or a slope, too."""
    for start in _random_postures(model):
        q = find_posture_along(model, axis, direction_world, start)
        if q is not None:
            yield q


def _random_postures(model: pin.Model) -> Iterator[Vector]:
    """Yield joint angles over the joints' ranges, shape (n,) [rad]."""
    middle = middle_of_ranges(model, np.zeros(model.nv))
    random = np.random.default_rng(0)
    for _ in range(RANDOM_POSTURES):
        yield middle + random.uniform(-0.5, 0.5, model.nv) * _sizes_of_ranges(model)


def _sizes_of_ranges(model: pin.Model) -> Vector:
    """Return the sizes of the joints' ranges, shape (n,), half a turn without one [rad]."""
    lower, upper = joint_limits(model)
    sizes: Vector = upper - lower
    sizes[np.isinf(sizes)] = np.pi
    return sizes


def _badness(model: pin.Model, q: Vector, limit: Vector) -> float:
    """Return how near a posture is to singular or to the torque limits [N m]; good below 1."""
    load = float((_holding_torque(model, q) / limit).max())
    return max(jacobian_condition(model, q) / GOOD_CONDITION, load / GOOD_LOAD)


def _holding_torque(model: pin.Model, q: Vector) -> Vector:
    """Return the torque that holds the arm, by its size, shape (n,) [N m]."""
    return np.abs(pin.computeGeneralizedGravity(model, model.createData(), q))


def _compose_robot_file(urdf: str, draft: Draft) -> str:
    """Return the text of the robot's file, of a URDF of this name."""
    lines = [
        f'# Written by `multicontact new-robot {urdf}`; what is marked {PLACEHOLDER} is a guess.',
        '# SI units. What is not here follows from the URDF (docs/your_robot.md).',
    ]
    for name, value in _round_numbers(draft.values).items():
        if name in ENTRY_HEADS:
            lines.append(f'# {ENTRY_HEADS[name]}')
        # In one line; None is the style of a list or dictionary within the line.
        style = None if isinstance(value, (list, dict)) else False
        dumped = yaml.safe_dump(
            {name: value}, default_flow_style=style, sort_keys=False, width=math.inf
        )
        entry = dumped.strip()
        if name in draft.comments:
            entry = f'{entry}  # {draft.comments[name]}'
        lines.append(entry)
    return '\n'.join([*lines, ''])


def _describe_robot(robot: Robot) -> tuple[str, ...]:
    """Return what is known of a robot, whose values are checked."""
    arm = robot.arm
    home = np.array(robot.file.home)
    model = arm.model()
    robot.plant_values('rigid')
    share = _holding_torque(model, home) / arm.torque_limit
    mass = sum(body.mass for body in arm.bodies)
    condition = jacobian_condition(model, home)
    return (
        f'{len(arm.links)} joints, {mass:.3g} kg, of which '
        f'{arm.carried_mass:.3g} kg hang on the sensor',
        f'at home gravity takes {100.0 * share.max():.0f} % of the torque limit at most, and the '
        f'condition of the Jacobian is {condition:.3g} (good below {GOOD_CONDITION:g})',
    )
