"""What a supervisor says of every tick."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.control.tick import ControlOutput
from multicontact_control.records import CONTACT, CONTROL
import numpy as np


class SupervisorStatus(NamedTuple):
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
    task_time
        Time of the task, which stands still during a reaction [s].

    """

    reaction: str
    causes: tuple[str, ...]
    rejected: tuple[str, ...]
    limits: tuple[str, ...]
    contact_states: tuple[str, ...]
    task_time: float


class TickOutput(NamedTuple):
    """The answer to one tick, and what a supervisor says of it, None without one."""

    output: ControlOutput
    status: SupervisorStatus | None


def no_answer(joints: int, contacts: int) -> ControlOutput:
    """Return the answer before anything is known."""
    controls = np.zeros(1, dtype=CONTROL)
    controls['frame']['rotation'] = controls['task']['rotation'] = np.eye(3)
    return ControlOutput(np.zeros(joints), np.zeros(contacts, dtype=CONTACT), controls)
