"""The faults of the campaign: what is done to an input or to the plant, and what must follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.supervision.inputs import TickInputs
import numpy as np
from scipy.spatial.transform import Rotation
from sim_bridge.pybullet_plant import PybulletPlant

APPROACH, REST, SLIDING = 'approach', 'rest', 'sliding'
PHASES = (REST, SLIDING, APPROACH)
HOLD, FLOAT, INFLATE = ('hold',), ('float',), ('inflate',)
STOPPED = ('hold', 'float', 'damp')


@dataclass
class Context:
    """
    What one fault is made of.

    Attributes
    ----------
    random
        Source of what it does in detail.
    period
        h [s].
    history
        The good inputs before it, newest last; those during it are appended.
    first
        The good inputs of its first tick.
    choice
        Numbers drawn once, uniform over (0, 1).

    """

    random: np.random.Generator
    period: float
    history: list[TickInputs]
    first: TickInputs
    choice: Vector


Corrupt = Callable[[Context, TickInputs, int], TickInputs]
PlantChange = Callable[[PybulletPlant, Context], None]


@dataclass(frozen=True)
class FaultKind:
    """
    One kind of fault.

    Attributes
    ----------
    kind, input
        Name, and what it befalls.
    corrupt
        What becomes of the inputs of a tick, the n-th since the fault began.
    begin, end
        What is done to the plant.
    declared
        Reactions of which one must be in force two ticks after the beginning; none if the fault
        cannot be told from a good input or is bridged.
    phases
        Phases in which it can be told at all.

    """

    kind: str
    input: str  # noqa: A003
    corrupt: Corrupt | None = None
    begin: PlantChange | None = None
    end: PlantChange | None = None
    declared: tuple[str, ...] = ()
    phases: tuple[str, ...] = PHASES

    def expected(self, phase: str) -> tuple[str, ...]:
        """Return the declared reactions in a phase."""
        return self.declared if phase in self.phases else ()


def _element(values: Any, context: Context) -> tuple[Vector, int]:
    vector = np.array(values, dtype=float)
    return vector, int(context.choice[0] * vector.size)


def _put(number: float) -> Callable[[Any, Context], Any]:
    """Return a change that puts a number in a random place."""
    def change(values: Any, context: Context) -> Any:
        vector, place = _element(values, context)
        vector[place] = number
        return vector
    return change


def _add(size: float) -> Callable[[Any, Context], Any]:
    """Return a change that adds an offset in a random place, of a random sign."""
    def change(values: Any, context: Context) -> Any:
        vector, place = _element(values, context)
        vector[place] += size * (1.0 if context.choice[1] < 0.5 else -1.0)
        return vector
    return change


def _shorter(values: Any, _context: Context) -> Any:
    return np.array(values, dtype=float)[:-1]


def _scaled(factor: float) -> Callable[[Any, Context], Any]:
    return lambda values, _context: factor * np.array(values, dtype=float)


def _turned(values: Any, context: Context) -> Any:
    axis = np.eye(3)[int(3 * context.choice[0])] * (1.0 if context.choice[1] < 0.5 else -1.0)
    rotation = Rotation.from_rotvec(0.5 * np.pi * axis).as_matrix()
    vector = np.array(values, dtype=float)
    return np.concatenate([rotation @ vector[:3], rotation @ vector[3:]])


def _with(inputs: TickInputs, source: str, reading: Any) -> TickInputs:
    """Return the inputs with another reading in the place of one."""
    readings: dict[str, Any] = {source: reading}
    return inputs._replace(**readings)


def change_field(source: str, field: str, change: Callable[[Any, Context], Any]) -> Corrupt:
    """Return a fault that changes one field of one reading."""
    def corrupt(context: Context, inputs: TickInputs, _n: int) -> TickInputs:
        reading: Any = getattr(inputs, source)
        changed = reading._replace(**{field: change(getattr(reading, field), context)})
        return _with(inputs, source, changed)
    return corrupt


def freeze_field(source: str, *names: str) -> Corrupt:
    """Return a fault in which values stand still while stamps go on."""
    def corrupt(context: Context, inputs: TickInputs, _n: int) -> TickInputs:
        before: Any = getattr(context.first, source)
        values = {name: getattr(before, name) for name in names}
        return _with(inputs, source, getattr(inputs, source)._replace(**values))
    return corrupt


def pick(source: str, which: Callable[[Context, int], int | None]) -> Corrupt:
    """Return a fault that delivers another reading than the newest: `which` ticks ago, or none."""
    def corrupt(context: Context, inputs: TickInputs, n: int) -> TickInputs:
        ago = which(context, n)
        reading = None if ago is None else getattr(context.history[-1 - ago], source)
        return _with(inputs, source, reading)
    return corrupt


def _names(names: list[str]) -> Callable[[Any, Context], Any]:
    return lambda _values, _context: names


def warp_clock(warp: Callable[[Context, int, float], float], *, stamps: bool) -> Corrupt:
    """Return a fault of the clock; the stamps follow it or not."""
    def corrupt(context: Context, inputs: TickInputs, n: int) -> TickInputs:
        time = warp(context, n, inputs.time)
        if not stamps or inputs.joints is None or inputs.wrench is None or (
                inputs.variance is None):
            return inputs._replace(time=time)
        shift = time - inputs.time
        return TickInputs(
            time, inputs.joints._replace(stamp=inputs.joints.stamp + shift),
            inputs.wrench._replace(stamp=inputs.wrench.stamp + shift),
            inputs.variance._replace(stamp=inputs.variance.stamp + shift))
    return corrupt


def _contact(context: Context) -> int:
    return int(2 * context.choice[0])


def _streams() -> list[FaultKind]:
    """Return the faults of delivery, for every input."""
    ways: list[tuple[str, Callable[[Context, int], int | None], bool]] = [
        ('dropped', lambda context, n: None, True),
        ('delayed', lambda context, n: 4, True),
        ('stuck', lambda context, n: n + 1, True),
        ('out_of_order', lambda context, n: 25, True),
        ('duplicated', lambda context, n: n % 2, False),
        ('reordered', lambda context, n: (1, 0, 2, 0)[n % 4], False),
        ('intermittent', lambda context, n: None if context.random.random() < 0.3 else 0, False)]
    reactions = {'joints': FLOAT, 'wrench': HOLD, 'variance': INFLATE}
    return [
        FaultKind(kind, source, pick(source, which), declared=reactions[source] if told else ())
        for source in reactions for kind, which, told in ways]


def _values() -> list[FaultKind]:
    """Return the faults of what a reading says."""
    nan, inf = float('nan'), float('inf')
    joints = [
        FaultKind(f'{kind}_{field}', 'joints', change_field('joints', field, change),
                  declared=declared)
        for field in ('q', 'qd') for kind, change, declared in (
            ('nan', _put(nan), FLOAT), ('infinite', _put(inf), FLOAT),
            ('huge', _put(1e30), FLOAT), ('wrong_count', _shorter, FLOAT))]
    wrench = [
        FaultKind(kind, 'wrench', change_field('wrench', 'wrench', change), declared=declared,
                  phases=phases)
        for kind, change, declared, phases in (
            ('nan', _put(nan), HOLD, PHASES), ('infinite', _put(-inf), HOLD, PHASES),
            ('huge', _put(1e30), HOLD, PHASES), ('wrong_count', _shorter, HOLD, PHASES),
            ('saturated', _put(200.0), HOLD, PHASES), ('biased', _add(5.0), (), PHASES),
            ('sign_flipped', _scaled(-1.0), HOLD, (REST, SLIDING)),
            ('rotated', _turned, (), PHASES), ('scaled_x3', _scaled(3.0), (), PHASES),
            ('half', _scaled(0.5), (), PHASES))]
    variance = [
        FaultKind(kind, 'variance', change_field('variance', 'variance', change),
                  declared=declared)
        for kind, change, declared in (
            ('nan', _put(nan), INFLATE), ('infinite', _put(inf), INFLATE),
            ('zero', _put(0.0), INFLATE), ('negative', _put(-1.0), INFLATE),
            ('wrong_count', _shorter, INFLATE), ('huge', _put(1e30), ()),
            ('tiny', _put(1e-30), ()))]
    return joints + wrench + variance + [
        FaultKind('biased_q', 'joints', change_field('joints', 'q', _add(0.05)), declared=FLOAT),
        FaultKind('biased_qd', 'joints', change_field('joints', 'qd', _add(0.2))),
        FaultKind('saturated_qd', 'joints', change_field('joints', 'qd', _put(50.0)),
                  declared=FLOAT),
        FaultKind('wrong_names', 'joints', change_field(
            'joints', 'names', _names(['a', 'b', 'c', 'd', 'e', 'f'])), declared=FLOAT),
        FaultKind('missing_name', 'joints', change_field(
            'joints', 'names', _names([f'joint{i}' for i in range(1, 6)])), declared=FLOAT),
        FaultKind('frozen', 'joints', freeze_field('joints', 'q', 'qd'), declared=FLOAT,
                  phases=(SLIDING, APPROACH)),
        FaultKind('frozen_q', 'joints', freeze_field('joints', 'q'), declared=FLOAT,
                  phases=(SLIDING, APPROACH)),
        FaultKind('frozen_qd', 'joints', freeze_field('joints', 'qd'), declared=FLOAT,
                  phases=(SLIDING, APPROACH)),
        FaultKind('frozen', 'wrench', freeze_field('wrench', 'wrench'), declared=HOLD),
        FaultKind('frozen', 'variance', freeze_field('variance', 'variance'))]


def _clocks() -> list[FaultKind]:
    return [
        FaultKind('backwards', 'clock', warp_clock(
            lambda c, n, t: t - 0.05, stamps=False), declared=STOPPED),
        FaultKind('restarted', 'clock', warp_clock(
            lambda c, n, t: t - c.first.time, stamps=True), declared=STOPPED),
        FaultKind('nan', 'clock', warp_clock(
            lambda c, n, t: float('nan'), stamps=False), declared=STOPPED),
        FaultKind('stands_still', 'clock', warp_clock(
            lambda c, n, t: c.first.time, stamps=False), declared=STOPPED),
        FaultKind('too_fast', 'clock', warp_clock(
            lambda c, n, t: t + 3.0 * (n + 1) * c.period, stamps=True), declared=STOPPED),
        FaultKind('too_slow', 'clock', warp_clock(
            lambda c, n, t: t - 0.8 * (n + 1) * c.period, stamps=True), declared=STOPPED),
        FaultKind('jump_ahead', 'clock', warp_clock(
            lambda c, n, t: t + 0.1, stamps=True))]


def _plants() -> list[FaultKind]:
    def surface(method: str, there: float, back: float | None) -> tuple[
            PlantChange, PlantChange | None]:
        def begin(plant: PybulletPlant, context: Context) -> None:
            getattr(plant.contacts, method)(_contact(context), there)

        def end(plant: PybulletPlant, context: Context) -> None:
            getattr(plant.contacts, method)(_contact(context), back)
        return begin, None if back is None else end

    def plant_kind(kind: str, *change: Any) -> FaultKind:
        begin, end = surface(*change)
        return FaultKind(kind, 'plant', begin=begin, end=end)

    return [
        plant_kind('stiffness_x20', 'scale_stiffness', 20.0, 1.0 / 20.0),
        plant_kind('stiffness_x5', 'scale_stiffness', 5.0, 1.0 / 5.0),
        plant_kind('stiffness_x0.2', 'scale_stiffness', 0.2, 5.0),
        plant_kind('surface_removed', 'shift', 1.0, -1.0),
        plant_kind('surface_gone', 'shift', 1.0, None),
        plant_kind('surface_jump_2mm_up', 'shift', -2e-3, None),
        plant_kind('surface_jump_2mm_down', 'shift', 2e-3, None),
        plant_kind('friction_x5', 'scale_friction', 5.0, 0.2),
        FaultKind('torque_limit_halved', 'plant',
                  begin=lambda plant, context: plant.scale_torque_limit(0.5),
                  end=lambda plant, context: plant.scale_torque_limit(2.0)),
        FaultKind('torque_limit_to_a_fifth', 'plant',
                  begin=lambda plant, context: plant.scale_torque_limit(0.2),
                  end=lambda plant, context: plant.scale_torque_limit(5.0))]


def fault_kinds() -> list[FaultKind]:
    """Return all kinds of faults, in the order of the table."""
    return _streams() + _values() + _clocks() + _plants()
