"""One fault: the loop in process from a phase of a scenario on, with the fault in it, judged."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.closed_loop import ClosedLoop, Corruption
from multicontact_control.experiment.faults.vocabulary import Context, FaultKind
from multicontact_control.supervision.fallback import SEVERITY
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.status import SupervisorStatus
import numpy as np
from numpy.typing import NDArray

REACTION_TICKS = 2
FORCE_MARGIN = 1.25  # times the force ceiling
RETRACT_TICKS = 50  # in which a contact beyond that must have been left
RUN_TICKS = 350


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


def run_fault(loop: ClosedLoop, kind: FaultKind, seed: int, phase: str) -> FaultRow:
    """
    Let one fault happen in a closed loop that is used up by it.

    Parameters
    ----------
    loop
        At the beginning of the phase, supervised.
    kind, seed, phase
        The fault, what decides its details, and where in the scenario it happens.

    """
    random = np.random.default_rng([seed, sum(map(ord, kind.kind + kind.input))])
    for _ in range(int(random.integers(5, 60))):
        loop.advance()
    context = Context(random, loop.setup.controller.period, list(loop.history), loop.inputs(),
                      random.random(4))
    length = int(random.integers(5, 150))
    watch = _Watch(loop)
    if kind.begin is not None:
        kind.begin(loop.plant, context)
    for n in range(RUN_TICKS):
        if n == length and kind.end is not None:
            kind.end(loop.plant, context)
        loop.advance(_corruption(kind, context, n) if n < length else None)
        watch.note(loop.command, loop.status, loop.true_forces, faulty=n < length)
    return watch.row(kind, seed, phase)


def _corruption(kind: FaultKind, context: Context, n: int) -> Corruption | None:
    """Return what the n-th tick of a fault does to the readings."""
    change = kind.corrupt
    if change is None:
        return None

    def corrupt(inputs: TickInputs) -> TickInputs:
        context.history.append(inputs)
        return change(context, inputs, n)

    return corrupt


class _Watch:
    """Notes what happens, and judges it."""

    def __init__(self, loop: ClosedLoop) -> None:
        config = loop.setup.controller
        self._plant, self._h = loop.setup.plant_name, config.period
        limits = config.limits
        self._limit = np.array(config.torque_limit)
        self._step = np.array(limits.torque_rate) * config.period
        self._ceiling = config.contact_state.force_ceiling
        self._before = loop.command
        self._reactions: list[str] = []
        self._forces: list[float] = []
        self._peak_fraction = 0.0
        self._strongest = 0
        self._problems: set[str] = set()

    def note(
        self, torque: Vector, status: SupervisorStatus, forces: Vector, *, faulty: bool,
    ) -> None:
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
        if any(cause.startswith('internal') for cause in status.causes):
            self._problems.add(status.causes[0])
        self._reactions.append(status.reaction)
        if faulty:
            self._strongest = max(self._strongest, SEVERITY.index(status.reaction))
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
