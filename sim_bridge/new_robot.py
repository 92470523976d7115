"""A first configuration of a robot from its URDF, with all that follows from it filled in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math
from pathlib import Path
from typing import Any
import xml.etree.ElementTree as ElementTree

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig, validate
from multicontact_control.dynamics.robot import (
    check_torques,
    find_followers,
    Follower,
    largest_gravity,
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
from sim_bridge.workspace import reachable_box
import yaml

MARK = 'PLACEHOLDER'
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
GUESSED_LIMITS = {'torque_limit': (50.0, 'N m'), 'speed_limit': (1.0, 'rad/s')}
GUESSED_OVER_GRAVITY = 3.0  # torque limit at least, over what gravity takes at most
GUESSED_ARMATURE = 0.1  # kg m^2
LARGEST_LIMIT = 1e6  # N m or rad/s, from which on a limit is none
TURNING = ('revolute', 'continuous')
DIGITS = 9  # behind the point, of a number that is written
FEWEST_JOINTS = 6  # for force and motion in six directions
# Places of the operational point that are tried for home, as shares of the arm's length: how far
# out and how high, on the four sides.
PLACES = ((0.45, 0.35), (0.35, 0.3), (0.5, 0.2), (0.4, 0.45), (0.3, 0.2))
STARTS = 4  # postures from which each is tried
RANDOM_STARTS = (
    100  # postures whose tool is turned straight down, if no such place is good
)
GOOD_CONDITION = 20.0  # of the Jacobian
GOOD_LOAD = 0.7  # share of the torque limit that gravity takes
HEADS = {
    'locked_joints': 'Joints that are no part of the arm, and where they stay.',
    'tool': f'{MARK}: the URDF has no tool with a mass beyond the sensor link. In the frame of '
    'the sensor; m, kg, kg m^2.',
    'contacts': f'{MARK}: a table 7 mm below the tip at home; the normal points INTO it.',
}
COMMENTS = {
    'locked_positions': 'rad or m',
    'mount_link': 'carries the wrist sensor',
    'mount_rpy': 'rad, axes of the sensor in it',
    'tip_links': 'of the tool, which is in the URDF',
    'armature': f'kg m^2, {MARK}',
    'home': 'rad',
    'workspace_lower': 'm, what the operational point reaches with the tool as at home',
    'workspace_upper': 'm',
}


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

    `out` is the robot's file and `controller` that of the controller on the real arm, beside which
    the URDF of the arm with its tool is written. `sensor` is the link that carries the wrist
    sensor, `tip` the one that touches; `lock` has joints that are no part of the arm, and where
    they stay, as ``JOINT=POSITION`` [rad or m].

    Raises ConfigError if the URDF is not that of an arm, has no such links or joints, or has
    impossible figures.
    """
    text, suspicious, missing = read_urdf(urdf), list[str](), list[str]()
    joints, locked = _joints(parse_urdf(text), sensor, tip, _positions(lock))
    path, folder = urdf.resolve(), out.parent.resolve()
    values: dict[str, Any] = {
        'urdf': str(path.relative_to(folder) if path.is_relative_to(folder) else path),
        'joint_names': joints,
        'mount_link': sensor,
        'mount_rpy': [0.0] * 3,
        'tip_links': {TIP: tip},
        'home': [0.0] * len(joints),
        'contacts': GUESSED_CONTACTS,
        'armature': [GUESSED_ARMATURE] * len(joints),
    }
    if locked:
        values |= {
            'locked_joints': list(locked),
            'locked_positions': list(locked.values()),
        }
    try:
        arm = read_robot_arm(urdf, RobotFile(**values))
    except ConfigError as error:
        if error.field != 'tool':
            raise
        missing.append(
            'tool: weigh it (`multicontact calibrate` shows how) and measure the tip'
        )
        del values['tip_links']
        values['tool'] = GUESSED_TOOL
        arm = read_robot_arm(urdf, RobotFile(**values))
    load_model(text, locked, suspicious)
    limits = {
        name: np.array(
            [
                value
                if 0.0 < (value := getattr(link, name)) < LARGEST_LIMIT
                else math.nan
                for link in arm.links
            ]
        )
        for name in GUESSED_LIMITS
    }
    suspicious += check_torques(arm.model(), limits['torque_limit'])
    guesses = {
        'speed_limit': np.full(len(joints), GUESSED_LIMITS['speed_limit'][0]),
        'torque_limit': np.maximum(
            GUESSED_LIMITS['torque_limit'][0],
            np.ceil(GUESSED_OVER_GRAVITY * largest_gravity(arm.model())),
        ),
    }
    limit = np.where(
        np.isnan(limits['torque_limit']),
        guesses['torque_limit'],
        limits['torque_limit'],
    )
    home = _home(arm, np.array(arm.tips[TIP]), limit)
    if home is None:
        home = min(
            _random_postures(arm.model()), key=lambda q: _badness(arm.model(), q, limit)
        )
        missing.append(
            'home: no posture with the tool straight down was found; this one is the '
            'farthest from singular, and from the torque limits, of '
            f'{RANDOM_STARTS}'
        )
    values['home'] = home.round(9).tolist()
    box = reachable_box(arm.model(), home)
    if box is None:
        missing.append(
            'workspace_lower, workspace_upper: around home the tool reaches no box; '
            'limits.workspace_* are 0.4 to 0.6 m from it'
        )
    else:
        values['workspace_lower'], values['workspace_upper'] = (
            corner.round(3).tolist() for corner in box
        )
    comments = dict(COMMENTS)
    for name, (_, unit) in GUESSED_LIMITS.items():
        values[name] = np.where(
            np.isnan(limits[name]), guesses[name], limits[name]
        ).tolist()
        comments[name] = unit
        if lacking := ', '.join(np.array(joints)[np.isnan(limits[name])]):
            comments[name] = f'{unit}, {MARK} for {lacking}: the URDF has none'
            missing.append(f'{name} of {lacking}: the URDF has none')
    missing += [
        'armature: rotor inertia x gear ratio squared of each joint',
        'contacts: the surfaces your tip really meets, and their stiffness',
    ]
    robot = Robot(str(out), validate(RobotFile, values, str(out)), folder)
    remarks = _remarks(robot)
    _write_controller(robot, controller, missing)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(_text(urdf.name, _rounded(values), comments), encoding='utf-8')
    return (
        *(f'suspicious: {remark}' for remark in suspicious),
        *remarks,
        *(f'missing: {what}' for what in missing),
    )


def _write_controller(robot: Robot, out: Path, missing: Sequence[str]) -> None:
    """Write what the controller needs, beside the URDF of the arm with its tool."""
    values = robot.controller_base()
    urdf = out.with_name(f'{Path(robot.name).stem}_with_tool.urdf')
    values['robot'] = {**values['robot'], 'urdf': urdf.name}
    # Nothing of the simulated sensor; and no contact before this one is proven by a push test.
    values['sensor'], values['watchdog'] = {'require_push_test': True}, {}
    validate(ControllerConfig, values, str(out))
    out.parent.mkdir(parents=True, exist_ok=True)
    urdf.write_text(robot.arm.urdf, encoding='utf-8')
    guesses = '\n'.join(f'# - {text}' for text in missing)
    write_parameters(
        out,
        {'/**': _rounded(values)},
        f'# Written by `multicontact new-robot` beside {Path(robot.name).name}, yours from here '
        "on.\n# Check every contact's normal and point, what hangs on the sensor, the torque "
        "limits\n# and the sensor's frame. Guessed or not known, and yours to replace:\n"
        f'{guesses}\n',
    )


def _rounded(value: Any) -> Any:
    """Return values without what rounding has left in them, such as 8.2e-18."""
    if isinstance(value, Mapping):
        return {name: _rounded(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(entry) for entry in value]
    return round(value, DIGITS) + 0.0 if isinstance(value, float) else value


def _positions(lock: Sequence[str]) -> dict[str, float]:
    """Return positions by joint."""
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


def _joints(
    root: ElementTree.Element,
    sensor: str,
    tip: str,
    lock: Mapping[str, float],
) -> tuple[list[str], dict[str, float]]:
    """Return the joints between base and sensor, and where all others are to stay."""
    links = [link.get('name', '') for link in root.findall('link')]
    moving = {
        joint.get('name', ''): joint
        for joint in root.findall('joint')
        if joint.get('type') != 'fixed'
    }
    for field, names, known in (
        ('sensor', [sensor], links),
        ('tip', [tip], links),
        ('lock', lock, moving),
    ):
        if unknown := [name for name in names if name not in known]:
            raise ConfigError(
                f'--{field}', f'one of {", ".join(known)}', f"'{unknown[0]}'"
            )
    chain = [
        name
        for joint in joints_up_to(root, sensor).values()
        if (name := joint.get('name', '')) in moving and name not in lock
    ]
    turning = [name for name in chain if moving[name].get('type') in TURNING]
    if len(turning) < FEWEST_JOINTS:
        raise ConfigError(
            '--sensor',
            f'a link carried by {FEWEST_JOINTS} or more joints that turn, for force '
            'and motion in six directions',
            f"'{sensor}', carried by {len(turning)} ({', '.join(turning) or 'none'})",
        )
    for name, joint in moving.items():
        kind = joint.get('type')
        if kind not in TURNING and (name in chain or kind != 'prismatic'):
            raise ConfigError(
                '--sensor',
                'an arm of joints that turn',
                f"'{name}', which is {kind}",
                hint=f'add --lock {name}=POSITION'
                if kind == 'prismatic'
                else 'make it fixed in the URDF',
            )
    if tip != sensor and sensor not in joints_up_to(root, tip):
        raise ConfigError('--tip', f"'{sensor}' or a link beyond it", f"'{tip}'")
    locked = dict(lock)
    coupled = find_followers(root)
    for name, joint in moving.items():
        if name not in chain and name not in coupled and name not in locked:
            locked[name] = _nearest_to_zero(joint)
    _lock_followers(coupled, chain, locked)
    return chain, {name: locked[name] for name in moving if name in locked}


def _nearest_to_zero(joint: ElementTree.Element) -> float:
    """Return the position in a joint's range that is nearest to 0 [rad or m]."""
    limit = joint.find('limit')
    ends = {} if limit is None else limit.attrib
    lower, upper = (float(ends.get(end, 0.0)) for end in ('lower', 'upper'))
    return min(max(0.0, lower), upper) if lower <= upper else 0.0


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
    waiting = [name for name in coupled if name not in locked]
    while ready := [
        name for name in waiting if name not in chain and coupled[name].leader in locked
    ]:
        for name in ready:
            follower = coupled[name]
            locked[name] = (
                follower.multiplier * locked[follower.leader] + follower.offset
            )
            waiting.remove(name)
    if waiting:
        name = waiting[0]
        raise ConfigError(
            '--sensor',
            'an arm whose joints each have a motor of their own',
            f'{name} follows {coupled[name].leader}, no motor of its own',
            hint=f'add --lock {name}=POSITION if it stays there',
        )


def _home(arm: Arm, tip: Vector, limit: Vector) -> Vector | None:
    """Return a posture with the tip straight below the sensor, or None."""
    model = arm.model()
    size = float(np.linalg.norm(tip))
    z = np.array([0.0, 0.0, 1.0])
    along = z if size < 1e-6 else tip / size
    length = sum(float(np.linalg.norm(link.placement.position)) for link in arm.links)
    best, home = math.inf, None
    for postures in (
        *_at_places(model, rotation_between(along, -z), length),
        _turned_where_they_are(model, along, -z),
    ):
        for q in postures:
            badness = _badness(model, q, limit)
            if badness < best:
                best, home = badness, q
        if best < 1.0:
            break
    return home


def _at_places(
    model: pin.Model,
    down: Matrix,
    length: float,
) -> Iterator[Iterator[Vector]]:
    """Yield for each place above the floor, round an upright base, the postures that reach it."""
    middle = middle_of_ranges(model, np.zeros(model.nv))
    random, span = np.random.default_rng(0), _spans(model)
    starts = [
        middle,
        *(
            middle + random.uniform(-0.25, 0.25, model.nv) * span
            for _ in range(STARTS - 1)
        ),
    ]
    turns = [pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi * side) for side in range(4)]
    for out, high in PLACES:
        point = np.array([out * length, 0.0, high * length])
        poses = [pin.SE3(turn @ down, turn @ point) for turn in turns]
        tries = (
            find_posture_at(model, pose, start) for pose in poses for start in starts
        )
        yield (q for q in tries if q is not None)


def _turned_where_they_are(
    model: pin.Model,
    axis: Vector,
    direction_world: Vector,
) -> Iterator[Vector]:
    """Yield postures wherever they are: of an arm on a wall, a ceiling or a slope, too."""
    for start in _random_postures(model):
        q = find_posture_along(model, axis, direction_world, start)
        if q is not None:
            yield q


def _random_postures(model: pin.Model) -> Iterator[Vector]:
    """Yield joint angles over the joints' ranges, shape (n,) [rad]."""
    middle, span = middle_of_ranges(model, np.zeros(model.nv)), _spans(model)
    random = np.random.default_rng(0)
    for _ in range(RANDOM_STARTS):
        yield middle + random.uniform(-0.5, 0.5, model.nv) * span


def _spans(model: pin.Model) -> Vector:
    """Return the sizes of the joints' ranges, shape (n,), half a turn without one [rad]."""
    lower, upper = joint_limits(model)
    spans: Vector = np.where(np.isfinite(upper - lower), upper - lower, np.pi)
    return spans


def _badness(model: pin.Model, q: Vector, limit: Vector) -> float:
    """Return how near a posture is to singular or to the torque limits [N m]; good below 1."""
    load = float((_load(model, q) / limit).max())
    return max(jacobian_condition(model, q) / GOOD_CONDITION, load / GOOD_LOAD)


def _load(model: pin.Model, q: Vector) -> Vector:
    """Return the torque that holds the arm, by its size, shape (n,) [N m]."""
    return np.abs(pin.computeGeneralizedGravity(model, model.createData(), q))


def _text(urdf: str, values: dict[str, Any], comments: Mapping[str, str]) -> str:
    """Return the text of the robot's file."""
    lines = [
        f'# Written by `multicontact new-robot {urdf}`; what is marked {MARK} is a guess.',
        '# SI units. What is not here follows from the URDF (docs/your_robot.md).',
    ]
    for name, value in values.items():
        if name in HEADS:
            lines.append(f'# {HEADS[name]}')
        style = (
            None if isinstance(value, (list, dict)) else False
        )  # lists in one line each
        entry = yaml.safe_dump(
            {name: value}, default_flow_style=style, sort_keys=False, width=math.inf
        ).strip()
        lines.append(f'{entry}  # {comments[name]}' if name in comments else entry)
    return '\n'.join([*lines, ''])


def _remarks(robot: Robot) -> tuple[str, ...]:
    """Return what is known of a robot, whose values are checked."""
    arm, home = robot.arm, np.array(robot.file.home)
    model = arm.model()
    robot.plant_values('rigid')
    share = _load(model, home) / arm.torque_limit
    return (
        f'{len(arm.links)} joints, {sum(body.mass for body in arm.bodies):.3g} kg, of which '
        f'{arm.carried_mass:.3g} kg hang on the sensor',
        f'at home gravity takes {100.0 * share.max():.0f} % of the torque limit at most, and the '
        f'condition of the Jacobian is {jacobian_condition(model, home):.3g} (good below '
        f'{GOOD_CONDITION:g})',
    )
