"""What became of a fault, in process or over the graph: one row, by the same limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.experiment.faults.vocabulary import CONTROLLER, Fault, INF
from multicontact_control.experiment.scenario import Setup
from multicontact_control.supervision.fallback import SEVERITY
import numpy as np

REACTION_TICKS = 2
FORCE_MARGIN = 1.25  # times the force ceiling
RETRACT_TIME = 0.1  # s, in which a contact beyond that must have been left
SILENCE = 0.1  # s without a command while samples come that counts as silence
STOPPED = 0.3  # s of silence that a controller which should go on may not be guilty of
TOLERANCE = 1e-9  # of a limit


@dataclass(frozen=True)
class FaultRow:
    """
    What became of one fault.

    Attributes
    ----------
    kind, input, seed
        Which fault.
    reaction
        In process the strongest reaction while it lasted, over the graph that which was told of
        for longest.
    time_to_safe_s
        From its beginning until a declared reaction is in force, if one is declared, or commands
        come again, and every true force is, and stays, within the ceiling [s]; infinite numbers
        do not occur: -1 says never.
    peak_force_n
        Largest true normal force from its beginning on [N].
    peak_torque_fraction
        Largest commanded torque over its limit.
    safe
        Every command finite, within the torque limits and their rates; in process, a declared
        reaction within two ticks, of R within its largest age; every true force within 1.25
        times the force ceiling, or back within it in 0.1 s; over the graph, everything that is
        said finite, no silence of a controller that should go on, no wrong command obeyed; no
        exception, no hang.
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


@dataclass
class Observation:
    """
    What was seen of a fault; times are from its beginning [s].

    Attributes
    ----------
    torque
        Commands, shape (ticks, n) [N m].
    time, force
        Largest true force, and when [N].
    reaction
        The word for the row.
    before
        The last torque before, if known.
    reactions
        The reaction in each tick, in process.
    silences
        From when to when samples came, but no commands.
    recovered
        Whether all was well again.
    problems
        What is known to have gone wrong.

    """

    torque: Matrix
    time: Vector
    force: Vector
    reaction: str
    before: Vector | None = None
    reactions: Sequence[str] = ()
    silences: Sequence[tuple[float, float]] = ()
    recovered: bool = True
    problems: set[str] = field(default_factory=set)


def judge(
    fault: Fault, seed: int, setup: Setup, seen: Observation, *, where: str, phase: str = '',
) -> FaultRow:
    """Return the row of a fault from what was seen of it."""
    config, problems = setup.controller, set(seen.problems)
    ceiling, period = config.contact_state.force_ceiling, config.period
    step = np.array(config.limits.torque_rate) * period
    # The first command of a new process or activation starts from what the drives do.
    fraction = _judge_torques(
        seen, np.array(config.torque_limit), step if fault.input != CONTROLLER else INF, problems)
    if _longest(seen.time, seen.force > FORCE_MARGIN * ceiling, period) > (
            RETRACT_TIME * (1.0 + TOLERANCE)):
        problems.add('force beyond the ceiling for too long')
    reached = _reaction_tick(seen.reactions, fault.expected(phase)) if seen.reactions else 0
    # An R that is late is used until it is too old; everything else is bridged for one tick.
    latest = int(config.watchdog.variance_max_age) if fault.input == 'variance' else REACTION_TICKS
    if reached is None or reached > latest:
        problems.add('declared reaction late')
    if fault.goes_on and any(end - begin > STOPPED for begin, end in seen.silences):
        problems.add('commands stopped')
    over = seen.force > ceiling
    safe_from = [0.0, (reached or 0) * period, *seen.time[over].tolist(),
                 *(end for _, end in seen.silences)]
    never = not seen.recovered or reached is None or bool(over.size and over[-1])
    return FaultRow(
        kind=fault.kind, input=fault.input, seed=seed, reaction=seen.reaction,
        time_to_safe_s=-1.0 if never else round(max(safe_from), 6),
        peak_force_n=round(float(seen.force.max(initial=0.0)), 3),
        peak_torque_fraction=round(fraction, 5), safe=not problems, plant=setup.plant_name,
        phase=phase, problems=', '.join(sorted(problems)), where=where)


def _judge_torques(
    seen: Observation, limit: Vector, step: Vector | float, problems: set[str],
) -> float:
    """Return the largest torque over its limit; `step` is what it may change in a tick."""
    finite = np.isfinite(seen.torque).all(axis=1)
    if not finite.all():
        problems.add('command not finite')
    torque = seen.torque[finite]
    fraction = float((np.abs(torque) / limit).max(initial=0.0))
    if fraction > 1.0 + TOLERANCE:
        problems.add('torque beyond its limit')
    if seen.before is not None:
        torque = np.vstack([seen.before, torque])
    if (np.abs(np.diff(torque, axis=0)) > step * (1.0 + TOLERANCE)).any():
        problems.add('torque rate beyond its limit')
    return fraction


def _longest(time: Vector, above: Mask, period: float) -> float:
    """Return the longest time without a break in which something was above [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]])))
    begin, end = time[edges[::2]], time[edges[1::2] - 1]
    return float((end - begin + period).max(initial=0.0))


def _reaction_tick(reactions: Sequence[str], expected: tuple[str, ...]) -> int | None:
    """
    Return the first tick with a declared reaction.

    Floating and damping count for holding and each other, not for inflating R.
    """
    if not expected:
        return 0
    for n, reaction in enumerate(reactions):
        if reaction in expected or (reaction in SEVERITY[3:] and 'inflate' not in expected):
            return n
    return None
