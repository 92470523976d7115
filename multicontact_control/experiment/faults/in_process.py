"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.closed_loop import ClosedLoop, Corruption
from multicontact_control.experiment.faults.judge import FaultRow, judge, Observation
from multicontact_control.experiment.faults.vocabulary import (
    ClockShift,
    Delivery,
    Edit,
    Fault,
    PlantEdit,
    PROCESS,
    Random,
)
from multicontact_control.supervision.fallback import SEVERITY
from multicontact_control.supervision.inputs import TickInputs
import numpy as np

RUN_TICKS = 350


class Corruptor:
    """
    Does to the inputs of ticks what a fault does to readings.

    Parameters
    ----------
    fault, random
        Which, and the source of its details.
    loop
        At the first tick of the fault.

    """

    def __init__(self, fault: Fault, random: Random, loop: ClosedLoop) -> None:
        self._fault, self._random = fault, random
        self._names = loop.setup.controller.robot.joint_names
        self._first, self._history = loop.inputs(), list(loop.history)
        self.choice: Vector = random.random(4)

    def corruption(self, n: int) -> Corruption | None:
        """Return what the n-th tick of the fault does to the readings."""
        if isinstance(self._fault.action, PlantEdit):
            return None
        return lambda inputs: self._corrupt(inputs, n)

    def _corrupt(self, inputs: TickInputs, n: int) -> TickInputs:
        self._history.append(inputs)
        source, action = self._fault.input, self._fault.action
        if isinstance(action, ClockShift):
            return self._shifted(inputs, action)
        reading: Any = None
        if isinstance(action, Delivery):
            if ages := (action.sampled or action.ages)(self._random, n):
                reading = getattr(self._history[-1 - ages[-1]], source)
        elif isinstance(action, Edit):
            reading = getattr(inputs, source)
            reading = reading._replace(**{
                name: self._value(action, reading, name) for name in action.fields})
        return inputs._replace(**{source: reading})

    def _value(self, action: Edit, reading: Any, name: str) -> Any:
        if action.change is None:
            return getattr(getattr(self._first, self._fault.input), name)
        value = getattr(reading, name)
        return action.change(self._names if name == 'names' and value is None else value,
                             self.choice)

    def _shifted(self, inputs: TickInputs, clock: ClockShift) -> TickInputs:
        begin = self._first.time
        shift = clock.shift(inputs.time - begin, begin)
        changes: dict[str, Any] = {'time': inputs.time + shift}
        if clock.stamps:
            changes.update({
                name: reading._replace(stamp=reading.stamp + shift)
                for name in ('joints', 'wrench', 'variance')
                if (reading := getattr(inputs, name)) is not None})
        return inputs._replace(**changes)


def run_fault(loop: ClosedLoop, fault: Fault, seed: int, phase: str) -> FaultRow:
    """
    Let one fault happen in a closed loop that is used up by it.

    Parameters
    ----------
    loop
        At the beginning of the phase, supervised.
    fault, seed, phase
        The fault, what decides its details, and where in the scenario it happens.

    """
    random = fault.random(seed)
    for _ in range(int(random.integers(5, 60))):
        loop.advance()
    corruptor = Corruptor(fault, random, loop)
    length = int(random.integers(5, 150))
    plant = fault.action if isinstance(fault.action, PlantEdit) else None
    before = loop.command.copy()
    torques, forces, reactions = [], [], []
    problems: set[str] = set()
    if plant is not None:
        plant.begin(loop.plant, corruptor.choice)
    for n in range(RUN_TICKS):
        if n == length and plant is not None and plant.end is not None:
            plant.end(loop.plant, corruptor.choice)
        loop.advance(corruptor.corruption(n) if n < length else None)
        torques.append(loop.command.copy())
        forces.append(float(loop.true_forces.max()))
        reactions.append(loop.status.reaction)
        if any(cause.startswith('internal') for cause in loop.status.causes):
            problems.add(loop.status.causes[0])
    # At the ends of the ticks: a force above the ceiling lasts until then.
    time: Vector = loop.setup.controller.period * np.arange(1.0, RUN_TICKS + 1.0)
    return judge(fault, seed, loop.setup, Observation(
        torque=np.array(torques), before=before, time=time, force=np.array(forces),
        reaction=max(reactions[:length], key=SEVERITY.index), reactions=reactions,
        problems=problems), where=PROCESS, phase=phase)
