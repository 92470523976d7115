"""
What C calls: one function for each step of a controller, of a pointer to its memory.

They are compiled by `objects`, for that memory, and call the kernels that run in Python.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.supervision.input_checks import check_inputs
from multicontact_control.tick import ACT, SEE, tick
from numba import carray
import numpy as np

STAGES = SEE | ACT


def take(pointer: Any) -> bool:
    """
    Check what has come in and hand over what is valid; return whether all is well.

    Before it, fill in `inputs[0].sample`; after it, compute the terms of the model at `motion`.
    """
    memory = carray(pointer, 1)[0]
    motion = memory.motion[:]
    return check_inputs(
        memory.inputs[:],
        motion[0],
        motion[1],
        memory.joints[:],
        memory.controls[:],
        memory.contacts[:],
    )


def step(pointer: Any) -> int:
    """Answer what was taken; return what was found, the sum of flags."""
    memory = carray(pointer, 1)[0]
    terms = memory.terms
    stages: Any = np.int64(STAGES)  # no constant: numba has it compiled for any number
    return tick(
        stages,
        (
            memory.joints[:],
            memory.controls[:],
            memory.contacts[:],
            memory.laws[:],
            memory.states[:],
            memory.limits[:],
            memory.judgements[:],
            memory.gates[:],
            memory.workspaces[:],
        ),
        memory.motion[:],
        (
            terms.mass_matrix[:].T,
            terms.bias_torque[:],
            terms.jacobian[:],
            terms.jacobian_rate[:],
            terms.position[:],
            terms.rotation[:].T,
            terms.sensor_position[:],
            terms.sensor_rotation[:].T,
        ),
    )


ENTRIES = {'mc_take': take, 'mc_tick': step}
