"""
One situation: what an arm is asked to do, where, and with which sensor and tool.

A fault is wrong from outside; in a situation everything works, but a motion leads to a stop of a
joint or out of reach, a sensor has a bias, a surface is tilted, a tool carries more.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
import hashlib
from importlib.util import find_spec
from pathlib import Path
import tempfile
from typing import Any, Literal, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import find_cache_folder
from multicontact_control.config import Config, merge, parameter, Vector3
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.faults.course import Course, REST_TIME
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.scenario import resolve, Setup
import numpy as np
from scipy.linalg import null_space
from sim_bridge.new_robot import new_robot
from sim_bridge.robots import DEFAULT, find_robot

FOREIGN = 'foreign'  # in the place of a robot's name
FOREIGN_URDF = 'foreign_arm.urdf'
FOREIGN_LINK = 'l6'
COMMAND_TIME = 0.1  # s, when the forces are commanded
STEP_TIME = 1.2  # s, when a scenario's forces go from the preload to their commands
BLEND_TIME = 1.0  # s, of a sinusoid
BOX_MARGIN = 1e-3  # m
BEYOND_STOP = 0.15  # rad, that a motion leads a joint beyond its stop
FARTHEST_SLIDE = 0.3  # m, to lead a joint to its stop
FARTHEST_TURN = 0.8  # rad, likewise
SIDE_SIGNS = {'lower': -1.0, 'upper': 1.0}  # of the turn towards a stop of a joint


class SituationConfig(Config):
    """
    What an arm is asked to do, where, and with which sensor and tool.

    In a study's file the names of these parameters begin with ``situation.``. By default the first
    contact is pressed with 10 N, and nothing moves.
    """

    contacts: int = parameter(
        1, 'How many of the contacts there are, the first ones.', ge=1
    )
    force: float = parameter(
        10.0,
        'Commanded at every contact; at 0 there are no surfaces.',
        unit='N',
        ge=0.0,
    )
    motion: Literal['line', 'sine'] = parameter(
        'line', 'There and back by setpoints, or the sinusoid of a scenario.'
    )
    direction_world: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Direction of the motion of the operational point; 0 for none.'
    )
    turn_world: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Axis of a turn about the operational point; 0 for none.'
    )
    distance: float = parameter(
        0.0, 'How far, less where the workspace box ends.', unit='m or rad', ge=0.0
    )
    speed: float = parameter(
        0.1, 'Largest speed of the motion.', unit='m/s or rad/s', gt=0.0
    )
    motion_time: float = parameter(
        2.0,
        'When the motion begins: every contact has been at its force for a while.',
        unit='s',
        ge=0.0,
    )
    legs: int = parameter(
        2,
        'There, back, there...: how often it goes; two are a period of a sinusoid.',
        ge=1,
    )
    stop_joint: int = parameter(
        0,
        'Joint, from 1 on, that is led to a stop near home by the motion that turns it most; 0 '
        'for none.',
        ge=0,
    )
    stop_side: Literal['lower', 'upper'] = parameter('upper', 'Which of its stops.')
    stop_margin: float = parameter(0.1, 'Of that stop from home.', unit='rad', gt=0.0)
    bias_along: float = parameter(
        0.0, "Bias of the sensor along the first contact's normal.", unit='N'
    )
    bias_across: float = parameter(0.0, 'Bias of the sensor across it.', unit='N')
    bias_appears: bool = parameter(
        False,
        'Whether the bias comes during the approach, and is not there from the start.',
    )
    farther: float = parameter(
        0.0,
        'How much farther away than usual the surfaces are.',
        unit='m',
        ge=0.0,
        le=0.08,
    )
    tilt: float = parameter(
        0.0,
        'Of the surfaces, unknown to the controller: a motion ahead leads up if positive.',
        unit='deg',
    )
    payload: float = parameter(0.0, 'What the tool picks up.', unit='kg', ge=0.0)
    told: bool = parameter(True, 'Whether the controller is told of it.')


@cache
def foreign_robot() -> str:
    """
    Return the file of a robot that `multicontact new-robot` has written for a foreign arm.

    The arm is ``config/studies/foreign_arm.urdf``, which no file of `config/robots` describes. Its
    file lies in the cache of compiled code, under a hash of the URDF.
    """
    urdf = find_config_folder() / 'studies' / FOREIGN_URDF
    stamp = hashlib.sha256(urdf.read_bytes()).hexdigest()[:16]
    base_folder = find_cache_folder() or Path(tempfile.gettempdir())
    folder = base_folder / f'foreign-{stamp}'
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / 'arm.yaml'
    # Written elsewhere and moved: other processes may write it at the same time.
    with tempfile.TemporaryDirectory(dir=folder) as unfinished:
        written = Path(unfinished) / file.name
        new_robot(
            urdf,
            FOREIGN_LINK,
            FOREIGN_LINK,
            written,
            written.with_name('controller.yaml'),
        )
        written.replace(file)
    return str(file)


class RobotMeans(NamedTuple):
    """
    What a robot has for situations: plants, contacts and joints.

    Found without a simulation, so that all combinations of a study can be sifted before the first
    is run.
    """

    plants: Collection[str]  # names and aliases
    contacts: int
    joints: int

    def allow(self, plant: str, situation: SituationConfig) -> bool:
        """
        Return whether there are such a plant, so many contacts, and such a joint.

        A study of situations skips the combinations that a robot has not the means for, instead of
        failing on them.
        """
        return (
            plant in self.plants
            and situation.contacts <= self.contacts
            and situation.stop_joint <= self.joints
        )


@cache
def find_means(name: str) -> RobotMeans:
    """
    Return what a robot has for situations.

    An empty name stands for the default robot. The answer is kept, since a study asks for it with
    each of its combinations.

    Raises
    ------
    ConfigError
        Of its `urdf` or `engine`, if it is not installed.

    """
    source = name or DEFAULT
    if name == FOREIGN:
        source = foreign_robot()
        if find_spec('mujoco') is None:
            raise ConfigError('engine', 'mujoco: pip install mujoco', 'none')
    robot = find_robot(source)
    contacts = robot.controller_base()['contact_names']
    plants = {*robot.file.plants, *robot.file.plant_aliases}
    return RobotMeans(plants, len(contacts), len(robot.arm.links))


def resolve_situation(
    arguments: Mapping[str, Any],
    situation: SituationConfig,
) -> tuple[Setup, Course]:
    """
    Return a setup in a situation, and the motion in it.

    The files are resolved twice: once to know the arm's home, limits and contacts, from which the
    course follows, and once with what the situation changes. Bias, payload and the distance of the
    surfaces are not in the setup; `SituationRun` applies them.

    Parameters
    ----------
    arguments
        Of `resolve`; the robot may be `FOREIGN`.
    situation
        What is asked for. The robot has such a joint, and so many contacts; see `RobotMeans`.

    """
    given = dict(arguments)
    if given.get('robot') == FOREIGN:
        given['robot'] = foreign_robot()
        given['plant_overrides'] = merge(
            {'engine': 'mujoco'}, given.get('plant_overrides') or {}
        )
    base = resolve(**given)
    names = base.controller.contact_names[: situation.contacts]
    course = _plan_course(base, situation, names)
    # A surface that is farther away is touched later, at the speed of the approach.
    approach_speed = base.controller.contact_state.approach_speed
    begin = situation.motion_time + situation.farther / approach_speed
    scenario: dict[str, Any] = {'duration': begin + course.duration + REST_TIME}
    if situation.motion == 'sine':
        scenario['reference'] = _sine_reference(situation, course, names)
        motion_duration = 0.5 * situation.legs * course.period
        scenario['duration'] = situation.motion_time + motion_duration
    chosen = {'contact_names': list(names)}
    limits = _stops_near_home(base, situation)
    surfaces = _tilted_surfaces(base, situation, course)
    changes = {
        'controller': {**chosen, 'limits': limits},
        'noise_estimator': chosen,
        'plant_overrides': {**chosen, 'surfaces': surfaces},
        'scenario_overrides': scenario,
    }
    return resolve(**merge(given, changes)), course


def _plan_course(
    base: Setup, situation: SituationConfig, names: tuple[str, ...]
) -> Course:
    """Return the motion of a situation, as far as the workspace box lets it go."""
    robot = RobotModel(base.controller.robot, base.urdf_dir)
    state = robot.update(np.array(base.plant.home), np.zeros(robot.joint_count))
    direction = np.array(situation.direction_world)
    axis = np.array(situation.turn_world)
    distance = situation.distance
    if situation.stop_joint:
        free = np.eye(3)
        if situation.force:
            contacts = base.controller.contacts
            normals = [contacts[name].normal_world for name in names]
            free = null_space(np.array(normals))
        direction, axis, distance = _towards_stop(
            state.mass_matrix, state.jacobian, free, situation
        )
    direction = _unit_vector(direction)
    axis = _unit_vector(axis)
    limits = base.controller.limits
    if direction.any() and limits.workspace_lower:
        ends = np.where(direction > 0.0, limits.workspace_upper, limits.workspace_lower)
        room = np.abs(ends - state.pose.position_world) - BOX_MARGIN
        along = np.abs(direction) > 1e-9
        distances = room[along] / np.abs(direction[along])
        distance = min(distance, float(distances.min()))
    legs = 0
    if direction.any() or axis.any():
        legs = situation.legs
    return Course(state.pose, direction, axis, distance, situation.speed, legs)


def _unit_vector(vector: Vector) -> Vector:
    """Return a vector of unit length in the same direction, or 0 as it is."""
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        return vector
    return vector / length


def _towards_stop(
    mass_matrix: Matrix,
    jacobian: Matrix,
    free: Matrix,
    situation: SituationConfig,
) -> tuple[Vector, Vector, float]:
    """
    Return direction, axis and distance of the motion that leads a joint beyond its stop.

    A slide in the `free` directions, shape (3, k), or a turn where no slide does, with the
    dynamically consistent inverse of J at home (P04 eq. 23).
    """
    moved = np.linalg.solve(mass_matrix, jacobian.T)
    inverse = moved @ np.linalg.inv(jacobian @ moved)
    rates = inverse[situation.stop_joint - 1]
    slide = free @ (free.T @ rates[:3])
    turn = rates[3:]
    rate_of_slide = float(np.linalg.norm(slide))  # rad of the joint per m
    rate_of_turn = float(np.linalg.norm(turn))
    sign = SIDE_SIGNS[situation.stop_side]
    way = situation.stop_margin + BEYOND_STOP
    if FARTHEST_SLIDE * rate_of_slide >= min(way, FARTHEST_TURN * rate_of_turn):
        distance = min(way / max(rate_of_slide, 1e-9), FARTHEST_SLIDE)
        return sign * slide, np.zeros(3), distance
    return np.zeros(3), sign * turn, min(way / rate_of_turn, FARTHEST_TURN)


def _stops_near_home(base: Setup, situation: SituationConfig) -> dict[str, list[float]]:
    """Return the joints' limits where one of them is near home."""
    if not situation.stop_joint:
        return {}
    joint = situation.stop_joint - 1
    side = f'joint_{situation.stop_side}'
    stops = list(getattr(base.controller.limits, side))
    margin = SIDE_SIGNS[situation.stop_side] * situation.stop_margin
    stops[joint] = base.plant.home[joint] + margin
    return {side: stops}


def _tilted_surfaces(
    base: Setup, situation: SituationConfig, course: Course
) -> dict[str, Any]:
    """Return the surfaces' normals, turned about where the tips meet them at home."""
    if not situation.tilt:
        return {}
    angle = np.radians(situation.tilt)
    surfaces = {}
    for name in base.plant.touched:
        normal = np.array(base.plant.surfaces[name].normal_world)
        ahead = _unit_vector(course.direction - normal * (normal @ course.direction))
        turned = np.cos(angle) * normal + np.sin(angle) * ahead
        surfaces[name] = {'normal_world': turned.tolist()}
    return surfaces


def _sine_reference(
    situation: SituationConfig,
    course: Course,
    names: tuple[str, ...],
) -> dict[str, Any]:
    """Return the scenario's reference: forces, then a sinusoid to either side."""
    forces = dict.fromkeys(names, situation.force)
    motion = {
        'start_time': situation.motion_time,
        'direction_world': course.direction.tolist(),
        'amplitude': course.distance,
        'period': course.period,
        'blend_time': BLEND_TIME,
    }
    return {
        'approach': {'start_time': COMMAND_TIME},
        'force_steps': [{'time': STEP_TIME, 'forces': forces}],
        'motion': motion,
    }
