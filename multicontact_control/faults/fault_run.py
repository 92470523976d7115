"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.faults.outcomes import FaultRow, judge_fault, Observation
from multicontact_control.faults.vocabulary import (
    Breakdown,
    ClockShift,
    Delivery,
    FAR,
    Fault,
    PlantEdit,
    Random,
    ReadingEdit,
    START,
)
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import plant_source, resolve, Setup
from multicontact_control.supervision.causes import SEVERITY
from multicontact_control.supervision.inputs import TickInputs
import numpy as np

RUN_TICKS = 600
QUIET_TICKS = (5, 60)  # before a fault, but for one from the start


def resolve_with_obstacles(scenario: str, plant: str, seed: int) -> Setup:
    """
    Resolve a scenario with walls far away that the first contact's tip, or the elbow, meets.

    They are the plant's last surfaces: `SIDE_WALL` and `ELBOW_WALL` are their numbers. A fault
    brings one before the arm (`put_before_tip`); the controller knows of neither, as it knows
    nothing of a person beside the arm.
    """
    setup = resolve(scenario, plant=plant, seed=seed)
    tip = setup.plant.surfaces[setup.plant.contact_names[0]].tip_link
    elbow, elbow_normal = plant_source(plant).robot.find_elbow()
    walls = {
        'side_wall': _distant_wall(tip, np.array([1.0, 0.0, 0.0]), 3000.0),
        'elbow_wall': _distant_wall(elbow, elbow_normal, 6000.0),
    }
    return resolve(
        scenario,
        plant=plant,
        seed=seed,
        plant_overrides={'obstacle_names': list(walls), 'surfaces': walls},
    )


def _distant_wall(link: str, normal: Vector, stiffness: float) -> dict[str, Any]:
    """Return the parameters of a smooth surface far ahead of a link, in the way of the normal."""
    return {
        'tip_link': link,
        'point_world': (FAR * normal).tolist(),
        'normal_world': normal.tolist(),
        'stiffness': stiffness,
        'roughness_std': 0.0,
    }


def _raise_error(*_arguments: Any, **_named: Any) -> Any:
    """Raise, whatever the part is called with."""
    raise ArithmeticError('broken part')


class FaultOccurrence:
    """
    A fault in a closed loop from its next tick on, for `duration_ticks` ticks.

    On construction it draws its details, so the same seed repeats it, and changes the plant or
    breaks the part of the supervisor at once. The caller gives it the inputs of every tick
    (`corrupt_inputs`) and says when the tick is over (`end_tick`).
    """

    def __init__(self, fault: Fault, random: Random, loop: ClosedLoop) -> None:
        self._fault = fault
        self._action = fault.action
        self._random = random
        self._loop = loop
        self._first = loop.inputs()
        self._history = list(loop.history)
        self.choice: Vector = random.random(4)
        self.duration_ticks = int(random.integers(*fault.ticks))
        self._tick = 0
        if isinstance(self._action, PlantEdit):
            self._action.begin(loop.plant, self.choice)
        if isinstance(self._action, Breakdown):
            owner, name = self._find_broken_part()
            setattr(owner, name, _raise_error)

    def _find_broken_part(self) -> tuple[Any, str]:
        """Return the owner of the broken part of the supervisor, and its name there."""
        *way, name = self._action.part.split('.')
        return reduce(getattr, way, self._loop.control.supervisor), name

    def corrupt_inputs(self, inputs: TickInputs) -> TickInputs:
        """
        Return what becomes of the inputs of a tick on their way from the sensors.

        The inputs themselves stay as they are; they join the history from which late readings are
        taken. After the fault's last tick, and in faults of the plant, they pass unchanged.
        """
        if self._tick >= self.duration_ticks:
            return inputs
        self._history.append(inputs)
        if isinstance(self._action, ClockShift):
            return self._shift_clock(inputs, self._action)
        if isinstance(self._action, Delivery):
            return self._deliver(inputs, self._action)
        if isinstance(self._action, ReadingEdit):
            return self._edit_reading(inputs, self._action)
        return inputs

    def _shift_clock(self, inputs: TickInputs, action: ClockShift) -> TickInputs:
        """Return the inputs with the tick's time shifted, and the stamps that share its clock."""
        begin = self._first.time
        shift = action.shift(inputs.time - begin, begin)
        changes: dict[str, Any] = {'time': inputs.time + shift}
        if action.stamps:
            for name in ('joints', 'wrench', 'variance'):
                reading = getattr(inputs, name)
                if reading is not None:
                    changes[name] = reading._replace(stamp=reading.stamp + shift)
        return inputs._replace(**changes)

    def _deliver(self, inputs: TickInputs, action: Delivery) -> TickInputs:
        """Return the inputs with an older reading, or none, in the stream of the fault."""
        stream = self._fault.input
        age = action.age_of_reading(self._random, self._tick)
        delivered: Any = None
        if age is not None:
            delivered = getattr(self._history[-1 - age], stream)
        return inputs._replace(**{stream: delivered})

    def _edit_reading(self, inputs: TickInputs, action: ReadingEdit) -> TickInputs:
        """Return the inputs with other values in the stream's reading, under its own stamp."""
        stream = self._fault.input
        before = self._first
        if action.age:
            before = self._history[max(0, len(self._history) - 1 - action.age)]
        reading = getattr(inputs, stream)
        first = getattr(before, stream)
        values = action.edited_values(reading._asdict(), first._asdict(), self.choice)
        return inputs._replace(**{stream: reading._replace(**values)})

    def end_tick(self) -> None:
        """
        Take note that a tick is over; undo the fault if it was its last one.

        The plant is changed back as `PlantEdit.end` says, and a broken part works again. In all
        later ticks nothing happens.
        """
        self._tick += 1
        if self._tick != self.duration_ticks:
            return
        if isinstance(self._action, PlantEdit) and self._action.end is not None:
            self._action.end(self._loop.plant, self.choice)
        if isinstance(self._action, Breakdown):
            owner, name = self._find_broken_part()
            delattr(owner, name)


def advance_with_faults(
    occurrences: Sequence[FaultOccurrence], loop: ClosedLoop
) -> None:
    """
    Take a tick of a loop in which all of these happen, one after the other.

    The second fault works on what the first has made of the inputs. Those that have ended pass
    inputs on, so the caller may go on with the same list.
    """

    def corrupt(inputs: TickInputs) -> TickInputs:
        """Return the inputs after every fault has had its turn."""
        for occurrence in occurrences:
            inputs = occurrence.corrupt_inputs(inputs)
        return inputs

    loop.advance(corrupt)
    for occurrence in occurrences:
        occurrence.end_tick()


def run_fault(loop: ClosedLoop, fault: Fault, seed: int, phase: str) -> FaultRow:
    """
    Let a fault happen in a loop, watch it for 600 ticks, and judge it.

    Parameters
    ----------
    loop
        At the beginning of the phase; it is used up.
    fault, seed
        What happens, and the seed of its details.
    phase
        Of the scenario. But for the start, the fault begins some ticks later.

    """
    parts = fault.single_faults
    randoms = [part.random_source(seed) for part in parts]
    quiet_ticks = int(randoms[0].integers(*QUIET_TICKS))
    if phase != START:
        for _ in range(quiet_ticks):
            loop.advance()
    period = loop.setup.controller.period
    begin = loop.tick
    torque_before = loop.command.copy()
    collisions_before = loop.control.events.collisions.total()
    occurrences = [
        FaultOccurrence(part, random, loop) for part, random in zip(parts, randoms)
    ]
    fault_ticks = max(occurrence.duration_ticks for occurrence in occurrences)
    torques: list[Vector] = []
    forces: list[Vector] = []
    obstacle_forces: list[Vector] = []
    reactions: list[str] = []
    speeds: list[float] = []
    problems: set[str] = set()
    for _ in range(RUN_TICKS):
        advance_with_faults(occurrences, loop)
        torques.append(loop.command.copy())
        forces.append(loop.sample.contact_force)
        obstacle_forces.append(loop.plant.contacts.obstacles)
        reactions.append(loop.status.reaction)
        speeds.append(np.abs(loop.plant.arm.qd).max())
        causes = loop.status.causes
        has_own_error = any(cause.startswith('internal') for cause in causes)
        if has_own_error and not fault.breaks_part:
            problems.add(causes[0])
    # At the ends of the ticks: a force above the ceiling lasts until then.
    time: Vector = period * np.arange(1.0, RUN_TICKS + 1.0)
    collisions = loop.control.events.collisions.total()
    seen = Observation(
        torque=np.array(torques),
        torque_before=torque_before,
        time=time,
        force=np.max(forces, axis=1),
        reaction=max(reactions[:fault_ticks], key=SEVERITY.index),
        reactions=reactions,
        forces=np.array(forces),
        commands=loop.setup.commanded(begin * period + time),
        obstacle_forces=np.array(obstacle_forces),
        collision_noticed=collisions > collisions_before,
        largest_speed=max(speeds),
        fault_ticks=fault_ticks,
        problems=problems,
    )
    return judge_fault(fault, seed, loop.setup, seen, phase=phase)
