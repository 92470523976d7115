"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.closed_loop import ClosedLoop
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
        # What a message would say, and a reading in process need not.
        self._names = {'names': loop.setup.controller.robot.joint_names}
        self._first, self._history = loop.inputs(), list(loop.history)
        self._passed = 0
        self.choice: Vector = random.random(4)

    def corrupt(self, inputs: TickInputs) -> TickInputs:
        """Return what becomes of the inputs of the next tick."""
        n, source, action = self._passed, self._fault.input, self._fault.action
        self._passed += 1
        self._history.append(inputs)
        if isinstance(action, ClockShift):
            return self._shifted(inputs, action)
        if isinstance(action, Delivery):
            ages = (action.sampled or action.ages)(self._random, n)
            delivered: Any = getattr(self._history[-1 - ages[-1]], source) if ages else None
            return inputs._replace(**{source: delivered})
        if isinstance(action, Edit):
            reading, first = getattr(inputs, source), getattr(self._first, source)
            values = action.values(
                reading._asdict() | self._names, first._asdict() | self._names, self.choice)
            return inputs._replace(**{source: reading._replace(**values)})
        return inputs

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
        loop.advance(corruptor.corrupt if n < length else None)
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
