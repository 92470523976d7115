"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.fault import (
    Breakdown,
    ClockShift,
    Delivery,
    Edit,
    Fault,
    PlantEdit,
    Random,
    START,
    TWO,
)
from multicontact_control.experiment.faults.judge import FaultRow, judge, Observation
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np

RUN_TICKS = 600


class Occurrence:
    """A fault in a closed loop from its next tick on; it `lasts` some ticks."""

    def __init__(self, fault: Fault, random: Random, loop: ClosedLoop) -> None:
        self._fault, self._action, self._random, self._loop = fault, fault.action, random, loop
        self._first, self._history = loop.inputs(), list(loop.history)
        self.choice: Vector = random.random(4)
        self.lasts = int(random.integers(*fault.ticks))
        self._tick = 0
        if isinstance(self._action, PlantEdit):
            self._action.begin(loop.plant, self.choice)
        if isinstance(self._action, Breakdown):
            part = self._action.part

            def fail(*_arguments: Any, **_named: Any) -> Any:
                raise ArithmeticError(part)
            setattr(*self._broken(part), fail)

    def _broken(self, part: str) -> tuple[Any, str]:
        """Return the owner of a part of the supervisor, and the name the part has there."""
        *way, name = part.split('.')
        return reduce(getattr, way, self._loop.control.supervisor), name

    def corrupt(self, inputs: TickInputs) -> TickInputs:
        """Return what becomes of the inputs of a tick."""
        if self._tick >= self.lasts:
            return inputs
        source, action = self._fault.input, self._action
        self._history.append(inputs)
        if isinstance(action, ClockShift):
            begin = self._first.time
            shift = action.shift(inputs.time - begin, begin)
            stamped = ('joints', 'wrench', 'variance') if action.stamps else ()
            return inputs._replace(time=inputs.time + shift, **{
                name: reading._replace(stamp=reading.stamp + shift) for name in stamped
                if (reading := getattr(inputs, name)) is not None})
        if isinstance(action, Delivery):
            age = action.age(self._random, self._tick)
            delivered: Any = None if age is None else getattr(self._history[-1 - age], source)
            return inputs._replace(**{source: delivered})
        if isinstance(action, Edit):
            before = self._history[-1 - action.age:][0] if action.age else self._first
            reading, first = getattr(inputs, source), getattr(before, source)
            values = action.values(reading._asdict(), first._asdict(), self.choice)
            return inputs._replace(**{source: reading._replace(**values)})
        return inputs

    def advanced(self) -> None:
        """Take note that a tick is over; end the fault if it was the last."""
        self._tick += 1
        if self._tick != self.lasts:
            return
        if isinstance(self._action, PlantEdit) and self._action.end is not None:
            self._action.end(self._loop.plant, self.choice)
        if isinstance(self._action, Breakdown):
            delattr(*self._broken(self._action.part))


def advance_with(occurrences: Sequence[Occurrence], loop: ClosedLoop) -> None:
    """Take a tick of a loop in which all of these happen."""
    loop.advance(lambda inputs: reduce(lambda some, each: each.corrupt(some), occurrences, inputs))
    for each in occurrences:
        each.advanced()


def run_fault(
    loop: ClosedLoop, fault: Fault, seed: int, phase: str, other: Fault | None = None,
) -> FaultRow:
    """
    Let one fault happen, or two at once, in a closed loop that is used up by it.

    Parameters
    ----------
    loop
        At the beginning of the phase, supervised.
    fault, seed, phase
        The fault, what decides its details, and where in the scenario it happens.
    other
        Another fault at the same time, if any; then no reaction is declared.

    """
    random = fault.random(seed)
    for _ in range(int(random.integers(5, 60)) * (phase != START)):
        loop.advance()
    begin, known = loop.tick, loop.control.events.collisions.total()
    occurrences = [Occurrence(fault, random, loop)]
    if other is not None:
        occurrences.append(Occurrence(other, other.random(seed), loop))
    lasted = max(each.lasts for each in occurrences)
    before = loop.command.copy()
    breaks = any(isinstance(each.action, Breakdown) for each in (fault, other) if each)
    torques, forces, met, reactions, speeds = [], [], [], [], []
    problems: set[str] = set()

    for _ in range(RUN_TICKS):
        advance_with(occurrences, loop)
        torques.append(loop.command.copy())
        forces.append(loop.true_forces)
        met.append(loop.obstacle_forces)
        reactions.append(loop.status.reaction)
        speeds.append(np.abs(loop.plant.arm.qd).max())
        if not breaks and any(cause.startswith('internal') for cause in loop.status.causes):
            problems.add(loop.status.causes[0])
    # At the ends of the ticks: a force above the ceiling lasts until then.
    time: Vector = loop.setup.controller.period * np.arange(1.0, RUN_TICKS + 1.0)
    return judge(fault if other is None else together(fault, other), seed, loop.setup, Observation(
        torque=np.array(torques), before=before, time=time, force=np.max(forces, axis=1),
        reaction=max(reactions[:lasted], key=SEVERITY.index), reactions=reactions,
        forces=np.array(forces),
        commands=loop.setup.commanded(begin * loop.setup.controller.period + time),
        met=np.array(met), noticed=bool(loop.control.events.collisions.total() > known),
        speed=max(speeds), lasted=lasted, problems=problems), phase=phase)


def together(fault: Fault, other: Fault) -> Fault:
    """Return two faults as one of which nothing is declared."""
    return Fault(
        TWO, f'{fault.input} {fault.kind} + {other.input} {other.kind}', fault.action,
        meets=other.meets if fault.meets is None else fault.meets, parts=(fault, other))
