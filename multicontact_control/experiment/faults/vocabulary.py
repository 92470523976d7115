"""
The faults of the campaign, each declared once: what is done to what, where, what must follow.

Actions work on numbers, names and times; `in_process` applies them to the readings of a tick and
`graph_relay` to the messages on their way, so that a fault of both is the same in both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle
import math
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.faults.fault import (
    APPROACH,
    BOTH,
    Breakdown,
    Change,
    ClockShift,
    Command,
    Delivery,
    Edit,
    Fault,
    IN_PROCESS,
    NodeChange,
    OVER_GRAPH,
    PHASES,
    PlantChange,
    PlantEdit,
    PROCESS,
    REST,
    SLIDING,
)
import numpy as np
from scipy.spatial.transform import Rotation

HOLD, FLOAT, INFLATE = ('hold',), ('float',), ('inflate',)
STOPPED = ('hold', 'float', 'damp')
REACTIONS = {'joints': FLOAT, 'wrench': HOLD, 'variance': INFLATE}
STREAMS = tuple(REACTIONS)
CONTROLLER = 'controller_node'
CLOCK = 'clock'  # over the graph, the stamps of joints and wrench together

NAN, INF = math.nan, math.inf
PERIOD = 0.002  # s, by which clocks are moved
LOSS = 0.3  # share of messages that an intermittent stream loses
BURST = 10  # messages that come at once
JUMP = 0.1  # m
FULL_SCALE = np.array([100.0, 100.0, 200.0, 5.0, 5.0, 5.0])  # N, N m of the simulated sensor
LASTING = (300, 600)  # ticks of what is there from the start
SIDE_WALL, ELBOW_WALL = -2, -1  # numbers of surfaces that are no contacts: the last ones
FAR = 10.0  # m, where they are not in the way
# What a tick calls of a supervisor, one after the other.
PARTS = ('inputs.validate', 'controller.arm.refresh', 'task.ask', 'controller.answer',
         'reactions.torque', 'gate.apply')


def _deliveries() -> list[Fault]:
    """Return the faults of delivery, for every stream."""
    ways: list[tuple[str, Delivery, bool]] = [
        ('dropped', Delivery(lambda random, n: ()), True),
        # Longer over the graph, where the limits of age are longer.
        ('delayed', Delivery(lambda random, n: (10,), lambda random, n: (4,)), True),
        ('stuck', Delivery(lambda random, n: (n + 1,)), True),
        ('out_of_order', Delivery(lambda random, n: (0, 25)), True),
        ('duplicated', Delivery(lambda random, n: (0, 0), lambda random, n: (n % 2,)), False),
        ('reordered', Delivery(lambda random, n: (0, 1) if n % 2 else (),
                               lambda random, n: ((1, 0, 2, 0)[n % 4],)), False),
        ('intermittent', Delivery(lambda random, n: () if random.random() < LOSS else (0,)),
         False)]
    burst = Delivery(
        lambda random, n: tuple(range(BURST))[::-1] if n % BURST == BURST - 1 else ())
    gap = Delivery(lambda random, n: ())
    return [Fault(kind, stream, delivery, REACTIONS[stream] if named else ())
            for stream in STREAMS for kind, delivery, named in ways] + [
        Fault('gap', stream, gap, where=IN_PROCESS, ticks=(1, 51)) for stream in STREAMS] + [
        Fault('burst', stream, burst, where=OVER_GRAPH) for stream in STREAMS]


def _place(values: Any, choice: Vector) -> tuple[Vector, int]:
    vector = np.array(values, dtype=float)
    return vector, int(choice[0] * vector.size)


def _sign(choice: Vector) -> float:
    return 1.0 if choice[1] < 0.5 else -1.0


def _put(number: float) -> Change:
    """Return a change that puts a number in a random place."""
    def change(values: Any, choice: Vector) -> Vector:
        vector, place = _place(values, choice)
        vector[place] = number
        return vector
    return change


def _add(size: float) -> Change:
    """Return a change that adds an offset in a random place, of a random sign."""
    def change(values: Any, choice: Vector) -> Vector:
        vector, place = _place(values, choice)
        vector[place] += size * _sign(choice)
        return vector
    return change


def _scale(factor: float) -> Change:
    return lambda values, choice: factor * np.array(values, dtype=float)


def _shorten(values: Any, _choice: Vector) -> Any:
    return values[:-1]


def _turn(values: Any, choice: Vector) -> Vector:
    """Turn force and torque by 90 degrees about a random axis."""
    axis = np.eye(3)[int(3 * choice[0])] * _sign(choice)
    rotation = Rotation.from_rotvec(0.5 * np.pi * axis).as_matrix()
    vector = np.array(values, dtype=float)
    return np.concatenate([rotation @ vector[:3], rotation @ vector[3:]])


def _rename(names: Sequence[str], _choice: Vector) -> list[str]:
    return [f'other_{name}' for name in names]


def _double(names: Sequence[str], _choice: Vector) -> list[str]:
    return [names[0], *names[:-1]]


def _edit(
    stream: str, fields: str, kind: str, change: Change | None, *, named: bool = True,
    declared: tuple[str, ...] = (), phases: tuple[str, ...] = PHASES,
    where: tuple[str, ...] = BOTH, at_once: bool = False,
) -> Fault:
    """Return a fault of what a reading says; `named` if the stream's reaction must follow."""
    return Fault(kind, stream, Edit(tuple(fields.split()), change),
                 (declared or REACTIONS[stream]) if named else (), phases, where, at_once=at_once)


def _numbers() -> list[Fault]:
    changes = {'nan': _put(NAN), 'infinite': _put(INF), 'huge': _put(1e30),
               'wrong_count': _shorten}
    return [
        *(_edit('joints', 'q', f'{kind}_q', change) for kind, change in changes.items()),
        *(_edit('joints', 'qd', f'{kind}_qd', change, declared=HOLD)
          for kind, change in changes.items()),
        _edit('wrench', 'wrench', 'nan', _put(NAN)),
        _edit('wrench', 'wrench', 'infinite', _put(-INF)),
        _edit('wrench', 'wrench', 'huge', _put(1e30)),
        # A message always has six numbers.
        _edit('wrench', 'wrench', 'wrong_count', _shorten, where=IN_PROCESS),
        _edit('wrench', 'wrench', 'saturated', _put(200.0), at_once=True),
        _edit('wrench', 'wrench', 'biased', _add(5.0), named=False),
        _edit('wrench', 'wrench', 'sign_flipped', _scale(-1.0), phases=(REST, SLIDING),
              at_once=True),
        _edit('wrench', 'wrench', 'rotated', _turn, named=False),
        _edit('wrench', 'wrench', 'scaled_x3', _scale(3.0), named=False, where=IN_PROCESS),
        _edit('wrench', 'wrench', 'half', _scale(0.5), named=False),
        _edit('variance', 'variance', 'nan', _put(NAN)),
        _edit('variance', 'variance', 'infinite', _put(INF)),
        _edit('variance', 'variance', 'zero', _put(0.0)),
        _edit('variance', 'variance', 'negative', _put(-1.0)),
        _edit('variance', 'variance', 'wrong_count', _shorten),
        _edit('variance', 'variance', 'huge', _put(1e30), named=False),
        _edit('variance', 'variance', 'tiny', _put(1e-30), named=False),
        _edit('joints', 'q', 'biased_q', _add(0.05)),
        _edit('joints', 'qd', 'biased_qd', _add(0.2), named=False),
        _edit('joints', 'qd', 'saturated_qd', _put(50.0), declared=HOLD, where=IN_PROCESS)]


def _names() -> list[Fault]:
    """Return the faults of the names in a message; readings in process have none."""
    changes = {'wrong_names': _rename, 'missing_name': _shorten, 'doubled_name': _double}
    return [_edit(stream, 'names', kind, change, where=OVER_GRAPH)
            for stream in ('joints', 'variance') for kind, change in changes.items()]


def _frozen() -> list[Fault]:
    """Return the faults in which values stand still while stamps go on."""
    moving = (SLIDING, APPROACH)
    return [
        _edit('joints', 'q qd', 'frozen', None, phases=moving),
        _edit('joints', 'q', 'frozen_q', None, phases=moving, where=IN_PROCESS),
        _edit('joints', 'qd', 'frozen_qd', None, named=False, where=IN_PROCESS),
        _edit('wrench', 'wrench', 'frozen', None),
        _edit('variance', 'variance', 'frozen', None, named=False)]


def _clocks() -> list[Fault]:
    def fault(kind: str, shift: Callable[[float, float], float], *, stamps: bool = True,
              declared: tuple[str, ...] = STOPPED, where: tuple[str, ...] = BOTH) -> Fault:
        return Fault(kind, CLOCK, ClockShift(shift, stamps), declared, where=where)

    return [
        fault('backwards', lambda since, begin: -0.05, stamps=False),
        fault('restarted', lambda since, begin: 2.0 * PERIOD - begin),
        fault('nan', lambda since, begin: NAN, stamps=False, where=IN_PROCESS),
        fault('stands_still', lambda since, begin: -since, stamps=False),
        fault('too_fast', lambda since, begin: 3.0 * (since + PERIOD)),
        fault('too_slow', lambda since, begin: -0.8 * (since + PERIOD), where=IN_PROCESS),
        fault('jump_ahead', lambda since, begin: 0.1, declared=(), where=IN_PROCESS),
        fault('ahead', lambda since, begin: 0.1, where=OVER_GRAPH),
        fault('zero', lambda since, begin: -INF, where=OVER_GRAPH)]


def _plants() -> list[Fault]:
    def surface(method: str, there: float, back: float | None) -> PlantEdit:
        def change(value: float) -> PlantChange:
            return lambda plant, choice: getattr(plant.contacts, method)(int(2 * choice[0]), value)

        return PlantEdit(change(there), None if back is None else change(back))

    def wall(number: int) -> PlantEdit:
        return PlantEdit(lambda plant, choice: plant.contacts.put_before_tip(number, 2e-3),
                         lambda plant, choice: plant.contacts.shift(number, FAR))

    def torque_limit(there: float, back: float) -> PlantEdit:
        return PlantEdit(lambda plant, choice: plant.scale_torque_limit(there),
                         lambda plant, choice: plant.scale_torque_limit(back))

    edits = {
        'stiffness_x20': surface('scale_stiffness', 20.0, 1.0 / 20.0),
        'stiffness_x5': surface('scale_stiffness', 5.0, 1.0 / 5.0),
        'stiffness_x0.2': surface('scale_stiffness', 0.2, 5.0),
        'surface_removed': surface('shift', 1.0, -1.0),
        'surface_gone': surface('shift', 1.0, None),
        'surface_jump_2mm_up': surface('shift', -2e-3, None),
        'surface_jump_2mm_down': surface('shift', 2e-3, None),
        'friction_x5': surface('scale_friction', 5.0, 0.2),
        'side_wall': wall(SIDE_WALL),
        'torque_limit_halved': torque_limit(0.5, 2.0),
        'torque_limit_to_a_fifth': torque_limit(0.2, 5.0)}
    return [*(Fault(kind, 'plant', edit, where=IN_PROCESS) for kind, edit in edits.items()),
            # It is met once the slide has turned round, as long as it takes.
            Fault('elbow_obstacle', 'plant', wall(ELBOW_WALL), where=IN_PROCESS,
                  ticks=(590, 600), meets=ELBOW_WALL)]


def _breakdowns() -> list[Fault]:
    """Return the failures of the program itself."""
    return [Fault('raises', part, Breakdown(part), where=IN_PROCESS) for part in PARTS]


KILL, HALT = ('kill',), ('halt',)


def _nodes() -> list[Fault]:
    """Return the faults of nodes and processes, by their names in a graph."""
    estimator, controller, recorder = 'noise_estimator_node', CONTROLLER, 'recorder_node'
    down, twice = ('deactivate',), ('deactivate', 'activate') * 2
    anew = ('deactivate', 'cleanup', 'configure')
    faults = [
        ('killed', estimator, KILL, True), ('killed', controller, KILL, False),
        ('killed', recorder, KILL, True), ('halted', estimator, HALT, True),
        ('halted', controller, HALT, False), ('halted', recorder, HALT, True),
        ('halted', 'sim_node', HALT, False), ('deactivated', estimator, down, True),
        ('deactivated', controller, down, True), ('reactivated', controller, twice, True),
        ('cleaned_up', estimator, anew, True), ('cleaned_up', controller, anew, False)]
    return [Fault(kind, node, NodeChange(steps), where=OVER_GRAPH, goes_on=goes_on)
            for kind, node, steps, goes_on in faults]


def _efforts(*efforts: float, names: Sequence[str] | None = None) -> Callable[[Any], None]:
    """Return a change of a command of forces, of the first contacts or under other names."""
    def change(message: Any) -> None:
        message.name = list(message.name[:max(1, len(efforts))] if names is None else names)
        message.effort = list(efforts)
    return change


def _set(path: str, value: float, *, add: bool = False) -> Callable[[Any], None]:
    """Return a change of one number of a message, by the names that lead to it."""
    *way, last = path.split('.')

    def change(message: Any) -> None:
        part = message
        for name in way:
            part = part[int(name)] if name.isdigit() else getattr(part, name)
        setattr(part, last, value + (getattr(part, last) if add else 0.0))
    return change


def _poses(count: int) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.transforms = (list(message.transforms) * count)[:count]
    return change


def _commands() -> list[Fault]:
    forces = {
        'nan': _efforts(NAN, 5.0), 'infinite': _efforts(5.0, INF), 'negative': _efforts(-5.0),
        'beyond_ceiling': _efforts(1000.0), 'wrong_count': _efforts(5.0, 5.0, names=['table']),
        'unknown_contact': _efforts(5.0, names=['nowhere']), 'empty': _efforts(names=[])}
    motions = {
        'nan': _set('transforms.0.translation.x', NAN),
        'nan_twist': _set('velocities.0.linear.y', NAN),
        'infinite': _set('accelerations.0.linear.z', INF),
        'no_pose': _poses(0), 'two_poses': _poses(2),
        'no_rotation': _set('transforms.0.rotation.w', 5.0),
        'outside_box': _set('transforms.0.translation.z', 50.0),
        'jump': _set('transforms.0.translation.x', JUMP, add=True)}
    # A stream of motions that ends, with the last twist in it.
    ends = {'ends_at_speed': 0.2, 'ends_too_fast': 10.0}
    return [Fault(kind, f'{topic} command', Command(change), where=OVER_GRAPH)
            for topic, changes in (('forces', forces), ('motion', motions))
            for kind, change in changes.items()] + [
        Fault(kind, 'motion command', Command(
            _set('velocities.0.linear.x', speed), last=True), where=OVER_GRAPH)
        for kind, speed in ends.items()]


def _velocities() -> list[Fault]:
    """Return the faults of speeds beside right positions, of all joints and of one."""
    edits = {
        'scaled_x0.02': Edit(('qd',), _scale(0.02)), 'scaled_x0.1': Edit(('qd',), _scale(0.1)),
        'in_degrees': Edit(('qd',), _scale(180.0 / math.pi)),
        'scaled_x60': Edit(('qd',), _scale(60.0)), 'sign_flipped': Edit(('qd',), _scale(-1.0)),
        'zero': Edit(('qd',), _scale(0.0)),
        'like_position': Edit(('qd',), _scale(1.0), source='q'),
        'constant': Edit(('qd',), lambda values, choice: np.full(len(values), 0.5)),
        'delayed': Edit(('qd',), None, age=25), 'frozen': Edit(('qd',), None)}
    named = ('constant_qd', 'like_position_qd')  # also of an arm that stands
    return [Fault(name := f'{kind}_{which}', 'joints', replace(edit, single=which == 'qd_of_one'),
                  STOPPED if name in named else (), where=IN_PROCESS, ticks=LASTING,
                  from_start=True)
            for kind, edit in edits.items() for which in ('qd', 'qd_of_one')
            if (kind, which) != ('frozen', 'qd')]


def _drivers() -> list[Fault]:
    """Return the faults of what is between an arm and its controller: units, tare, publishers."""
    def bias(share: float) -> Change:
        return lambda values, choice: values + FULL_SCALE * _put(share * _sign(choice))(
            np.zeros(6), choice)

    def command_twice(plant: Any, choice: Vector) -> None:
        step, mine = plant.step, cycle((True, False))
        plant.step = lambda torque: step(torque if next(mine) else plant.initial_torque)

    wrenches = {'millinewtons': _scale(1e3), 'kilonewtons': _scale(1e-3),
                **{f'biased_by_{share:.0%}': bias(share) for share in (0.1, 0.5, 1.0)}}
    return [
        *(Fault(kind, 'wrench', Edit(('wrench',), change), where=IN_PROCESS, ticks=LASTING,
                from_start=True) for kind, change in wrenches.items()),
        _edit('joints', 'q', 'wrapped_q', _add(2.0 * math.pi), named=False, where=IN_PROCESS),
        Fault('second_publisher', 'plant', PlantEdit(
            command_twice, lambda plant, choice: delattr(plant, 'step')), where=IN_PROCESS)]


FAULTS = (*_nodes(), *_deliveries(), *_numbers(), *_names(), *_frozen(), *_clocks(), *_plants(),
          *_breakdowns(), *_commands(), *_velocities(), *_drivers())


def faults_of(where: str) -> dict[tuple[str, str], Fault]:
    """Return all faults of a place by kind and input, in the order of the table."""
    return {(fault.kind, fault.input): fault for fault in FAULTS if where in fault.where}


def pairs_of_faults(count: int, seed: int) -> list[tuple[Fault, Fault]]:
    """Return faults of different things, two at a time, drawn among all that happen in process."""
    random = np.random.default_rng([seed, count])
    known = list(faults_of(PROCESS).values())
    pairs: list[tuple[Fault, Fault]] = []
    while len(pairs) < count:
        one, other = (known[int(k)] for k in random.integers(len(known), size=2))
        if one.input != other.input:
            pairs.append((one, other))
    return pairs
