"""The controller with everything that keeps it safe around it; nothing that comes in raises."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_view import ArmView
from multicontact_control.control.contact_reference import ContactReference
from multicontact_control.control.controller import Controller, ControlOutput
from multicontact_control.control.gate_kernels import (
    doubt_answer,
    NOT_FINITE,
    OUTSIDE,
    PULL,
    SIDEWAYS,
    SUSPICION,
)
from multicontact_control.control.reactions import (
    DAMP,
    FLOAT,
    HOLD,
    INFLATE,
    NONE,
    Reactions,
    SEVERITY,
    TorqueBlend,
)
from multicontact_control.control.reference import TaskSource
from multicontact_control.control.safety import TorqueGate
from multicontact_control.control.watchdog import Believed, TickInputs, Watchdog
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.force.kernels import DESIRED, REPORT_ROWS
import numpy as np

BOX_EXCESS = 0.01  # m beyond the box, that the reference did not prevent
DOUBTS = 2  # samples in a row that contradict the contacts, for the wrench not to be believed


class SupervisorStatus(NamedTuple):
    """
    What the supervisor did in a tick, and why.

    Attributes
    ----------
    reaction
        ``none``, ``inflate`` (R), or instead of the control law ``hold``, ``float``, ``damp``.
    causes
        What called for it.
    rejected
        What was wrong with readings, whether it called for a reaction or not.
    limits
        Limits that were enforced.
    contact_states
        State of each contact.
    energy, energy_limit
        Of each contact's passivity observer, shape (r,) [J].
    task_time
        Time of the task, which stands still during a reaction [s].

    """

    reaction: str
    causes: tuple[str, ...]
    rejected: tuple[str, ...]
    limits: tuple[str, ...]
    contact_states: tuple[str, ...]
    energy: Vector
    energy_limit: Vector
    task_time: float


class SupervisorOutput(NamedTuple):
    """The answer to one tick: `output.torque` is finite and within limits, always."""

    output: ControlOutput
    status: SupervisorStatus


class Supervisor:
    """
    Controller, contact states, watchdog, reactions and gate in one step that never raises.

    Parameters
    ----------
    config
        Everything tunable.
    robot
        The arm.
    task
        What to do.

    """

    def __init__(self, config: ControllerConfig, robot: RobotModel, task: TaskSource) -> None:
        self.config = config
        self._robot = robot
        self.reference = ContactReference(config, task)
        self.controller = Controller(config, robot, self.reference)
        self._watchdog = Watchdog(config)
        self._gate = TorqueGate(config, robot.joint_count)
        self._reactions = Reactions(config.watchdog, robot, config.period)
        self._blend = TorqueBlend(config.contact_state.blend_time, config.period)
        self._normals = np.array(
            [config.contacts[name].normal_world for name in config.contact_names])
        self._suspicion = _suspicion(config)
        self._view = ArmView(config.limits, robot.joint_count)
        self.reference.look_at(self._view)
        self.reference.make_in(self.controller.buffers)
        self._energy_limits = self.reference.energy_limits
        self._warm_up()
        self.reset()

    @classmethod
    def from_config(
        cls, config: ControllerConfig, task: TaskSource, base_dir: Path,
    ) -> Supervisor:
        """
        Build a supervised controller with the arm its configuration names.

        Raises
        ------
        ConfigError
            If the URDF cannot be read or does not match the names.

        """
        return cls(config, RobotModel(config.robot, base_dir), task)

    def reset(self) -> None:
        """Forget everything measured; the next tick starts anew."""
        self.controller.reset()
        self._watchdog.reset()
        self._gate.reset()
        self._reactions.end()
        self._blend.reset()
        self._arm: ArmView | None = None
        self._output = _nothing(self._robot.joint_count, len(self.config.contact_names))
        self._status: SupervisorStatus | None = None
        self._task_ticks = 0
        self._good_ticks = 0
        self._paused = False
        self._running = False
        self._last_reaction = DAMP
        self._doubts = 0

    def _warm_up(self) -> None:
        """Call everything compiled once: no tick is to wait for numba."""
        n, r = self._robot.joint_count, len(self.config.contact_names)
        nothing = np.zeros(n)
        self._view.see(self.controller.sense(nothing, nothing), nothing, nothing)
        output = _nothing(n, r)
        doubt_answer(
            output.torque, output.contacts, output.alpha_meas, self.reference.state_codes,
            np.zeros(6), self._view.posture, self._normals, self._suspicion)

    def step(self, inputs: TickInputs) -> SupervisorOutput:
        """
        Answer one tick, whatever came in.

        Parameters
        ----------
        inputs
            The newest readings, however old; nothing of them is believed unseen.

        Returns
        -------
        SupervisorOutput
            A torque that may be commanded, and how it came about. A tick with the time of the
            one before gets the same answer again.

        """
        try:
            return self._step(inputs)
        except Exception as error:  # whatever it is, it must not stop the callback
            return self._last_resort(f'internal_{type(error).__name__}')

    def _step(self, inputs: TickInputs) -> SupervisorOutput:
        believed = self._watchdog.judge(inputs)
        if believed.repeated and self._status is not None:
            return SupervisorOutput(self._output, self._status)
        self._update_state(believed)
        causes = believed.causes
        if self._arm is not None and self._arm.too_fast:
            causes += self._arm.too_fast
        reaction = self._reaction_to(causes)
        if SEVERITY.index(reaction) <= SEVERITY.index(INFLATE):
            self._good_ticks += 1
            if self._paused and self._good_ticks * self.config.period < (
                    self.config.watchdog.recovery_time):
                return self._react(('recovering',), believed.rejected, self._last_reaction)
            return self._control(believed, causes, reaction)
        if reaction == HOLD and believed.blind:
            reaction = FLOAT  # what is not seen cannot be held
        return self._react(causes, believed.rejected, reaction)

    def _update_state(self, believed: Believed) -> None:
        """Work out where the arm is."""
        if believed.q is None or believed.qd is None:
            return
        terms = self.controller.sense(believed.q, believed.qd)
        if self._view.see(terms, believed.q, believed.qd):
            self._arm = self._view

    def _reaction_to(self, causes: tuple[str, ...]) -> str:
        if not causes:
            return NONE
        watch = self.config.watchdog
        reactions = {
            'joints': watch.on_joint_fault, 'wrench': watch.on_wrench_fault, 'variance': INFLATE,
            'clock': watch.on_clock_fault, 'motion': watch.on_motion_fault,
            'law': watch.on_law_fault}
        found = [reactions[cause.split('_')[0]] for cause in causes]
        return max(found, key=SEVERITY.index, default=NONE)

    def _control(
        self, believed: Believed, causes: tuple[str, ...], reaction: str,
    ) -> SupervisorOutput:
        """Step the control law."""
        if self._arm is None or believed.wrench is None:
            return self._react(('joints_stale',), believed.rejected, DAMP)
        resumed = self._paused and self._running
        if resumed:
            self.reference.resume()
        try:
            output = self.controller.answer(
                self._task_time(), believed.wrench, believed.variance)
        except Exception as error:  # whatever it is, the arm needs an answer
            return self._react((f'law_{type(error).__name__}',), believed.rejected,
                               self.config.watchdog.on_law_fault)
        doubts = doubt_answer(
            output.torque, output.contacts, output.alpha_meas, self.reference.state_codes,
            believed.wrench, self._arm.posture, self._normals, self._suspicion)
        if doubts & NOT_FINITE:
            return self._react(('law_not_finite',), believed.rejected,
                               self.config.watchdog.on_law_fault)
        doubt = self._doubt(doubts)
        if doubt:
            return self._react((doubt,), believed.rejected, self.config.watchdog.on_wrench_fault)
        self._running, self._paused = True, False
        self._reactions.end()
        self._task_ticks += 1
        if doubts & OUTSIDE:  # the contacts have led there; the reference leads back
            self.reference.release()
        limits = ('reference',) if self.reference.limited else ()
        return self._finish(output, (NONE, output.active.tobytes(), resumed), causes,
                            believed.rejected, reaction, limits)

    def _doubt(self, doubts: int) -> str:
        """Return how the wrench contradicts what contacts can do, once it has done so twice."""
        if not doubts & (PULL | SIDEWAYS):
            self._doubts = 0
            return ''
        self._doubts += 1
        doubt = 'wrench_pull' if doubts & PULL else 'wrench_sideways'
        return doubt if self._doubts >= DOUBTS or self._paused else ''

    def _react(
        self, causes: tuple[str, ...], rejected: tuple[str, ...], reaction: str,
    ) -> SupervisorOutput:
        """Answer without the control law."""
        if 'recovering' not in causes:
            self._good_ticks = 0
        self._paused, self._last_reaction = True, reaction
        with np.errstate(all='ignore'):  # numbers that are none are for the gate to find
            torque = self._reactions.torque(reaction, self._arm)
            contacts = self._output.contacts.copy()
            contacts[DESIRED] = 0.0
            output = self._output._replace(
                torque=torque, contacts=contacts, active=np.zeros_like(self._output.active))
            return self._finish(output, reaction, causes, rejected, reaction, ())

    def _finish(
        self, output: ControlOutput, law: object, causes: tuple[str, ...],
        rejected: tuple[str, ...], reaction: str, limits: tuple[str, ...],
    ) -> SupervisorOutput:
        """Blend, pass the gate, report."""
        blended = self._blend.apply(law, output.torque)
        fallback = np.zeros_like(blended) if self._arm is None else self._arm.bias_torque
        gated = self._gate.apply(blended, fallback, self._arm)
        self._blend.last = gated.torque
        self._output = ControlOutput(gated.torque, *output[1:])
        self._status = SupervisorStatus(
            reaction, causes, rejected, limits + gated.limits, self.reference.state_names,
            self.reference.energies, self._energy_limits, self._task_time())
        return SupervisorOutput(self._output, self._status)

    def _last_resort(self, cause: str) -> SupervisorOutput:
        """Answer after something failed that should not: forget the arm, let go of it slowly."""
        self._paused, self._last_reaction, self._arm = True, DAMP, None
        self._good_ticks = 0
        return self._finish(self._output, DAMP, (cause,), (), DAMP, ())

    def _task_time(self) -> float:
        return self._task_ticks * self.config.period


def _suspicion(config: ControllerConfig) -> Any:
    """Return what speaks against an answer: one record of `SUSPICION`."""
    suspicion = np.zeros(1, dtype=SUSPICION)
    for name in ('pull_threshold', 'friction_bound', 'friction_offset'):
        suspicion[name] = getattr(config.watchdog, name)
    suspicion['inertia'] = config.tool.mass * config.watchdog.loss_acceleration
    suspicion['weight'] = config.tool.mass * np.array(config.robot.gravity_world)
    limits, everywhere = config.limits, np.full(3, np.inf)
    suspicion['box'] = (
        np.array(limits.workspace_lower or -everywhere) - BOX_EXCESS,
        np.array(limits.workspace_upper or everywhere) + BOX_EXCESS)
    return suspicion


def _nothing(joints: int, contacts: int) -> ControlOutput:
    """Return the answer before anything is known."""
    pose = Pose(np.zeros(3), np.eye(3))
    return ControlOutput(
        torque=np.zeros(joints), contacts=np.zeros((len(REPORT_ROWS), contacts)),
        active=np.zeros(contacts, dtype=bool), pose=pose, pose_des=pose)
