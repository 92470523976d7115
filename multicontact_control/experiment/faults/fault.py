"""What a fault is: what is done to what, when, and what must follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from multicontact_control.arrays import Vector
import numpy as np

TWO = 'two at once'
START, APPROACH, REST, SLIDING = 'start', 'approach', 'rest', 'sliding'
PHASES = (REST, SLIDING, APPROACH)

Random = np.random.Generator
Change = Callable[[Any, Vector], Any]  # of old values and four numbers drawn once from (0, 1)
PlantChange = Callable[[Any, Vector], None]


@dataclass(frozen=True)
class Delivery:
    """Another reading than the newest: from how many ticks ago in the n-th tick, or none."""

    age: Callable[[Random, int], int | None]


@dataclass(frozen=True)
class Edit:
    """Other values in some fields of a reading (``q qd wrench variance``); stamps go on."""

    fields: tuple[str, ...]
    change: Change | None  # None keeps the values of the first reading
    source: str = ''  # field whose values are changed into those of `fields`; '' for their own
    age: int = 0  # how many readings ago the values without a change were; 0 for the first
    single: bool = False  # one number of each field, in a random place, and not all

    def values(
        self, now: Mapping[str, Any], first: Mapping[str, Any], choice: Vector,
    ) -> dict[str, Any]:
        """Return what the fields become, from a reading and the first one during the fault."""
        values = {}
        for name in self.fields:
            values[name] = first[name] if self.change is None else (
                self.change(now[self.source or name], choice))
            if self.single:
                every, vector = values[name], np.array(now[name], dtype=float)
                place = int(choice[0] * vector.size)
                vector[place] = every[place]
                values[name] = vector
        return values


@dataclass(frozen=True)
class ClockShift:
    """A clock that goes wrong, with the stamps of the readings or without."""

    # By how much, from the time since the fault began and the time when it did [s].
    shift: Callable[[float, float], float]
    stamps: bool = True


@dataclass(frozen=True)
class Breakdown:
    """A part of the supervisor, by the names that lead to it, that raises whenever called."""

    part: str


@dataclass(frozen=True)
class PlantEdit:
    """What is done to the plant at the beginning and at the end."""

    begin: PlantChange
    end: PlantChange | None = None


@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    kind: str
    input: str  # noqa: A003
    action: Any  # one of the above
    # Reactions of which one must be in force two ticks after the beginning; none if the fault
    # cannot be told from a good input or is bridged.
    declared: tuple[str, ...] = ()
    phases: tuple[str, ...] = PHASES  # in which it can be noticed at all
    at_once: bool = False  # a declared reaction may not wait until the reading is too old
    ticks: tuple[int, int] = (5, 150)  # how long it lasts, at least and less than
    from_start: bool = False  # also happens from the first sample on; joint speeds are judged
    meets: int | None = None  # obstacle that the arm meets before its sensor and must notice
    parts: tuple[Fault, ...] = ()  # what happens at the same time, of two faults

    @property
    def passes(self) -> bool:
        """Whether the arm can do again what it did, once it has passed, with all its parts."""
        return all(isinstance(part.action, (Delivery, Breakdown)) or bool(part.declared)
                   for part in self.parts or (self,))

    def random(self, seed: int) -> Random:
        """Return the source of the details of this fault."""
        return np.random.default_rng([seed, sum(map(ord, self.kind + self.input))])
