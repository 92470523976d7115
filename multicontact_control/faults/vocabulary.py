"""What a fault is, and the faults of the campaign: what is done to what, what must follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import cycle
import math
from typing import Any

from multicontact_control.arrays import Vector
import numpy as np
from scipy.spatial.transform import Rotation

TWO = 'two at once'
START, APPROACH, REST, SLIDING = 'start', 'approach', 'rest', 'sliding'
PHASES = (REST, SLIDING, APPROACH)

Random = np.random.Generator
Change = Callable[
    [Any, Vector], Any
]  # of old values and four numbers drawn once from (0, 1)
PlantChange = Callable[[Any, Vector], None]

HOLD, FLOAT, INFLATE = ('hold',), ('float',), ('inflate',)
STOPPED = ('hold', 'float', 'damp')
REACTIONS = {'joints': FLOAT, 'wrench': HOLD, 'variance': INFLATE}
CLOCK = 'clock'

NAN, INF = math.nan, math.inf
PERIOD = 0.002  # s, by which clocks are moved
LOSS = 0.3  # share of messages that an intermittent stream loses
FULL_SCALE = np.array(
    [100.0, 100.0, 200.0, 5.0, 5.0, 5.0]
)  # N, N m of the simulated sensor
LASTING = (300, 600)  # ticks of what is there from the start
SIDE_WALL, ELBOW_WALL = (
    -2,
    -1,
)  # numbers of surfaces that are no contacts: the last ones
FAR = 10.0  # m, where they are not in the way
# What a tick calls of a supervisor, one after the other.
PARTS = (
    'inputs.validate',
    'controller.robot.compute',
    'task.update_wanted_task',
    'reactions.reaction_torque',
    'gate.apply_torque',
)


@dataclass(frozen=True)
class Delivery:
    """Another reading than the newest: from how many ticks ago in the n-th tick, or none."""

    age: Callable[[Random, int], int | None]


@dataclass(frozen=True)
class Edit:
    """Other values in some fields of a reading (``q qd wrench variance``); stamps go on."""

    fields: tuple[str, ...]
    change: Change | None  # None keeps the values of the first reading
    source: str = (
        ''  # field whose values are changed into those of `fields`; '' for their own
    )
    age: int = (
        0  # how many readings ago the values without a change were; 0 for the first
    )
    single: bool = False  # one number of each field, in a random place, and not all

    def values(
        self,
        now: Mapping[str, Any],
        first: Mapping[str, Any],
        choice: Vector,
    ) -> dict[str, Any]:
        """Return what the fields become, from a reading and the first one during the fault."""
        values = {}
        for name in self.fields:
            values[name] = (
                first[name]
                if self.change is None
                else (self.change(now[self.source or name], choice))
            )
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
    at_once: bool = (
        False  # a declared reaction may not wait until the reading is too old
    )
    ticks: tuple[int, int] = (5, 150)  # how long it lasts, at least and less than
    from_start: bool = (
        False  # also happens from the first sample on; joint speeds are judged
    )
    meets: int | None = (
        None  # obstacle that the arm meets before its sensor and must notice
    )
    parts: tuple[Fault, ...] = ()  # what happens at the same time, of two faults

    @property
    def passes(self) -> bool:
        """Whether the arm can do again what it did, once it has passed, with all its parts."""
        return all(
            isinstance(part.action, (Delivery, Breakdown)) or bool(part.declared)
            for part in self.parts or (self,)
        )

    def random(self, seed: int) -> Random:
        """Return the source of the details of this fault."""
        return np.random.default_rng([seed, sum(map(ord, self.kind + self.input))])


def _vector(values: Any) -> Vector:
    return np.array(values, dtype=float)


def _sign(choice: Vector) -> float:
    return 1.0 if choice[1] < 0.5 else -1.0


def _one(new: Callable[[float, float], float]) -> Change:
    """Return a change of a number in a random place, by its value and a random sign."""

    def change(values: Any, choice: Vector) -> Vector:
        vector = _vector(values)
        place = int(choice[0] * vector.size)
        vector[place] = new(vector[place], _sign(choice))
        return vector

    return change


def _put(number: float) -> Change:
    return _one(lambda value, sign: number)


def _add(size: float) -> Change:
    return _one(lambda value, sign: value + size * sign)


def _scale(factor: float) -> Change:
    return lambda values, choice: factor * _vector(values)


def _shorten(values: Any, _choice: Vector) -> Any:
    return values[:-1]


def _turn(values: Any, choice: Vector) -> Vector:
    """Turn force and torque by 90 degrees about a random axis."""
    axis = np.eye(3)[int(3 * choice[0])] * _sign(choice)
    rotation = Rotation.from_rotvec(0.5 * np.pi * axis)
    return np.concatenate(
        [rotation.as_matrix() @ part for part in np.split(_vector(values), 2)]
    )


def _deliveries() -> Iterator[Fault]:
    """Yield the faults of delivery of every stream: kind, age, and whether it must be noticed."""
    ways: tuple[tuple[str, Callable[[Any, int], int | None], bool], ...] = (
        ('dropped', lambda random, n: None, True),
        ('delayed', lambda random, n: 4, True),
        ('stuck', lambda random, n: n + 1, True),
        ('out_of_order', lambda random, n: 25, True),
        ('duplicated', lambda random, n: n % 2, False),
        ('reordered', lambda random, n: (1, 0, 2, 0)[n % 4], False),
        (
            'intermittent',
            lambda random, n: None if random.random() < LOSS else 0,
            False,
        ),
    )
    for stream, reactions in REACTIONS.items():
        for kind, age, noticed in ways:
            yield Fault(kind, stream, Delivery(age), reactions if noticed else ())
    for stream in REACTIONS:
        yield Fault('gap', stream, Delivery(lambda random, n: None), ticks=(1, 51))


def _edits() -> Iterator[Fault]:
    """Yield the faults of the values in readings, and of values that stand still."""

    def edit(
        stream: str, fields: str, kind: str, change: Change | None, **options: Any
    ) -> Fault:
        return Fault(
            kind,
            stream,
            Edit(tuple(fields.split()), change),
            **{'declared': REACTIONS[stream], **options},
        )

    wrong = {
        'nan': _put(NAN),
        'infinite': _put(INF),
        'huge': _put(1e30),
        'wrong_count': _shorten,
    }
    for field, declared in (('q', FLOAT), ('qd', HOLD)):
        for kind, change in wrong.items():
            yield edit('joints', field, f'{kind}_{field}', change, declared=declared)
    for kind, change, options in (
        ('nan', _put(NAN), {}),
        ('infinite', _put(-INF), {}),
        ('huge', _put(1e30), {}),
        ('wrong_count', _shorten, {}),
        ('saturated', _put(200.0), {'at_once': True}),
        ('biased', _add(5.0), {'declared': ()}),
        ('sign_flipped', _scale(-1.0), {'phases': (REST, SLIDING), 'at_once': True}),
        ('rotated', _turn, {'declared': ()}),
        ('scaled_x3', _scale(3.0), {'declared': ()}),
        ('half', _scale(0.5), {'declared': ()}),
    ):
        yield edit('wrench', 'wrench', kind, change, **options)
    for kind, change, options in (
        ('nan', _put(NAN), {}),
        ('infinite', _put(INF), {}),
        ('zero', _put(0.0), {}),
        ('negative', _put(-1.0), {}),
        ('wrong_count', _shorten, {}),
        ('huge', _put(1e30), {'declared': ()}),
        ('tiny', _put(1e-30), {'declared': ()}),
    ):
        yield edit('variance', 'variance', kind, change, **options)
    yield edit('joints', 'q', 'biased_q', _add(0.05))
    yield edit('joints', 'qd', 'biased_qd', _add(0.2), declared=())
    yield edit('joints', 'qd', 'saturated_qd', _put(50.0), declared=HOLD)
    yield edit('joints', 'q qd', 'frozen', None, phases=(SLIDING, APPROACH))
    yield edit('joints', 'q', 'frozen_q', None, phases=(SLIDING, APPROACH))
    yield edit('joints', 'qd', 'frozen_qd', None, declared=())
    yield edit('wrench', 'wrench', 'frozen', None)
    yield edit('variance', 'variance', 'frozen', None, declared=())


def _clocks() -> Iterator[Fault]:
    for kind, shift, stamps, declared in (
        ('backwards', lambda since, begin: -0.05, False, STOPPED),
        ('restarted', lambda since, begin: 2.0 * PERIOD - begin, True, STOPPED),
        ('nan', lambda since, begin: NAN, False, STOPPED),
        ('stands_still', lambda since, begin: -since, False, STOPPED),
        ('too_fast', lambda since, begin: 3.0 * (since + PERIOD), True, STOPPED),
        ('too_slow', lambda since, begin: -0.8 * (since + PERIOD), True, STOPPED),
        ('jump_ahead', lambda since, begin: 0.1, True, ()),
    ):
        yield Fault(kind, CLOCK, ClockShift(shift, stamps), declared)


def _plants() -> Iterator[Fault]:
    def surface(method: str, value: float) -> PlantChange:
        return lambda plant, choice: getattr(plant.contacts, method)(
            int(2 * choice[0]), value
        )

    def wall(number: int) -> PlantEdit:
        return PlantEdit(
            lambda plant, choice: plant.contacts.put_before_tip(number, 2e-3),
            lambda plant, choice: plant.contacts.shift_surface(number, FAR),
        )

    def torque_limit(factor: float) -> PlantEdit:
        return PlantEdit(
            lambda plant, choice: plant.scale_torque_limit(factor),
            lambda plant, choice: plant.scale_torque_limit(1.0 / factor),
        )

    for kind, method, there, back in (
        ('stiffness_x20', 'scale_stiffness', 20.0, 1.0 / 20.0),
        ('stiffness_x5', 'scale_stiffness', 5.0, 1.0 / 5.0),
        ('stiffness_x0.2', 'scale_stiffness', 0.2, 5.0),
        ('surface_removed', 'shift_surface', 1.0, -1.0),
        ('surface_gone', 'shift_surface', 1.0, None),
        ('surface_jump_2mm_up', 'shift_surface', -2e-3, None),
        ('surface_jump_2mm_down', 'shift_surface', 2e-3, None),
        ('friction_x5', 'scale_friction', 5.0, 0.2),
    ):
        yield Fault(
            kind,
            'plant',
            PlantEdit(
                surface(method, there), None if back is None else surface(method, back)
            ),
        )
    yield Fault('side_wall', 'plant', wall(SIDE_WALL))
    yield Fault('torque_limit_halved', 'plant', torque_limit(0.5))
    yield Fault('torque_limit_to_a_fifth', 'plant', torque_limit(0.2))
    # It is met once the slide has turned round, as long as it takes.
    yield Fault(
        'elbow_obstacle', 'plant', wall(ELBOW_WALL), ticks=(590, 600), meets=ELBOW_WALL
    )


def _velocities() -> Iterator[Fault]:
    """Yield the faults of speeds beside right positions, of all joints and of one."""
    edits = {
        'scaled_x0.02': Edit(('qd',), _scale(0.02)),
        'scaled_x0.1': Edit(('qd',), _scale(0.1)),
        'in_degrees': Edit(('qd',), _scale(180.0 / math.pi)),
        'scaled_x60': Edit(('qd',), _scale(60.0)),
        'sign_flipped': Edit(('qd',), _scale(-1.0)),
        'zero': Edit(('qd',), _scale(0.0)),
        'like_position': Edit(('qd',), _scale(1.0), source='q'),
        'constant': Edit(('qd',), lambda values, choice: np.full(len(values), 0.5)),
        'delayed': Edit(('qd',), None, age=25),
        'frozen': Edit(('qd',), None),
    }
    noticed = ('constant_qd', 'like_position_qd')  # also of an arm that stands
    for kind, edit in edits.items():
        for which in ('qd', 'qd_of_one'):
            if (kind, which) != ('frozen', 'qd'):
                name = f'{kind}_{which}'
                yield Fault(
                    name,
                    'joints',
                    replace(edit, single=which == 'qd_of_one'),
                    STOPPED if name in noticed else (),
                    ticks=LASTING,
                    from_start=True,
                )


def _drivers() -> Iterator[Fault]:
    """Yield the faults of what is between an arm and its controller: units, tare, publishers."""

    def bias(share: float) -> Change:
        return lambda values, choice: (
            values + FULL_SCALE * _add(share)(np.zeros(6), choice)
        )

    def command_twice(plant: Any, choice: Vector) -> None:
        step, mine = plant.step, cycle((True, False))
        plant.step = lambda torque: step(torque if next(mine) else plant.initial_torque)

    wrenches = {
        'millinewtons': _scale(1e3),
        'kilonewtons': _scale(1e-3),
        **{f'biased_by_{share:.0%}': bias(share) for share in (0.1, 0.5, 1.0)},
    }
    for kind, change in wrenches.items():
        yield Fault(
            kind, 'wrench', Edit(('wrench',), change), ticks=LASTING, from_start=True
        )
    yield Fault('wrapped_q', 'joints', Edit(('q',), _add(2.0 * math.pi)))
    yield Fault(
        'second_publisher',
        'plant',
        PlantEdit(command_twice, lambda plant, choice: delattr(plant, 'step')),
    )


# By kind and input.
FAULTS: dict[tuple[str, str], Fault] = {
    (fault.kind, fault.input): fault
    for fault in (
        *_deliveries(),
        *_edits(),
        *_clocks(),
        *_plants(),
        *(Fault('raises', part, Breakdown(part)) for part in PARTS),
        *_velocities(),
        *_drivers(),
    )
}


def together(*faults: Fault) -> Fault:
    """Return several faults as one of which no reaction is declared; a single one as it is."""
    meets = [fault.meets for fault in faults if fault.meets is not None]
    return (
        faults[0]
        if len(faults) == 1
        else Fault(TWO, '', None, meets=meets[0] if meets else None, parts=faults)
    )


def pairs_of_faults(count: int, seed: int) -> list[tuple[tuple[str, str], ...]]:
    """Return the names of faults of different inputs, two at a time, drawn at random."""
    random, known = np.random.default_rng([seed, count]), list(FAULTS)
    pairs: list[tuple[tuple[str, str], ...]] = []
    while len(pairs) < count:
        one, other = (known[int(k)] for k in random.integers(len(known), size=2))
        if one[1] != other[1]:
            pairs.append((one, other))
    return pairs
