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
START = 'start'
APPROACH = 'approach'
REST = 'rest'
SLIDING = 'sliding'
PHASES = (REST, SLIDING, APPROACH)

Random = np.random.Generator
# Each takes four numbers that are drawn once from (0, 1), and the old values or the plant.
ValueChange = Callable[[Any, Vector], Any]
PlantChange = Callable[[Any, Vector], None]
ClockError = Callable[[float, float], float]

HOLD = ('hold',)
FLOAT = ('float',)
INFLATE = ('inflate',)
STOPPED = ('hold', 'float', 'damp')
REACTIONS = {'joints': FLOAT, 'wrench': HOLD, 'variance': INFLATE}
CLOCK = 'clock'
PLANT = 'plant'

PERIOD = 0.002  # s, by which clocks are moved
LOSS = 0.3  # share of messages that an intermittent stream loses
# Of the simulated sensor [N, N m].
FULL_SCALE = np.array([100.0, 100.0, 200.0, 5.0, 5.0, 5.0])
LASTING = (300, 600)  # ticks of what is there from the start
# Surfaces that are no contacts: the last ones.
SIDE_WALL = -2
ELBOW_WALL = -1
FAR = 10.0  # m, where they are not in the way
# What a tick calls of a supervisor, one after the other.
PARTS = (
    'inputs.validate',
    'controller.robot.compute',
    'task.update_wanted_task',
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
    # Field whose values are changed into those of `fields`; '' for their own.
    source: str = ''
    # How many readings ago the values without a change were; 0 for the first.
    age: int = 0
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
                vector = _copy_as_floats(now[name])
                place = _choose_place(vector, choice)
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
        for fault in self.single_faults:
            if isinstance(fault.action, Breakdown):
                return True
        return False

    @property
    def allows_return(self) -> bool:
        """
        Whether the arm can do again what it did, once the fault has passed.

        So it is after a delivery, a breakdown, or what is noticed and answered. A surface that is
        gone, or a bias that is believed, leaves it elsewhere.
        """
        for fault in self.single_faults:
            passes = isinstance(fault.action, (Delivery, Breakdown))
            if not passes and not fault.declared:
                return False
        return True

    def random_source(self, seed: int) -> Random:
        """
        Return the source of the details of this fault, another one for each kind and input.

        The seed and the letters of both names decide, so that a fault repeats bit by bit, also
        when others are added to the campaign.
        """
        letters = sum(map(ord, self.kind + self.input))
        return np.random.default_rng([seed, letters])


def _copy_as_floats(values: Any) -> Vector:
    """Return a copy as floats: edits must not reach the history of readings."""
    return np.array(values, dtype=float)


def _choose_sign(choice: Vector) -> float:
    """Return the sign that the second draw stands for."""
    if choice[1] < 0.5:
        return 1.0
    return -1.0


def _choose_place(vector: Vector, choice: Vector) -> int:
    """Return the index that the first draw stands for."""
    return int(choice[0] * vector.size)


def _put_number(number: float) -> ValueChange:
    """Return a change of one number, in a random place, into another."""

    def change_number(values: Any, choice: Vector) -> Vector:
        """Put `number` in the place that the first draw chooses."""
        vector = _copy_as_floats(values)
        vector[_choose_place(vector, choice)] = number
        return vector

    return change_number


def _shift_number(size: float) -> ValueChange:
    """Return a change of one number, in a random place, by a size with a random sign."""

    def change_number(values: Any, choice: Vector) -> Vector:
        """Add the size in the place that the first draw chooses, with the sign of the second."""
        vector = _copy_as_floats(values)
        vector[_choose_place(vector, choice)] += size * _choose_sign(choice)
        return vector

    return change_number


def _scale_numbers(factor: float) -> ValueChange:
    """Return a change of all numbers by a factor."""

    def change_numbers(values: Any, _choice: Vector) -> Vector:
        """Scale every number; the draws do not matter."""
        return factor * _copy_as_floats(values)

    return change_numbers


def _shift_wrench(share: float) -> ValueChange:
    """Return a change of one number of a wrench by a share of the sensor's range."""
    shift_number = _shift_number(share)

    def change_number(values: Any, choice: Vector) -> Vector:
        """Add the share of its own range, 100 to 200 N or 5 N m, to one number of six."""
        return _copy_as_floats(values) + FULL_SCALE * shift_number(np.zeros(6), choice)

    return change_number


def _drop_last_number(values: Any, _choice: Vector) -> Any:
    """Leave out the last number: a reading of the wrong length."""
    return values[:-1]


def _make_constant(values: Any, _choice: Vector) -> Vector:
    """Put 0.5 everywhere, which is plausible as an angle [rad] and as a speed [rad/s]."""
    return np.full(len(values), 0.5)


def _rotate_wrench(values: Any, choice: Vector) -> Vector:
    """Turn force and torque by 90 degrees about a random axis."""
    axis = np.eye(3)[int(3 * choice[0])] * _choose_sign(choice)
    rotation = Rotation.from_rotvec(0.5 * np.pi * axis).as_matrix()
    force, torque = np.split(_copy_as_floats(values), 2)
    return np.concatenate([rotation @ force, rotation @ torque])


# How readings come, by kind: what must be noticed, and what is bridged.
NOTICED_DELIVERIES = {
    'dropped': Delivery((None,)),
    'delayed': Delivery((4,)),
    'stuck': Delivery(stuck=True),
    'out_of_order': Delivery((25,)),
}
BRIDGED_DELIVERIES = {
    'duplicated': Delivery((0, 1)),
    'reordered': Delivery((1, 0, 2, 0)),
    'intermittent': Delivery(loss=LOSS),
}


def _delivery_faults() -> Iterator[Fault]:
    """Yield the faults of delivery of every stream of readings."""
    for stream, reactions in REACTIONS.items():
        for kind, delivery in NOTICED_DELIVERIES.items():
            yield Fault(kind, stream, delivery, reactions)
        for kind, delivery in BRIDGED_DELIVERIES.items():
            yield Fault(kind, stream, delivery)
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
        'nan': _put_number(math.nan),
        'infinite': _put_number(math.inf),
        'huge': _put_number(1e30),
        'wrong_count': _drop_last_number,
    }
    for field, declared in (('q', FLOAT), ('qd', HOLD)):
        for kind, change in invalid.items():
            yield _joint_fault(f'{kind}_{field}', field, change, declared)
    flip_sign = _scale_numbers(-1.0)
    pressed = (REST, SLIDING)
    yield _wrench_fault('nan', _put_number(math.nan))
    yield _wrench_fault('infinite', _put_number(-math.inf))
    yield _wrench_fault('huge', _put_number(1e30))
    yield _wrench_fault('wrong_count', _drop_last_number)
    yield _wrench_fault('saturated', _put_number(200.0), at_once=True)
    yield _wrench_fault('biased', _shift_number(5.0), ())
    yield _wrench_fault('sign_flipped', flip_sign, phases=pressed, at_once=True)
    yield _wrench_fault('rotated', _rotate_wrench, ())
    yield _wrench_fault('scaled_x3', _scale_numbers(3.0), ())
    yield _wrench_fault('half', _scale_numbers(0.5), ())
    yield _variance_fault('nan', _put_number(math.nan))
    yield _variance_fault('infinite', _put_number(math.inf))
    yield _variance_fault('zero', _put_number(0.0))
    yield _variance_fault('negative', _put_number(-1.0))
    yield _variance_fault('wrong_count', _drop_last_number)
    yield _variance_fault('huge', _put_number(1e30), ())
    yield _variance_fault('tiny', _put_number(1e-30), ())
    # A joint that stands still looks frozen at rest.
    moving = (SLIDING, APPROACH)
    yield _joint_fault('biased_q', 'q', _shift_number(0.05))
    yield _joint_fault('biased_qd', 'qd', _shift_number(0.2), ())
    yield _joint_fault('saturated_qd', 'qd', _put_number(50.0), HOLD)
    yield _joint_fault('frozen', 'q qd', None, phases=moving)
    yield _joint_fault('frozen_q', 'q', None, phases=moving)
    yield _joint_fault('frozen_qd', 'qd', None, ())
    yield _wrench_fault('frozen', None)
    yield _variance_fault('frozen', None, ())


def _set_clock_off(size: float) -> ClockError:
    def shift_clock(_since: float, _begin: float) -> float:
        """Return the same shift [s] throughout the fault."""
        return size

    return shift_clock


def _let_clock_drift(rate: float) -> ClockError:
    def shift_clock(since: float, _begin: float) -> float:
        """Return a shift [s] that grows from one period in the first tick on."""
        return rate * (since + PERIOD)

    return shift_clock


def _stop_clock(since: float, _begin: float) -> float:
    """Return the shift [s] by which the clock stays where the fault began."""
    return -since


def _restart_clock(_since: float, begin: float) -> float:
    """Return the shift [s] to a clock that starts again near 0, as of a driver that comes back."""
    return 2.0 * PERIOD - begin


def _clock_fault(
    kind: str,
    error: ClockError,
    declared: tuple[str, ...] = STOPPED,
    *,
    stamps: bool = True,
) -> Fault:
    return Fault(kind, CLOCK, ClockShift(error, stamps), declared)


def _clock_faults() -> Iterator[Fault]:
    """Yield the faults of the clock that a tick reads."""
    yield _clock_fault('backwards', _set_clock_off(-0.05), stamps=False)
    yield _clock_fault('restarted', _restart_clock)
    yield _clock_fault('nan', _set_clock_off(math.nan), stamps=False)
    yield _clock_fault('stands_still', _stop_clock, stamps=False)
    yield _clock_fault('too_fast', _let_clock_drift(3.0))
    yield _clock_fault('too_slow', _let_clock_drift(-0.8))
    yield _clock_fault('jump_ahead', _set_clock_off(0.1), ())


def _change_surface(method: str, value: float) -> PlantChange:
    """Return what calls a method of the contacts with one of the first two, and a value."""

    def call_method(plant: Any, choice: Vector) -> None:
        """Call the method with the first or second surface, as the first draw chooses."""
        getattr(plant.contacts, method)(int(2 * choice[0]), value)

    return call_method


def _surface_fault(
    kind: str, method: str, begin: float, end: float | None = None
) -> Fault:
    """Return a fault of a surface, whose method is called at its beginning and at its end."""
    undo = None
    if end is not None:
        undo = _change_surface(method, end)
    return Fault(kind, PLANT, PlantEdit(_change_surface(method, begin), undo))


def _put_obstacle(number: int) -> PlantEdit:
    """Return what puts an obstacle before the tip, and takes it away."""

    def put_before_tip(plant: Any, _choice: Vector) -> None:
        """Put the obstacle 2 mm before the point that it is there for."""
        plant.contacts.put_before_tip(number, 2e-3)

    def take_away(plant: Any, _choice: Vector) -> None:
        """Take the obstacle out of the way."""
        plant.contacts.shift_surface(number, FAR)

    return PlantEdit(put_before_tip, take_away)


def _scale_torque_limit(factor: float) -> PlantChange:
    """Return what scales the torque that the drives give; the controller's own limit stays."""

    def scale_limit(plant: Any, _choice: Vector) -> None:
        plant.scale_torque_limit(factor)

    return scale_limit


def _plant_faults() -> Iterator[Fault]:
    """Yield the changes of surfaces, obstacles and drives."""
    yield _surface_fault('stiffness_x20', 'scale_stiffness', 20.0, 1.0 / 20.0)
    yield _surface_fault('stiffness_x5', 'scale_stiffness', 5.0, 1.0 / 5.0)
    yield _surface_fault('stiffness_x0.2', 'scale_stiffness', 0.2, 5.0)
    yield _surface_fault('surface_removed', 'shift_surface', 1.0, -1.0)
    yield _surface_fault('surface_gone', 'shift_surface', 1.0)
    yield _surface_fault('surface_jump_2mm_up', 'shift_surface', -2e-3)
    yield _surface_fault('surface_jump_2mm_down', 'shift_surface', 2e-3)
    yield _surface_fault('friction_x5', 'scale_friction', 5.0, 0.2)
    yield Fault('side_wall', PLANT, _put_obstacle(SIDE_WALL))
    halved = PlantEdit(_scale_torque_limit(0.5), _scale_torque_limit(2.0))
    yield Fault('torque_limit_halved', PLANT, halved)
    to_a_fifth = PlantEdit(_scale_torque_limit(0.2), _scale_torque_limit(5.0))
    yield Fault('torque_limit_to_a_fifth', PLANT, to_a_fifth)
    # It is met once the slide has turned round, as long as it takes.
    yield Fault(
        'elbow_obstacle',
        PLANT,
        _put_obstacle(ELBOW_WALL),
        ticks=(590, 600),
        obstacle=ELBOW_WALL,
    )


def _velocity_faults() -> Iterator[Fault]:
    """Yield the faults of speeds beside right positions, of all joints and of one."""
    fields = ('qd',)
    edits = {
        'scaled_x0.02': ReadingEdit(fields, _scale_numbers(0.02)),
        'scaled_x0.1': ReadingEdit(fields, _scale_numbers(0.1)),
        'in_degrees': ReadingEdit(fields, _scale_numbers(180.0 / math.pi)),
        'scaled_x60': ReadingEdit(fields, _scale_numbers(60.0)),
        'sign_flipped': ReadingEdit(fields, _scale_numbers(-1.0)),
        'zero': ReadingEdit(fields, _scale_numbers(0.0)),
        'like_position': ReadingEdit(fields, _scale_numbers(1.0), source='q'),
        'constant': ReadingEdit(fields, _make_constant),
        'delayed': ReadingEdit(fields, None, age=25),
        'frozen': ReadingEdit(fields, None),
    }
    noticed_at_rest = {'constant_qd': STOPPED, 'like_position_qd': STOPPED}
    for kind, edit in edits.items():
        for which, single in (('qd', False), ('qd_of_one', True)):
            name = f'{kind}_{which}'
            if name == 'frozen_qd':  # one of the values above
                continue
            action = replace(edit, single=single)
            declared = noticed_at_rest.get(name, ())
            yield _lasting_fault(name, 'joints', action, declared)


def _lasting_fault(
    kind: str, stream: str, action: ReadingEdit, declared: tuple[str, ...] = ()
) -> Fault:
    """Return a fault of readings that is there from the start."""
    return Fault(kind, stream, action, declared, ticks=LASTING, from_start=True)


def _publish_twice(plant: Any, _choice: Vector) -> None:
    """Let every second command be that of a publisher which holds the arm where it started."""
    step = plant.step
    own_turns = cycle((True, False))

    def step_in_turn(torque: Vector) -> Any:
        """Pass on every second torque, and the plant's first one [N m] in between."""
        if next(own_turns):
            return step(torque)
        return step(plant.initial_torque)

    plant.step = step_in_turn


def _publish_once(plant: Any, _choice: Vector) -> None:
    """Take the wrapper off again: the plant's own `step` is that of its class."""
    del plant.step


def _driver_faults() -> Iterator[Fault]:
    """Yield the faults of what is between an arm and its controller: units, tare, publishers."""
    changes = {'millinewtons': _scale_numbers(1e3), 'kilonewtons': _scale_numbers(1e-3)}
    for share in (0.1, 0.5, 1.0):
        changes[f'biased_by_{share:.0%}'] = _shift_wrench(share)
    for kind, change in changes.items():
        yield _lasting_fault(kind, 'wrench', ReadingEdit(('wrench',), change))
    yield _joint_fault('wrapped_q', 'q', _shift_number(2.0 * math.pi), ())
    yield Fault('second_publisher', PLANT, PlantEdit(_publish_twice, _publish_once))


def _breakdown_faults() -> Iterator[Fault]:
    """Yield a fault for every part of a tick that can raise."""
    for part in PARTS:
        yield Fault('raises', part, Breakdown(part))


def _campaign_faults() -> Iterator[Fault]:
    """Yield every fault, in an order on which its phase and seed in a study depend."""
    yield from _delivery_faults()
    yield from _value_faults()
    yield from _clock_faults()
    yield from _plant_faults()
    yield from _breakdown_faults()
    yield from _velocity_faults()
    yield from _driver_faults()


# By kind and input.
FAULTS = {(fault.kind, fault.input): fault for fault in _campaign_faults()}


def combine_faults(*faults: Fault) -> Fault:
    """
    Return several faults as one of which no reaction is declared; a single one as it is.

    Either of two may hide the other or ask for another reaction. What holds for every fault
    (limits of torque, rate and force) is still judged.
    """
    if len(faults) == 1:
        return faults[0]
    obstacle = None
    for fault in faults:
        if fault.obstacle is not None:
            obstacle = fault.obstacle
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
        _, first_input = known[first]
        _, second_input = known[second]
        if first_input != second_input:
            pairs.append((known[first], known[second]))
    return pairs
