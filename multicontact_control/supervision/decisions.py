"""
What answers a tick, the control law or a reaction, and how control resumes; compiled.

`records` and `terms` of all functions are those of a tick, see `TickRecords` and `ModelTerms`.
"""

from __future__ import annotations

from multicontact_control.algebra import add_scaled_vector, dot, solve_cholesky
from multicontact_control.compiled import compiled
from multicontact_control.control.motion_observer import forget_disturbance
from multicontact_control.dynamics.operational_space import choose_posture
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.flags import (
    LASTING_LIMITS,
    RESIDUAL_EXCEEDED,
)
from multicontact_control.force.force_law import (
    add_extra_acceleration,
    continue_law_after_pause,
)
from multicontact_control.supervision.causes import (
    choose_severest_reaction,
    CLOCK,
    find_arm_causes,
    find_input_causes,
    INTERNAL,
    JOINTS_VELOCITY,
    START_OUTSIDE,
    TO_FLOAT,
    TO_HOLD,
    TO_INFLATE,
    TO_SAFE,
    WAITING,
)
from multicontact_control.supervision.command_limits import START_EXCESS
from multicontact_control.supervision.contacts import GIVEN_UP
from multicontact_control.supervision.gate import (
    begin_torque,
    cancel_blend,
    pass_gate,
    start_blend,
)
from multicontact_control.supervision.input_checks import EFFORT_USABLE
from multicontact_control.supervision.reactions import (
    end_reaction,
    fill_reaction_torque,
    forget_postures,
    remember_forces,
    return_to_first_hold,
)
from multicontact_control.supervision.recovery import (
    find_waiting_cause,
    note_reaction,
    note_relapse,
    reset_hysteresis,
    reset_recovery,
    steady_reaction,
    unlatch_control,
)
from multicontact_control.supervision.task_limits import restart_task, resume_task
from multicontact_control.supervision.tick_records import TickRecords

SEEN_TIME = 0.05  # s, after which an arm that was not seen is held again


@compiled
def decide(records: TickRecords, found: int) -> None:
    """
    Decide what answers a tick whose inputs are taken in, and whose arm has been seen.

    `found` is what was found of the arm, 0 if it was never seen. A law that is to answer and has
    not answered the tick before begins, or resumes.
    """
    supervision = records.supervisions[0]
    stage = records.stages[0]
    limit = records.limits[0]
    supervision.begins = False
    supervision.resumes = False
    supervision.arm_found = found
    supervision.blind = supervision.config.guarded and stage.found.blind
    if supervision.config.guarded and supervision.in_control:
        supervision.task_ticks += stage.found.skipped
    causes = find_input_causes(stage.found) | find_arm_causes(found, limit.locked)
    if not supervision.config.guarded:
        causes = 0
    choose_reaction(records, causes)
    if supervision.reaction <= TO_INFLATE and not supervision.in_control:
        if supervision.started:
            resume_law(records)
        else:
            begin_law(records)


@compiled
def choose_reaction(records: TickRecords, causes: int) -> None:
    """Choose what answers a tick, the law or a reaction, of its causes and of the past."""
    supervision = records.supervisions[0]
    config = supervision.config
    before = supervision.reaction
    if supervision.safe:
        supervision.causes = causes
        supervision.reaction = TO_SAFE
        return
    if causes & JOINTS_VELOCITY:
        supervision.trusts_velocities = False
    elif config.guarded and doubts_velocities(records):
        # At rest nothing contradicts them: the arm is held by estimates from its positions.
        causes |= JOINTS_VELOCITY
    if config.guarded and supervision.seen and not supervision.started:
        if starts_outside(records):  # the limits would move it at once
            causes |= START_OUTSIDE
    supervision.causes = causes
    supervision.reaction = choose_severest_reaction(causes, config.collision_reaction)
    if supervision.reaction > TO_INFLATE or not supervision.paused:
        return
    supervision.good_ticks += 1
    waiting = find_waiting_cause(supervision.recovery, supervision.good_ticks)
    if waiting == 0:
        return
    supervision.causes = waiting
    supervision.reaction = TO_HOLD
    if before == TO_FLOAT and supervision.good_ticks * config.period < SEEN_TIME:
        supervision.reaction = TO_FLOAT  # joints that come and go are not held


@compiled
def doubts_velocities(records: TickRecords) -> bool:
    """Return whether velocities were refuted, and neither motion nor an operator trusts them."""
    refuted = records.stages[0].state.velocities.on_probation
    return refuted and not records.supervisions[0].trusts_velocities


@compiled
def starts_outside(records: TickRecords) -> bool:
    """Return whether the arm is farther beyond its limits than it may be at the start."""
    bounds = records.limits[0].config
    position = records.controls[0].frame.position
    for k in range(3):
        below = position[k] < bounds.lower[k] - START_EXCESS
        above = position[k] > bounds.upper[k] + START_EXCESS
        if below or above:
            return True
    for joint in records.joints:
        below = joint.q < joint.config.lower - START_EXCESS
        above = joint.q > joint.config.upper + START_EXCESS
        if below or above:
            return True
    return False


@compiled
def begin_law(records: TickRecords) -> None:
    """Let law and task begin where the arm is, which may have been moved since an attempt."""
    control = records.controls[0]
    contacts = records.contacts
    forget_disturbance(control)
    for i in range(contacts.shape[0]):
        contacts[i].normal[:] = contacts[i].config.normal
        contacts[i].surface_speed_est = 0.0
        records.laws[i] = records.fresh_laws[i]
    choose_posture(records.joints)
    restart_task(records.limits[0], control, contacts, records.states)
    records.supervisions[0].begins = True


@compiled
def resume_law(records: TickRecords) -> None:
    """Let the law go on after a reaction, with the contacts that stayed pressed."""
    contacts, states = records.contacts, records.states
    forget_disturbance(records.controls[0])
    resume_task(records.limits[0], contacts, states)
    for i in range(contacts.shape[0]):
        continue_law_after_pause(
            records.laws[i], states[i].kept, contacts[i].alpha_meas
        )
    records.supervisions[0].resumes = True


@compiled
def hand_over_to_law(records: TickRecords, terms: ModelTerms, found: int) -> None:
    """Let the law act from now on; `found` says what of its answer has been limited."""
    supervision = records.supervisions[0]
    records.judgements[0].resumes = False
    if supervision.paused:
        end_reaction(supervision.reactions)
        if supervision.started:
            supervision.recovery.resumed_at = supervision.task_ticks
    supervision.started = True
    supervision.in_control = True
    supervision.paused = False
    supervision.reacting_ticks = 0
    supervision.task_ticks += 1
    remember_forces(supervision.reactions, records.contacts)
    # A blend passes in a moment, and a limited rate is caught up with: they are left out.
    if supervision.config.guarded and found & LASTING_LIMITS:
        account_for_torque(records, terms)


@compiled
def account_for_torque(records: TickRecords, terms: ModelTerms) -> None:
    """
    Tell the force laws that another torque is commanded than the one answered.

    It accelerates the contact points by N^T J M^-1 Delta Gamma more, and so does what is fed
    forward beyond the estimate, which a force that cannot be reached never makes good. So much
    is added to the input that they predict with. L of M = L L^T is that of the law's answer.
    """
    joints, contacts = records.joints, records.contacts
    space = records.workspaces[0]
    n = joints.shape[0]
    torque = space.torque[:n]
    space.wrench[:] = 0.0
    for i in range(contacts.shape[0]):
        answer = contacts[i].answer
        if answer.active:
            beyond = answer.alpha_fed_forward - answer.alpha_est
            add_scaled_vector(space.wrench, beyond, contacts[i].N)
    for j in range(n):
        torque[j] = joints[j].gate.commanded_torque - joints[j].answer.unlimited
        torque[j] += dot(terms.jacobian[:, j], space.wrench)
    solve_cholesky(space.law.inertia.L[:n, :n], torque)
    for k in range(6):
        space.acceleration[k] = dot(terms.jacobian[k], torque)
    for i in range(contacts.shape[0]):
        if contacts[i].answer.active:
            extra = dot(contacts[i].N, space.acceleration)
            add_extra_acceleration(records.laws[i], extra)


@compiled
def refuse_answer(records: TickRecords, cause: int) -> None:
    """Let a reaction answer the tick because of what the law says, or because it says nothing."""
    supervision = records.supervisions[0]
    if supervision.paused:
        note_relapse(supervision.recovery, cause)
    supervision.causes = cause
    supervision.reaction = choose_severest_reaction(
        cause, supervision.config.collision_reaction
    )


@compiled
def lose_sight(records: TickRecords) -> None:
    """Let the arm float by what is known of its past, after an error whose effect is not known."""
    supervision = records.supervisions[0]
    records.controls[0].measured = False
    supervision.blind = True
    supervision.causes = INTERNAL
    supervision.reaction = TO_FLOAT


@compiled
def react(records: TickRecords, terms: ModelTerms) -> int:
    """Answer a tick without the control law; return the `LIMITS` that were enforced."""
    supervision = records.supervisions[0]
    gate = records.gates[0]
    joints = records.joints
    n = joints.shape[0]
    sees_arm = supervision.seen and not supervision.blind
    if supervision.seen and not sees_arm:
        supervision.reaction = TO_FLOAT  # it is neither held nor slowed down unseen
    if supervision.reaction != TO_SAFE:
        supervision.reaction = steady_reaction(
            supervision.hysteresis, supervision.reaction
        )
    note_causes(records)
    supervision.paused = True
    supervision.in_control = False
    begin_acting(records, terms)
    if supervision.reaction != TO_SAFE:
        cancel_blend(gate)
    presses_on = records.controls[0].measured
    if supervision.arm_found & RESIDUAL_EXCEEDED:
        presses_on = False  # what blocks the arm may be what it is pressed against
    held = supervision.reactions.joints
    for j in range(n):
        held[j].torque = 0.0
        held[j].rate = joints[j].velocity
        if supervision.config.guarded:
            held[j].rate = records.stages[0].state.tracks[j].v_tracked
    if supervision.seen:
        fill_reaction_torque(
            supervision.reactions,
            supervision.reaction,
            joints,
            records.controls[0],
            records.contacts,
            terms,
            presses_on,
            not supervision.causes & CLOCK,
        )
    for j in range(n):
        joints[j].answer.torque = held[j].torque
    gate.seen = sees_arm
    return pass_gate(
        gate,
        joints,
        records.controls[0],
        records.contacts,
        terms,
        records.workspaces[0].law.inertia,
        -supervision.reaction,
    )


@compiled
def note_causes(records: TickRecords) -> None:
    """Count relapses, and remember what was pressed and where, as a reaction begins."""
    supervision = records.supervisions[0]
    causes = supervision.causes
    if not causes & WAITING:
        supervision.good_ticks = 0
    supervision.reacting_ticks += 1
    if supervision.paused:
        return
    supervision.reacting_ticks = 0
    if supervision.started:
        reactions = supervision.reactions
        if note_reaction(supervision.recovery, causes, supervision.task_ticks):
            forget_postures(reactions)
        return_to_first_hold(reactions, records.controls[0].task)
        reactions.presses = True


@compiled
def begin_acting(records: TickRecords, terms: ModelTerms) -> None:
    """Let the torque start from the one that acts before any command, measured or of gravity."""
    gate, joints = records.gates[0], records.joints
    if gate.begun:
        return
    effort = records.stages[0].sample.effort
    torque = records.workspaces[0].torque[: joints.shape[0]]
    for j in range(joints.shape[0]):
        joint = joints[j]
        torque[j] = 0.0
        if records.supervisions[0].seen:
            torque[j] = terms.gravity[j]
        if joint.watch.effort_fault == EFFORT_USABLE and effort[j] != 0.0:
            torque[j] = effort[j] + joint.drive_gravity_torque
    begin_torque(gate, joints, torque)


@compiled
def restart_control(records: TickRecords) -> None:
    """Let the law begin with the task anew; relapses and holds are forgotten."""
    supervision = records.supervisions[0]
    control = records.controls[0]
    control.measured = False
    forget_disturbance(control)
    restart_task(records.limits[0], control, records.contacts, records.states)
    records.judgements[0].contradictions = 0
    supervision.task_ticks = 0
    supervision.good_ticks = 0
    supervision.reacting_ticks = 0
    supervision.started = False
    supervision.paused = False
    supervision.in_control = False
    supervision.trusts_velocities = False
    reset_recovery(supervision.recovery)
    reset_hysteresis(supervision.hysteresis)
    forget_postures(supervision.reactions)


@compiled
def stop_control(records: TickRecords) -> None:
    """Answer by the declared safe behaviour from the next tick on."""
    supervision = records.supervisions[0]
    if not supervision.safe:
        restart_control(records)
        supervision.safe = True
        start_blend(records.gates[0])


@compiled
def retry(records: TickRecords) -> bool:
    """
    Resume control that is latched, seek contacts given up; return if there was any.

    Control resumes on estimates as well, if velocities were refuted and not proven since.
    """
    supervision = records.supervisions[0]
    waited = supervision.recovery.latched or doubts_velocities(records)
    for state in records.states:
        if state.state == GIVEN_UP:
            state.retry_requested = True
            waited = True
    unlatch_control(supervision.recovery)
    supervision.reactions.has_reference = False  # the present hold goes on
    supervision.trusts_velocities = records.stages[0].state.velocities.on_probation
    return waited
