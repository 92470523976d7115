"""
One situation: what an arm is asked to do, where, and with which sensor and tool.

A fault is wrong from outside; in a situation everything works, but a motion leads to a stop of a
joint or out of reach, a sensor has a bias, a surface is tilted, a tool carries more.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
import hashlib
from pathlib import Path
import tempfile
from typing import Any, Literal, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import cache_folder
from multicontact_control.config import Config, merge, parameter, ToolConfig, Vector3
from multicontact_control.control.tasks import MotionReading, sine_motion
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.judge import (
    died,
    judge_situation,
    Observation,
    SituationRow,
    Way,
)
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.paths import config_dir
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from sim_bridge.new_robot import new_robot
from sim_bridge.robots import DEFAULT, find_robot

FOREIGN = 'foreign'  # in the place of a robot's name
FOREIGN_URDF, FOREIGN_LINK = 'foreign_arm.urdf', 'l6'
NOWHERE = 10.0  # m, how far away surfaces are that are not there
COMMAND_TIME = 0.1  # s, when the forces are commanded
MOTION_TIME = 2.0  # s, when the motion begins: every contact has been at its force for a while
PICK_UP_TIME = 2.0  # s, the same of a payload
APPEARING_TIME = 0.5  # s, in the middle of the approach
RAMP_TIME = 0.3  # s, of the speed of a motion
REST_TIME = 1.0  # s, at each end of a motion
BOX_MARGIN = 1e-3  # m
BEYOND_STOP = 0.15  # rad, that a motion leads a joint beyond its stop
FARTHEST_SLIDE, FARTHEST_TURN = 0.3, 0.8  # m, rad, to lead a joint to its stop


class SituationConfig(Config):
    """What an arm is asked to do, where, and with which sensor and tool."""

    contacts: int = parameter(1, 'How many of the contacts there are, the first ones.', ge=1)
    force: float = parameter(
        10.0, 'Commanded at every contact; at 0 there are no surfaces.', unit='N', ge=0.0)
    motion: Literal['line', 'sine'] = parameter(
        'line', 'There and back by setpoints, or the sinusoid of a scenario.')
    direction_world: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Direction of the motion of the operational point; 0 for none.')
    turn_world: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Axis of a turn about the operational point; 0 for none.')
    distance: float = parameter(
        0.0, 'How far, less where the workspace box ends.', unit='m or rad', ge=0.0)
    speed: float = parameter(0.1, 'Largest speed of the motion.', unit='m/s or rad/s', gt=0.0)
    legs: int = parameter(
        2, 'There, back, there...: how often it goes; two are a period of a sinusoid.', ge=1)
    stop_joint: int = parameter(
        0, 'Joint, from 1 on, that is led to a stop near home by the motion that turns it most; 0 '
        'for none.', ge=0)
    stop_side: Literal['lower', 'upper'] = parameter('upper', 'Which of its stops.')
    stop_margin: float = parameter(0.1, 'Of that stop from home.', unit='rad', gt=0.0)
    bias_along: float = parameter(
        0.0, "Bias of the sensor along the first contact's normal.", unit='N')
    bias_across: float = parameter(0.0, 'Bias of the sensor across it.', unit='N')
    bias_appears: bool = parameter(
        False, 'Whether the bias comes during the approach, and is not there from the start.')
    farther: float = parameter(
        0.0, 'How much farther away than usual the surfaces are.', unit='m', ge=0.0, le=0.08)
    tilt: float = parameter(
        0.0, 'Of the surfaces, unknown to the controller: a motion ahead leads up if positive.',
        unit='deg')
    payload: float = parameter(0.0, 'What the tool picks up.', unit='kg', ge=0.0)
    told: bool = parameter(True, 'Whether the controller is told of it.')


@cache
def foreign_robot() -> str:
    """Return the file of a robot that `multicontact new-robot` has written for a foreign arm."""
    urdf = config_dir() / 'studies' / FOREIGN_URDF
    stamp = hashlib.sha256(urdf.read_bytes()).hexdigest()[:16]
    folder = (cache_folder() or Path(tempfile.gettempdir())) / f'foreign-{stamp}'
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / 'arm.yaml'
    with tempfile.TemporaryDirectory(dir=folder) as unfinished:  # others may write it, too
        written = Path(unfinished) / file.name
        new_robot(urdf, FOREIGN_LINK, FOREIGN_LINK, written, written.with_name('controller.yaml'))
        written.replace(file)
    return str(file)


class Course(NamedTuple):
    """A motion from a pose: along a direction and about an axis, world axes, unit vectors or 0."""

    start: Pose
    direction: Vector
    axis: Vector
    distance: float  # [m or rad]
    speed: float  # [m/s or rad/s]
    legs: int  # 0 for no motion

    @property
    def leg_time(self) -> float:
        """How long it takes in one direction, and to rest there [s]."""
        return self.distance / self.speed + RAMP_TIME + REST_TIME

    @property
    def duration(self) -> float:
        """How long it takes in all [s]."""
        return self.legs * self.leg_time

    @property
    def period(self) -> float:
        """Return the period of a sinusoid of this amplitude and largest speed [s]."""
        return 2.0 * np.pi * self.distance / self.speed

    def way(self, time: float) -> Vector:
        """Return way [m or rad], rate and its rate at a time since its beginning [s], (3,)."""
        if not 0.0 <= time < self.duration:
            return np.array([self.distance * (self.legs % 2) * (time > 0.0), 0.0, 0.0])
        leg, elapsed = divmod(time, self.leg_time)
        way = _run(elapsed, self.distance, self.speed)
        return np.array([self.distance, 0.0, 0.0]) - way if leg % 2 else way

    def readings(self, ways: Matrix) -> list[MotionReading]:
        """Return the setpoints of some ways [m or rad] with their rates, shape (k, 3)."""
        turns = Rotation.from_rotvec(ways[:, :1] * self.axis)
        quaternions = (turns * Rotation.from_quat(self.start.quaternion_xyzw)).as_quat()
        both = np.concatenate([self.direction, self.axis])
        return [MotionReading(self.start.position_world + way * self.direction, quaternion,
                              rate * both, acceleration * both)
                for (way, rate, acceleration), quaternion in zip(ways.tolist(), quaternions)]


def _run(elapsed: float, distance: float, speed: float) -> Vector:
    """Return way, rate and its rate of a motion of constant speed with smooth ramps, (3,)."""
    way = np.zeros(3)
    for begin, sign in ((0.0, 1.0), (distance / speed, -1.0)):
        share = min(max((elapsed - begin) / RAMP_TIME, 0.0), 1.0)
        after = max(elapsed - begin - RAMP_TIME, 0.0)
        way += sign * speed * np.array([
            RAMP_TIME * (share ** 3 - 0.5 * share ** 4) + after,
            share ** 2 * (3.0 - 2.0 * share), 6.0 * share * (1.0 - share) / RAMP_TIME])
    return way


def is_possible(robot: str, plant: str, situation: SituationConfig) -> bool:
    """Return whether a robot has what a situation takes; ConfigError if its URDF is missing."""
    known = find_robot(foreign_robot() if robot == FOREIGN else robot or DEFAULT)
    joints = len(known.arm.links)
    contacts = len(known.controller_base()['contact_names'])
    return bool(known.plant_name(plant)) and (
        situation.contacts <= contacts and situation.stop_joint <= joints)


def situated(
    arguments: Mapping[str, Any], situation: SituationConfig,
) -> tuple[Setup, Course]:
    """
    Return a setup, resolved from some `arguments`, in a situation, and the motion in it.

    The arm has such a joint, and so many contacts; see `is_possible`.
    """
    given = dict(arguments)
    if given.get('robot') == FOREIGN:
        given['robot'] = foreign_robot()
        given['plant_overrides'] = merge(
            {'engine': 'mujoco'}, given.get('plant_overrides') or {})
    base = resolve(**given)
    names = base.controller.contact_names[:situation.contacts]
    course = _course(base, situation, names)
    chosen = {'contact_names': list(names)}
    begin = MOTION_TIME + situation.farther / base.controller.contact_state.approach_speed
    scenario: dict[str, Any] = {'duration': begin + course.duration + REST_TIME}
    if situation.motion == 'sine':
        scenario['reference'] = _sine_reference(situation, course, names)
        scenario['duration'] = MOTION_TIME + 0.5 * situation.legs * course.period
    setup = resolve(**merge(given, {
        'controller': {**chosen, 'limits': _stops(base, situation)},
        'noise_estimator': chosen,
        'plant_overrides': {**chosen, 'surfaces': _tilted(base, situation, course)},
        'scenario_overrides': scenario}))
    return setup, course


def _course(base: Setup, situation: SituationConfig, names: tuple[str, ...]) -> Course:
    robot = RobotModel(base.controller.robot, base.urdf_dir)
    state = robot.update(np.array(base.plant.home), np.zeros(robot.joint_count))
    direction, axis = np.array(situation.direction_world), np.array(situation.turn_world)
    distance = situation.distance
    if situation.stop_joint:
        normals = [base.controller.contacts[name].normal_world for name in names]
        free = null_space(np.array(normals)) if situation.force else np.eye(3)
        direction, axis, distance = _towards_stop(
            state.mass_matrix, state.jacobian, free, situation)
    direction, axis = (v / max(float(np.linalg.norm(v)), 1e-9) for v in (direction, axis))
    start, limits = state.pose.position_world, base.controller.limits
    if direction.any() and limits.workspace_lower:
        room = np.where(direction > 0.0, limits.workspace_upper, limits.workspace_lower) - start
        along = np.abs(direction) > 1e-9
        shares = (np.abs(room[along]) - BOX_MARGIN) / np.abs(direction[along])
        distance = min(distance, float(shares.min()))
    return Course(state.pose, direction, axis, distance, situation.speed,
                  situation.legs if direction.any() or axis.any() else 0)


def _towards_stop(
    mass_matrix: Matrix, jacobian: Matrix, free: Matrix, situation: SituationConfig,
) -> tuple[Vector, Vector, float]:
    """
    Return direction, axis and distance of the motion that leads a joint beyond its stop.

    A slide in the `free` directions, shape (3, k), or a turn where no slide does, with the
    dynamically consistent inverse of J at home (P04 eq. 23).
    """
    moved = np.linalg.solve(mass_matrix, jacobian.T)
    rates = (moved @ np.linalg.inv(jacobian @ moved))[situation.stop_joint - 1]
    sign = 1.0 if situation.stop_side == 'upper' else -1.0
    slide, turn = free @ (free.T @ rates[:3]), rates[3:]
    way = situation.stop_margin + BEYOND_STOP
    slid, turned = (float(np.linalg.norm(rate)) for rate in (slide, turn))
    if FARTHEST_SLIDE * slid >= way or FARTHEST_SLIDE * slid >= FARTHEST_TURN * turned:
        return sign * slide, np.zeros(3), min(way / max(slid, 1e-9), FARTHEST_SLIDE)
    return np.zeros(3), sign * turn, min(way / turned, FARTHEST_TURN)


def _stops(base: Setup, situation: SituationConfig) -> dict[str, list[float]]:
    """Return the joints' limits where one of them is near home."""
    if not situation.stop_joint:
        return {}
    joint, side = situation.stop_joint - 1, f'joint_{situation.stop_side}'
    stops = list(getattr(base.controller.limits, side))
    sign = 1.0 if situation.stop_side == 'upper' else -1.0
    stops[joint] = base.plant.home[joint] + sign * situation.stop_margin
    return {side: stops}


def _tilted(
    base: Setup, situation: SituationConfig, course: Course,
) -> dict[str, Any]:
    """Return the surfaces' normals, turned about where the tips meet them at home."""
    if not situation.tilt:
        return {}
    surfaces = {}
    angle = np.radians(situation.tilt)
    for name in base.plant.touched:
        surface = base.plant.surfaces[name]
        normal = np.array(surface.normal_world)
        ahead = course.direction - normal * (normal @ course.direction)
        ahead /= np.linalg.norm(ahead)
        turned = np.cos(angle) * normal + np.sin(angle) * ahead
        surfaces[name] = {'normal_world': turned.tolist()}
    return surfaces


def _sine_reference(
    situation: SituationConfig, course: Course, names: tuple[str, ...],
) -> dict[str, Any]:
    """Return the scenario's reference: forces, then a sinusoid to either side."""
    return {
        'approach': {'start_time': COMMAND_TIME},
        'force_steps': [{'time': 1.2, 'forces': dict.fromkeys(names, situation.force)}],
        'motion': {
            'start_time': MOTION_TIME, 'direction_world': course.direction.tolist(),
            'amplitude': course.distance, 'period': course.period, 'blend_time': 1.0}}


class SituationRun:
    """A situation in a closed loop, tick by tick, and what is seen of it."""

    def __init__(self, setup: Setup, course: Course, situation: SituationConfig) -> None:
        self._course, self._situation = course, situation
        self._scenario = situation.motion == 'sine'
        self.loop = ClosedLoop(setup, commanded=not self._scenario)
        self._period = setup.controller.period
        self._names = setup.controller.contact_names
        self._robot = RobotModel(setup.controller.robot, setup.urdf_dir)
        self._setpoints = self._planned(setup)
        self._setpoint = self._setpoints[0]
        self._bias = self._sensor_bias(setup)
        for surface in range(len(setup.plant.touched)):
            self.loop.plant.contacts.shift(
                surface, situation.farther if situation.force else NOWHERE)
        self.seen: dict[str, list[Any]] = {name: [] for name in (
            'torque', 'force', 'q', 'qd', 'tip', 'setpoint', 'states', 'reaction', 'commanded')}

    def _sensor_bias(self, setup: Setup) -> Vector:
        """Return the bias of the wrench in the sensor's axes at home, shape (6,) [N, N m]."""
        home = np.array(setup.plant.home)
        rotation = self._robot.update(home, np.zeros(len(home))).sensor_pose.rotation_world
        normal = np.array(setup.controller.contacts[self._names[0]].normal_world)
        across = null_space(normal[np.newaxis])[:, 0]
        force = self._situation.bias_along * normal + self._situation.bias_across * across
        return np.concatenate([rotation.T @ force, np.zeros(3)])

    def _planned(self, setup: Setup) -> list[MotionReading]:
        """Return the setpoint of every tick."""
        times = self._period * np.arange(setup.ticks)
        motion = setup.scenario.reference.motion
        ways = [sine_motion(motion, time) if self._scenario and motion is not None
                else self._course.way(time - MOTION_TIME) for time in times.tolist()]
        return self._course.readings(np.array(ways))

    def _biased(self, inputs: TickInputs) -> TickInputs:
        appeared = not self._situation.bias_appears or inputs.time >= APPEARING_TIME
        if inputs.wrench is None or not appeared:
            return inputs
        wrench = inputs.wrench._replace(wrench=inputs.wrench.wrench + self._bias)
        return inputs._replace(wrench=wrench)

    def advance(self) -> None:
        """Take one tick, and note what was there at its beginning, and how it was answered."""
        loop, seen, arm = self.loop, self.seen, self.loop.plant.arm
        time = loop.tick * self._period
        self._command(time)
        seen['setpoint'].append(self._setpoint)
        seen['commanded'].append(self._commanded(time))
        seen['force'].append(loop.sample.contact_force)
        seen['q'].append(np.array(arm.q))
        seen['qd'].append(np.array(arm.qd))
        seen['tip'].append(loop.plant.contacts.points_world.copy())
        loop.advance(self._biased if self._bias.any() else None)
        seen['torque'].append(loop.command.copy())
        seen['states'].append(loop.status.contact_states)
        seen['reaction'].append(loop.status.reaction)

    def _commanded(self, time: float) -> Vector:
        """Return the forces that are commanded, shape (r,) [N]."""
        if self._scenario:
            return self.loop.setup.commanded(np.array([time]))[0]
        forces = self.loop.control.commanded_forces
        return np.array([forces[name] for name in self._names])

    def _command(self, time: float) -> None:
        """Command forces, motion and payload when it is time."""
        situation, control = self._situation, self.loop.control
        if situation.payload and time >= PICK_UP_TIME and not self.loop.plant.payload:
            self._pick_up()
        setpoint = self._setpoints[self.loop.tick]
        if self._scenario:
            self._setpoint = setpoint
            return
        with suppress(CommandError):  # before it has begun, or while it is held
            if time >= COMMAND_TIME and situation.force and not any(
                    control.commanded_forces.values()):
                control.set_forces(dict.fromkeys(self._names, situation.force))
            begun = self._course.legs and time >= MOTION_TIME
            if begun and _differs(setpoint, self._setpoint):
                control.set_motion(setpoint)
                self._setpoint = setpoint

    def _pick_up(self) -> None:
        situation, config = self._situation, self.loop.setup.controller
        plant, tool = self.loop.plant, config.tool
        plant.payload = situation.payload
        if situation.told:
            mass = tool.mass + situation.payload
            place = np.array(plant.description.tool.com.position)
            com = (tool.mass * np.array(tool.com_sensor) + situation.payload * place) / mass
            told = ToolConfig(mass=mass, com_sensor=tuple(com), bias_sensor=tool.bias_sensor)
            self.loop.control.reconfigure(config.model_copy(update={'tool': told}))

    def way(self) -> Way:
        """Return where the arm was and should have been."""
        seen = self.seen
        q, qd = np.array(seen['q']), np.array(seen['qd'])
        places = np.array([
            self._robot.update(*joints).pose.position_world for joints in zip(q, qd)])
        return Way(
            q=q, qd=qd, position=places,
            setpoint=np.array([setpoint.position_world for setpoint in seen['setpoint']]),
            tip=np.array(seen['tip']), tip_setpoint=self._tip_setpoints(),
            states=seen['states'])

    def _tip_setpoints(self) -> Any:
        """Return where the tips would be if each setpoint were reached, shape (ticks, k, 3)."""
        start = self._course.start
        offsets = self._tips_at_home() - start.position_world
        turns = Rotation.from_quat([x.quaternion_xyzw for x in self.seen['setpoint']])
        turned = turns * Rotation.from_quat(start.quaternion_xyzw).inv()
        places = np.array([x.position_world for x in self.seen['setpoint']])
        return np.stack([places + turned.apply(offset) for offset in offsets], axis=1)

    def _tips_at_home(self) -> Matrix:
        tips: Matrix = self.seen['tip'][0]
        return tips


def _differs(setpoint: MotionReading, before: MotionReading) -> bool:
    """Return whether a setpoint says anything new."""
    return any(bool((new != old).any()) for new, old in zip(setpoint, before))


def run_situation(
    what: str, setup: Setup, course: Course, situation: SituationConfig,
) -> SituationRow:
    """Run a situation from the start to the end, and judge it."""
    run = SituationRun(setup, course, situation)
    before = run.loop.command.copy()
    try:
        for _ in range(setup.ticks):
            run.advance()
    except Exception as error:  # an arm out of all numbers, or a broken controller
        return died(what, error)
    finally:
        run.loop.close()
    seen = run.seen
    force, commanded = np.array(seen['force']), np.array(seen['commanded'])
    time: Vector = setup.controller.period * np.arange(float(len(force)))
    return judge_situation(what, setup, Observation(
        torque=np.array(seen['torque']), before=before, time=time, force=force.max(axis=1),
        reaction=max(seen['reaction'], key=SEVERITY.index), forces=force, commands=commanded),
        run.way())
