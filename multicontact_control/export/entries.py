"""
What C calls: one function for each step of a controller, and for each command.

Each takes a pointer to the memory, see `memory`, and whole numbers. `objects` compiles them; they
call the kernels that run in Python. The first lines of their docstrings are in the header.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from multicontact_control.supervision.decisions import retry, stop_control
from multicontact_control.supervision.gate import start_blend, update_added_torque
from multicontact_control.supervision.input_checks import check_inputs
from multicontact_control.supervision.task_limits import hold_task, lock_task
from multicontact_control.supervision.tick_records import TickRecords
from multicontact_control.tick import answer_error, SEE, tick
from numba import carray
from numba.extending import register_jitable


@register_jitable
def get_records(memory: Any) -> Any:
    """Return the fields of `TickRecords` of the memory in a plain tuple."""
    return (
        memory.joints[:],
        memory.controls[:],
        memory.contacts[:],
        memory.laws[:],
        memory.fresh_laws[:],
        memory.states[:],
        memory.stages[:],
        memory.supervisions[:],
        memory.limits[:],
        memory.judgements[:],
        memory.gates[:],
        memory.workspaces[:],
    )


@register_jitable
def get_terms(memory: Any) -> Any:
    """Return the fields of `ModelTerms` of the memory in a plain tuple, laid out as by Python."""
    terms = memory.terms
    return (
        terms.mass_matrix[:].T,
        terms.bias_torque[:],
        terms.gravity[:],
        terms.jacobian[:],
        terms.jacobian_rate[:],
        terms.position[:],
        terms.rotation[:].T,
        terms.sensor_position[:],
        terms.sensor_rotation[:].T,
    )


def take(pointer: Any) -> Any:
    """
    Check what has come in, `stages[0].sample`; return 1 if all is well.

    What of it is valid goes to `motion`, at which the terms of the model are due then.
    """
    memory = carray(pointer, 1)[0]
    motion = memory.motion[:]
    return check_inputs(
        memory.stages[:],
        motion[0],
        motion[1],
        memory.joints[:],
        memory.controls[:],
        memory.contacts[:],
    )


def run(pointer: Any, stages: int) -> Any:
    """
    Run stages of a tick, MC_SEE, MC_ACT or both; return flags.

    To see is to take in where the arm is, and to decide what answers, the law or a reaction.
    """
    memory = carray(pointer, 1)[0]
    stage = memory.stages[0]
    if stages & SEE and stage.settings.adds_gravity and stage.state.known:
        update_added_torque(memory.joints[:], memory.added[:])
    return tick(stages, get_records(memory), memory.motion[:], get_terms(memory))


def fail(pointer: Any, cause: int) -> Any:
    """
    Answer instead of `mc_act` after a failure of the caller; return flags.

    `cause` is `MC_LAW` if no task could be had, `MC_INTERNAL` for all else.
    """
    memory = carray(pointer, 1)[0]
    return answer_error(cause, get_records(memory), get_terms(memory))


def hold(pointer: Any, wanted: int) -> Any:
    """Hold pose and forces as they are (1), or go on (0); meanwhile `wanted` is the library's."""
    memory = carray(pointer, 1)[0]
    start_blend(memory.gates[0])
    hold_task(
        memory.limits[0],
        memory.controls[0],
        memory.contacts[:],
        memory.states[:],
        wanted != 0,
    )
    return 0


def lock(pointer: Any, wanted: int) -> Any:
    """Stay without contact (1), as during a push test, or go on (0)."""
    memory = carray(pointer, 1)[0]
    start_blend(memory.gates[0])
    lock_task(
        memory.limits[0],
        memory.controls[0],
        memory.contacts[:],
        memory.states[:],
        wanted != 0,
    )
    return 0


def try_again(pointer: Any) -> Any:
    """Resume control that is latched, seek contacts given up; return 1 if there was any."""
    memory = carray(pointer, 1)[0]
    return retry(TickRecords(*get_records(memory)))


def stop(pointer: Any) -> Any:
    """Answer by the declared safe behaviour from the next tick on, until `mc_reset`."""
    memory = carray(pointer, 1)[0]
    stop_control(TickRecords(*get_records(memory)))
    return 0


ENTRIES: dict[str, Callable[..., Any]] = {
    'mc_take': take,
    'mc_run': run,
    'mc_fail': fail,
    'mc_hold': hold,
    'mc_lock': lock,
    'mc_retry': try_again,
    'mc_stop': stop,
}
