"""
The middle of the closed loop: samples and commands in, torques out.

Sensor front end, supervision, control law, gate; with hold, tare and push test. Nothing else turns
samples into torques: the node, the simulation in process, the faults and the benchmark all step
this.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import math
from pathlib import Path

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.control.tasks import CommandedTask, MotionReading, TaskSource
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.sensor.push_test import PushGate, PushTestConfig
from multicontact_control.sensor.tool import MAX_JOINT_SPEED, tare_bias, TareConfig
from multicontact_control.supervision.checks import COLLISION
from multicontact_control.supervision.command_limits import (
    check_position,
    CommandLimits,
    offset_shares,
)
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.report import EventLog, SupervisorStatus
from multicontact_control.supervision.supervisor import not_supervised, Supervisor
import numpy as np

STREAM_TIME = 1.0  # s, between commands; more often they are a stream, which insists on nothing


class ControlLoop:
    """
    A controller between activation and deactivation, and all that it remembers of its samples.

    Parameters
    ----------
    config
        The controller's.
    scenario
        What to do; None to obey commands.
    limits
        Of those commands.
    base_dir
        Folder that relative paths start from.
    supervised
        Whether contact states, watchdogs and limits are around the control law; without them it
        runs bare but for its start.

    Attributes
    ----------
    supervisor
        The control law and what is around it.
    output
        The answer to the newest sample, None before the first and in the safe behaviour.
    status
        What the supervisor says of that, None without one.
    events, reactions, rejected, limited
        What the supervisor did since the last restart, and in how many ticks.
    collisions
        How often something has touched the arm before its wrist sensor, by cause.
    push_gate
        What allows force control.

    """

    def __init__(
        self, config: ControllerConfig, scenario: TaskSource | None, limits: CommandLimits,
        base_dir: Path, *, supervised: bool = True,
    ) -> None:
        self._feels = config.wrench_input != 'momentum'
        if not (self._feels or supervised):
            raise ConfigError('wrench_input', 'raw or filtered without a supervisor', 'momentum')
        self.limits = limits
        source = scenario or CommandedTask(config.column_names, config.leader_of)
        self._commanded = source if isinstance(source, CommandedTask) else None
        self.supervisor = Supervisor.from_config(config, source, base_dir, guarded=supervised)
        self.push_gate = PushGate(
            required=config.sensor.require_push_test, robot=self.supervisor.controller.robot,
            gravity_world=np.array(config.robot.gravity_world), rate=config.rate)
        self.restart()

    @property
    def config(self) -> ControllerConfig:
        """Return the configuration in force."""
        return self.supervisor.config

    @property
    def supervised(self) -> bool:
        """Whether contact states, watchdogs and limits are around the control law."""
        return self.supervisor.guarded

    @property
    def safe(self) -> bool:
        """Whether samples are answered by the declared safe behaviour."""
        return self.supervisor.safe

    @property
    def held(self) -> bool:
        """Whether pose and forces are held."""
        return self.supervisor.task.held

    def restart(self) -> None:
        """Forget the past: the next sample is the first."""
        self.supervisor.reset()
        self.push_gate.restart()
        self.output: ControlOutput | None = None
        self.status: SupervisorStatus | None = None
        self.events = EventLog(self.config.contact_names)
        self.reactions: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.limited: Counter[str] = Counter()
        self.collisions: Counter[str] = Counter()
        self._touched = ''
        self._inputs = TickInputs(0.0)
        self._commanded_at = -math.inf

    def step(self, inputs: TickInputs) -> Vector:
        """
        Answer a tick.

        Parameters
        ----------
        inputs
            The newest readings, however old, as the sensors gave them.

        Returns
        -------
        Vector
            The torque to command, shape (n,) [N m].

        Raises
        ------
        MulticontactError
            Without supervisor, if something is missing or there is no torque for this posture.

        """
        self._inputs = inputs
        output, status = self.supervisor.step(inputs)
        self.output, self.status = None if self.safe else output, status
        if status is not None:
            self._note(inputs.time, status)
        if self.push_gate.running and not self.safe and self.supervisor.inputs.fresh:
            self._push(inputs)
        return output.torque

    def stop(self) -> Vector:
        """Answer the newest sample by the safe behaviour, as all that follow until a restart."""
        self.supervisor.stop()
        return self.step(self._inputs)

    @property
    def sensor_fault(self) -> str:
        """What is wrong with the newest wrench, ``frozen`` or ``saturated``; empty for nothing."""
        return self.supervisor.inputs.sensor_fault

    @property
    def time(self) -> float:
        """Time of the newest tick [s]."""
        return self._inputs.time

    def _require_supervisor(self) -> None:
        if not self.supervised:
            raise not_supervised()

    def _note(self, time: float, status: SupervisorStatus) -> None:
        """Count what the supervisor did."""
        self.events.note(time, status)
        self.reactions[status.reaction] += 1
        if status.rejected:
            self.rejected.update(status.rejected)
        if status.limits:
            self.limited.update(status.limits)
        if status.causes or self._touched:
            touched = next((cause for cause in status.causes if cause.startswith(COLLISION)), '')
            if touched and not self._touched:
                self.collisions[touched] += 1
            self._touched = touched

    def _push(self, seen: TickInputs) -> None:
        """Lead on with a push test, and obey its verdict."""
        joints, wrench = seen.joints, seen.wrench
        if joints is None or wrench is None or joints.stamp != wrench.stamp:
            return
        if self.push_gate.update(
                joints.q, joints.qd, self.supervisor.inputs.raw, self.config.tool):
            if self.push_gate.open:
                self.supervisor.go_over()
                self.supervisor.task.unlock()

    def _require_rest(self, purpose: str) -> None:
        """Refuse what is only possible with a wrist sensor that nothing presses on."""
        if not self._feels:
            raise CommandError('wrench_input', f'raw or filtered, for {purpose}', 'momentum')
        if self.output is not None and self.output.active.any():
            raise CommandError('contacts', f'none under force control for {purpose}', 'some')
        if self.supervisor.presses:
            raise CommandError('contacts', f'none pressed by a reaction for {purpose}', 'some')

    def push_test(self, config: PushTestConfig, point_sensor: tuple[float, ...]) -> str:
        """
        Begin a push test; the arm stays where it is meanwhile.

        Returns
        -------
        str
            What the user should do now.

        Raises
        ------
        CommandError
            If the arm presses on something, or has no wrist sensor.

        """
        self._require_rest('a push test')
        self.push_gate.start(config, point_sensor)
        self.supervisor.go_over()
        self.supervisor.task.lock()
        return self.push_gate.instruction

    def set_forces(
        self, forces: dict[str, float], centres: Mapping[str, float] | None = None,
    ) -> None:
        """
        Obey commanded forces.

        Other forces than before, the first in a second, also seek contacts again that were given
        up, and resume control that is latched.

        Parameters
        ----------
        forces
            Of contacts, and couples of edges and planes, by name [N].
        centres
            Where the centre of pressure is to be instead of a couple, by the couple's name: from
            the centre of the contact, along its direction or across it [m].

        Raises
        ------
        CommandError
            If they are out of limits or nothing can be commanded now.

        """
        reference = self._commandable()
        shares = offset_shares(self.config, centres or {})
        followed = {name: share for name, share in reference.shares.items() if name not in forces}
        self.limits.check_forces(
            self.config, forces, before=reference.forces, shares={**followed, **shares})
        # A client may repeat its command many times a second, or vary it: neither asks for
        # another try of what has been given up.
        if reference.set_forces(forces, shares):
            if not self.time - self._commanded_at <= STREAM_TIME:
                self._try_again()
            self._commanded_at = self.time

    def set_motion(self, motion: MotionReading) -> None:
        """
        Obey a commanded motion, as far as it is not along a contact that is sought or held.

        Raises
        ------
        CommandError
            If it is out of limits or nothing can be commanded now.

        """
        reference = self._commandable()
        check_position(motion.position_world, self.config.limits)
        reference.set_motion(
            motion, self.supervisor.task.sought_normals(), self.limits.motion_timeout)

    @property
    def commanded_pose(self) -> Pose | None:
        """Return the pose that is obeyed, without what contacts add to it; None in a scenario."""
        return None if self._commanded is None else self._commanded.pose

    @property
    def commanded_forces(self) -> dict[str, float]:
        """Return the forces and couples that are obeyed, by name [N]; none in a scenario."""
        return {} if self._commanded is None else self._commanded.forces

    def _commandable(self) -> CommandedTask:
        if self._commanded is None:
            raise CommandError('reference_file', 'none, to obey commands', 'a scenario')
        self._running()
        if self.held:
            raise CommandError('~/hold', 'released, to obey commands', 'held')
        return self._commanded

    def _running(self) -> None:
        if self.output is None:
            raise CommandError('controller', 'active, with samples coming', 'not so')
        if self.supervisor.task.locked:
            raise CommandError('~/push_test', 'passed, to obey commands',
                               f"'{self.push_gate.instruction}'")
        if not (self.supervisor.task.begun and self.supervisor.started):
            causes = () if self.status is None else self.status.causes
            raise CommandError(
                'control', 'begun, to obey commands', ', '.join(causes) or 'not yet')

    def hold(self, wanted: bool) -> None:
        """
        Hold the present pose and the desired forces, or go on.

        Raises
        ------
        CommandError
            If nothing is controlled now.

        """
        self._running()
        if not wanted:
            self._try_again()
        if wanted or self.held:
            self.supervisor.go_over()
            task = self.supervisor.task
            (task.hold if wanted else task.release)()

    def retry(self) -> str:
        """
        Resume control that waits for an operator, and seek contacts that were given up.

        Returns
        -------
        str
            What happens now.

        Raises
        ------
        CommandError
            If there is nothing of that.

        """
        self._require_supervisor()
        if not self._try_again():
            raise CommandError('~/retry', 'contacts that were given up, or control that is '
                               'latched', 'neither')
        return 'trying again'

    def _try_again(self) -> bool:
        return self.supervisor.try_again()

    def tare(self, config: TareConfig) -> Vector:
        """
        Return the sensor's bias, by which the compensated wrench would read zero now.

        Returns
        -------
        Vector
            Sensor axes, force first, shape (6,) [N, N m].

        Raises
        ------
        CommandError
            If the arm presses on something or moves: what presses, or slows the tool down, would
            be taken for bias. If there is no wrist sensor, or something is wrong with it.
        CalibrationError
            If there are too few readings, or they are restless.

        """
        self._require_rest('a tare')
        refused = [] if self.status is None else [
            x for x in self.status.rejected if x.startswith('wrench')]
        if self.sensor_fault or refused:
            raise CommandError('wrench', 'nothing wrong with it, for a tare',
                               self.sensor_fault or refused[0])
        joints = self._inputs.joints
        if joints is None:
            raise CommandError('samples', 'some, for a tare', 'none')
        readings, postures = self.supervisor.inputs.kept
        way = float(np.abs(postures[-1:] - postures[:1]).max(initial=0.0))
        fastest = way / (max(len(postures) - 1, 1) * self.config.period)
        if not fastest <= MAX_JOINT_SPEED:
            raise CommandError('joint speeds', f'at most {MAX_JOINT_SPEED:g} rad/s for a '
                               'tare', f'{fastest:.3g} rad/s')
        model = self.config
        pose = self.supervisor.controller.robot.update(joints.q, joints.qd).sensor_pose
        return tare_bias(readings, pose.rotation_world, model.tool,
                         np.array(model.robot.gravity_world), config)
