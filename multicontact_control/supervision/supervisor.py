"""The control law with everything around it that keeps the arm safe, in one step."""

from __future__ import annotations

import logging

from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control.arm import RELEASE
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
    ANSWER_REFUSED,
    LIMITS,
    NO_ANSWER,
    REFERENCE_LIMITED,
    RESIDUAL_CLEARED,
)
from multicontact_control.records import Records
from multicontact_control.supervision import checks
from multicontact_control.supervision.causes import (
    COLLISION,
    find_refusal_cause,
    FLOAT,
    INTERNAL,
    LAW,
    LAW_NOT_FINITE,
    name_causes,
    NONE,
    SEVERITY,
    START_OUTSIDE,
    TO_INFLATE,
    TO_NONE,
    TO_SAFE,
    WAITING,
)
from multicontact_control.supervision.command_limits import outside_limits
from multicontact_control.supervision.contact_task import ContactTask
from multicontact_control.supervision.decisions import (
    doubts_velocities,
    restart_control,
    retry,
    stop_control,
)
from multicontact_control.supervision.gate import limit_names, TorqueGate
from multicontact_control.supervision.inputs import (
    ALL_VALID,
    Inputs,
    InputVerdict,
    TickInputs,
)
from multicontact_control.supervision.reactions import (
    configure_reactions,
    presses_contact,
)
from multicontact_control.supervision.report import make_empty_answer, SupervisorStatus
from multicontact_control.supervision.tick_records import (
    SUPERVISION,
    Supervision,
    TickRecords,
    WORKSPACE,
)
from multicontact_control.tick import ACT, answer_error, SEE, tick
import numpy as np

LOGGER = logging.getLogger(__name__)
# s between two looks at what an arm that stands in a reaction weighs.
STANDING_TIME = 0.2
NAMED = LIMITS | REFERENCE_LIMITED  # what a status names
UNNAMED = -1  # equal to nothing that may be found
Answer = tuple[ControlOutput, SupervisorStatus | None]


class Supervisor:
    """
    The control loop of a tick: inputs, model, task, and the compiled `tick` that answers.

    The torque starts from the measured effort, or from gravity compensation where the robot
    measures none (or only zeros). Reactions take the place of the law; see `reactions`. If not
    `guarded`, the law answers every sample as it is, and `step` raises where it cannot; torques
    are still limited.

    Attributes
    ----------
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
        self.explanations = Explanations(
            controller, self.inputs, self.task, guarded=guarded
        )
        judgements: Records[checks.Judgement] = np.zeros(1, dtype=checks.JUDGEMENT)
        self._judgement = judgements[0]
        supervisions: Records[Supervision] = np.zeros(1, dtype=SUPERVISION)
        self._supervision = supervisions[0]
        settings = self._supervision['config']
        settings['guarded'] = guarded
        settings['period'] = config.period
        settings['collision_reaction'] = SEVERITY.index(config.collision.reaction)
        for part in ('recovery', 'hysteresis'):
            self._supervision[part]['period'] = config.period
        self._supervision['recovery']['shortest'] = config.watchdog.recovery_time
        self._q = controller.arm.q
        self._velocity = controller.arm.velocity
        self._motion = controller.arm.motion
        self.records = TickRecords(
            joints=self._joints,
            controls=self._controls,
            contacts=controller.contacts,
            laws=controller.laws,
            fresh_laws=controller.fresh_laws,
            states=self.task.states,
            stages=self.inputs.stages,
            supervisions=supervisions,
            limits=self.task.limits,
            judgements=judgements,
            gates=self.gate.records,
            workspaces=np.zeros(1, dtype=WORKSPACE),
        )
        self._record_tuple = self.records[:]  # a plain tuple, as `tick` takes it
        self._torque_acts = self.gate.records['begun']
        self._in_control = supervisions['in_control']
        self._task_ticks = supervisions['task_ticks']
        self._decided = supervisions['reaction']
        self._causes_found = supervisions['causes']
        self._states_changed = self.task.limits['changed']
        self._has_free_readings = self.task.limits['has_free_readings']
        self._apply_config(config)
        self._compile_kernels()
        self.reset()

    def _compile_kernels(self) -> None:
        """Call what no sample is to wait for, once."""
        self._run_stages(0)
        restart_control(self.records)
        retry(self.records)
        stop_control(self.records)
        doubts_velocities(self.records)
        presses_contact(self._supervision['reactions'])
        answer_error(INTERNAL, self._record_tuple, self._robot.term_tuple)
        operational_wrench(self._controls[0], np.zeros(6))

    def reset(self) -> None:
        """Forget everything measured and commanded; the next tick starts anew."""
        if self.guarded:
            checks.configure_monitors(self.config, self.controller)
        self.controller.reset()
        restart_control(self.records)
        self.task.forget_source()
        self.inputs.reset()
        self.gate.reset()
        self._supervision['safe'] = False
        self._supervision['seen'] = False
        self._supervision['reaction'] = TO_NONE
        self._supervision['causes'] = 0
        self.findings: tuple[str, ...] = ()
        self._explained: tuple[str, ...] = ()  # causes that these explain
        self._weighed = False
        self._reacting = False  # whether a reaction has answered the tick before
        self._error_type = ''  # of the exception that is being answered
        self._error_text = ''
        self._logged_causes: set[str] = set()  # of exceptions
        self._verdict = InputVerdict()
        self._named = UNNAMED
        self._status = SupervisorStatus(NONE)
        self._output = make_empty_answer(
            self._robot.joint_count, len(self.config.columns)
        )

    @property
    def safe(self) -> bool:
        """Whether ticks are answered by the declared safe behaviour; see `stop`."""
        return bool(self._supervision['safe'])

    @property
    def started(self) -> bool:
        """Whether the control law has answered a sample since it was reset."""
        return bool(self._supervision['started'])

    def stop(self) -> None:
        """Answer by the declared safe behaviour from the next tick on, until a `reset`."""
        if not self.safe:
            self.controller.reset()
            stop_control(self.records)
            self.task.forget_source()

    def step(self, inputs: TickInputs) -> Answer:
        """
        Answer the newest readings, whatever they are, by a torque that may be commanded.

        Without guards there is no status, and MulticontactError says what is missing or singular.
        """
        self._part = INTERNAL
        try:
            if not self.guarded:
                self._require_readings(inputs)
            command = None
            if self._torque_acts[0]:
                command = self.gate.last
            self._verdict = self.inputs.validate(inputs, command)
            if self.controller.tool is not self.controller.next_tool:
                self.controller.advance_tool_change()
            if self._verdict.joints_known:
                self._robot.compute(self._q, self._velocity)
                if self._adds_gravity:
                    weight = self.controller.drive_gravity_torque()
                    self.gate.update_added_torque(weight)
            return self._report_tick(self._answer_tick())
        except Exception as error:
            if not self.guarded:
                raise
            return self._answer_exception(error)

    def _require_readings(self, inputs: TickInputs) -> None:
        """Raise if joints or wrench are missing; the law's time is that of the samples."""
        if inputs.joints is None or inputs.wrench is None:
            raise unsupervised_error()
        self._task_ticks[0] = round(inputs.time / self._period)

    def _answer_tick(self) -> int:
        """Ask the source for the task, and let the compiled tick answer; return what it found."""
        found = 0
        stages = SEE | ACT
        sees_first = not self._in_control[0] or (not self.guarded and self.task.seeks)
        if sees_first or self._verdict is not ALL_VALID:
            stages = ACT
            found = self._run_stages(SEE)
            if self._decided[0] > TO_INFLATE:
                return found | self._run_stages(ACT)
            self._part = LAW
            if self._supervision['begins']:
                self.task.start_source(self.controller.begin())
            elif self._supervision['resumes']:
                self.task.go_on()
        self._part = LAW
        self.task.update_wanted_task(self._task_ticks[0] * self._period)
        self._part = INTERNAL
        return found | self._run_stages(stages)

    def _run_stages(self, stages: int) -> int:
        """Run stages of the compiled tick on the terms of the model; return what was found."""
        found = tick(stages, self._record_tuple, self._motion, self._robot.term_tuple)
        self.controller.arm.flags = found
        return found

    def _answer_exception(self, error: Exception) -> Answer:
        """Answer after an exception, in the law or in what is around it, and tell what it says."""
        cause = self._part
        if cause == LAW and not self.controller.arm.has_finite_terms:
            cause = LAW_NOT_FINITE
        if cause == INTERNAL:  # what is known of the arm is its past
            self._verdict = InputVerdict()
        self._note_error(cause, error)
        try:
            found = answer_error(cause, self._record_tuple, self._robot.term_tuple)
            return self._report_tick(found)
        except Exception as second:  # the torque that acts goes on
            text = self._log_exception(f'reaction_{type(second).__name__}', second)
            self.findings = self._error_text, text
            self._explained = name_causes(cause, error=self._error_type)
            for name, value in (('paused', True), ('in_control', False)):
                self._supervision[name] = value
            return self._answer_with_status(FLOAT, self._explained, 0)

    def _note_error(self, cause: int, error: Exception) -> None:
        """Keep what an exception says, for the cause that it is of this tick."""
        self._error_type = type(error).__name__
        (name,) = name_causes(cause, error=self._error_type)
        self._error_text = self._log_exception(name, error)

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

    def _report_tick(self, found: int) -> Answer:
        """Return the answer of the tick, and what is known of why it is this one."""
        if found & NO_ANSWER:
            error = self.controller.explain_no_answer(found)
            if not self.guarded:
                raise error
            self._note_error(find_refusal_cause(found), error)
        elif found & ANSWER_REFUSED and not self.guarded:
            raise SingularTaskError(
                'the torque: expected finite numbers, got NaN or infinity'
            )
        reaction = self._decided[0]
        causes: tuple[str, ...] = ()
        if self._causes_found[0]:
            causes = self._name_causes()
        if reaction > TO_INFLATE:
            self._explain_reaction(causes)
        elif self._reacting:
            self._explained = ()
            self.findings = ()
        self._reacting = reaction > TO_INFLATE
        if found & RESIDUAL_CLEARED:
            self._add_finding(self.explanations.explain_late_wrench())
        if reaction == TO_SAFE:
            reaction = TO_NONE
        self._error_type = self._error_text = ''
        return self._answer_with_status(SEVERITY[reaction], causes, found)

    def _name_causes(self) -> tuple[str, ...]:
        """Return the names of the causes of this tick; of a collision, the joint it loads last."""
        causes = int(self._causes_found[0])
        joint = ''
        if causes & COLLISION:
            watch = self._joints['watch']
            beyond = np.abs(watch['residual']) > RELEASE * watch['threshold']
            joint = self.config.robot.joint_names[np.flatnonzero(beyond)[-1]]
        return name_causes(causes, joint, self._error_type)

    def _explain_reaction(self, causes: tuple[str, ...]) -> None:
        """Explain causes that are new, and weigh an arm that stands."""
        arm = self.controller.arm
        bits = int(self._causes_found[0])
        if bits & START_OUTSIDE:
            outside = outside_limits(self.config, arm.q, arm.pose.position_world)
            self.findings = self.findings or outside
        is_new = causes != self._explained or not self.findings
        if is_new and not bits & WAITING:
            self._explained = causes
            self.findings = self._explain_causes(causes) or self.findings
            self._weighed = False
        ticks = self._supervision['reacting_ticks']
        if ticks % round(STANDING_TIME / self._period) == 1 and not self._weighed:
            gravity = self.explanations.explain_other_gravity(self._explained)
            self._weighed = bool(gravity)
            self._add_finding(gravity)

    def _explain_causes(self, causes: tuple[str, ...]) -> tuple[str, ...]:
        """Return what is known about causes that have just begun."""
        if self._error_text:
            return (self._error_text,)
        if self.explanations.comes_of_velocities(causes):
            self.inputs.refute_worst_velocity()
        return self.explanations.explain_causes(causes)

    def _add_finding(self, finding: str) -> None:
        """Keep what explains the reaction in force, if anything new does."""
        if finding and finding not in self.findings:
            self.findings = (*self.findings, finding)

    def _answer_with_status(
        self, reaction: str, causes: tuple[str, ...], found: int
    ) -> Answer:
        """Return torque and status; of contacts that no law controls nothing is known."""
        torque = self.gate.last.copy()
        if self._adds_gravity:
            torque -= self._joints['drive_gravity_torque']
        if self._supervision['seen']:
            self._output = ControlOutput(torque, self.controller.memory.tobytes())
        else:
            self._output = self._output._replace(torque=torque)
        if self._reacting:
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
        return float(self._task_ticks[0] * self._period)

    def adopt_design(self, design: ControllerDesign) -> None:
        """Go on with other live parameters, without a jump; see `Controller.design`."""
        self.controller.use(design)
        self._apply_config(design.config)
        self.gate.start_blend()

    def _apply_config(self, config: ControllerConfig) -> None:
        """Set what follows from the values that may change while the arm is controlled."""
        self.config = config
        self.gate.apply_config(config.transition)
        configure_reactions(self.records.supervisions['reactions'], config)
        self.task.apply_config(config)
        self._judgement['plausibility'] = checks.plausibility_limits(config)

    def request_retry(self) -> bool:
        """
        Resume control that is latched, seek contacts given up; return if there was any.

        Control resumes on estimates as well, if velocities were refuted and not proven since.
        """
        return retry(self.records)

    @property
    def velocities_on_probation(self) -> bool:
        """Whether velocities were refuted, and neither motion nor an operator says otherwise."""
        return self.guarded and doubts_velocities(self.records)

    @property
    def presses_contact(self) -> bool:
        """Whether a reaction still presses a contact that the law held."""
        return presses_contact(self._supervision['reactions'])


def unsupervised_error() -> CommandError:
    """Return the error of a tick that only a supervisor with guards can answer."""
    return CommandError(
        'control', hint='it needs the supervisor for this (supervised: true)'
    )
