"""One situation in the loop: commanded from the start to the end, seen, and judged."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ToolConfig
from multicontact_control.control.tasks import MotionReading, sine_motion
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError
from multicontact_control.faults.course import Course
from multicontact_control.faults.judge import (
    died,
    judge_situation,
    Observation,
    SituationRow,
)
from multicontact_control.faults.situation import (
    COMMAND_TIME,
    SituationConfig,
)
from multicontact_control.faults.unasked import across_normals, Way
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

NOWHERE = 10.0  # m, how far away surfaces are that are not there
APPEARING_TIME = 0.5  # s, when a bias comes: in the middle of the approach


class SituationRun:
    """A situation in a closed loop, tick by tick, and what is seen of it."""

    def __init__(
        self, setup: Setup, course: Course, situation: SituationConfig
    ) -> None:
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
            self.loop.plant.contacts.shift_surface(
                surface, situation.farther if situation.force else NOWHERE
            )
        self.seen: dict[str, list[Any]] = {
            name: []
            for name in (
                'torque',
                'force',
                'q',
                'qd',
                'tip',
                'setpoint',
                'states',
                'reaction',
                'commanded',
            )
        }

    def _sensor_bias(self, setup: Setup) -> Vector:
        """Return the bias of the wrench in the sensor's axes at home, shape (6,) [N, N m]."""
        home = np.array(setup.plant.home)
        rotation = self._robot.update(
            home, np.zeros(len(home))
        ).sensor_pose.rotation_world
        normal = np.array(setup.controller.contacts[self._names[0]].normal_world)
        across = null_space(normal[np.newaxis])[:, 0]
        force = (
            self._situation.bias_along * normal + self._situation.bias_across * across
        )
        return np.concatenate([rotation.T @ force, np.zeros(3)])

    def _planned(self, setup: Setup) -> list[MotionReading]:
        """Return the setpoint of every tick."""
        times = self._period * np.arange(setup.ticks)
        start = self._situation.motion_time
        motion = setup.scenario.reference.motion
        ways = [
            sine_motion(motion, time)
            if self._scenario and motion is not None
            else self._course.way(time - start)
            for time in times.tolist()
        ]
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
        if (
            situation.payload
            and time >= situation.motion_time
            and not self.loop.plant.payload
        ):
            self._pick_up()
        setpoint = self._setpoints[self.loop.tick]
        if self._scenario:
            self._setpoint = setpoint
            return
        with suppress(CommandError):  # before it has begun, or while it is held
            if (
                time >= COMMAND_TIME
                and situation.force
                and not any(control.commanded_forces.values())
            ):
                control.set_forces(dict.fromkeys(self._names, situation.force))
            begun = self._course.legs and time >= situation.motion_time
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
            com = (
                tool.mass * np.array(tool.com_sensor) + situation.payload * place
            ) / mass
            told = ToolConfig(
                mass=mass, com_sensor=tuple(com), bias_sensor=tool.bias_sensor
            )
            self.loop.control.reconfigure(config.model_copy(update={'tool': told}))

    def way(self) -> Way:
        """Return where the arm was and should have been."""
        seen, contacts = self.seen, self.loop.setup.controller.contacts
        q, qd = np.array(seen['q']), np.array(seen['qd'])
        positions = [
            self._robot.update(*joints).pose.position_world for joints in zip(q, qd)
        ]
        wanted = np.array(seen['commanded']) > 0.0
        normals = np.array([contacts[name].normal_world for name in self._names])
        return Way(
            direction=self._course.direction,
            q=q,
            qd=qd,
            position=np.array(positions),
            setpoint=np.array(
                [setpoint.position_world for setpoint in seen['setpoint']]
            ),
            tip=np.array(seen['tip']),
            tip_setpoint=self._tip_setpoints(),
            wanted=wanted,
            pressed=np.array(seen['force']) > 0.0,
            across=across_normals(normals, wanted),
            states=seen['states'],
        )

    def _tip_setpoints(self) -> Any:
        """Return where the tips would be if each setpoint were reached, shape (ticks, k, 3)."""
        start, setpoints = self._course.start, self.seen['setpoint']
        offsets = self.seen['tip'][0] - start.position_world
        turns = Rotation.from_quat([setpoint.quaternion_xyzw for setpoint in setpoints])
        turned = turns * Rotation.from_quat(start.quaternion_xyzw).inv()
        places = np.array([setpoint.position_world for setpoint in setpoints])
        return np.stack([places + turned.apply(offset) for offset in offsets], axis=1)


def _differs(setpoint: MotionReading, before: MotionReading) -> bool:
    """Return whether a setpoint says anything new."""
    return any(bool((new != old).any()) for new, old in zip(setpoint, before))


def run_situation(
    what: str,
    setup: Setup,
    course: Course,
    situation: SituationConfig,
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
    return judge_situation(
        what,
        setup,
        Observation(
            torque=np.array(seen['torque']),
            before=before,
            time=time,
            force=force.max(axis=1),
            reaction=max(seen['reaction'], key=SEVERITY.index),
            forces=force,
            commands=commanded,
        ),
        run.way(),
    )
