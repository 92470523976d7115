"""The faults of a running graph: of its nodes and messages; `study faults` has those of values."""

from collections import namedtuple
from dataclasses import dataclass

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

KILL, HALT = ('kill',), ('halt',)
BURST = 10  # messages that come at once


# Other messages than the n-th of a fault, by how many messages ago they came; other names in a
# message, or a stamp by so many seconds later; what is done to a node: kill, halt, or transitions.
Resending, Renaming, ClockShift, NodeChange = (
    namedtuple(name, field)
    for name, field in (
        ('Resending', 'ages'),
        ('Renaming', 'change'),
        ('ClockShift', 'shift'),
        ('NodeChange', 'steps'),
    )
)


@dataclass(frozen=True)
class GraphFault(Fault):
    """A fault of a graph; the controller may have to go on commanding meanwhile."""

    goes_on: bool = True


WAYS = {  # by which messages are sent on in the place of the n-th
    'dropped': lambda random, n: (),
    'delayed': lambda random, n: (10,),
    'stuck': lambda random, n: (n + 1,),
    'out_of_order': lambda random, n: (0, 25),
    'duplicated': lambda random, n: (0, 0),
    'reordered': lambda random, n: (0, 1) if n % 2 else (),
    'intermittent': lambda random, n: () if random.random() < LOSS else (0,),
    'burst': lambda random, n: (
        tuple(range(BURST))[::-1] if n % BURST == BURST - 1 else ()
    ),
}
NAMES = {
    'wrong_names': lambda names: [f'other_{name}' for name in names],
    'missing_name': lambda names: names[:-1],
    'doubled_name': lambda names: [names[0], *names[:-1]],
}
DOWN, TWICE = ('deactivate',), ('deactivate', 'activate') * 2
ANEW = ('deactivate', 'cleanup', 'configure')
NODES = (  # what befalls which node, and whether commands have to go on
    ('killed', ESTIMATOR, KILL, True),
    ('killed', CONTROLLER, KILL, False),
    ('killed', RECORDER, KILL, True),
    ('halted', ESTIMATOR, HALT, True),
    ('halted', CONTROLLER, HALT, False),
    ('halted', RECORDER, HALT, True),
    ('halted', SIM, HALT, False),
    ('deactivated', ESTIMATOR, DOWN, True),
    ('deactivated', CONTROLLER, DOWN, True),
    ('reactivated', CONTROLLER, TWICE, True),
    ('cleaned_up', ESTIMATOR, ANEW, True),
    ('cleaned_up', CONTROLLER, ANEW, False),
)

GRAPH_FAULTS = {
    (fault.kind, fault.input): fault
    for fault in (
        *(
            GraphFault(kind, node, NodeChange(steps), goes_on=goes_on)
            for kind, node, steps, goes_on in NODES
        ),
        *(
            GraphFault(kind, stream, Resending(ages))
            for stream in REACTIONS
            for kind, ages in WAYS.items()
        ),
        *(
            GraphFault(kind, stream, Renaming(change), declared)
            for stream, declared in (('joints', FLOAT), ('variance', INFLATE))
            for kind, change in NAMES.items()
        ),
        GraphFault('ahead', CLOCK, ClockShift(0.1), STOPPED),
        GraphFault('zero', CLOCK, ClockShift(-1e12), STOPPED),
    )
}
