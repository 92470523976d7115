"""Contacts as columns of N: what is pressed, and where the pressure is centred."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from multicontact_control.config.base import Vector3

ContactType = Literal['point', 'edge', 'plane']

# Kinds of columns, as `records.CONTACT` counts them: a force along the normal, a couple by which
# it moves along the contact's direction, and one by which it moves across it.
FORCE, ALONG, ACROSS = range(3)
KINDS: dict[str, tuple[int, ...]] = {
    'point': (FORCE,), 'edge': (FORCE, ALONG), 'plane': (FORCE, ALONG, ACROSS)}
SUFFIXES = {FORCE: '', ALONG: '/along', ACROSS: '/across'}
# Of a line or face that is equally stiff everywhere, seen by couples: k / 3 at the half length.
UNIFORM = 1.0 / 3.0


@dataclass(frozen=True)
class Column:
    """
    One controlled coordinate of a contact.

    Attributes
    ----------
    name, contact
        Its own name, and that of its contact.
    kind
        FORCE, ALONG or ACROSS.
    leader
        Index of the column with the normal force of its contact.
    stiffness
        Modelled, along this coordinate [N/m].
    half_length
        Unit of a couple's lever, 0 for a force [m].
    direction_operational
        Direction of an edge, or of a plane's first side, in the operational frame.

    """

    name: str
    contact: str
    kind: int
    leader: int
    stiffness: float
    half_length: float
    direction_operational: Vector3


def leaders(columns: Iterable[Column]) -> tuple[int, ...]:
    """Return the indices of the columns that are normal forces, one per contact."""
    return tuple(i for i, column in enumerate(columns) if column.kind == FORCE)


def is_couple_name(name: str) -> bool:
    """Return whether a name is that of a couple of a contact."""
    return name.endswith((SUFFIXES[ALONG], SUFFIXES[ACROSS]))


def contact_types(names: Iterable[str]) -> dict[str, ContactType]:
    """Return the contacts that the names of forces and couples are of, and what they are."""
    known = list(names)
    types: dict[str, ContactType] = {}
    for name in known:
        if not is_couple_name(name):
            types[name] = 'plane' if name + SUFFIXES[ACROSS] in known else (
                'edge' if name + SUFFIXES[ALONG] in known else 'point')
    return types
