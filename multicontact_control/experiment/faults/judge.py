"""What became of a fault, in process or over the graph: one row, by the same limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import WatchdogConfig
from multicontact_control.experiment.faults.fault import Fault, REST, SLIDING
from multicontact_control.experiment.faults.vocabulary import CONTROLLER, INF
from multicontact_control.experiment.metrics import torque_limit
from multicontact_control.experiment.scenario import Setup
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np
from scipy.ndimage import uniform_filter1d

REACTION_TICKS = 2
FORCE_MARGIN = 1.25  # times the force ceiling
RETRACT_TIME = 0.1  # s, in which a contact beyond that must have been left
SILENCE = 0.1  # s without a command while samples come that counts as silence
STOPPED = 0.3  # s of silence that a controller which should go on may not be guilty of
TOLERANCE = 1e-9  # of a limit
# N on what is in the way, at most: nobody asked for any, so that unlike a contact's an impact may
# not be above it. Found: 36 N at the elbow of a sliding puma, 11 N on a side wall, in pairs, too.
MET_FORCE = 40.0
# rad/s of a joint while its speed or the sensor is wrong: 0.3 beyond a right run of the scenario.
FASTEST = 0.7
NOTICED_FORCE = 30.0  # N on what the wrist sensor does not feel, from where it must be told of
OFF_TIME, OFF_FORCE, OFF_SHARE = 0.02, 2.0, 0.2  # s, N, share of the command: off it beyond both
BACK_TIME = 0.6  # s after a fault, in which the arm is back: waiting, and five time constants
AGAIN = 10  # changes of the reaction, within a run of 1.2 s and 2/s over 5 s


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
        Largest true normal force from its beginning on, also on what is in the way [N].
    peak_torque_fraction
        Largest commanded torque over its limit, 0 without one.
    safe
        Every command finite, within the torque limits and their rates; in process, a declared
        reaction within two ticks, of R within its largest age; every true force within 1.25
        times the force ceiling, or back within it in 0.1 s; what is in the way pressed by less
        than 40 N, and noticed if it is at the elbow; over the graph, everything that is said
        finite, no silence of a controller that should go on, no wrong command obeyed; no
        exception, no hang.
    plant, phase, problems
        Where it happened, and why it was not safe.
    where
        ``process`` or ``graph``.
    off_command_s
        How long, from its beginning on, the true force of a contact was further from what the
        task asks for than 2 N and a fifth of it, over 20 ms; in process, on surfaces [s].
    transitions
        How often the reaction changed.
    shortfalls
        What the arm did not do as well as it should, though it was safe: not back at its command
        0.6 s after a fault of the inputs that it is told of, or bridges; reactions that come and
        go more than 10 times.

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
    off_command_s: float = -1.0
    transitions: int = 0
    shortfalls: str = ''


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
    forces, wanted
        True forces, and those that the task asks for, in process, shape (ticks, r) [N].
    met, noticed
        True forces on what is in the way, shape (ticks, o) [N], and whether a collision was
        told of, in process.
    speed
        Largest true speed of a joint, in process [rad/s].
    lasted
        How many ticks the fault lasted, in process.
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
    forces: Matrix | None = None
    wanted: Matrix | None = None
    met: Matrix | None = None
    noticed: bool = False
    speed: float = 0.0
    lasted: int = 0
    silences: Sequence[tuple[float, float]] = ()
    recovered: bool = True
    problems: set[str] = field(default_factory=set)


def judge(
    fault: Fault, seed: int, setup: Setup, seen: Observation, *, where: str, phase: str = '',
) -> FaultRow:
    """Return the row of a fault from what was seen of it."""
    config = setup.controller
    ceiling, period = config.contact_state.force_ceiling, config.period
    problems, fraction = never_allowed(
        seen, setup, begins_anew=fault.input == CONTROLLER, goes_on=fault.goes_on)
    met = float(seen.met.max(initial=0.0)) if seen.met is not None else 0.0
    if met > MET_FORCE:
        problems.add('obstacle pressed too hard')
    if fault.from_start and seen.speed > FASTEST:
        problems.add('joint too fast')
    if seen.met is not None and fault.meets is not None and not seen.noticed and (
            seen.met[:, fault.meets].max() > NOTICED_FORCE):
        problems.add('obstacle not noticed')
    latest = _latest(fault, config.watchdog)
    told = bool(seen.reactions) and seen.lasted > latest
    reached = _reaction_tick(seen.reactions, fault.expected(phase)) if told else 0
    if reached is None or reached > latest:
        problems.add('declared reaction late')
    over = seen.force > ceiling
    safe_from = [0.0, (reached or 0) * period, *seen.time[over].tolist(),
                 *(end for _, end in seen.silences)]
    off_command = _off_command(seen, config.rate)
    transitions = sum(a != b for a, b in zip(seen.reactions, seen.reactions[1:]))
    shortfalls = [f'reactions that change {transitions} times'] if transitions > AGAIN else []
    back = seen.lasted + round(BACK_TIME * config.rate)
    if fault.passes and phase in (REST, SLIDING) and off_command[back:].any():
        shortfalls.append('not back at its command')
    never = not seen.recovered or reached is None or bool(over.size and over[-1])
    return FaultRow(
        kind=fault.kind, input=fault.input, seed=seed, reaction=seen.reaction,
        time_to_safe_s=-1.0 if never else round(max(safe_from), 6),
        peak_force_n=round(max(met, float(seen.force.max(initial=0.0))), 3),
        peak_torque_fraction=round(fraction, 5), safe=not problems, plant=setup.plant_name,
        phase=phase, problems=', '.join(sorted(problems)), where=where,
        off_command_s=-1.0 if seen.forces is None or phase not in (REST, SLIDING) else round(
            float(off_command.sum()) * period, 6),
        transitions=transitions, shortfalls=', '.join(shortfalls))


def never_allowed(
    seen: Observation, setup: Setup, *, begins_anew: bool = False, goes_on: bool = True,
) -> tuple[set[str], float]:
    """
    Return what may not be seen whatever happens, and the largest torque over its limit.

    Parameters
    ----------
    seen
        Commands, forces, and what is known to have gone wrong.
    setup
        Limits and rate.
    begins_anew
        Whether a process or an activation begins: its first command starts from what the drives
        do.
    goes_on
        Whether the controller should not stop.

    """
    config, problems = setup.controller, set(seen.problems)
    step = np.inf if begins_anew else np.array(config.limits.torque_rate or INF) * config.period
    fraction = _judge_torques(seen, torque_limit(setup), step, problems)
    above = seen.force > FORCE_MARGIN * config.contact_state.force_ceiling
    if _longest(seen.time, above, config.period) > RETRACT_TIME * (1.0 + TOLERANCE):
        problems.add('force beyond the ceiling for too long')
    if goes_on and any(end - begin > STOPPED for begin, end in seen.silences):
        problems.add('commands stopped')
    return problems, fraction


def _latest(fault: Fault, watch: WatchdogConfig) -> int:
    """Return the tick by which a reaction must be in force: what is too old by then, or wrong."""
    ages = {'wrench': watch.wrench_max_age, 'variance': watch.variance_max_age}
    age = 0.0 if fault.at_once else ages.get(fault.input, 0.0)
    return max(REACTION_TICKS, int(age))


def _off_command(seen: Observation, rate: float) -> Mask:
    """Return in which ticks a contact is off its command, shape (ticks,)."""
    if seen.forces is None or seen.wanted is None:
        return np.zeros(0, dtype=bool)
    window = round(OFF_TIME * rate)
    error = uniform_filter1d(seen.forces - seen.wanted, window, axis=0, mode='nearest')
    off: Mask = (np.abs(error) > np.maximum(OFF_FORCE, OFF_SHARE * seen.wanted)).any(axis=1)
    return off


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
