"""The controller with everything that keeps it safe around it; nothing that comes in raises."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from multicontact_control.arrays import all_finite, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_view import ArmView, view_arm
from multicontact_control.control.contact_reference import ContactReference
from multicontact_control.control.controller import Controller, ControlOutput, Measurement
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

SPEED_EXCESS = 1.1  # times a speed limit, that the gate and the reference did not prevent
DOUBTS = 2  # samples in a row that contradict the contacts, for the wrench not to be believed


@dataclass(frozen=True, slots=True)
class SupervisorStatus:
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


@dataclass(frozen=True, slots=True)
class SupervisorOutput:
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
        self._weight = config.tool.mass * np.array(config.robot.gravity_world)
        limits = config.limits
        self._speed = np.array(limits.joint_speed or [np.inf] * robot.joint_count)
        self._box = (np.array(limits.workspace_lower), np.array(limits.workspace_upper))
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
        with np.errstate(all='ignore'):
            try:
                return self._step(inputs)
            except Exception as error:  # whatever it is, it must not stop the callback
                return self._last_resort(f'internal_{type(error).__name__}')

    def _step(self, inputs: TickInputs) -> SupervisorOutput:
        believed = self._watchdog.judge(inputs)
        if believed.repeated and self._status is not None:
            return SupervisorOutput(self._output, self._status)
        self._update_state(believed)
        causes = believed.causes + self._motion_causes()
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
        """Work out where the arm is, if that has changed."""
        if believed.q is None or believed.qd is None:
            return
        if self._arm is not None and believed.blind:
            return
        arm = view_arm(self._robot, believed.q, believed.qd)
        if arm is not None:
            self._arm = arm
            self.reference.observe(arm.pose, arm.twist_world)

    def _motion_causes(self) -> tuple[str, ...]:
        """Return which speeds are beyond their limits, and act on the box."""
        arm, limits = self._arm, self.config.limits
        if arm is None:
            return ()
        causes = []
        v, w = arm.twist_world[:3], arm.twist_world[3:]
        if v @ v > (SPEED_EXCESS * limits.operational_speed) ** 2 or (
                w @ w > (SPEED_EXCESS * limits.operational_turn) ** 2):
            causes.append('motion_operational_speed')
        if (np.abs(arm.velocity) > SPEED_EXCESS * self._speed).any():
            causes.append('motion_joint_speed')
        return tuple(causes)

    def _reaction_to(self, causes: tuple[str, ...]) -> str:
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
        arm = self._arm
        if arm is None or believed.q is None or believed.qd is None or believed.wrench is None:
            return self._react(('joints_stale',), believed.rejected, DAMP)
        resumed = self._paused and self._running
        if resumed:
            self.reference.resume()
        measurement = Measurement(self._task_time(), believed.q, believed.qd, believed.wrench)
        try:
            output = self.controller.step(measurement, believed.variance)
        except Exception as error:  # whatever it is, the arm needs an answer
            return self._react((f'law_{type(error).__name__}',), believed.rejected,
                               self.config.watchdog.on_law_fault)
        if not _finite(output):
            return self._react(('law_not_finite',), believed.rejected,
                               self.config.watchdog.on_law_fault)
        doubt = self._doubt(output, arm, believed.wrench)
        if doubt:
            return self._react((doubt,), believed.rejected, self.config.watchdog.on_wrench_fault)
        self._running, self._paused = True, False
        self._reactions.end()
        self._task_ticks += 1
        self._stay_in_box(arm)
        limits = ('reference',) if self.reference.limited else ()
        return self._finish(output, (NONE, tuple(output.active.tolist()), resumed), causes,
                            believed.rejected, reaction, limits)

    def _doubt(self, output: ControlOutput, arm: ArmView, wrench: Vector) -> str:
        """Return how the wrench contradicts what contacts can do, once it has done so twice."""
        watch = self.config.watchdog
        force = arm.sensor_rotation @ wrench[:3] + self._weight
        sideways = force - output.alpha_meas @ self._normals
        bound = watch.friction_offset + watch.friction_bound * np.abs(output.alpha_meas).sum()
        doubt = ''
        if (output.alpha_meas < -watch.pull_threshold).any():
            doubt = 'wrench_pull'
        elif sideways @ sideways > bound * bound:
            doubt = 'wrench_sideways'
        self._doubts = self._doubts + 1 if doubt else 0
        return doubt if self._doubts >= DOUBTS or (doubt and self._paused) else ''

    def _stay_in_box(self, arm: ArmView) -> None:
        """Leave the contacts if they have led out of the box; the reference leads back."""
        lower, upper = self._box
        position = arm.pose.position_world
        if lower.size and ((position < lower - 0.01).any() or (position > upper + 0.01).any()):
            self.reference.release()

    def _react(
        self, causes: tuple[str, ...], rejected: tuple[str, ...], reaction: str,
    ) -> SupervisorOutput:
        """Answer without the control law."""
        if 'recovering' not in causes:
            self._good_ticks = 0
        self._paused, self._last_reaction = True, reaction
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
        self._output = output._replace(torque=gated.torque)
        observers = self.reference.observers
        self._status = SupervisorStatus(
            reaction=reaction, causes=causes, rejected=rejected, limits=limits + gated.limits,
            contact_states=tuple(state.value for state in self.reference.states),
            energy=np.array([observer.energy for observer in observers]),
            energy_limit=np.array([observer.limit for observer in observers]),
            task_time=self._task_time())
        return SupervisorOutput(self._output, self._status)

    def _last_resort(self, cause: str) -> SupervisorOutput:
        """Answer after something failed that should not: forget the arm, let go of it slowly."""
        self._paused, self._last_reaction, self._arm = True, DAMP, None
        self._good_ticks = 0
        return self._finish(self._output, DAMP, (cause,), (), DAMP, ())

    def _task_time(self) -> float:
        return self._task_ticks * self.config.period


def _finite(output: ControlOutput) -> bool:
    return all_finite(output.torque) and all(map(all_finite, output.contacts))


def _nothing(joints: int, contacts: int) -> ControlOutput:
    """Return the answer before anything is known."""
    pose = Pose(np.zeros(3), np.eye(3))
    return ControlOutput(
        torque=np.zeros(joints), contacts=np.zeros((len(REPORT_ROWS), contacts)),
        active=np.zeros(contacts, dtype=bool), pose=pose, pose_des=pose)
