"""All that a tick works on, in one piece: what is a struct in C."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any, get_type_hints, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.loop import ControlLoop
from multicontact_control.records import Record, Records
from multicontact_control.supervision.tick_records import TickRecords
import numpy as np


def make_terms_record(joint_count: int) -> type:
    """Return the record of the model's terms for n joints: the fields of `ModelTerms`."""
    n = joint_count
    fields = {
        'mass_matrix': Annotated[Matrix, n, n],
        'bias_torque': Annotated[Vector, n],
        'gravity': Annotated[Vector, n],
        'jacobian': Annotated[Matrix, 6, n],
        'jacobian_rate': Annotated[Matrix, 6, n],
        'position': Annotated[Vector, 3],
        'rotation': Annotated[Matrix, 3, 3],
        'sensor_position': Annotated[Vector, 3],
        'sensor_rotation': Annotated[Matrix, 3, 3],
    }
    return _make_record('Terms', ModelTerms, fields)


class MemoryParts(Protocol):
    """
    All that a controller of this configuration works on.

    The caller writes `stages[0].sample`, `terms` and `added` at the positions and velocities of
    `motion`, and what is wanted: `controls[0].wanted`, `wanted` and `alpha_wanted` of `contacts`.
    """

    # Positions [rad], then velocities [rad/s] of the joints, at which the terms are to be.
    motion: Matrix

    # Matrices have their rows one after the other; `mass_matrix` and rotations, their columns.
    terms: ModelTerms

    added: Vector  # torques that the drives add to a command by themselves [N m]


def make_memory_record(loop: ControlLoop) -> type:
    """Return the record of all that a tick of a controller works on."""
    supervisor = loop.supervisor
    n = len(supervisor.controller.arm.joints)
    fields: dict[str, Any] = {}
    for name, kind in get_type_hints(TickRecords).items():
        count = len(getattr(supervisor.records, name))
        fields[name] = Annotated[kind, count]
    fields['motion'] = Annotated[Matrix, 2, n]
    fields['terms'] = make_terms_record(n)
    fields['added'] = Annotated[Vector, n]
    return _make_record('Controller', MemoryParts, fields)


def _make_record(name: str, described: type, fields: dict[str, Any]) -> type:
    """Return a record with these fields, whose comments are those of another class."""
    content = {
        '__annotations__': fields,
        '__doc__': described.__doc__,
        '__module__': __name__,
        'described': described,
    }
    return type(name, (Record, Protocol), content)


def copy_memory(loop: ControlLoop, memory: Records[Any]) -> None:
    """Copy what a tick of a controller works on into one record of `make_memory_record`."""
    supervisor = loop.supervisor
    for name, records in supervisor.records._asdict().items():
        memory[name] = records
    memory['motion'] = supervisor.controller.arm.motion
    memory['added'] = supervisor.controller.arm.joints['drive_gravity_torque']
    terms = memory['terms'][0]
    for name, term in supervisor.controller.robot.terms._asdict().items():
        place = terms[name]
        if name in COLUMNS_FIRST:
            place = place.T
        place[:] = term


# Matrices that pinocchio has by columns.
COLUMNS_FIRST = ('mass_matrix', 'rotation', 'sensor_rotation')


def hash_layout(memory: np.dtype[Any]) -> int:
    """Return a number of 64 bits for names, types, shapes and places of all fields."""
    digest = hashlib.sha256(repr(_list_fields(memory)).encode()).digest()
    return int.from_bytes(digest[:8], 'little')


def _list_fields(dtype: np.dtype[Any]) -> list[Any]:
    """Return the fields of a dtype and of those within it."""
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        return [shape, _list_fields(element)]
    if dtype.fields is None:
        return [dtype.str]
    listed: list[Any] = [dtype.itemsize]
    for name, field in dtype.fields.items():
        listed.append((name, field[1], _list_fields(field[0])))
    return listed
