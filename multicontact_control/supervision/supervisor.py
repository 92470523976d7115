"""The controller with everything that keeps it safe around it; nothing that comes in raises."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_state import (
    AMBIGUOUS,
    ArmState,
    JOINT_SPEED,
    OPERATIONAL_SPEED,
)
from multicontact_control.control.controller import ControlOutput
from multicontact_control.control.law import limit_torque
from multicontact_control.control.reference import TaskSource
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.force.force_law import continue_laws_at
from multicontact_control.records import SUPERVISION
from multicontact_control.supervision.bumpless import BumplessController
from multicontact_control.supervision.checks import (
    CollisionWatch,
    limit_speeds,
    NOT_FINITE,
    OUTSIDE,
    plausibility_limits,
    PULL,
    reactions_of,
    SIDEWAYS,
    TOO_FAST,
)
from multicontact_control.supervision.command_limits import outside_limits
from multicontact_control.supervision.fallback import (
    DAMP,
    FLOAT,
    HOLD,
    INFLATE,
    NONE,
    Reactions,
    SEVERITY,
)
from multicontact_control.supervision.gate import ENFORCED, JOINT_STOP, TORQUE, TorqueGate
from multicontact_control.supervision.inputs import Seen, TickInputs
from multicontact_control.supervision.recovery import LATCHED, RECOVERING, Recovery
from multicontact_control.supervision.reference import ContactReference
from multicontact_control.supervision.status import (
    no_answer,
    SupervisorStatus,
    TickOutput,
)
from multicontact_control.supervision.supervised_law import (
    GATE,
    PASSED,
    REFERENCE,
    SupervisedLaw,
)
import numpy as np

__all__ = ['Supervisor', 'TickOutput', 'SupervisorStatus']

CONTRADICTIONS = 2  # samples in a row that contradict the contacts, for the wrench to be refused
SEEN_TIME = 0.05  # s, after which an arm that was not seen is held again
LONGEST_SKIP = 0.1  # s; the task's time does not follow a clock that has been set
WAITING = ((RECOVERING,), (LATCHED,))
# What is 0 of a contact that no force law controls.
OF_THE_LAW = ('active', 'alpha_des', 'alpha_fed', 'alpha_est', 'alpha_rate_est', 'innovation',
              'prior_variance', 'variance_used')
SATURATED = frozenset(ENFORCED[TORQUE | JOINT_STOP])
FIXED = ('torque_limit', 'sensor', 'contact_state', 'limits', 'watchdog', 'collision')
LIVE_OF_CONTACTS = (
    'friction_coefficient', 'normal_world', 'normal_turn_rate', 'normal_range', 'surface_speed',
    'surface_speed_limit')


class Supervisor(BumplessController):
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

    Attributes
    ----------
    config
        The configuration in force.
    controller, reference
        The control law, and what it is asked for.
    outside
        Where the arm is beyond its limits, so that control cannot start, a line for each.
    expects_pushes
        Whether forces are expected that no contact can explain, from pushes on the tool.
    collisions
        What touches the arm before its wrist sensor.

    """

    def __init__(self, config: ControllerConfig, robot: RobotModel, task: TaskSource) -> None:
        self._robot, self._period = robot, config.period
        self._record: Any = np.zeros(1, dtype=SUPERVISION)
        self.reference = ContactReference(config, task, self._record['reference'])
        super().__init__(config, robot, self.reference)
        self._gate = TorqueGate(config, robot.joint_count)
        self._reactions = Reactions(config, self.controller)
        self._recovery = Recovery(config.watchdog, config.period)
        self.collisions = CollisionWatch(config, self.controller)
        self.expects_pushes = False
        arm = self.controller.arm
        limit_speeds(arm.joints, arm.frames, config)
        self.reference.bind(self.controller)
        self._law = SupervisedLaw(
            self._record, self.controller, self.reference.contact_states, self._gate)
        self._measured: Any = self.controller.controls['measured']
        self.reset()

    def _adopt(self, config: ControllerConfig) -> None:
        super()._adopt(config)
        self.reference.retune(config)
        self._record['plausibility'] = plausibility_limits(config)
        self.controller.controls['law']['limited'] = False  # that is done, and told, at the gate

    def check(self, config: ControllerConfig) -> None:
        """Find out whether `reconfigure` would take a configuration; see `BumplessController`."""
        for name in FIXED:
            if getattr(config, name) != getattr(self.config, name):
                raise ConfigError(name, 'what it is while in use', 'another value')
        for name, contact in self.config.contacts.items():
            other = config.contacts.get(name)
            if other is None or other != contact.model_copy(update={
                    field: getattr(other, field) for field in LIVE_OF_CONTACTS}):
                raise ConfigError(
                    f'contacts.{name}', 'what it is while in use, but for '
                    f'{", ".join(LIVE_OF_CONTACTS)}', 'another value')
        super().check(config)

    def stand_still(self, pose: Pose) -> Pose:
        """Keep the contacts that are held; return the pose of a task that leaves the arm there."""
        return self.reference.stand_still(super().stand_still(pose))

    def go_on(self) -> None:
        """Go on with the task after `stand_still`, from where the arm is."""
        super().go_on()
        self.reference.resume()

    def reset(self) -> None:
        """Forget everything measured; the next tick starts anew."""
        super().reset()
        self.outside: tuple[str, ...] = ()
        self._restart_law()
        self.collisions.reset()
        self._gate.reset()
        self._reactions.end()
        self._arm: ArmState | None = None
        self._too_fast: tuple[str, ...] = ()
        self._touched: tuple[str, ...] = ()
        self._wrench_known, self._blind = False, False
        self._output = no_answer(self._robot.joint_count, len(self.config.columns))
        self._status: SupervisorStatus | None = None
        self._last_law: object = None
        self._effort: Vector | None = None

    def _restart_law(self) -> None:
        self.controller.reset()
        self._task_ticks = self._good_ticks = self._contradictions = 0
        self._paused = self._running = False
        self._waiting_reaction = HOLD
        self._recovery.reset()

    @property
    def started(self) -> bool:
        """Whether the control law has answered a sample since it was reset."""
        return self._running

    @property
    def presses(self) -> bool:
        """Whether a reaction presses on with what a contact was held with."""
        return self._reactions.presses

    def try_again(self) -> bool:
        """
        Resume control that is latched, and seek contacts that were given up.

        Returns
        -------
        bool
            Whether there was any of that.

        """
        latched = self._recovery.latched
        self._recovery.allow()
        return self.reference.seek_again() or latched

    def step(self, inputs: TickInputs) -> TickOutput:
        """
        Answer one tick, whatever came in.

        Parameters
        ----------
        inputs
            The newest readings, however old, not validated.

        Returns
        -------
        TickOutput
            A torque that may be commanded, and how it came about. A tick with the time of the
            one before gets the same answer again.

        """
        return self._survive(self._step, inputs)

    def safe_step(self, inputs: TickInputs) -> TickOutput:
        """
        Answer one tick by the declared safe behaviour, reached without a jump.

        The control law is forgotten: a later `step` starts it anew, from the torque that acts
        then.
        """
        return self._survive(self._safe_step, inputs)

    def _survive(
        self, answer: Callable[[Seen], TickOutput], inputs: TickInputs,
    ) -> TickOutput:
        try:
            valid = self._validate(inputs)
            if valid.repeated and self._status is not None:
                return TickOutput(self._output, self._status)
            self._update_state(valid)
            return answer(valid)
        except Exception as error:  # whatever it is, it must not stop the callback
            return self._last_resort(f'internal_{type(error).__name__}')

    def _validate(self, inputs: TickInputs) -> Seen:
        """Return what is valid; take note of the time, and of the effort to start from."""
        before = self.inputs.now
        valid = self.inputs.validate(inputs)
        skipped = self.inputs.now - before - self._period
        if self._running and not self._paused and 0.5 * self._period < skipped <= LONGEST_SKIP:
            self._task_ticks += round(skipped / self._period)
        if not self._transition.begun and inputs.joints is not None:
            self._effort = self.inputs.effort.copy() if self.inputs.acted else None
        return valid

    def _safe_step(self, valid: Seen) -> TickOutput:
        arm = self._arm
        if not self._safe_running:
            self._restart_law()
            self._reactions.end()
            self.reference.reset()
            self._safe.start()
            self._transition.begin(self._acting)
        self._safe_running = True
        if arm is None or valid.blind:
            self._safe.start()  # it is held wherever it has gone meanwhile
            return self._react(valid.causes or ('joints_stale',), valid.rejected,
                               DAMP if arm is None else FLOAT)
        torque = self._safe.torque(arm.q, arm.velocity, self._added)
        return self._finish(self._idle_output(torque), 'safe', valid.causes,
                            valid.rejected, NONE, ())

    def _acting(self) -> Vector:
        """Return the torque that acts before any command, shape (n,) [N m]."""
        return self._held(self._effort, None if self._arm is None else self._arm.q)

    def _idle_output(self, torque: Vector) -> ControlOutput:
        """Return an answer of something else than the control law: what is seen, no force."""
        output = self._output if self._arm is None else self.controller.output(torque)
        contacts = output.contacts.copy()
        for name in OF_THE_LAW:
            contacts[name] = 0
        return output._replace(torque=torque, contacts=contacts)

    def _step(self, valid: Seen) -> TickOutput:
        causes = valid.causes + self._too_fast + self._touched
        if not self._running:
            causes += self._start_refused()
        reaction = self._reaction_to(causes) if causes else NONE
        if reaction in (NONE, INFLATE):
            self._good_ticks += 1
            missing = self._recovery.missing(self._good_ticks) if self._paused else ()
            if missing:
                return self._react(missing, valid.rejected, self._waiting(valid.blind))
            return self._control(valid, causes, reaction)
        return self._react(causes, valid.rejected, reaction)

    def _waiting(self, blind: bool) -> str:
        """Return what is done while control waits; joints that come and go are not held."""
        floats = self._status is not None and self._status.reaction == FLOAT
        seen = self._good_ticks * self._period
        return FLOAT if blind or floats and seen < SEEN_TIME else self._waiting_reaction

    def _start_refused(self) -> tuple[str, ...]:
        """Return why control must not start from here: its limits would move the arm at once."""
        arm = self._arm
        if arm is not None:
            self.outside = outside_limits(self.config, arm.q, arm.pose.position_world)
        return ('start_outside',) if self.outside else ()

    def _update_state(self, valid: Seen) -> None:
        """Work out where the arm is."""
        arm, self._wrench_known, self._blind = (
            self.controller.arm, valid.measured, valid.blind)
        self.collisions.look(
            self.inputs.joint_stamp, acted=self.inputs.acted, measured=valid.measured,
            added=None if self.own_weight is None else self.own_weight.torque)
        self.inputs.estimate_known = self.collisions.knows
        if valid.joints and arm.refresh():
            self._arm = arm
            self._too_fast = TOO_FAST[arm.found & (OPERATIONAL_SPEED | JOINT_SPEED)]
            if arm.found & AMBIGUOUS:  # what the contacts bear is of some time before
                self._wrench_known = False
            touched = self.collisions.cause(arm.found)
            # The wrench is not to be believed before the pushes that prove it.
            self._touched = (touched,) if touched and not self.expects_pushes else ()
            if self.own_weight is not None:
                self._carry()

    def _carry(self) -> Vector | None:
        change = super()._carry()
        if change is not None and self.own_weight is not None:
            self._gate.allow_for(self.own_weight.torque, change)
        return change

    def _reaction_to(self, causes: tuple[str, ...]) -> str:
        reactions = reactions_of(self.config)
        found = [reactions[cause.split('_')[0]] for cause in causes]
        return max(found, key=SEVERITY.index, default=NONE)

    def _control(
        self, valid: Seen, causes: tuple[str, ...], reaction: str,
    ) -> TickOutput:
        """Step the control law."""
        if self._arm is None or not valid.wrench:
            return self._react(('joints_stale',), valid.rejected, DAMP)
        resumed = self._paused and self._running
        if self._paused and not self._running:
            self.controller.reset()  # the arm may have been moved since the first attempt
        if resumed:
            held = self.reference.resume()
            continue_laws_at(self.controller.laws, held, self.controller.contacts['alpha_meas'])
        self._measured[0] = valid.measured
        try:
            found = self._answer()
        except Exception as error:  # whatever it is, the arm needs an answer
            cause = f'law_{type(error).__name__}' if self.controller.arm.finite else (
                'law_not_finite')
            return self._refuse(cause, valid, HOLD)
        if found & NOT_FINITE:
            return self._refuse('law_not_finite', valid, HOLD)
        cause = '' if self.expects_pushes else self._contradiction(found)
        if cause:
            return self._refuse(cause, valid, self.config.watchdog.on_wrench_fault)
        if self._safe_running or not self._transition.begun:
            self._transition.begin(self._acting)
        if resumed:
            self._recovery.resumed(self._task_ticks)
        self._running, self._paused, self._safe_running = True, False, False
        self._reactions.end()
        self._task_ticks += 1
        if found & OUTSIDE:  # the contacts have led there
            self.reference.lead_back()
        limits = ('reference',) if found & REFERENCE else ()
        if found & PASSED:
            torque = self._gate.passed()
            if found // GATE & (TORQUE | JOINT_STOP):
                self.controller.account_for(torque)
            self._transition.commanded(torque)
            return self._report(
                self.controller.output(torque), reaction, causes, valid.rejected,
                limits + ENFORCED[found // GATE])
        active = self.controller.active.tobytes()
        self._last_law = NONE, active, False
        torque = self.controller.arm.joints['torque'].copy()
        limited = limit_torque(
            self.controller.arm.joints, self.config.limits.least_task_share, torque)
        finished = self._finish(
            self.controller.output(torque), (NONE, active, resumed), causes, valid.rejected,
            reaction, limits, limited=limited)
        # A blend passes in a moment, and a limited rate is caught up with: they are left out.
        if not SATURATED.isdisjoint(finished.status.limits if finished.status else ()):
            self.controller.account_for(finished.output.torque)
        return finished

    def _answer(self) -> int:
        """Let the control law answer the task; return what `supervised_law` does."""
        self.controller.begin()
        self.reference.ask(self._task_time())
        return self._law.answer(self._transition.settled(self._last_law))

    def _contradiction(self, found: int) -> str:
        """Return how the wrench contradicts what contacts can do, once it has done so twice."""
        if not found & (PULL | SIDEWAYS):
            self._contradictions = 0
            return ''
        self._contradictions += 1
        cause = 'wrench_pull' if found & PULL else 'wrench_sideways'
        return cause if self._contradictions >= CONTRADICTIONS or self._paused else ''

    def _refuse(self, cause: str, valid: Seen, reaction: str) -> TickOutput:
        """Answer without the control law because of what it says."""
        if self._paused:
            self._recovery.relapsed((cause,))
        return self._react((cause,), valid.rejected, reaction)

    def _react(
        self, causes: tuple[str, ...], rejected: tuple[str, ...], reaction: str,
    ) -> TickOutput:
        """Answer without the control law."""
        if self._blind and self._arm is not None and reaction in (HOLD, DAMP):
            reaction = FLOAT  # what is not seen can be neither held nor slowed down
        if causes not in WAITING:
            self._good_ticks = 0
            # An arm that was not seen for a moment only is held when it is seen again, or what
            # else it waited in goes on.
            if not self._unseen(causes, reaction):
                self._waiting_reaction = reaction
            elif not self._paused:
                self._waiting_reaction = HOLD
        if self._running and not self._paused:
            self._recovery.stopped(causes, self._task_ticks)
            self._reactions.begin(self._output)
        self._paused = True
        with np.errstate(all='ignore'):  # numbers that are none are for the gate to find
            # What blocks the arm may be what the contacts' forces press it against: they fade.
            felt = self._wrench_known and not self._touched
            output = self._idle_output(self._reactions.torque(reaction, self._arm, felt))
            self._transition.drop_slow_blend(self._acting)
            return self._finish(output, reaction, causes, rejected, reaction, ())

    def _unseen(self, causes: tuple[str, ...], reaction: str) -> bool:
        """Return whether the arm floats only because it is not seen, or a part has failed."""
        others = tuple(cause for cause in causes
                       if cause.split('_')[0] not in ('joints', 'internal'))
        return reaction == FLOAT and self._reaction_to(others) != FLOAT

    def _finish(
        self, output: ControlOutput, law: object, causes: tuple[str, ...],
        rejected: tuple[str, ...], reaction: str, limits: tuple[str, ...], *,
        limited: bool = False,
    ) -> TickOutput:
        """Blend, pass the gate, report; `limited` if the torque is at its limits already."""
        blended = self._transition.apply(law, output.torque)
        fallback = np.zeros_like(blended) if self._arm is None else self._arm.bias_torque.copy()
        # Speeds that were once would be braked for ever: `float` ends them open loop.
        seen = None if self._blind else self._arm
        torque, enforced = self._gate.apply(blended, fallback, seen, limited=limited)
        self._transition.commanded(torque)
        return self._report(
            ControlOutput(torque, *output[1:]), reaction, causes, rejected, limits + enforced)

    def _report(
        self, output: ControlOutput, reaction: str, causes: tuple[str, ...],
        rejected: tuple[str, ...], limits: tuple[str, ...],
    ) -> TickOutput:
        self.collisions.commanded(output.torque)
        self._output, self._status = output, SupervisorStatus(
            reaction, causes, rejected, limits, self.reference.state_names, self._task_time())
        return TickOutput(output, self._status)

    def _last_resort(self, cause: str) -> TickOutput:
        """Answer after something failed that should not: what is known of the arm is its past."""
        self._too_fast, self._touched = (), ()
        self._wrench_known, self._blind = False, True
        reaction = DAMP if self._arm is None else FLOAT
        try:
            return self._react((cause,), (), reaction)
        except Exception:  # nothing is left but gravity where the arm was seen last
            self._paused, self._good_ticks = True, 0
            carried = self._gate.carry(self._arm)
            self._transition.commanded(carried)
            return self._report(self._idle_output(carried), reaction, (cause,), (), ())

    def _task_time(self) -> float:
        return self._task_ticks * self._period
