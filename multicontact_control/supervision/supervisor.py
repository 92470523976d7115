"""The control law with everything around it that keeps the arm safe, in one step."""

from __future__ import annotations

import logging

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control.arm import ArmState, RELEASE
from multicontact_control.control.controller import (
    Controller,
    ControllerDesign,
    ControlOutput,
)
from multicontact_control.control.tasks import TaskSource
from multicontact_control.diagnosis.explanations import Explanations
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import (
    CommandError,
    MulticontactError,
    SingularTaskError,
)
from multicontact_control.flags import (
    ALARMS,
    ANSWER_REFUSED,
    COLUMNS_DEPENDENT,
    FORCES_AMBIGUOUS,
    LASTING_LIMITS,
    LIMITS,
    MODEL_NOT_FINITE,
    POSTURE_SINGULAR,
    REFERENCE_LIMITED,
    RESIDUAL_CLEARED,
    RESIDUAL_EXCEEDED,
)
from multicontact_control.force.force_law import continue_laws_after_pause
from multicontact_control.records import Records
from multicontact_control.supervision import checks, reactions
from multicontact_control.supervision.command_limits import outside_limits
from multicontact_control.supervision.contact_task import ContactTask
from multicontact_control.supervision.contacts import GIVEN_UP
from multicontact_control.supervision.gate import limit_names, TorqueGate
from multicontact_control.supervision.inputs import (
    ALL_VALID,
    Inputs,
    InputVerdict,
    TickInputs,
)
from multicontact_control.supervision.reactions import FLOAT, HOLD, NONE, SAFE
from multicontact_control.supervision.report import make_empty_answer, SupervisorStatus
from multicontact_control.tick import ACT, SEE, tick, TickRecords, WORKSPACE
import numpy as np

LOGGER = logging.getLogger(__name__)
# s between two looks at what an arm that stands in a reaction weighs.
STANDING_TIME = 0.2
SEEN_TIME = 0.05  # s, after which an arm that was not seen is held again
NAMED = LIMITS | REFERENCE_LIMITED  # what a status names
UNNAMED = -1  # equal to nothing that may be found
CONTROLLED = (NONE, reactions.INFLATE)  # what the control law answers
Answer = tuple[ControlOutput, SupervisorStatus | None]


class Supervisor:
    """
    The control loop of a tick: inputs, controller, task, checks, gate.

    The torque starts from the measured effort, or from gravity compensation where the robot
    measures none (or only zeros). Reactions take the place of the law; see `Reactions`. If not
    `guarded`, the law answers every sample as it is, and `step` raises where it cannot; torques
    are still limited.

    Attributes
    ----------
    safe, started
        Whether ticks are answered by the declared safe behaviour, see `stop`; whether the control
        law has answered a sample since it was reset.
    findings
        What explains the reaction in force, a sentence for each cause that has one.

    """

    def __init__(
        self,
        config: ControllerConfig,
        robot: RobotModel,
        source: TaskSource,
        *,
        guarded: bool = True,
    ) -> None:
        self.guarded = guarded
        self._robot = robot
        self._period = config.period
        self._adds_gravity = config.robot.adds_gravity
        self.controller = controller = Controller(config, robot)
        self._joints = controller.arm.joints
        self._controls = controller.controls
        self.task = ContactTask(config, source, controller, guarded=guarded)
        self.inputs = Inputs(config, controller, guarded=guarded)
        self.gate = TorqueGate(config, controller.arm, guarded=guarded)
        self.reactions = reactions.Reactions(config, controller)
        self.explanations = Explanations(
            controller, self.inputs, self.task, guarded=guarded
        )
        self._recovery = reactions.RecoveryPolicy(
            config.watchdog.recovery_time, config.period
        )
        self._hysteresis = reactions.ReactionHysteresis(config.period)
        judgements: Records[checks.Judgement] = np.zeros(1, dtype=checks.JUDGEMENT)
        self._judgement = judgements[0]
        self._q = controller.arm.q
        self._velocity = controller.arm.velocity
        self._motion = controller.arm.motion
        records = TickRecords(
            joints=self._joints,
            controls=self._controls,
            contacts=controller.contacts,
            laws=controller.laws,
            states=self.task.states,
            limits=self.task.limits,
            judgements=judgements,
            gates=self.gate.records,
            workspaces=np.zeros(1, dtype=WORKSPACE),
        )
        self.records = records
        self._records = records[:]  # a plain tuple, as `tick` takes it
        self._torque_acts = self.gate.records['begun']
        self._states_changed = self.task.limits['changed']
        self._has_free_readings = self.task.limits['has_free_readings']
        self._apply_config(config)
        self._run_stages(0)  # no stage, but compiled: no sample waits for it
        operational_wrench(self._controls[0], np.zeros(6))
        self.reset()

    def reset(self) -> None:
        """Forget everything measured and commanded; the next tick starts anew."""
        if self.guarded:
            checks.configure_monitors(self.config, self.controller)
        self._restart_law()
        self.inputs.reset()
        self.gate.reset()
        self.safe = False
        self.findings: tuple[str, ...] = ()
        self._causes: tuple[str, ...] = ()  # that these explain
        # Cause and text of an exception that is being answered.
        self._failure = '', ''
        self._logged_causes: set[str] = set()  # of exceptions
        self._arm: ArmState | None = None  # once it was seen
        self._verdict = InputVerdict()
        self._set_wrench_known(False)
        self._reaction = NONE
        self._named = UNNAMED
        self._status = SupervisorStatus(NONE)
        self._output = make_empty_answer(
            self._robot.joint_count, len(self.config.columns)
        )

    def _restart_law(self) -> None:
        """Let the law begin with the task anew; relapses and holds are forgotten."""
        self.controller.reset()
        self.task.reset()
        self._task_ticks = 0
        self._good_ticks = 0
        self._reacting_ticks = 0
        self._judgement['contradictions'] = 0
        self.started = False
        self._paused = False
        self._weighed = False
        self._in_control = False  # whether the law has answered the sample before
        self._recovery.reset()
        self._hysteresis.reset()
        self._operator_trusts_velocities = False
        self.reactions.forget_postures()

    def stop(self) -> None:
        """Answer by the declared safe behaviour from the next tick on, until a `reset`."""
        if not self.safe:
            self._restart_law()
            self.safe = True
            self.gate.start_blend()

    def step(self, inputs: TickInputs) -> Answer:
        """
        Answer the newest readings, whatever they are, by a torque that may be commanded.

        Without guards there is no status, and MulticontactError says what is missing or singular.
        """
        self._part = 'internal'
        try:
            if not self.guarded:
                self._require_readings(inputs)
            command = None
            if self._torque_acts[0]:
                command = self.gate.last
            verdict = self.inputs.validate(inputs, command)
            self._verdict = verdict
            if self.controller.tool is not self.controller.next_tool:
                self.controller.advance_tool_change()
            if verdict.joints_known:
                self._robot.compute(self._q, self._velocity)
                if self._adds_gravity:
                    self._allow_for_gravity()
            if verdict.wrench_is_current != self._wrench_known:
                self._set_wrench_known(verdict.wrench_is_current)
            sees_first = not self._in_control or (not self.guarded and self.task.seeks)
            if sees_first or verdict is not ALL_VALID:
                return self._step_in_stages(verdict)
            self._part = 'law'
            self.task.update_wanted_task(self._task_ticks * self._period)
            found = self._run_stages(SEE | ACT)
            self.controller.arm.flags = found
            if found & ALARMS:
                return self._choose_answer(verdict, found)
            return self._finish_law_answer(found, NONE, ())
        except Exception as error:
            if not self.guarded:
                raise
            return self._answer_exception(self._part, error)

    def _require_readings(self, inputs: TickInputs) -> None:
        """Raise if joints or wrench are missing; the law's time is that of the samples."""
        if inputs.joints is None or inputs.wrench is None:
            raise unsupervised_error()
        self._task_ticks = round(inputs.time / self._period)

    def _allow_for_gravity(self) -> None:
        """Tell the gate what the drives add to a command."""
        weight = self.controller.drive_gravity_torque()
        if np.isfinite(weight).all():
            self.gate.update_added_torque(weight)

    def _step_in_stages(self, verdict: InputVerdict) -> Answer:
        """See first and act then, where it has to be decided between the two what answers."""
        found = 0
        if self.guarded and self._in_control:
            self._task_ticks += verdict.skipped_samples
        if verdict.joints_known:
            found = self._run_stages(SEE)
            self.controller.arm.flags = found
            if not found & MODEL_NOT_FINITE:
                self._arm = self.controller.arm
            if found & RESIDUAL_CLEARED:
                self._add_finding(self.explanations.explain_late_wrench())
        return self._choose_answer(verdict, found)

    def _choose_answer(self, verdict: InputVerdict, found: int) -> Answer:
        """Let the law answer what has been seen, or a reaction."""
        self._part = 'internal'
        if found & FORCES_AMBIGUOUS:
            self._set_wrench_known(False)  # it is older
        reaction, causes = self._choose_reaction(
            verdict.causes + self._name_alarms(found)
        )
        if reaction in CONTROLLED:
            return self._answer_by_law(reaction, causes)
        return self._answer_by_reaction(reaction, causes)

    def _run_stages(self, stages: int) -> int:
        """Run stages of the compiled pass on the terms of the model; return what was found."""
        return tick(stages, self._records, self._motion, self._robot.term_tuple)

    def _set_wrench_known(self, known: bool) -> None:
        """Say whether the wrench is of this sample, and the contacts' forces with it."""
        self._wrench_known = known
        self._controls['measured'] = known

    def _name_alarms(self, found: int) -> tuple[str, ...]:
        """Name what is wrong with where the arm is and what touches it."""
        causes = []
        for flag, cause in checks.TOO_FAST.items():
            if found & flag:
                causes.append(cause)
        if found & RESIDUAL_EXCEEDED and not self.task.locked:
            watch = self._joints['watch']
            beyond = np.abs(watch['residual']) > RELEASE * watch['threshold']
            last_joint = np.flatnonzero(beyond)[-1]
            name = self.config.robot.joint_names[last_joint]
            causes.append(f'{checks.COLLISION}_{name}')
        return tuple(causes)

    def _answer_by_law(self, reaction: str, causes: tuple[str, ...]) -> Answer:
        """Let the law answer a sample that has been seen, also for the first time."""
        arm = self.controller.arm
        self._part = 'law'
        if not self._in_control:
            self._resume_law()
            self._begin_torque()
        self.task.update_wanted_task(self._task_ticks * self._period)
        if arm.flags & (MODEL_NOT_FINITE | FORCES_AMBIGUOUS):
            self.controller.raise_no_answer()
        self._judgement['resumes'] = self._paused
        return self._finish_law_answer(self._run_stages(ACT), reaction, causes)

    def _finish_law_answer(
        self, found: int, reaction: str, causes: tuple[str, ...]
    ) -> Answer:
        """Answer by the law, or refuse what it says."""
        if found & (POSTURE_SINGULAR | COLUMNS_DEPENDENT):
            self.controller.raise_no_answer(found)
        self._part = 'internal'
        if found & ANSWER_REFUSED:
            return self._refuse_answer(checks.name_refusal_cause(found))
        if not self._in_control:
            self._hand_control_to_law()
        if found & RESIDUAL_CLEARED:
            self._add_finding(self.explanations.explain_late_wrench())
        # A blend passes in a moment, and a limited rate is caught up with: they are left out.
        if self.guarded and found & LASTING_LIMITS:
            self.controller.account_for_torque(self.gate.last)
        self._task_ticks += 1
        return self._report_tick(reaction, causes, found)

    def _add_finding(self, finding: str) -> None:
        """Keep what explains the reaction in force, if anything new does."""
        if finding and finding not in self.findings:
            self.findings = (*self.findings, finding)

    def _choose_reaction(self, causes: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """Return what answers the tick, the law or a reaction, and why."""
        arm = self._arm
        if self.safe:
            return SAFE, causes
        if checks.VELOCITY_CONTRADICTED in causes:
            self._operator_trusts_velocities = False
        elif self.velocities_on_probation:
            # At rest nothing contradicts them: the arm is held by estimates from its positions.
            causes = (checks.VELOCITY_CONTRADICTED, *causes)
        if self.guarded and not self.started and arm is not None:
            outside = outside_limits(self.config, arm.q, arm.pose.position_world)
            if outside:  # the limits would move it at once
                causes = (*causes, 'start_outside')
                self.findings = self.findings or outside
        reaction = checks.choose_severest_reaction(causes, self.config)
        if reaction not in CONTROLLED or not self._paused:
            return reaction, causes
        self._good_ticks += 1
        waiting = self._recovery.waiting_causes(self._good_ticks)
        if not waiting:
            return reaction, causes
        seen_time = self._good_ticks * self._period
        if self._reaction == FLOAT and seen_time < SEEN_TIME:
            return FLOAT, waiting  # joints that come and go are not held
        return HOLD, waiting

    @property
    def velocities_on_probation(self) -> bool:
        """Whether velocities were refuted, and neither motion nor an operator says otherwise."""
        return (
            self.guarded
            and self.inputs.velocities_refuted
            and not self._operator_trusts_velocities
        )

    def _resume_law(self) -> None:
        """Start the control law, or go on with it after a reaction."""
        controller = self.controller
        controller.pause_motion_observer()
        if self.started:
            held = self.task.resume_task()
            continue_laws_after_pause(
                controller.laws, held, controller.contacts['alpha_meas']
            )
        else:
            controller.reset()  # the arm may have been moved since an attempt before
            self.task.start_task(controller.start())

    def _hand_control_to_law(self) -> None:
        """Let the law act from now on."""
        self._judgement['resumes'] = False
        if self._paused:
            self.reactions.end_reaction()
            self._causes = ()
            self.findings = ()
            if self.started:
                self._recovery.resumed_at = self._task_ticks
        self.started = True
        self._in_control = True
        self._paused = False

    def _begin_torque(self) -> None:
        """Let the torque start from the one that acts before any command."""
        if self.gate.begun:
            return
        acting = np.zeros(self._robot.joint_count)
        if self._arm is not None:
            acting = self._robot.gravity.copy()
        measured = self.inputs.measured_effort + self._joints['drive_gravity_torque']
        self.gate.begin_from(np.where(np.isnan(measured), acting, measured))

    def _refuse_answer(self, cause: str) -> Answer:
        """Answer without the control law because of what it says, or raise without guards."""
        if not self.guarded:
            raise SingularTaskError(
                'the torque: expected finite numbers, got NaN or infinity'
            )
        if self._paused:
            self._recovery.note_relapse((cause,))
        return self._answer_by_reaction(
            checks.choose_severest_reaction((cause,), self.config), (cause,)
        )

    def _answer_by_reaction(self, reaction: str, causes: tuple[str, ...]) -> Answer:
        """Answer without the control law."""
        arm = self._arm
        sees_arm = arm is not None and not self._verdict.blind
        if arm is not None and not sees_arm:
            reaction = FLOAT  # what is not seen can be neither held nor slowed down
        if reaction != SAFE:
            reaction = self._hysteresis.steady_reaction(reaction)
        self._note_causes(causes)
        self._paused = True
        self._in_control = False
        self._begin_torque()
        if reaction != SAFE:
            self.gate.cancel_blend()
        torque = self._compute_reaction(reaction, causes)
        found = self.gate.apply_torque(
            reactions.NUMBERS[reaction], torque, seen=sees_arm
        )
        if reaction == SAFE:
            reaction = NONE
        return self._report_tick(reaction, causes, found, controlled=False)

    def _note_causes(self, causes: tuple[str, ...]) -> None:
        """Explain causes that are new, count relapses, and weigh an arm that stands."""
        if causes not in reactions.WAITING:
            self._good_ticks = 0
            if causes != self._causes or not self.findings:
                self._causes = causes
                self.findings = self._explain_causes(causes) or self.findings
                self._weighed = False
        if self.started and not self._paused:
            if self._recovery.note_reaction(causes, self._task_ticks):
                self.reactions.forget_postures()
            self.reactions.return_to_first_hold()
            self.reactions.begin_pressing(self._output)
        self._reacting_ticks += 1
        if not self._paused:
            self._reacting_ticks = 0
        looks = self._reacting_ticks % round(STANDING_TIME / self._period) == 1
        if looks and not self._weighed:
            gravity = self.explanations.explain_other_gravity(self._causes)
            self._weighed = bool(gravity)
            self._add_finding(gravity)

    def _compute_reaction(self, reaction: str, causes: tuple[str, ...]) -> Vector:
        """
        Return the torque of a reaction, shape (n,) [N m]; the gate finds numbers without sense.

        What blocks the arm may be what the contacts' forces press it against: they fade. Without
        guards, velocities and angles are used as they come.
        """
        presses_on = self._wrench_known
        if self.controller.arm.flags & RESIDUAL_EXCEEDED:
            presses_on = False
        rate = self.controller.arm.velocity
        if self.guarded:
            rate = self.inputs.estimated_velocity
        timed = not any(cause.startswith('clock') for cause in causes)
        with np.errstate(all='ignore'):
            return self.reactions.reaction_torque(
                reaction, self._arm, presses_on, rate, timed=timed
            )

    def _explain_causes(self, causes: tuple[str, ...]) -> tuple[str, ...]:
        """Return what is known about causes that have just begun."""
        failed, text = self._failure
        if failed in causes:
            return (text,)
        if self.explanations.comes_of_velocities(causes):
            self.inputs.refute_worst_velocity()
        return self.explanations.explain_causes(causes)

    def _answer_exception(self, part: str, error: Exception) -> Answer:
        """Answer after an exception, in the law or in what is around it, and tell what it says."""
        cause = f'{part}_{type(error).__name__}'
        if part == 'law' and not self.controller.arm.has_finite_terms:
            cause = 'law_not_finite'
        self._failure = cause, self._log_exception(cause, error)
        try:
            if part == 'law':
                return self._refuse_answer(cause)
            # What failed is not known: what is known of the arm is its past.
            self._set_wrench_known(False)
            self._verdict = InputVerdict(blind=True)
            return self._answer_by_reaction(FLOAT, (cause,))
        except Exception as second:  # the torque that acts goes on
            text = self._log_exception(f'reaction_{type(second).__name__}', second)
            self.findings = self._failure[1], text
            self._causes = (cause,)
            self._paused = True
            self._in_control = False
            self._good_ticks = 0
            return self._report_tick(FLOAT, (cause,), 0, controlled=False)
        finally:
            self._failure = '', ''

    def _log_exception(self, cause: str, error: Exception) -> str:
        """Return what an exception says; the first of each cause is logged with its traceback."""
        text = ' '.join(f'{type(error).__name__}: {error}'.split())
        if cause not in self._logged_causes:
            self._logged_causes.add(cause)
            traceback = None
            if not isinstance(error, MulticontactError):  # ours say all that there is
                traceback = error
            LOGGER.error('%s: %s', cause, text, exc_info=traceback)
        return text

    def _report_tick(
        self,
        reaction: str,
        causes: tuple[str, ...],
        found: int,
        *,
        controlled: bool = True,
    ) -> Answer:
        """Return the answer of the tick; of contacts that no law controls nothing is known."""
        self._reaction = reaction
        torque = self.gate.last.copy()
        if self._adds_gravity:
            torque -= self._joints['drive_gravity_torque']
        if self._arm is None:
            self._output = self._output._replace(torque=torque)
        else:
            self._output = ControlOutput(torque, self.controller.memory.tobytes())
        if not controlled:
            self._output = self._output.without_force_answers()
        if not self.guarded:
            return self._output, None
        named = found & NAMED
        plain = self._verdict is ALL_VALID and not causes
        changed = self._states_changed[0] or named != self._named
        if changed or self._has_free_readings[0] or not plain:
            self._status = self._new_status(reaction, causes, named)
            self._named = UNNAMED
            if plain:
                self._named = named
        return self._output, self._status

    def _new_status(
        self, reaction: str, causes: tuple[str, ...], named: int
    ) -> SupervisorStatus:
        """Return what was done in a tick in which something is not as in the one before."""
        unwatched = ''
        read_before: tuple[str, ...] = ()
        if self._verdict.efforts_unusable:
            unwatched = self.explanations.explain_unwatched_joints()
        if self._has_free_readings[0]:
            read_before = self.task.read_before
        return SupervisorStatus(
            reaction,
            causes,
            self._verdict.rejected,
            limit_names(named),
            self.task.state_names,
            unwatched,
            read_before,
        )

    @property
    def task_time(self) -> float:
        """Return the time of the task, which stands still during a reaction [s]."""
        return self._task_ticks * self._period

    def adopt_design(self, design: ControllerDesign) -> None:
        """Go on with other live parameters, without a jump; see `Controller.design`."""
        self.controller.use(design)
        self._apply_config(design.config)
        self.gate.start_blend()

    def _apply_config(self, config: ControllerConfig) -> None:
        """Set what follows from the values that may change while the arm is controlled."""
        self.config = config
        self.gate.apply_config(config.transition)
        self.reactions.apply_config(config)
        self.task.apply_config(config)
        self._judgement['plausibility'] = checks.plausibility_limits(config)

    def request_retry(self) -> bool:
        """
        Resume control that is latched, seek contacts given up; return if there was any.

        Control resumes on estimates as well, if velocities were refuted and not proven since.
        """
        given_up = self.task.states['state'] == GIVEN_UP
        waited = self._recovery.latched or self.velocities_on_probation
        self.task.states['retry_requested'] |= given_up
        self._recovery.unlatch_control()
        self.reactions.keep_present_hold()
        self._operator_trusts_velocities = self.inputs.velocities_refuted
        return bool(given_up.any()) or waited


def unsupervised_error() -> CommandError:
    """Return the error of a tick that only a supervisor with guards can answer."""
    return CommandError(
        'control', hint='it needs the supervisor for this (supervised: true)'
    )
