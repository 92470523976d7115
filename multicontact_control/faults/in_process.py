"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.faults.judge import FaultRow, judge, Observation
from multicontact_control.faults.vocabulary import (
    Breakdown,
    ClockShift,
    Delivery,
    Edit,
    FAR,
    Fault,
    PlantEdit,
    Random,
    START,
)
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import plant_source, resolve, Setup
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np

RUN_TICKS = 600


def with_obstacles(scenario: str, plant: str, seed: int) -> Setup:
    """Resolve a scenario with walls far away that the first contact's tip, or the elbow, meets."""
    setup = resolve(scenario, plant=plant, seed=seed)
    tip = setup.plant.surfaces[setup.plant.contact_names[0]].tip_link
    elbow, normal = plant_source(plant).robot.find_elbow()
    walls = {
        name: {
            'tip_link': link,
            'point_world': (FAR * into).tolist(),
            'normal_world': into.tolist(),
            'stiffness': stiffness,
            'roughness_std': 0.0,
        }
        for name, link, into, stiffness in (
            ('side_wall', tip, np.array([1.0, 0.0, 0.0]), 3000.0),
            ('elbow_wall', elbow, normal, 6000.0),
        )
    }
    return resolve(
        scenario,
        plant=plant,
        seed=seed,
        plant_overrides={'obstacle_names': list(walls), 'surfaces': walls},
    )


def _fail(*_arguments: Any, **_named: Any) -> Any:
    raise ArithmeticError('broken part')


class Occurrence:
    """A fault in a closed loop from its next tick on; it `lasts` some ticks."""

    def __init__(self, fault: Fault, random: Random, loop: ClosedLoop) -> None:
        self._fault, self._action, self._random, self._loop = (
            fault,
            fault.action,
            random,
            loop,
        )
        self._first, self._history = loop.inputs(), list(loop.history)
        self.choice: Vector = random.random(4)
        self.lasts = int(random.integers(*fault.ticks))
        self._tick = 0
        if isinstance(self._action, PlantEdit):
            self._action.begin(loop.plant, self.choice)
        if isinstance(self._action, Breakdown):
            setattr(*self._broken(), _fail)

    def _broken(self) -> tuple[Any, str]:
        """Return the owner of the broken part of the supervisor, and its name there."""
        *way, name = self._action.part.split('.')
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
            return inputs._replace(
                time=inputs.time + shift,
                **{
                    name: reading._replace(stamp=reading.stamp + shift)
                    for name in stamped
                    if (reading := getattr(inputs, name)) is not None
                },
            )
        if isinstance(action, Delivery):
            age = action.age(self._random, self._tick)
            delivered: Any = (
                None if age is None else getattr(self._history[-1 - age], source)
            )
            return inputs._replace(**{source: delivered})
        if isinstance(action, Edit):
            before = self._history[-1 - action.age :][0] if action.age else self._first
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
            delattr(*self._broken())


def advance_with(occurrences: Sequence[Occurrence], loop: ClosedLoop) -> None:
    """Take a tick of a loop in which all of these happen."""
    loop.advance(
        lambda inputs: reduce(
            lambda some, each: each.corrupt(some), occurrences, inputs
        )
    )
    for each in occurrences:
        each.advanced()


def run_fault(loop: ClosedLoop, fault: Fault, seed: int, phase: str) -> FaultRow:
    """Let a fault happen in a loop at the beginning of a phase, which is used up by it."""
    parts = fault.parts or (fault,)
    randoms = [part.random(seed) for part in parts]
    for _ in range(int(randoms[0].integers(5, 60)) * (phase != START)):
        loop.advance()
    period, begin = loop.setup.controller.period, loop.tick
    before, collisions = loop.command.copy(), loop.control.events.collisions.total()
    occurrences = [
        Occurrence(part, random, loop) for part, random in zip(parts, randoms)
    ]
    lasted = max(each.lasts for each in occurrences)
    breaks = any(isinstance(part.action, Breakdown) for part in parts)
    torques, forces, met, reactions, speeds = [], [], [], [], []
    problems: set[str] = set()
    for _ in range(RUN_TICKS):
        advance_with(occurrences, loop)
        torques.append(loop.command.copy())
        forces.append(loop.sample.contact_force)
        met.append(loop.plant.contacts.obstacles)
        reactions.append(loop.status.reaction)
        speeds.append(np.abs(loop.plant.arm.qd).max())
        if not breaks and any(
            cause.startswith('internal') for cause in loop.status.causes
        ):
            problems.add(loop.status.causes[0])
    # At the ends of the ticks: a force above the ceiling lasts until then.
    time: Vector = period * np.arange(1.0, RUN_TICKS + 1.0)
    return judge(
        fault,
        seed,
        loop.setup,
        Observation(
            torque=np.array(torques),
            before=before,
            time=time,
            force=np.max(forces, axis=1),
            reaction=max(reactions[:lasted], key=SEVERITY.index),
            reactions=reactions,
            forces=np.array(forces),
            commands=loop.setup.commanded(begin * period + time),
            met=np.array(met),
            noticed=loop.control.events.collisions.total() > collisions,
            speed=max(speeds),
            lasted=lasted,
            problems=problems,
        ),
        phase=phase,
    )
