"""The control loop of one sample, from the arm's model to the commanded torque, compiled."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from multicontact_control.arrays import Matrix
from multicontact_control.compiled import compiled
from multicontact_control.control.arm import ArmSpace, update_arm_state
from multicontact_control.control.law import control_law, LawSpace
from multicontact_control.control.motion_observer import observe_motion
from multicontact_control.dynamics.terms import ModelTerms, TermTuple
from multicontact_control.flags import (
    ALARMS,
    ANSWER_REFUSED,
    BOUNDING_LIMITS,
    COLUMNS_DEPENDENT,
    POSTURE_SINGULAR,
    REFERENCE_LIMITED,
)
from multicontact_control.force.force_law import ForceLaw
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    Record,
    record_dtype,
    Records,
)
from multicontact_control.supervision.checks import judge_answer, Judgement
from multicontact_control.supervision.contact_task import limit_task, TaskLimits
from multicontact_control.supervision.contacts import ContactState
from multicontact_control.supervision.gate import GateState, number_of_law, pass_gate

# Stages of a tick.
SEE = 1
ACT = 2


class Workspace(Record, Protocol):
    """What a tick works in, so that it allocates nothing: one record for each of its parts."""

    arm: ArmSpace
    law: LawSpace


WORKSPACE = record_dtype(Workspace)


class TickRecords(NamedTuple):
    """
    The records that a tick works on, which are made once and changed by every tick.

    Those of what is set (`config`) change between ticks alone: at the start, by live parameters
    and by what a reaction decides.
    """

    joints: Records[Joint]  # shape (n,); `gate.commanded_torque` is what is commanded
    controls: Records[Control]  # one
    contacts: Records[Contact]  # shape (r,), as of laws and states
    laws: Records[ForceLaw]
    states: Records[ContactState]

    # One of each.
    limits: Records[TaskLimits]
    judgements: Records[Judgement]
    gates: Records[GateState]
    workspaces: Records[Workspace]


RecordTuple = tuple[
    Records[Joint],
    Records[Control],
    Records[Contact],
    Records[ForceLaw],
    Records[ContactState],
    Records[TaskLimits],
    Records[Judgement],
    Records[GateState],
    Records[Workspace],
]


@compiled
def tick(
    stages: int,
    record_tuple: RecordTuple,
    motion: Matrix,
    term_tuple: TermTuple,
) -> int:
    """
    See the arm, then act: limit the task, ask the law, judge its answer, let the torque through.

    An alarm of the first stage ends it before the second; an answer that is missing or refused
    ends that before the gate, so that no torque is commanded.

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
        What was found; see `flags`.

    """
    records = TickRecords(*record_tuple)
    terms = ModelTerms(*term_tuple)
    joints = records.joints
    contacts = records.contacts
    control = records.controls[0]
    space = records.workspaces[0]
    found = 0
    if stages & SEE:
        found = update_arm_state(motion, terms, joints, control, contacts, space.arm)
        if found & ALARMS:
            return found
    if not stages & ACT:
        return found
    limit = records.limits[0]
    gate = records.gates[0]
    if limit_task(limit, control, contacts, records.states):
        found |= REFERENCE_LIMITED
    observe_motion(control, joints, contacts, space.law.inertia, space.law.motion)
    found |= control_law(control, joints, terms, contacts, records.laws, space.law)
    if found & (POSTURE_SINGULAR | COLUMNS_DEPENDENT):
        return found
    strict = limit.config.guarded and not limit.locked
    found |= judge_answer(
        records.judgements[0], control, joints, contacts, records.states, strict
    )
    if found & ANSWER_REFUSED:
        return found
    gate.seen = True
    law = number_of_law(contacts, gate.config.guarded)
    found |= pass_gate(gate, joints, control, contacts, terms, law)
    if found & BOUNDING_LIMITS:
        limit.bounded_at = limit.time
    return found
