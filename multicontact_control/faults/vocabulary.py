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

TWO_AT_ONCE = 'two at once'  # kind of a pair of faults
START, APPROACH, REST, SLIDING = 'start', 'approach', 'rest', 'sliding'
PHASES = (REST, SLIDING, APPROACH)

Random = np.random.Generator
# Each takes four numbers that are drawn once from (0, 1), and the old values or the plant.
ValueChange = Callable[[Any, Vector], Any]
PlantChange = Callable[[Any, Vector], None]
ClockError = Callable[[float, float], float]

HOLD, FLOAT, INFLATE = ('hold',), ('float',), ('inflate',)
STOPPED = ('hold', 'float', 'damp')
REACTIONS = {'joints': FLOAT, 'wrench': HOLD, 'variance': INFLATE}
CLOCK, PLANT = 'clock', 'plant'

NAN, INF = math.nan, math.inf
PERIOD = 0.002  # s, by which clocks are moved
LOSS = 0.3  # share of messages that an intermittent stream loses
FULL_SCALE = np.array(
    [100.0, 100.0, 200.0, 5.0, 5.0, 5.0]
)  # N, N m of the simulated sensor
LASTING = (300, 600)  # ticks of what is there from the start
SIDE_WALL, ELBOW_WALL = -2, -1  # surfaces that are no contacts: the last ones
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
    """
    Readings that come late, in another order, or never: another one than the newest.

    The stamps stay those of the delivered reading, so that a watchdog which compares ages sees the
    delay, as it would with a slow driver.
    """

    # How many ticks old the reading of each tick is, in turn; None for no reading.
    ages: tuple[int | None, ...] = (0,)
    stuck: bool = False  # every tick has the last reading from before the fault
    loss: float = 0.0  # share of readings that never come

    def age_of_reading(self, random: Random, tick: int) -> int | None:
        """
        Return how many ticks old the reading of a tick of the fault is, None for no reading.

        Ticks count from 0 at the fault's beginning. Losses are drawn anew from `random` in each
        tick; all other deliveries repeat without chance.
        """
        if self.stuck:
            return tick + 1
        if self.loss and random.random() < self.loss:
            return None
        return self.ages[tick % len(self.ages)]


@dataclass(frozen=True)
class ReadingEdit:
    """
    Other values in some fields of a reading (``q qd wrench variance``); stamps go on.

    Nothing about time is wrong then: only the plausibility checks of the values, or the law
    itself, can answer it.
    """

    fields: tuple[str, ...]
    change: ValueChange | None  # None keeps the values of the first reading
    source: str = (
        ''  # field whose values are changed into those of `fields`; '' for their own
    )
    age: int = (
        0  # how many readings ago the values without a change were; 0 for the first
    )
    single: bool = False  # one number of each field, in a random place, and not all

    def edited_values(
        self,
        now: Mapping[str, Any],
        first: Mapping[str, Any],
        choice: Vector,
    ) -> dict[str, Any]:
        """
        Return what the fields become; the arrays of `now` stay as they are.

        With `single`, one number of each field takes its new value and the others stay, as of one
        broken encoder.

        Parameters
        ----------
        now, first
            Values by field: of the reading, and of the first one during the fault.
        choice
            Four numbers from (0, 1), which decide on places and signs.

        """
        edited = {}
        for name in self.fields:
            if self.change is None:
                values = first[name]
            else:
                values = self.change(now[self.source or name], choice)
            if self.single:
                vector = _vector(now[name])
                place = _random_place(vector, choice)
                vector[place] = values[place]
                values = vector
            edited[name] = values
        return edited


@dataclass(frozen=True)
class ClockShift:
    """
    A clock that goes wrong, with the stamps of the readings or without.

    With the stamps the whole computer's clock is wrong, and all ages look right; without them
    readings seem to come from the future or the past.
    """

    # By how much, from the time since the fault began and the time when it did [s].
    shift: ClockError
    stamps: bool = True


@dataclass(frozen=True)
class Breakdown:
    """
    A part of the supervisor, by the names that lead to it, that raises whenever called.

    It stands for our own mistakes: whatever raises within a tick must become a declared reaction.
    `PARTS` are what is broken.
    """

    part: str


@dataclass(frozen=True)
class PlantEdit:
    """
    What is done to the plant at the beginning and at the end of a fault, if anything.

    The controller is not told. Without `end` the change is for good, as of a surface that is gone.
    """

    begin: PlantChange
    end: PlantChange | None = None


@dataclass(frozen=True)
class Fault:
    """
    One kind of fault: what is done to which input, and what must follow.

    A pair of faults is one with `parts` and neither input nor action of its own.
    """

    kind: str
    input: str  # noqa: A003
    action: Any  # one of the above
    # Reactions of which one must be in force two ticks after the beginning; none if the fault
    # cannot be told from a good input or is bridged.
    declared: tuple[str, ...] = ()
    phases: tuple[str, ...] = PHASES  # in which it can be noticed at all
    # Whether a declared reaction may not wait until the reading is too old.
    at_once: bool = False
    ticks: tuple[int, int] = (5, 150)  # how long it lasts, at least and less than
    # Whether it also happens from the first sample on; joint speeds are judged.
    from_start: bool = False
    obstacle: int | None = None  # that the arm meets before its sensor, and must notice
    parts: tuple[Fault, ...] = ()  # what happens at the same time, of two faults

    @property
    def single_faults(self) -> tuple[Fault, ...]:
        """
        Return the faults that happen at the same time: those of a pair, or this one alone.

        Readers of a fault's action go through them, since a pair has none of its own.
        """
        return self.parts or (self,)

    @property
    def breaks_part(self) -> bool:
        """
        Whether a part of the supervisor raises on purpose.

        An internal error in the run's status is then expected, and its log is kept silent; in
        every other fault it is a problem by itself.
        """
        return any(isinstance(each.action, Breakdown) for each in self.single_faults)

    @property
    def allows_return(self) -> bool:
        """
        Whether the arm can do again what it did, once the fault has passed.

        So it is after a delivery, a breakdown, or what is noticed and answered. A surface that is
        gone, or a bias that is believed, leaves it elsewhere.
        """
        return all(
            isinstance(each.action, (Delivery, Breakdown)) or bool(each.declared)
            for each in self.single_faults
        )

    def random_source(self, seed: int) -> Random:
        """
        Return the source of the details of this fault, another one for each kind and input.

        The seed and the letters of both names decide, so that a fault repeats bit by bit, also
        when others are added to the campaign.
        """
        letters = sum(ord(letter) for letter in self.kind + self.input)
        return np.random.default_rng([seed, letters])


def _vector(values: Any) -> Vector:
    """Return a copy as floats: edits must not reach the history of readings."""
    return np.array(values, dtype=float)


def _sign(choice: Vector) -> float:
    """Return the sign that the second draw stands for."""
    return 1.0 if choice[1] < 0.5 else -1.0


def _random_place(vector: Vector, choice: Vector) -> int:
    """Return the index that the first draw stands for."""
    return int(choice[0] * vector.size)


def _put(number: float) -> ValueChange:
    """Return a change of one number, in a random place, into another."""

    def change(values: Any, choice: Vector) -> Vector:
        """Put `number` in the place that the first draw chooses."""
        vector = _vector(values)
        vector[_random_place(vector, choice)] = number
        return vector

    return change


def _add(size: float) -> ValueChange:
    """Return a change of one number, in a random place, by a size with a random sign."""

    def change(values: Any, choice: Vector) -> Vector:
        """Add the size in the place that the first draw chooses, with the sign of the second."""
        vector = _vector(values)
        vector[_random_place(vector, choice)] += size * _sign(choice)
        return vector

    return change


def _scale(factor: float) -> ValueChange:
    """Return a change of all numbers by a factor."""

    def change(values: Any, _choice: Vector) -> Vector:
        """Scale every number; the draws do not matter."""
        return factor * _vector(values)

    return change


def _bias(share: float) -> ValueChange:
    """Return a change of one number of a wrench by a share of the sensor's range."""
    add_share = _add(share)

    def change(values: Any, choice: Vector) -> Vector:
        """Add the share of its own range, 100 to 200 N or 5 N m, to one number of six."""
        return _vector(values) + FULL_SCALE * add_share(np.zeros(6), choice)

    return change


def _shorten(values: Any, _choice: Vector) -> Any:
    """Leave out the last number: a reading of the wrong length."""
    return values[:-1]


def _make_constant(values: Any, _choice: Vector) -> Vector:
    """Put 0.5 everywhere, which is plausible as an angle [rad] and as a speed [rad/s]."""
    return np.full(len(values), 0.5)


def _turn(values: Any, choice: Vector) -> Vector:
    """Turn force and torque by 90 degrees about a random axis."""
    axis = np.eye(3)[int(3 * choice[0])] * _sign(choice)
    rotation = Rotation.from_rotvec(0.5 * np.pi * axis).as_matrix()
    force, torque = np.split(_vector(values), 2)
    return np.concatenate([rotation @ force, rotation @ torque])


DELIVERIES = {  # by kind: how readings come, and whether that must be noticed
    'dropped': (Delivery((None,)), True),
    'delayed': (Delivery((4,)), True),
    'stuck': (Delivery(stuck=True), True),
    'out_of_order': (Delivery((25,)), True),
    'duplicated': (Delivery((0, 1)), False),
    'reordered': (Delivery((1, 0, 2, 0)), False),
    'intermittent': (Delivery(loss=LOSS), False),
}


def _delivery_faults() -> Iterator[Fault]:
    """Yield the faults of delivery of every stream of readings."""
    for stream, reactions in REACTIONS.items():
        for kind, (delivery, is_noticed) in DELIVERIES.items():
            declared = reactions if is_noticed else ()
            yield Fault(kind, stream, delivery, declared)
    for stream in REACTIONS:
        yield Fault('gap', stream, Delivery((None,)), ticks=(1, 51))


def _joint_fault(
    kind: str,
    fields: str,
    change: ValueChange | None,
    declared: tuple[str, ...] = FLOAT,
    phases: tuple[str, ...] = PHASES,
) -> Fault:
    edit = ReadingEdit(tuple(fields.split()), change)
    return Fault(kind, 'joints', edit, declared, phases)


def _wrench_fault(
    kind: str,
    change: ValueChange | None,
    declared: tuple[str, ...] = HOLD,
    phases: tuple[str, ...] = PHASES,
    *,
    at_once: bool = False,
) -> Fault:
    edit = ReadingEdit(('wrench',), change)
    return Fault(kind, 'wrench', edit, declared, phases, at_once)


def _variance_fault(
    kind: str, change: ValueChange | None, declared: tuple[str, ...] = INFLATE
) -> Fault:
    return Fault(kind, 'variance', ReadingEdit(('variance',), change), declared)


def _value_faults() -> Iterator[Fault]:
    """Yield the faults of the values in readings, and of values that stand still."""
    invalid = {
        'nan': _put(NAN),
        'infinite': _put(INF),
        'huge': _put(1e30),
        'wrong_count': _shorten,
    }
    for field, declared in (('q', FLOAT), ('qd', HOLD)):
        for kind, change in invalid.items():
            yield _joint_fault(f'{kind}_{field}', field, change, declared)
    yield from (
        _wrench_fault('nan', _put(NAN)),
        _wrench_fault('infinite', _put(-INF)),
        _wrench_fault('huge', _put(1e30)),
        _wrench_fault('wrong_count', _shorten),
        _wrench_fault('saturated', _put(200.0), at_once=True),
        _wrench_fault('biased', _add(5.0), ()),
        _wrench_fault(
            'sign_flipped', _scale(-1.0), phases=(REST, SLIDING), at_once=True
        ),
        _wrench_fault('rotated', _turn, ()),
        _wrench_fault('scaled_x3', _scale(3.0), ()),
        _wrench_fault('half', _scale(0.5), ()),
        _variance_fault('nan', _put(NAN)),
        _variance_fault('infinite', _put(INF)),
        _variance_fault('zero', _put(0.0)),
        _variance_fault('negative', _put(-1.0)),
        _variance_fault('wrong_count', _shorten),
        _variance_fault('huge', _put(1e30), ()),
        _variance_fault('tiny', _put(1e-30), ()),
        _joint_fault('biased_q', 'q', _add(0.05)),
        _joint_fault('biased_qd', 'qd', _add(0.2), ()),
        _joint_fault('saturated_qd', 'qd', _put(50.0), HOLD),
        _joint_fault('frozen', 'q qd', None, phases=(SLIDING, APPROACH)),
        _joint_fault('frozen_q', 'q', None, phases=(SLIDING, APPROACH)),
        _joint_fault('frozen_qd', 'qd', None, ()),
        _wrench_fault('frozen', None),
        _variance_fault('frozen', None, ()),
    )


def _jump(size: float) -> ClockError:
    def shift(_since: float, _begin: float) -> float:
        """Return the same shift [s] throughout the fault."""
        return size

    return shift


def _drift(rate: float) -> ClockError:
    def shift(since: float, _begin: float) -> float:
        """Return a shift [s] that grows from one period in the first tick on."""
        return rate * (since + PERIOD)

    return shift


def _stand_still(since: float, _begin: float) -> float:
    """Return the shift [s] by which the clock stays where the fault began."""
    return -since


def _restart(_since: float, begin: float) -> float:
    """Return the shift [s] to a clock that starts again near 0, as of a driver that comes back."""
    return 2.0 * PERIOD - begin


def _clock_faults() -> Iterator[Fault]:
    """Yield the faults of the clock that a tick reads."""
    yield from (
        Fault('backwards', CLOCK, ClockShift(_jump(-0.05), stamps=False), STOPPED),
        Fault('restarted', CLOCK, ClockShift(_restart), STOPPED),
        Fault('nan', CLOCK, ClockShift(_jump(NAN), stamps=False), STOPPED),
        Fault('stands_still', CLOCK, ClockShift(_stand_still, stamps=False), STOPPED),
        Fault('too_fast', CLOCK, ClockShift(_drift(3.0)), STOPPED),
        Fault('too_slow', CLOCK, ClockShift(_drift(-0.8)), STOPPED),
        Fault('jump_ahead', CLOCK, ClockShift(_jump(0.1))),
    )


def _change_surface(method: str, value: float) -> PlantChange:
    """Return what calls a method of the contacts with one of the first two, and a value."""

    def change(plant: Any, choice: Vector) -> None:
        """Call the method with the first or second surface, as the first draw chooses."""
        getattr(plant.contacts, method)(int(2 * choice[0]), value)

    return change


def _surface_fault(
    kind: str, method: str, begin: float, end: float | None = None
) -> Fault:
    """Return a fault of a surface, whose method is called at its beginning and at its end."""
    undo = None if end is None else _change_surface(method, end)
    return Fault(kind, PLANT, PlantEdit(_change_surface(method, begin), undo))


def _put_wall(number: int) -> PlantEdit:
    """Return what puts an obstacle before the tip, and takes it away."""

    def begin(plant: Any, _choice: Vector) -> None:
        """Put the obstacle 2 mm before the point that it is there for."""
        plant.contacts.put_before_tip(number, 2e-3)

    def end(plant: Any, _choice: Vector) -> None:
        """Take the obstacle out of the way."""
        plant.contacts.shift_surface(number, FAR)

    return PlantEdit(begin, end)


def _limit_torque(factor: float) -> PlantEdit:
    """Return what scales the torque that the drives can give, and undoes that."""

    def begin(plant: Any, _choice: Vector) -> None:
        """Scale what the drives give; the controller's own limit stays."""
        plant.scale_torque_limit(factor)

    def end(plant: Any, _choice: Vector) -> None:
        """Give the drives their limit back."""
        plant.scale_torque_limit(1.0 / factor)

    return PlantEdit(begin, end)


def _plant_faults() -> Iterator[Fault]:
    """Yield the changes of surfaces, obstacles and drives."""
    yield from (
        _surface_fault('stiffness_x20', 'scale_stiffness', 20.0, 1.0 / 20.0),
        _surface_fault('stiffness_x5', 'scale_stiffness', 5.0, 1.0 / 5.0),
        _surface_fault('stiffness_x0.2', 'scale_stiffness', 0.2, 5.0),
        _surface_fault('surface_removed', 'shift_surface', 1.0, -1.0),
        _surface_fault('surface_gone', 'shift_surface', 1.0),
        _surface_fault('surface_jump_2mm_up', 'shift_surface', -2e-3),
        _surface_fault('surface_jump_2mm_down', 'shift_surface', 2e-3),
        _surface_fault('friction_x5', 'scale_friction', 5.0, 0.2),
        Fault('side_wall', PLANT, _put_wall(SIDE_WALL)),
        Fault('torque_limit_halved', PLANT, _limit_torque(0.5)),
        Fault('torque_limit_to_a_fifth', PLANT, _limit_torque(0.2)),
        # It is met once the slide has turned round, as long as it takes.
        Fault(
            'elbow_obstacle',
            PLANT,
            _put_wall(ELBOW_WALL),
            ticks=(590, 600),
            obstacle=ELBOW_WALL,
        ),
    )


def _velocity_faults() -> Iterator[Fault]:
    """Yield the faults of speeds beside right positions, of all joints and of one."""
    fields = ('qd',)
    edits = {
        'scaled_x0.02': ReadingEdit(fields, _scale(0.02)),
        'scaled_x0.1': ReadingEdit(fields, _scale(0.1)),
        'in_degrees': ReadingEdit(fields, _scale(180.0 / math.pi)),
        'scaled_x60': ReadingEdit(fields, _scale(60.0)),
        'sign_flipped': ReadingEdit(fields, _scale(-1.0)),
        'zero': ReadingEdit(fields, _scale(0.0)),
        'like_position': ReadingEdit(fields, _scale(1.0), source='q'),
        'constant': ReadingEdit(fields, _make_constant),
        'delayed': ReadingEdit(fields, None, age=25),
        'frozen': ReadingEdit(fields, None),
    }
    noticed_at_rest = ('constant_qd', 'like_position_qd')
    for kind, edit in edits.items():
        for which in ('qd', 'qd_of_one'):
            name = f'{kind}_{which}'
            if name == 'frozen_qd':  # one of the values above
                continue
            yield Fault(
                name,
                'joints',
                replace(edit, single=which == 'qd_of_one'),
                STOPPED if name in noticed_at_rest else (),
                ticks=LASTING,
                from_start=True,
            )


def _publish_twice(plant: Any, _choice: Vector) -> None:
    """Let every second command be that of a publisher which holds the arm where it started."""
    step = plant.step
    own_turns = cycle((True, False))

    def step_in_turn(torque: Vector) -> Any:
        """Pass on every second torque, and the plant's first one [N m] in between."""
        return step(torque if next(own_turns) else plant.initial_torque)

    plant.step = step_in_turn


def _publish_once(plant: Any, _choice: Vector) -> None:
    """Take the wrapper off again: the plant's own `step` is that of its class."""
    del plant.step


def _driver_faults() -> Iterator[Fault]:
    """Yield the faults of what is between an arm and its controller: units, tare, publishers."""
    wrenches = {'millinewtons': _scale(1e3), 'kilonewtons': _scale(1e-3)}
    for share in (0.1, 0.5, 1.0):
        wrenches[f'biased_by_{share:.0%}'] = _bias(share)
    for kind, change in wrenches.items():
        edit = ReadingEdit(('wrench',), change)
        yield Fault(kind, 'wrench', edit, ticks=LASTING, from_start=True)
    yield _joint_fault('wrapped_q', 'q', _add(2.0 * math.pi), ())
    yield Fault('second_publisher', PLANT, PlantEdit(_publish_twice, _publish_once))


def _breakdown_faults() -> Iterator[Fault]:
    """Yield a fault for every part of a tick that can raise."""
    for part in PARTS:
        yield Fault('raises', part, Breakdown(part))


# By kind and input.
FAULTS: dict[tuple[str, str], Fault] = {
    (fault.kind, fault.input): fault
    for fault in (
        *_delivery_faults(),
        *_value_faults(),
        *_clock_faults(),
        *_plant_faults(),
        *_breakdown_faults(),
        *_velocity_faults(),
        *_driver_faults(),
    )
}


def combine_faults(*faults: Fault) -> Fault:
    """
    Return several faults as one of which no reaction is declared; a single one as it is.

    Either of two may hide the other or ask for another reaction. What holds for every fault
    (limits of torque, rate and force) is still judged.
    """
    if len(faults) == 1:
        return faults[0]
    obstacles = [fault.obstacle for fault in faults if fault.obstacle is not None]
    obstacle = obstacles[0] if obstacles else None
    return Fault(TWO_AT_ONCE, '', None, obstacle=obstacle, parts=faults)


def draw_pairs(count: int, seed: int) -> list[tuple[tuple[str, str], ...]]:
    """
    Return the names of faults of different inputs, two at a time, drawn at random.

    Two of one input would overwrite each other's values. A pair may come twice; the same `count`
    and `seed` give the same list.
    """
    random = np.random.default_rng([seed, count])
    known = list(FAULTS)
    pairs: list[tuple[tuple[str, str], ...]] = []
    while len(pairs) < count:
        first, second = random.integers(len(known), size=2)
        pair = (known[first], known[second])
        inputs = {name for _, name in pair}
        if len(inputs) == 2:
            pairs.append(pair)
    return pairs
