"""The faults of a running graph: of its nodes, messages and commands, beside those in process."""

from collections import namedtuple
from dataclasses import dataclass
import math

from multicontact_control.experiment.faults.vocabulary import (
    CLOCK,
    ClockShift,
    Edit,
    Fault,
    FAULTS,
    FLOAT,
    INFLATE,
    LOSS,
    REACTIONS,
    STOPPED,
)
from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, RECORDER, SIM

NAN, INF = math.nan, math.inf
KILL, HALT = ('kill',), ('halt',)
BURST, JUMP = 10, 0.1  # messages that come at once; m
ONLY_IN_PROCESS = {  # a message always has six numbers; and what messages cannot tell
    ('wrong_count', 'wrench'), ('scaled_x3', 'wrench'), ('saturated_qd', 'joints'),
    ('frozen_q', 'joints'), ('frozen_qd', 'joints'), ('wrapped_q', 'joints'), ('nan', CLOCK),
    ('too_slow', CLOCK), ('jump_ahead', CLOCK)}


# Other messages than the n-th of a fault, by how many messages ago they came; what is done to a
# node: kill, halt, or transitions; a change of a rightful command, sent beside those.
Resending, NodeChange, Command = (
    namedtuple(name, field) for name, field in (
        ('Resending', 'ages'), ('NodeChange', 'steps'), ('Command', 'change')))


@dataclass(frozen=True)
class GraphFault(Fault):
    """A fault of a graph; the controller may have to go on commanding meanwhile."""

    goes_on: bool = True


WAYS = {  # by which messages are sent on in the place of the n-th
    'dropped': lambda random, n: (), 'delayed': lambda random, n: (10,),
    'stuck': lambda random, n: (n + 1,), 'out_of_order': lambda random, n: (0, 25),
    'duplicated': lambda random, n: (0, 0),
    'reordered': lambda random, n: (0, 1) if n % 2 else (),
    'intermittent': lambda random, n: () if random.random() < LOSS else (0,),
    'burst': lambda random, n: tuple(range(BURST))[::-1] if n % BURST == BURST - 1 else ()}
NAMES = {'wrong_names': lambda names, _: [f'other_{name}' for name in names],
         'missing_name': lambda names, _: names[:-1],
         'doubled_name': lambda names, _: [names[0], *names[:-1]]}
DOWN, TWICE = ('deactivate',), ('deactivate', 'activate') * 2
ANEW = ('deactivate', 'cleanup', 'configure')
NODES = (  # what befalls which node, and whether commands have to go on
    ('killed', ESTIMATOR, KILL, True), ('killed', CONTROLLER, KILL, False),
    ('killed', RECORDER, KILL, True), ('halted', ESTIMATOR, HALT, True),
    ('halted', CONTROLLER, HALT, False), ('halted', RECORDER, HALT, True),
    ('halted', SIM, HALT, False), ('deactivated', ESTIMATOR, DOWN, True),
    ('deactivated', CONTROLLER, DOWN, True), ('reactivated', CONTROLLER, TWICE, True),
    ('cleaned_up', ESTIMATOR, ANEW, True), ('cleaned_up', CONTROLLER, ANEW, False))


def _efforts(*efforts, names=None):
    """Return a change of a command of forces, of the first contacts or under other names."""
    def change(message):
        message.name = list(message.name[:max(1, len(efforts))] if names is None else names)
        message.effort = list(efforts)
    return change


def _number(field, part, axis, value, *, add=False):
    """Return a change of one number of a motion."""
    def change(message):
        vector = getattr(getattr(message, field)[0], part)
        setattr(vector, axis, value + (getattr(vector, axis) if add else 0.0))
    return change


FORCES = {
    'nan': _efforts(NAN, 5.0), 'infinite': _efforts(5.0, INF), 'negative': _efforts(-5.0),
    'beyond_ceiling': _efforts(1000.0), 'wrong_count': _efforts(5.0, 5.0, names=['table']),
    'unknown_contact': _efforts(5.0, names=['nowhere']), 'empty': _efforts(names=[])}
MOTIONS = {
    'nan': _number('transforms', 'translation', 'x', NAN),
    'nan_twist': _number('velocities', 'linear', 'y', NAN),
    'infinite': _number('accelerations', 'linear', 'z', INF),
    'no_pose': lambda message: message.transforms.clear(),
    'two_poses': lambda message: message.transforms.append(message.transforms[0]),
    'no_rotation': _number('transforms', 'rotation', 'w', 5.0),
    'outside_box': _number('transforms', 'translation', 'z', 50.0),
    'jump': _number('transforms', 'translation', 'x', JUMP, add=True)}

GRAPH_FAULTS = {(fault.kind, fault.input): fault for fault in (
    *(GraphFault(kind, node, NodeChange(steps), goes_on=goes_on)
      for kind, node, steps, goes_on in NODES),
    *(GraphFault(kind, stream, Resending(ages)) for stream in REACTIONS
      for kind, ages in WAYS.items()),
    *(GraphFault(kind, stream, Edit(('names',), change), declared)
      for stream, declared in (('joints', FLOAT), ('variance', INFLATE))
      for kind, change in NAMES.items()),
    GraphFault('ahead', CLOCK, ClockShift(lambda since, begin: 0.1), STOPPED),
    GraphFault('zero', CLOCK, ClockShift(lambda since, begin: -INF), STOPPED),
    *(GraphFault(fault.kind, fault.input, fault.action, fault.declared, fault.phases)
      for fault in FAULTS.values() if isinstance(fault.action, (Edit, ClockShift))
      and not fault.from_start and (fault.kind, fault.input) not in ONLY_IN_PROCESS),
    *(GraphFault(kind, f'{topic} command', Command(change))
      for topic, changes in (('forces', FORCES), ('motion', MOTIONS))
      for kind, change in changes.items()))}
