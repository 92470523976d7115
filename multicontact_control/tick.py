"""The control loop of one sample, from the arm's model to the commanded torque, compiled."""

from __future__ import annotations

from typing import Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.control.arm import ArmSpace, update_arm_state
from multicontact_control.control.law import control_law, LawSpace
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


@compiled
def tick(
    stages: int,
    joints: Records[Joint],
    controls: Records[Control],
    contacts: Records[Contact],
    laws: Records[ForceLaw],
    states: Records[ContactState],
    limits: Records[TaskLimits],
    judgements: Records[Judgement],
    gates: Records[GateState],
    workspaces: Records[Workspace],
    q: Vector,
    velocity: Vector,
    mass_matrix: Matrix,
    bias_torque: Vector,
    jacobian: Matrix,
    jacobian_rate: Matrix,
    position: Vector,
    rotation: Matrix,
    sensor_position: Vector,
    sensor_rotation: Matrix,
) -> int:
    """
    See the arm, then act: limit the task, ask the law, judge its answer, let the torque through.

    An alarm of the first stage ends it before the second; an answer that is missing or refused
    ends that before the gate, so that no torque is commanded.

    Parameters
    ----------
    stages
        SEE, ACT or both.
    joints, controls, contacts, laws, states
        Records of `JOINT`, shape (n,), whose `gate.commanded_torque` is what is commanded, one
        of `CONTROL`, and records of `CONTACT`, `FORCE_LAW` and `CONTACT_STATE`, shape (r,).
    limits, judgements, gates, workspaces
        One record of `TASK_LIMITS`, of `JUDGEMENT`, of `GATE_STATE` and of `WORKSPACE`.
    q, velocity
        Joint positions [rad] and velocities [rad/s], shape (n,).
    mass_matrix, bias_torque, jacobian, jacobian_rate
        M (upper triangle), C v + g, J and dJ/dt there.
    position, rotation, sensor_position, sensor_rotation
        Of the operational frame and the sensor's, world axes.

    Returns
    -------
    int
        What was found; see `flags`.

    """
    control, space = controls[0], workspaces[0]
    found = 0
    if stages & SEE:
        found = update_arm_state(
            q,
            velocity,
            mass_matrix,
            bias_torque,
            jacobian,
            position,
            rotation,
            sensor_position,
            sensor_rotation,
            joints,
            control,
            contacts,
            space.arm,
        )
        if found & ALARMS:
            return found
    if not stages & ACT:
        return found
    limit, gate = limits[0], gates[0]
    if limit_task(limit, control, contacts, states):
        found |= REFERENCE_LIMITED
    found |= control_law(
        control, joints, mass_matrix, jacobian, jacobian_rate, contacts, laws, space.law
    )
    if found & (POSTURE_SINGULAR | COLUMNS_DEPENDENT):
        return found
    strict = limit.config.guarded and not limit.locked
    found |= judge_answer(judgements[0], control, joints, contacts, states, strict)
    if found & ANSWER_REFUSED:
        return found
    gate.seen = True
    law = number_of_law(contacts, gate.config.guarded)
    found |= pass_gate(gate, joints, control, contacts, mass_matrix, jacobian, law)
    if found & BOUNDING_LIMITS:
        limit.bounded_at = limit.time
    return found
