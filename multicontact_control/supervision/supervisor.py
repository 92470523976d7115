"""The control law with everything around it that keeps the arm safe, in one step."""

from __future__ import annotations

import logging

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control.arm import AMBIGUOUS, ArmState, PASSED, RELEASE, TOUCHED
from multicontact_control.control.controller import Controller, ControlOutput, Design
from multicontact_control.control.tasks import TaskSource
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError, MulticontactError, SingularTaskError
from multicontact_control.force.force_law import continue_laws_at
from multicontact_control.supervision import checks, reactions
from multicontact_control.supervision.command_limits import outside_limits
from multicontact_control.supervision.contact_task import ContactTask
from multicontact_control.supervision.contacts import GIVEN_UP
from multicontact_control.supervision.gate import BOUNDING_LIMITS, LASTING_LIMITS, TorqueGate
from multicontact_control.supervision.inputs import Inputs, Seen, TickInputs
from multicontact_control.supervision.reactions import FLOAT, HOLD, NONE, SAFE
from multicontact_control.supervision.report import no_answer, SupervisorStatus
from multicontact_control.supervision.velocities import explain_velocities
import numpy as np

LOGGER = logging.getLogger(__name__)
CONTRADICTIONS = 2  # samples in a row that contradict the contacts, for the wrench to be refused
STRAY_TORQUE = 0.5  # N m at the operational point that is worth a report
STANDING_TIME = 0.2  # s between two looks at what an arm that stands in a reaction weighs
STANDING_SPEED = 0.01  # rad/s, of every joint, below which it stands
SEEN_TIME = 0.05  # s, after which an arm that was not seen is held again
DOUBTED = ('Held by estimates from the positions until ten readings of such joints in motion '
           'agree, or an operator resumes control (~/retry)')
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
        self, config: ControllerConfig, robot: RobotModel, source: TaskSource, *,
        guarded: bool = True,
    ) -> None:
        self.guarded = guarded
        self._robot, self._period = robot, config.period
        self.controller = controller = Controller(config, robot)
        self._joints, self._controls = controller.arm.joints, controller.controls
        self.task = ContactTask(config, source, controller, guarded=guarded)
        self.inputs = Inputs(config, controller, guarded=guarded)
        self.gate = TorqueGate(config, controller.arm, guarded=guarded)
        self.reactions = reactions.Reactions(config, controller)
        self._recovery = reactions.Recovery(config.watchdog.recovery_time, config.period)
        self._steadiness = reactions.Steadiness(config.period)
        self._adopt(config)
        checks.check_plausibility(*self._answered)  # compiled here: no sample waits for it
        operational_wrench(self._controls[0], np.zeros(6))
        self.reset()

    def reset(self) -> None:
        """Forget everything measured and commanded; the next tick starts anew."""
        if self.guarded:
            checks.watch_arm(self.config, self.controller)
        self._restart_law()
        self.inputs.reset()
        self.gate.reset()
        self.safe = False
        self.findings: tuple[str, ...] = ()
        self._causes: tuple[str, ...] = ()  # that these explain
        self._failure = '', ''  # cause and text of an exception that is being answered
        self._told: set[str] = set()  # causes of which an exception has been logged
        self._arm: ArmState | None = None  # once it was seen
        self._seen, self._wrench_known = Seen(), False
        self._reaction = NONE
        self._output = no_answer(self._robot.joint_count, len(self.config.columns))

    def _restart_law(self) -> None:
        self.controller.reset()
        self.task.reset()
        self._task_ticks = self._good_ticks = self._contradictions = self._reacting = 0
        self.started = self._paused = self._weighed = False
        self._recovery.reset()
        self._steadiness.reset()
        self._trusted = False
        self.reactions.forget()

    def stop(self) -> None:
        """Answer by the declared safe behaviour from the next tick on, until a `reset`."""
        if not self.safe:
            self._restart_law()
            self.safe = True
            self.gate.go_over()

    def step(self, inputs: TickInputs) -> Answer:
        """
        Answer the newest readings, whatever they are, by a torque that may be commanded.

        Without guards there is no status, and MulticontactError says what is missing or singular.
        """
        part = 'internal'  # at work, for an error in it
        try:
            seen = self.inputs.validate(inputs, self.gate.last if self.gate.begun else None)
            reaction, causes = self._decide(self._see(inputs, seen))
            if reaction not in CONTROLLED:
                return self._react(reaction, causes)
            part, resumes = 'law', self._paused or not self.started
            if resumes:
                self._resume()
            self.task.ask(self._task_ticks * self._period)
            limited = self.controller.answer()
            part = 'internal'
            if refused := self._check():
                return self._refuse(refused)
            if resumes:
                self._take_over()
            torque, limits = self.gate.apply(
                self.controller.active.tobytes() if self.guarded else None,
                self.controller.torque.copy(), limited=limited, by_task=True)
            # A blend passes in a moment, and a limited rate is caught up with: they are left out.
            if self.guarded and not LASTING_LIMITS.isdisjoint(limits):
                self.controller.account_for(torque)
            if not BOUNDING_LIMITS.isdisjoint(limits):
                self.task.bounded_at = self._task_ticks * self._period
            self._task_ticks += 1
            return self._report(
                torque, reaction, causes, ('reference', *limits) if self.task.limited else limits)
        except Exception as error:
            if not self.guarded:
                raise
            return self._survive(part, error)

    def _see(self, inputs: TickInputs, seen: Seen) -> tuple[str, ...]:
        """Compute where the arm is and what its contacts bear; return what is wrong."""
        if not self.guarded:
            if inputs.joints is None or inputs.wrench is None:
                raise not_supervised()
            self._task_ticks = round(inputs.time / self._period)
        elif self.started and not self._paused:
            self._task_ticks += seen.skipped
        self._seen, arm = seen, self.controller.arm
        alarms: tuple[str, ...] = ()
        if self.controller.tool is not self.controller.next_tool:
            self.controller.change_tool()
        if seen.joints and arm.refresh():
            self._arm = arm
            alarms = checks.TOO_FAST[arm.flags] + self._touch(arm.flags)
            if arm.flags & PASSED:
                self._look_back()
            if self.config.robot.adds_gravity:
                self.gate.allow_for(self.controller.own_weight())
        self._wrench_known = seen.measured and not arm.flags & AMBIGUOUS  # then it is older
        self._controls['measured'] = self._wrench_known
        return seen.causes + alarms

    def _touch(self, flags: int) -> tuple[str, ...]:
        """Name the last joint whose residual counts, if any does."""
        if not flags & TOUCHED or self.task.locked:
            return ()
        joints = self._joints
        last = np.flatnonzero(np.abs(joints['residual']) > RELEASE * joints['threshold'])[-1]
        return (f'{checks.COLLISION}_{self.config.robot.joint_names[last]}',)

    def _look_back(self) -> None:
        """Tell what is known of a collision once it has passed."""
        lag = checks.explain_lag(self._joints)
        if lag and lag not in self.findings:
            self.findings = (*self.findings, lag)

    def _decide(self, causes: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """Return what answers the tick, the law or a reaction, and why."""
        arm = self._arm
        if self.safe:
            return SAFE, causes
        if checks.CONTRADICTED in causes:
            self._trusted = False
        elif self._seen.refuted and not self._trusted:
            # At rest nothing contradicts them: the arm is held by estimates from its positions.
            causes = (checks.CONTRADICTED, *causes)
        if self.started and not self._paused:
            return checks.reaction_to(causes, self.config) if causes else NONE, causes
        if self.guarded and not self.started and arm is not None:
            outside = outside_limits(self.config, arm.q, arm.pose.position_world)
            if outside:  # the limits would move it at once
                causes, self.findings = (*causes, 'start_outside'), self.findings or outside
        reaction = checks.reaction_to(causes, self.config)
        if reaction in CONTROLLED and self._paused:
            self._good_ticks += 1
            if missing := self._recovery.missing(self._good_ticks):
                # Joints that come and go are not held.
                floats = self._reaction == FLOAT and self._good_ticks * self._period < SEEN_TIME
                return FLOAT if floats else HOLD, missing
        return reaction, causes

    @property
    def velocities_in_doubt(self) -> bool:
        """Whether velocities were refuted, and neither motion nor an operator says otherwise."""
        return self.guarded and self.inputs.refuted and not self._trusted

    def _resume(self) -> None:
        """Start the control law, or go on with it after a reaction."""
        controller = self.controller
        if self.started:
            held = self.task.resume()
            continue_laws_at(controller.laws, held, controller.contacts['alpha_meas'])
        else:
            controller.reset()  # the arm may have been moved since an attempt before
            self.task.start(controller.start())

    def _check(self) -> str:
        """Return the cause to refuse the answer of the law, nothing if it may be commanded."""
        doubts = checks.check_plausibility(*self._answered)
        if doubts & checks.NOT_FINITE:
            return 'law_not_finite'
        wrong = [cause for bit, cause in checks.WRONG_WRENCH.items() if doubts & bit] if (
            doubts and self.guarded and not self.task.locked) else []
        self._contradictions = self._contradictions + 1 if wrong else 0
        if wrong and (self._contradictions >= CONTRADICTIONS or self._paused):
            return wrong[0]
        if doubts & checks.OUTSIDE:  # the contacts that are pressed have led there
            self.task.states['left'] |= self.controller.active
        return ''

    def _take_over(self) -> None:
        """Let the law act from now on."""
        self._begin()
        if self._paused:
            self.reactions.end()
            self._causes = self.findings = ()
            if self.started:
                self._recovery.resumed_at = self._task_ticks
        self.started, self._paused = True, False

    def _begin(self) -> None:
        """Let the torque start from the one that acts before any command."""
        if self.gate.begun:
            return
        acting = np.zeros(self._robot.joint_count)
        if self._arm is not None:
            acting = self._robot.update(self._arm.q, acting).gravity
        measured = self.inputs.effort + self._joints['added']
        self.gate.begin(np.where(np.isnan(measured), acting, measured))

    def _refuse(self, cause: str) -> Answer:
        """Answer without the control law because of what it says, or raise without guards."""
        if not self.guarded:
            raise SingularTaskError('the torque: expected finite numbers, got NaN or infinity')
        if self._paused:
            self._recovery.relapsed((cause,))
        return self._react(checks.reaction_to((cause,), self.config), (cause,))

    def _react(self, reaction: str, causes: tuple[str, ...]) -> Answer:
        """Answer without the control law."""
        arm, blind = self._arm, self._seen.blind
        if blind and arm is not None:
            reaction = FLOAT  # what is not seen can be neither held nor slowed down
        if reaction != SAFE:
            reaction = self._steadiness.of(reaction)
        if causes not in reactions.WAITING:
            self._good_ticks = 0
            if causes != self._causes or not self.findings:
                self._causes = causes
                self.findings = tuple(filter(None, map(self._explain, causes))) or self.findings
                self._weighed = False
        if self.started and not self._paused:
            if self._recovery.stopped(causes, self._task_ticks):
                self.reactions.forget()
            self.reactions.go_back()
            self.reactions.begin(self._output)
        self._reacting = self._reacting + 1 if self._paused else 0
        if self._reacting % round(STANDING_TIME / self._period) == 1 and not self._weighed:
            gravity = self._gravity()
            self._weighed = bool(gravity)
            self.findings = (*self.findings, *filter(None, [gravity]))
        self._paused = True
        self._begin()
        if reaction != SAFE:
            self.gate.hurry()
        with np.errstate(all='ignore'):  # the gate finds numbers that are not finite
            # What blocks the arm may be what the contacts' forces press it against: they fade.
            felt = self._wrench_known and not self.controller.arm.flags & TOUCHED
            # Bare, velocities and angles are used as they come.
            rate = self.inputs.rate if self.guarded else self.controller.arm.velocity
            timed = not any(cause.startswith('clock') for cause in causes)
            torque = self.reactions.torque(reaction, arm, felt, rate, timed=timed).copy()
            torque, limits = self.gate.apply(
                reaction, torque, seen=arm is not None and not blind)
        return self._report(
            torque, NONE if reaction == SAFE else reaction, causes, limits, controlled=False)

    def _explain(self, cause: str) -> str:
        """Return what is known about a cause that has just begun; empty if nothing."""
        failed, text = self._failure
        if cause == failed:
            return text
        if cause in checks.WRONG_WRENCH.values():
            return self._exchanged_axes() or self.stray_force
        touched, names = cause.startswith(checks.COLLISION), self.config.robot.joint_names
        if not touched and cause != checks.CONTRADICTED:
            return ''
        text = explain_velocities(*self.inputs.history, names, self._period)
        if text:
            if touched:  # by what the law made of such a velocity
                self.inputs.refute()
            return f'{text}. {DOUBTED}'
        if touched:
            residual = self._exchanged_axes() or checks.explain_collision(
                self._joints, self._controls['momentum'][0], names)
            text = '; '.join(filter(None, (residual, self.stray_force)))
        return text

    def _exchanged_axes(self) -> str:
        """Return what says that the axes of the wrench sensor are others; empty if nothing."""
        if not self._wrench_known or self.config.wrench_input == 'momentum':
            return ''
        control = self._controls[0]
        return checks.explain_axes(
            self._joints, control['momentum'], self._robot.terms.jacobian,
            control['frame']['sensor_rotation'], control['tool']['weight'])

    def _gravity(self) -> str:
        """Return what says that gravity is another, where a collision has led to a pause."""
        collides = any(cause.startswith(checks.COLLISION) for cause in self._causes)
        known = self._wrench_known and self.config.wrench_input != 'momentum'
        stands = np.abs(self.controller.arm.velocity).max() < STANDING_SPEED
        if not (collides and known and stands) or self.task.sought_normals().size:
            return ''
        wrench, tool = np.zeros(6), self.controller.tool
        operational_wrench(self._controls[0], wrench)
        shares = self._robot.gravity_shares(self.controller.arm.q.copy(), tool)
        return checks.explain_gravity(
            self._joints, shares, wrench[:3], tool.mass, np.array(self.config.robot.gravity_world))

    @property
    def stray_force(self) -> str:
        """Return what is felt while no contact is sought or held; empty if it is small."""
        wrench = np.zeros(6)
        known = self._wrench_known and self.guarded and self.config.wrench_input != 'momentum'
        if known and not self.task.sought_normals().size:
            operational_wrench(self._controls[0], wrench)
        force, torque = np.linalg.norm(wrench.reshape(2, 3), axis=1).tolist()
        stray = force > self.config.contact_state.smallest_force or torque > STRAY_TORQUE
        return (f'{force:.1f} N and {torque:.2g} N m while no contact is commanded: if nothing '
                'touches the tool, bias or tool weight (tare or calibrate)') if stray else ''

    def _unwatched(self) -> str:
        """Return whose measured torques are of no use, and what that leads to."""
        config, faults = self.config, self.inputs.unheard_joints
        if not config.robot.measures_torque:
            return ''
        names, count = config.robot.joint_names, sum(map(len, faults.values()))
        texts = [f'of {", ".join(names[j] for j in joints) if len(joints) < len(names) else "all"}'
                 f' {fault}' for fault, joints in faults.items()]
        if config.wrench_input == 'momentum':
            effect = 'there is no wrench of the contacts without them'
        elif config.collision.command_delay >= 0:
            effect = 'the commands stand in for them'
        elif count == len(names):
            effect = 'collisions are not watched'
        else:
            effect = 'what touches the arm is not seen in these joints, but in the others'
        return f'effort in joint_states: {", ".join(texts)}; {effect}'

    def _survive(self, part: str, error: Exception) -> Answer:
        """Answer after an exception, in the law or in what is around it, and tell what it says."""
        cause = f'{part}_{type(error).__name__}'
        if part == 'law' and not self.controller.arm.finite:
            cause = 'law_not_finite'
        self._failure = cause, self._tell(cause, error)
        try:
            if part == 'law':
                return self._refuse(cause)
            # What failed is not known: what is known of the arm is its past.
            self._wrench_known, self._seen = False, Seen(blind=True)
            return self._react(FLOAT, (cause,))
        except Exception as second:  # the torque that acts goes on
            again = self._tell(f'reaction_{type(second).__name__}', second)
            self.findings = self._failure[1], again
            self._causes = (cause,)
            self._paused, self._good_ticks = True, 0
            return self._report(self.gate.last.copy(), FLOAT, (cause,), (), controlled=False)
        finally:
            self._failure = '', ''

    def _tell(self, cause: str, error: Exception) -> str:
        """Return what an exception says; the first of each cause is logged with its traceback."""
        text = ' '.join(f'{type(error).__name__}: {error}'.split())
        if cause not in self._told:
            self._told.add(cause)
            # What is one of ours says all that there is to say.
            trace = None if isinstance(error, MulticontactError) else error
            LOGGER.error('%s: %s', cause, text, exc_info=trace)
        return text

    def _report(
        self, torque: Vector, reaction: str, causes: tuple[str, ...], limits: tuple[str, ...], *,
        controlled: bool = True,
    ) -> Answer:
        """Return the answer of the tick; of contacts that no law controls nothing is known."""
        self._reaction = reaction
        if self.config.robot.adds_gravity:
            torque = torque - self._joints['added']
        output = self._output if self._arm is None else self.controller.output(torque)
        if not controlled:
            contacts = output.contacts.copy()
            contacts['answer'] = 0
            output = output._replace(torque=torque, contacts=contacts)
        self._output = output
        return output, SupervisorStatus(
            reaction, causes, self._seen.rejected, limits, self.task.state_names,
            self._task_ticks * self._period, self._unwatched() if self._seen.unheard else '',
            self.task.read_before if self.task.reads_before else ()) if self.guarded else None

    def use(self, design: Design) -> None:
        """Go on with other live parameters, without a jump; see `Controller.design`."""
        self.controller.use(design)
        self._adopt(design.config)
        self.gate.go_over()

    def _adopt(self, config: ControllerConfig) -> None:
        """Set what follows from the values that may change while the arm is controlled."""
        self.config = config
        self.gate.pace = config.transition
        self.reactions.retune(config)
        self.task.retune(config)
        self._answered = (  # what an answer is checked by
            checks.plausibility_limits(config), self._controls, self._joints,
            self.controller.contacts, self.task.states)

    def try_again(self) -> bool:
        """
        Resume control that is latched, seek contacts given up; return if there was any.

        Control resumes on estimates as well, if velocities were refuted and not proven since.
        """
        given_up = self.task.states['state'] == GIVEN_UP
        waited = self._recovery.latched or self.velocities_in_doubt
        self.task.states['again'] |= given_up
        self._recovery.allow()
        self.reactions.stay()
        self._trusted = self.inputs.refuted
        return bool(given_up.any()) or waited


def not_supervised() -> CommandError:
    """Return the error of a tick that only a supervisor with guards can answer."""
    return CommandError('control', hint='it needs the supervisor for this (supervised: true)')
