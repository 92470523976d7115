"""
The control loop of one sample, from inputs and the arm's model to the commanded torque, compiled.

Whatever embeds the controller calls `tick` alone: `Supervisor` in Python, the C library in a
robot's own loop.
"""

from __future__ import annotations

from multicontact_control.arrays import Matrix
from multicontact_control.compiled import compiled
from multicontact_control.control.arm import update_arm_state
from multicontact_control.control.law import control_law
from multicontact_control.control.motion_observer import observe_motion
from multicontact_control.dynamics.terms import ModelTerms, TermTuple
from multicontact_control.flags import (
    ANSWER_REFUSED,
    BOUNDING_LIMITS,
    COLUMNS_DEPENDENT,
    FORCES_AMBIGUOUS,
    MODEL_NOT_FINITE,
    NO_ANSWER,
    POSTURE_SINGULAR,
    REFERENCE_LIMITED,
)
from multicontact_control.supervision.causes import (
    find_refusal_cause,
    INTERNAL,
    TO_INFLATE,
)
from multicontact_control.supervision.checks import judge_answer
from multicontact_control.supervision.decisions import (
    begin_acting,
    decide,
    hand_over_to_law,
    lose_sight,
    react,
    refuse_answer,
)
from multicontact_control.supervision.gate import number_of_law, pass_gate
from multicontact_control.supervision.input_checks import FINE
from multicontact_control.supervision.task_limits import limit_task
from multicontact_control.supervision.tick_records import RecordTuple, TickRecords

# Stages of a tick.
SEE = 1
ACT = 2


@compiled
def tick(
    stages: int,
    record_tuple: RecordTuple,
    motion: Matrix,
    term_tuple: TermTuple,
) -> int:
    """
    See the arm and decide what answers, then act: by the control law, or by a reaction.

    The inputs have been taken in by `check_inputs`, and the model is computed where they say that
    the arm is. Where `Supervision.begins` or `resumes` says so, a task may be started between the
    stages; otherwise both may be one call, with what is wanted in `control.wanted`.

    Parameters
    ----------
    stages
        SEE, ACT or both.
    record_tuple, term_tuple
        The fields of `TickRecords` and of `ModelTerms`, in their order, as plain tuples: numba
        takes those from Python in half the time that named ones need.
    motion
        Joint positions [rad] and velocities [rad/s], shape (2, n), at which the terms are.

    Returns
    -------
    int
        What was found; see `flags`. Without guards there may be no torque: NO_ANSWER.

    """
    records = TickRecords(*record_tuple)
    terms = ModelTerms(*term_tuple)
    supervision = records.supervisions[0]
    if stages & SEE:
        decide(records, see_arm(records, motion, terms))
    found = supervision.arm_found
    if not stages & ACT:
        return found
    if supervision.reaction <= TO_INFLATE:
        found |= answer_by_law(records, terms)
        if not found & (NO_ANSWER | ANSWER_REFUSED):
            hand_over_to_law(records, terms, found)
            return found
        if not supervision.config.guarded:
            return found
        refuse_answer(records, find_refusal_cause(found))
    return found | react(records, terms)


@compiled
def see_arm(records: TickRecords, motion: Matrix, terms: ModelTerms) -> int:
    """Take in where the arm is and what touches it, if it is known; return what was found."""
    supervision = records.supervisions[0]
    stage = records.stages[0]
    control = records.controls[0]
    guarded = supervision.config.guarded
    control.measured = not guarded or stage.found.wrench.problem == FINE
    if guarded and not stage.state.known:
        return 0
    found = update_arm_state(
        motion,
        terms,
        records.joints,
        control,
        records.contacts,
        records.workspaces[0].arm,
    )
    if not found & MODEL_NOT_FINITE:
        supervision.seen = True
    if found & FORCES_AMBIGUOUS:
        control.measured = False  # it is older
    return found


@compiled
def answer_by_law(records: TickRecords, terms: ModelTerms) -> int:
    """
    Limit the task, ask the law, judge its answer, let the torque through.

    Returns what was found. An answer that is missing or refused ends this before the gate, so that
    no torque is commanded.
    """
    supervision = records.supervisions[0]
    joints = records.joints
    contacts = records.contacts
    control = records.controls[0]
    limit = records.limits[0]
    gate = records.gates[0]
    space = records.workspaces[0].law
    begin_acting(records, terms)
    unknown = supervision.arm_found & (MODEL_NOT_FINITE | FORCES_AMBIGUOUS)
    if unknown:
        return NO_ANSWER
    found = 0
    limit.time = supervision.task_ticks * supervision.config.period
    if limit_task(limit, control, contacts, records.states):
        found |= REFERENCE_LIMITED
    observe_motion(control, joints, contacts, space.inertia, space.motion)
    found |= control_law(control, joints, terms, contacts, records.laws, space)
    if found & (POSTURE_SINGULAR | COLUMNS_DEPENDENT):
        return found | NO_ANSWER
    strict = limit.config.guarded and not limit.locked
    judgement = records.judgements[0]
    judgement.resumes = supervision.paused
    found |= judge_answer(judgement, control, joints, contacts, records.states, strict)
    if found & ANSWER_REFUSED:
        return found
    gate.seen = True
    law = number_of_law(contacts, gate.config.guarded)
    found |= pass_gate(gate, joints, control, contacts, terms, space.inertia, law)
    if found & BOUNDING_LIMITS:
        limit.bounded_at = limit.time
    return found


@compiled
def answer_error(cause: int, record_tuple: RecordTuple, term_tuple: TermTuple) -> int:
    """
    Answer a tick in which what surrounds the compiled code has failed, by a reaction.

    `cause` is LAW or LAW_NOT_FINITE where a task was to be had, INTERNAL for all else; for the
    others and what is returned see `tick`.
    """
    records = TickRecords(*record_tuple)
    if cause == INTERNAL:
        lose_sight(records)
    else:
        refuse_answer(records, cause)
    return react(records, ModelTerms(*term_tuple))
