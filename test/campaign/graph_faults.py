"""The faults of a running graph: of its nodes and messages; `study faults` has those of values."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from multicontact_control.faults.vocabulary import (
    CLOCK,
    Fault,
    FLOAT,
    INFLATE,
    LOSS,
    REACTIONS,
    STOPPED,
)
from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, RECORDER, SIM
import numpy as np

KILL, HALT = ('kill',), ('halt',)
DEACTIVATE = ('deactivate',)
RESTART = ('deactivate', 'activate') * 2
CONFIGURE_AGAIN = ('deactivate', 'cleanup', 'configure')
BURST = 10  # messages that come at once


class Resending(NamedTuple):
    """Other messages are sent on in the place of the n-th: by how many messages they are older."""

    ages: Callable[[np.random.Generator, int], Sequence[int]]


class Renaming(NamedTuple):
    """A message has other names."""

    change: Callable[[list[str]], list[str]]


class ClockShift(NamedTuple):
    """Stamps are later [s]."""

    shift: float


class NodeChange(NamedTuple):
    """A node is killed, halted, or led through transitions of its life cycle."""

    steps: tuple[str, ...]


@dataclass(frozen=True)
class GraphFault(Fault):
    """A fault of a graph; the controller may have to go on commanding meanwhile."""

    goes_on: bool = True


def drop(random, n):
    return ()


def delay(random, n):
    return (10,)


def repeat_first(random, n):
    return (n + 1,)


def add_an_old_one(random, n):
    return (0, 25)


def duplicate(random, n):
    return (0, 0)


def swap_pairs(random, n):
    return (0, 1) if n % 2 else ()


def drop_at_random(random, n):
    return () if random.random() < LOSS else (0,)


def collect_into_bursts(random, n):
    if n % BURST < BURST - 1:
        return ()
    return tuple(reversed(range(BURST)))


def rename_all(names):
    return [f'other_{name}' for name in names]


def leave_out_the_last(names):
    return names[:-1]


def double_the_first(names):
    return [names[0], *names[:-1]]


RESENDINGS = {
    'dropped': drop,
    'delayed': delay,
    'stuck': repeat_first,
    'out_of_order': add_an_old_one,
    'duplicated': duplicate,
    'reordered': swap_pairs,
    'intermittent': drop_at_random,
    'burst': collect_into_bursts,
}
RENAMINGS = {
    'wrong_names': rename_all,
    'missing_name': leave_out_the_last,
    'doubled_name': double_the_first,
}
NODE_FAULTS = (
    GraphFault('killed', ESTIMATOR, NodeChange(KILL)),
    GraphFault('killed', CONTROLLER, NodeChange(KILL), goes_on=False),
    GraphFault('killed', RECORDER, NodeChange(KILL)),
    GraphFault('halted', ESTIMATOR, NodeChange(HALT)),
    GraphFault('halted', CONTROLLER, NodeChange(HALT), goes_on=False),
    GraphFault('halted', RECORDER, NodeChange(HALT)),
    GraphFault('halted', SIM, NodeChange(HALT), goes_on=False),
    GraphFault('deactivated', ESTIMATOR, NodeChange(DEACTIVATE)),
    GraphFault('deactivated', CONTROLLER, NodeChange(DEACTIVATE)),
    GraphFault('reactivated', CONTROLLER, NodeChange(RESTART)),
    GraphFault('cleaned_up', ESTIMATOR, NodeChange(CONFIGURE_AGAIN)),
    GraphFault('cleaned_up', CONTROLLER, NodeChange(CONFIGURE_AGAIN), goes_on=False),
)
CLOCK_FAULTS = (
    GraphFault('ahead', CLOCK, ClockShift(0.1), STOPPED),
    GraphFault('zero', CLOCK, ClockShift(-1e12), STOPPED),
)


def message_faults():
    """Yield the faults of the messages of every input."""
    for stream in REACTIONS:
        for kind, ages in RESENDINGS.items():
            yield GraphFault(kind, stream, Resending(ages))
    for stream, declared in (('joints', FLOAT), ('variance', INFLATE)):
        for kind, change in RENAMINGS.items():
            yield GraphFault(kind, stream, Renaming(change), declared)


GRAPH_FAULTS = {
    (fault.kind, fault.input): fault
    for fault in (*NODE_FAULTS, *message_faults(), *CLOCK_FAULTS)
}
