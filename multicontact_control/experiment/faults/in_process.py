"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.faults.vocabulary import Context, FaultKind
from multicontact_control.experiment.loop import inputs_of
from multicontact_control.experiment.scenario import Setup
from multicontact_control.force.noise import make_noise_estimator
from multicontact_control.supervision.supervisor import Supervisor, SupervisorOutput
from multicontact_control.supervision.validation import TickInputs
import numpy as np
from numpy.typing import NDArray
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.pybullet_plant import PybulletPlant

REACTION_TICKS = 2
FORCE_MARGIN = 1.25  # times the force ceiling
RETRACT_TICKS = 50  # in which a contact beyond that must have been left
RUN_TICKS = 350
HISTORY = 64
SEVERITY = ('none', 'inflate', 'hold', 'float', 'damp')


@dataclass(frozen=True)
class FaultRow:
    """
    What became of one fault.

    Attributes
    ----------
    kind, input, seed
        Which fault.
    reaction
        The strongest reaction while it lasted.
    time_to_safe_s
        From its beginning until a declared reaction is in force, if one is declared, and every
        true force is, and stays, within the ceiling [s]; infinite numbers do not occur: -1 says
        never.
    peak_force_n
        Largest true normal force from its beginning on [N].
    peak_torque_fraction
        Largest commanded torque over its limit.
    safe
        Every command finite, within the torque limits and their rates; a declared reaction within
        two ticks; every true force within 1.25 times the force ceiling, or back within it in
        0.1 s; no exception, no hang.
    plant, phase, problems
        Where it happened, and why it was not safe.
    where
        ``process`` or ``graph``.

    """

    kind: str
    input: str  # noqa: A003
    seed: int
    reaction: str
    time_to_safe_s: float
    peak_force_n: float
    peak_torque_fraction: float
    safe: bool
    plant: str
    phase: str
    problems: str = ''
    where: str = 'process'

    def as_json(self) -> dict[str, Any]:
        """Return the row as plain values."""
        return asdict(self)


class World:
    """
    Plant, supervised controller and estimator, advanced tick by tick.

    Parameters
    ----------
    setup
        The scenario.

    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        config = setup.controller
        self.supervisor = Supervisor.from_config(config, setup.reference(), setup.urdf_dir)
        self._estimator = make_noise_estimator(setup.noise_estimator)
        self.plant = PybulletPlant(setup.plant, rate=config.rate, seed=setup.seed)
        self._delay = ActuatorDelay(setup.plant.actuator_delay_ticks, self.plant.initial_torque)
        self._sample = self.plant.reset()
        self._variance: Vector = np.full(
            len(config.contact_names), config.initial_noise_variance)
        self.command: Vector = self.plant.initial_torque
        self.tick = 0
        self.history: list[TickInputs] = []

    def advance(self, fault: tuple[FaultKind, Context, int] | None = None) -> SupervisorOutput:
        """Take one tick, with the n-th tick of a fault in it."""
        inputs = self.inputs()
        self.history = [*self.history[-HISTORY:], inputs]
        if fault is not None and fault[0].corrupt is not None:
            kind, context, n = fault
            context.history.append(inputs)
            inputs = fault[0].corrupt(context, inputs, n)
        result = self.supervisor.step(inputs)
        self._variance = self._estimator.update(result.output.alpha_meas)
        self._delay.command(self.tick, result.output.torque)
        self._sample = self.plant.step(self._delay.torque_for(self.tick))
        self.command = result.output.torque
        self.tick += 1
        return result

    def inputs(self) -> TickInputs:
        """Return what is known in this tick if all is well."""
        return inputs_of(
            self.setup, self.tick, self._sample, self._sample.wrench, self._variance)

    @property
    def true_forces(self) -> Vector:
        """Return the true normal forces now, shape (r,) [N]."""
        return self._sample.contact_force


def run_fault(world: World, kind: FaultKind, seed: int, phase: str) -> FaultRow:
    """
    Let one fault happen in a world that is used up by it.

    Parameters
    ----------
    world
        At the beginning of the phase.
    kind, seed, phase
        The fault, what decides its details, and where in the scenario it happens.

    """
    random = np.random.default_rng([seed, sum(map(ord, kind.kind + kind.input))])
    for _ in range(int(random.integers(5, 60))):
        world.advance()
    context = Context(random, world.setup.controller.period, list(world.history), world.inputs(),
                      random.random(4))
    length = int(random.integers(5, 150))
    watch = _Watch(world)
    if kind.begin is not None:
        kind.begin(world.plant, context)
    for n in range(RUN_TICKS):
        if n == length and kind.end is not None:
            kind.end(world.plant, context)
        result = world.advance((kind, context, n) if n < length else None)
        watch.note(n, result, world.true_forces, faulty=n < length)
    return watch.row(kind, seed, phase)


class _Watch:
    """Notes what happens, and judges it."""

    def __init__(self, world: World) -> None:
        config = world.setup.controller
        self._plant, self._h = world.setup.plant_name, config.period
        limits = config.limits
        self._limit = np.array(config.torque_limit)
        self._step = np.array(limits.torque_rate) * config.period
        self._ceiling = config.contact_state.force_ceiling
        self._before = world.command
        self._reactions: list[str] = []
        self._forces: list[float] = []
        self._peak_fraction = 0.0
        self._strongest = 0
        self._problems: set[str] = set()

    def note(self, n: int, result: SupervisorOutput, forces: Vector, *, faulty: bool) -> None:
        torque = result.output.torque
        if not np.isfinite(torque).all():
            self._problems.add('command not finite')
        else:
            fraction = float((np.abs(torque) / self._limit).max())
            self._peak_fraction = max(self._peak_fraction, fraction)
            if fraction > 1.0 + 1e-12:
                self._problems.add('torque beyond its limit')
            if (np.abs(torque - self._before) > self._step * (1.0 + 1e-9)).any():
                self._problems.add('torque rate beyond its limit')
            self._before = torque
        if any(cause.startswith('internal') for cause in result.status.causes):
            self._problems.add(result.status.causes[0])
        self._reactions.append(result.status.reaction)
        if faulty:
            self._strongest = max(self._strongest, SEVERITY.index(result.status.reaction))
        self._forces.append(float(forces.max()))

    def row(self, kind: FaultKind, seed: int, phase: str) -> FaultRow:
        reached = self._reaction_tick(kind.expected(phase))
        beyond = np.flatnonzero(np.array(self._forces) > FORCE_MARGIN * self._ceiling)
        if reached is None or reached > REACTION_TICKS:
            self._problems.add('declared reaction late')
        if beyond.size and self._longest(beyond) > RETRACT_TICKS:
            self._problems.add('force beyond the ceiling for too long')
        over = np.flatnonzero(np.array(self._forces) > self._ceiling)
        calm = int(over[-1]) + 1 if over.size else 0
        settled = reached is not None and calm < RUN_TICKS
        return FaultRow(
            kind=kind.kind, input=kind.input, seed=seed, reaction=SEVERITY[self._strongest],
            time_to_safe_s=round(max(reached or 0, calm) * self._h, 6) if settled else -1.0,
            peak_force_n=round(max(self._forces), 3),
            peak_torque_fraction=round(self._peak_fraction, 5), safe=not self._problems,
            plant=self._plant, phase=phase, problems=', '.join(sorted(self._problems)))

    def _reaction_tick(self, expected: tuple[str, ...]) -> int | None:
        if not expected:
            return 0
        for n, reaction in enumerate(self._reactions):
            if reaction in expected or (
                    reaction in SEVERITY[3:] and 'inflate' not in expected):
                return n
        return None

    @staticmethod
    def _longest(ticks: NDArray[np.intp]) -> int:
        breaks = np.flatnonzero(np.diff(ticks) > 1)
        edges = np.concatenate([[-1], breaks, [ticks.size - 1]])
        return int(np.diff(edges).max())
