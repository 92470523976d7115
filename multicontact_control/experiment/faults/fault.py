"""What a fault is: what is done to what, where and when, and what must follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from multicontact_control.arrays import Vector
import numpy as np

PROCESS, GRAPH = 'process', 'graph'
TWO = 'two at once'
BOTH, IN_PROCESS, OVER_GRAPH = (PROCESS, GRAPH), (PROCESS,), (GRAPH,)
START, APPROACH, REST, SLIDING = 'start', 'approach', 'rest', 'sliding'
PHASES = (REST, SLIDING, APPROACH)

Random = np.random.Generator
Ages = Callable[[Random, int], tuple[int, ...]]
Change = Callable[[Any, Vector], Any]
PlantChange = Callable[[Any, Vector], None]  # of a plant; the relay does without the simulator


@dataclass(frozen=True)
class Delivery:
    """
    Other readings than the newest.

    Attributes
    ----------
    ages
        What comes instead of the n-th reading since the fault began, by how many readings ago it
        was the newest. A tick in process takes in the last of them.
    sampled
        The same in process, where that is not what ticks would see.

    """

    ages: Ages
    sampled: Ages | None = None


@dataclass(frozen=True)
class Edit:
    """
    Other values in some fields of a reading (``q qd names wrench variance``).

    Attributes
    ----------
    fields
        Which.
    change
        Makes the new values of the old ones and of four numbers drawn once, uniform over (0, 1);
        none keeps those of the first reading, while stamps go on.
    source
        The field whose values are changed into those of `fields`, in process; empty for their own.
    age
        In process, how many readings ago the values without a change were; 0 for those of the
        first.
    single
        Whether one number of each field, in a random place, becomes other, and not all.

    """

    fields: tuple[str, ...]
    change: Change | None
    source: str = ''
    age: int = 0
    single: bool = False

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
    """
    A clock that goes wrong.

    Attributes
    ----------
    shift
        By how much, from the time since the fault began and the time when it did [s].
    stamps
        Whether, in process, the stamps of the readings go with it; over the graph only they do.

    """

    shift: Callable[[float, float], float]
    stamps: bool = True


@dataclass(frozen=True)
class Breakdown:
    """A part of the supervisor, by the names that lead to it, that raises whenever called."""

    part: str


@dataclass(frozen=True)
class PlantEdit:
    """What is done to the plant at the beginning and at the end; numbers as for `Edit`."""

    begin: PlantChange
    end: PlantChange | None = None


@dataclass(frozen=True)
class NodeChange:
    """What is done to a node: ``kill``, ``halt``, or the transitions that it is led through."""

    steps: tuple[str, ...]


@dataclass(frozen=True)
class Command:
    """
    A command that nobody asked for: a change of a rightful message of that topic.

    It is sent again and again beside those of the rightful user, or once and as the last of
    theirs.
    """

    change: Callable[[Any], None]
    last: bool = False


@dataclass(frozen=True)
class Fault:
    """
    One kind of fault.

    Attributes
    ----------
    kind, input
        Name, and what it befalls.
    action
        What is done.
    declared
        Reactions of which one must be in force two ticks after the beginning, in process; none if
        the fault cannot be told from a good input or is bridged.
    phases
        Phases in which it can be told at all.
    where
        Where it can happen.
    goes_on
        Whether the controller of a graph must go on commanding meanwhile.
    at_once
        Whether a declared reaction may not wait until the reading has become too old.
    ticks
        How long it lasts in process, at least and less than.
    from_start
        Whether it also happens from the first sample on, and the joints' speeds are judged.
    meets
        Number of the obstacle that the arm meets before its wrist sensor, in process: it must
        notice.
    parts
        What happens at the same time, if this is two faults.

    """

    kind: str
    input: str  # noqa: A003
    action: Delivery | Edit | ClockShift | Breakdown | PlantEdit | NodeChange | Command
    declared: tuple[str, ...] = ()
    phases: tuple[str, ...] = PHASES
    where: tuple[str, ...] = BOTH
    goes_on: bool = True
    at_once: bool = False
    ticks: tuple[int, int] = (5, 150)
    from_start: bool = False
    meets: int | None = None
    parts: tuple[Fault, ...] = ()

    @property
    def passes(self) -> bool:
        """Whether the arm can do again what it did, once it has passed, with all its parts."""
        if self.parts:
            return all(part.passes for part in self.parts)
        told = isinstance(self.action, Delivery) or bool(self.declared)
        return told or isinstance(self.action, Breakdown)

    def expected(self, phase: str) -> tuple[str, ...]:
        """Return the declared reactions in a phase."""
        return self.declared if phase in self.phases else ()

    def random(self, seed: int) -> Random:
        """Return the source of the details of this fault."""
        return np.random.default_rng([seed, sum(map(ord, self.kind + self.input))])
