"""One situation in the loop: commanded from the start to the end, seen, and judged."""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ToolConfig
from multicontact_control.control.motions import evaluate_sine_motion, SineConfig
from multicontact_control.control.tasks import MotionReading
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError
from multicontact_control.faults.course import Course
from multicontact_control.faults.outcomes import (
    judge_situation,
    Observation,
    SituationRow,
)
from multicontact_control.faults.situation import COMMAND_TIME, SituationConfig
from multicontact_control.faults.unasked_motion import (
    MotionTrace,
    project_across_normals,
)
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.causes import SEVERITY
from multicontact_control.supervision.inputs import TickInputs
import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

NOWHERE = 10.0  # m, how far away surfaces are that are not there
APPEARING_TIME = 0.5  # s, when a bias comes: in the middle of the approach


class SituationRun:
    """
    A situation in a closed loop, tick by tick, and what is seen of it.

    `seen` has a list for each quantity, with an entry for every tick. Without a force the surfaces
    are 10 m away. The course is commanded as a client would, over forces and setpoints; a sinusoid
    is the scenario's own.
    """

    def __init__(
        self, setup: Setup, course: Course, situation: SituationConfig
    ) -> None:
        self._course = course
        self._situation = situation
        self._is_scenario = situation.motion == 'sine'
        self.loop = ClosedLoop(setup, commanded=not self._is_scenario)
        self._period = setup.controller.period
        self._names = setup.controller.contact_names
        self._robot = RobotModel(setup.controller.robot, setup.urdf_dir)
        self._setpoints = self._plan_setpoints(setup)
        self._setpoint = self._setpoints[0]
        self._bias = self._sensor_bias(setup)
        distance = NOWHERE
        if situation.force:
            distance = situation.farther
        for surface in range(len(setup.plant.touched)):
            self.loop.plant.contacts.shift_surface(surface, distance)
        self.seen: defaultdict[str, list[Any]] = defaultdict(list)  # of every tick

    def _sensor_bias(self, setup: Setup) -> Vector:
        """Return the bias of the wrench in the sensor's axes at home, shape (6,) [N, N m]."""
        home = np.array(setup.plant.home)
        state = self._robot.update(home, np.zeros(len(home)))
        normal = np.array(setup.controller.contacts[self._names[0]].normal_world)
        across = null_space(normal[np.newaxis])[:, 0]
        situation = self._situation
        force = situation.bias_along * normal + situation.bias_across * across
        return np.concatenate([state.sensor_pose.rotation_world.T @ force, np.zeros(3)])

    def _plan_setpoints(self, setup: Setup) -> list[MotionReading]:
        """Return the setpoint of every tick."""
        times = (self._period * np.arange(setup.ticks)).tolist()
        motion = setup.scenario.reference.motion
        ways: list[Any]
        if self._is_scenario and isinstance(motion, SineConfig):
            ways = [evaluate_sine_motion(motion, time) for time in times]
        else:
            start = self._situation.motion_time
            ways = [self._course.way_at(time - start) for time in times]
        return self._course.setpoints(np.array(ways))

    def _add_bias(self, inputs: TickInputs) -> TickInputs:
        """Return the inputs of a tick with the bias of the sensor, once it has appeared."""
        is_early = inputs.time < APPEARING_TIME
        if inputs.wrench is None or (is_early and self._situation.bias_appears):
            return inputs
        wrench = inputs.wrench._replace(wrench=inputs.wrench.wrench + self._bias)
        return inputs._replace(wrench=wrench)

    def advance(self) -> None:
        """
        Take one tick, and note what was there at its beginning, and how it was answered.

        Commands that the supervisor refuses, before it has begun or while it holds the arm, are
        given again in the next tick; the sensor's bias is laid over the readings on their way.
        """
        loop = self.loop
        seen = self.seen
        time = loop.tick * self._period
        self._command(time)
        seen['setpoint'].append(self._setpoint)
        seen['commanded'].append(self._commanded_forces(time))
        seen['force'].append(loop.sample.contact_force)
        seen['q'].append(np.array(loop.plant.arm.q))
        seen['qd'].append(np.array(loop.plant.arm.qd))
        seen['tip'].append(loop.plant.contacts.points_world.copy())
        if self._bias.any():
            loop.advance(self._add_bias)
        else:
            loop.advance()
        seen['torque'].append(loop.command.copy())
        seen['states'].append(loop.status.contact_states)
        seen['reaction'].append(loop.status.reaction)

    def _commanded_forces(self, time: float) -> Vector:
        """Return the forces that are commanded, shape (r,) [N]."""
        if self._is_scenario:
            return self.loop.setup.commanded(np.array([time]))[0]
        forces = self.loop.control.commanded_forces
        return np.array([forces[name] for name in self._names])

    def _command(self, time: float) -> None:
        """Command forces, motion and payload when it is time."""
        situation = self._situation
        control = self.loop.control
        in_motion = time >= situation.motion_time
        if situation.payload and in_motion and not self.loop.plant.payload:
            self._pick_up_payload()
        setpoint = self._setpoints[self.loop.tick]
        if self._is_scenario:
            self._setpoint = setpoint
            return
        with suppress(CommandError):  # before it has begun, or while it is held
            is_commanded = any(control.commanded_forces.values())
            if time >= COMMAND_TIME and situation.force and not is_commanded:
                control.set_forces(dict.fromkeys(self._names, situation.force))
            moves = in_motion and self._course.legs > 0
            if moves and _differs(setpoint, self._setpoint):
                control.set_motion(setpoint)
                self._setpoint = setpoint

    def _pick_up_payload(self) -> None:
        """Load the tool, and tell the controller of its new mass and centre, if it is told."""
        payload = self._situation.payload
        plant = self.loop.plant
        plant.payload = payload
        if not self._situation.told:
            return
        config = self.loop.setup.controller
        tool = config.tool
        mass = tool.mass + payload
        place = np.array(plant.description.tool.com.position)
        com = (tool.mass * np.array(tool.com_sensor) + payload * place) / mass
        loaded = ToolConfig(
            mass=mass, com_sensor=tuple(com), bias_sensor=tool.bias_sensor
        )
        self.loop.control.reconfigure(config.model_copy(update={'tool': loaded}))

    def trace_motion(self) -> MotionTrace:
        """
        Return where the arm was and should have been, for `judge_situation`.

        Positions come from the true joints by the controller's own model, once more for every tick
        after the run; the tips are those of the plant.
        """
        seen = self.seen
        contacts = self.loop.setup.controller.contacts
        q = np.array(seen['q'])
        qd = np.array(seen['qd'])
        positions = []
        for joints in zip(q, qd):
            state = self._robot.update(*joints)
            positions.append(state.pose.position_world)
        wanted = np.array(seen['commanded']) > 0.0
        normals = np.array([contacts[name].normal_world for name in self._names])
        setpoints = np.array([each.position_world for each in seen['setpoint']])
        return MotionTrace(
            direction=self._course.direction,
            q=q,
            qd=qd,
            position=np.array(positions),
            setpoint=setpoints,
            tip=np.array(seen['tip']),
            tip_setpoint=self._tip_setpoints(setpoints),
            wanted=wanted,
            pressed=np.array(seen['force']) > 0.0,
            across=project_across_normals(normals, wanted),
            states=seen['states'],
        )

    def _tip_setpoints(self, places: Matrix) -> Any:
        """Return where the tips would be if each setpoint were reached, shape (ticks, k, 3)."""
        start = self._course.start
        offsets = self.seen['tip'][0] - start.position_world
        quaternions = [setpoint.quaternion_xyzw for setpoint in self.seen['setpoint']]
        back_to_start = Rotation.from_quat(start.quaternion_xyzw).inv()
        turned = Rotation.from_quat(quaternions) * back_to_start
        return np.stack([places + turned.apply(offset) for offset in offsets], axis=1)


def _differs(setpoint: MotionReading, before: MotionReading) -> bool:
    """Return whether a setpoint says anything new."""
    return not all(map(np.array_equal, setpoint, before))


def run_situation(
    what: str,
    setup: Setup,
    course: Course,
    situation: SituationConfig,
) -> SituationRow:
    """
    Run a situation from the start to the end, and judge it; one that breaks off is not safe.

    Parameters
    ----------
    what
        The situation in words, for the row.
    setup, course
        What `resolve_situation` makes of it.
    situation
        What is asked of the arm.

    """
    run = SituationRun(setup, course, situation)
    torque_before = run.loop.command.copy()
    try:
        for _ in range(setup.ticks):
            run.advance()
    except Exception as error:  # an arm out of all numbers, or a broken controller
        return SituationRow(what, problems=f'{type(error).__name__}: {error}')
    finally:
        run.loop.close()
    forces = np.array(run.seen['force'])
    time: Vector = setup.controller.period * np.arange(float(len(forces)))
    seen = Observation(
        torque=np.array(run.seen['torque']),
        torque_before=torque_before,
        time=time,
        force=forces.max(axis=1),
        reaction=max(run.seen['reaction'], key=SEVERITY.index),
        forces=forces,
        commands=np.array(run.seen['commanded']),
    )
    return judge_situation(what, setup, seen, run.trace_motion())
