"""The records that a tick works on."""

from __future__ import annotations

from typing import Annotated, NamedTuple, Protocol

from multicontact_control.arrays import Vector
from multicontact_control.control.arm import ArmSpace
from multicontact_control.control.law import LawSpace
from multicontact_control.force.force_law import ForceLaw
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    MAX_JOINTS,
    Record,
    record_dtype,
    Records,
)
from multicontact_control.supervision.checks import Judgement
from multicontact_control.supervision.contacts import ContactState
from multicontact_control.supervision.gate import GateState
from multicontact_control.supervision.input_checks import InputStage
from multicontact_control.supervision.reactions import ReactionState
from multicontact_control.supervision.recovery import Hysteresis, Recovery
from multicontact_control.supervision.reference import TaskLimits


class Workspace(Record, Protocol):
    """What a tick works in, so that it allocates nothing: one record for each of its parts."""

    arm: ArmSpace
    law: LawSpace
    torque: Annotated[Vector, MAX_JOINTS]  # [N m]
    wrench: Annotated[Vector, 6]  # [N, N m]
    acceleration: Annotated[Vector, 6]  # [m/s^2, rad/s^2]


WORKSPACE = record_dtype(Workspace)


class SupervisionConfig(Record, Protocol):
    """What is set for the decisions of a tick; one."""

    guarded: bool  # whether reactions answer; if not, the law alone does
    period: float  # h [s]
    collision_reaction: int  # TO_NONE, TO_HOLD, TO_FLOAT or TO_DAMP, of `causes`


class Supervision(Record, Protocol):
    """What is decided in a tick, and what of the ticks before leads to it; one."""

    config: SupervisionConfig
    safe: bool  # whether ticks are answered by the declared safe behaviour
    started: bool  # whether the law has answered a sample since a restart
    in_control: bool  # whether it has answered the sample before
    paused: bool  # whether a reaction has
    seen: bool  # whether the arm was ever seen
    blind: bool  # whether it is not seen now
    begins: bool  # whether the law begins in this tick, with a task that starts here
    resumes: bool  # whether it goes on in this tick, after a reaction
    trusts_velocities: bool  # whether an operator does, although they were refuted

    causes: int  # why the law does not answer, or not as usual; see `causes`
    reaction: int  # what answers this tick: TO_NONE, TO_INFLATE, TO_HOLD, ...
    arm_found: int  # what was found of the arm when it was seen last; see `flags`
    good_ticks: int  # in a row, since a reaction
    reacting_ticks: int  # in a row
    task_ticks: int  # of the task's time, which stands still during a reaction

    hysteresis: Hysteresis
    recovery: Recovery
    reactions: ReactionState


SUPERVISION = record_dtype(Supervision)


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
    fresh_laws: Records[ForceLaw]  # the same laws, which know nothing yet
    states: Records[ContactState]

    # One of each.
    stages: Records[InputStage]
    supervisions: Records[Supervision]
    limits: Records[TaskLimits]
    judgements: Records[Judgement]
    gates: Records[GateState]
    workspaces: Records[Workspace]


# Its fields in a plain tuple, which numba takes from Python in half the time.
RecordTuple = tuple[
    Records[Joint],
    Records[Control],
    Records[Contact],
    Records[ForceLaw],
    Records[ForceLaw],
    Records[ContactState],
    Records[InputStage],
    Records[Supervision],
    Records[TaskLimits],
    Records[Judgement],
    Records[GateState],
    Records[Workspace],
]
