"""What became of a fault, or of a situation: one row, by the same limits for all."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Matrix, Vector
from multicontact_control.faults.unasked_motion import MotionTrace, unasked_motion
from multicontact_control.faults.vocabulary import Fault, REST, SLIDING
from multicontact_control.judging.metrics import torque_limit
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.causes import SEVERITY
import numpy as np
from scipy.ndimage import uniform_filter1d

REACTION_TICKS = 2
FORCE_MARGIN = 1.25  # times the force ceiling
RETRACT_TIME = 0.1  # s, in which a contact beyond that must have been left
TOLERANCE = 1e-9  # of a limit
# N on what is in the way, at most; unlike a contact it is to be touched lightly.
OBSTACLE_FORCE = 40.0
# rad/s of a joint while its speed or the sensor is wrong: 0.3 beyond a right run of the scenario.
FASTEST = 0.7
# N on what the wrist sensor does not feel, from where it must be noticed.
NOTICED_FORCE = 30.0
# A force is off its command if it is further away than both, over a time.
OFF_FORCE = 2.0  # N
OFF_SHARE = 0.2  # of the command
OFF_TIME = 0.02  # s
# s after a fault, in which the arm is back: waiting, and five time constants.
BACK_TIME = 0.6
UNKNOWN = np.zeros((0, 1))  # forces
MOST_TRANSITIONS = 10  # of the reaction, within a run of 1.2 s and 2/s over 5 s
# In a situation, where nothing is wrong.
OVER_COMMAND = 20.0  # N on a surface above what is commanded, also while that is 0
SPEED_TOLERANCE = 0.01  # of a joint's largest speed
PAST_STOP = 0.01  # rad
UNASKED = 5e-3  # m, of a motion that was not asked for
END_TIME = 0.5  # s, the end of a run that tells what it has come to


@dataclass(frozen=True)
class FaultRow:
    """
    What became of one fault; the fields are columns of the table of `study faults`.

    A row without `problems` is safe. With `shortfalls` alone the arm is safe and does its work
    less well; the table shows it as not `back`.
    """

    kind: str
    input: str  # noqa: A003
    seed: int
    reaction: str  # the strongest while it lasted
    # From its beginning until a declared reaction is in force, if one is declared, and every true
    # force is, and stays, within the ceiling [s]; infinite if that never comes.
    time_to_safe_s: float
    peak_force_n: float  # largest true normal force, also on what is in the way [N]
    peak_torque_fraction: float  # largest command over its limit, 0 without one
    safe: bool  # without `problems`
    plant: str
    phase: str
    problems: str = ''
    # How long the true force of a contact was further from what the task asks for than 2 N and a
    # fifth of it, over 20 ms, on surfaces [s]; None if not known.
    off_command_s: float | None = None
    transitions: int = 0  # how often the reaction changed
    shortfalls: str = ''  # what a safe arm did not do as well as it should
    pair: str = ''  # the two at once


class Observation(NamedTuple):
    """
    What was seen of a fault or a situation; times are from its beginning [s].

    Forces and speeds are the simulated plant's own, and not what the controller measures. The
    defaults stand for what cannot be seen, as over a graph.
    """

    torque: Matrix  # commands, shape (ticks, n) [N m]
    time: Vector  # of the largest true forces `force`
    force: Vector  # largest of all contacts [N]
    reaction: str  # for the row
    torque_before: Vector | None = None  # the last one before, if known [N m]
    limited_rate: bool = True  # torques may not jump; they may where a process begins
    reactions: Sequence[str] = ()  # in each tick
    # True forces, those that the task asks for, and those on obstacles, shape (ticks, count) [N].
    forces: Matrix = UNKNOWN
    commands: Matrix = UNKNOWN
    obstacle_forces: Matrix = UNKNOWN
    collision_noticed: bool = False
    largest_speed: float = 0.0  # true one of a joint [rad/s]
    fault_ticks: int = 0  # how long the fault lasted
    problems: Collection[str] = ()  # what is known to have gone wrong


@dataclass(frozen=True)
class SituationRow:
    """
    What became of one situation; the fields are columns of the table of `study situations`.

    Without figures it is the row of a run that broke off.
    """

    what: str  # it is
    peak_over_n: float = math.inf  # largest true normal force above its command [N]
    speed_share: float = math.inf  # largest true speed of a joint over its limit
    # How far a joint was beyond its stop, below 0 before it [rad].
    beyond_stop_rad: float = math.inf
    unasked_mm: float = math.inf  # see `unasked_motion` [mm]
    # Mean distance of the worst force from its command, at the end [N].
    off_n: float = math.inf
    # Distance from the setpoint at the end, but for normals [mm].
    short_mm: float = math.inf
    reaction: str = 'died'  # the strongest
    peak_torque_fraction: float = math.inf
    safe: bool = False  # without `problems`
    problems: str = ''


def judge_fault(
    fault: Fault,
    seed: int,
    setup: Setup,
    seen: Observation,
    *,
    phase: str = '',
) -> FaultRow:
    """
    Return the row of a fault from what was seen of it.

    A declared reaction comes within two ticks, or, to a wrench or an R that is missing, within its
    largest age. It falls short if the arm is not back at its command 0.6 s after a fault that is
    noticed or bridged, or reactions come and go more than 10 times.

    Parameters
    ----------
    fault, seed
        What happened, and the seed of its details.
    setup
        Of the run: it has the limits.
    seen
        What was seen from the fault's beginning on.
    phase
        Of the scenario, in which the fault began; '' if no reaction is expected.

    """
    config = setup.controller
    problems, torque_fraction = find_violations(seen, setup)
    problems |= _find_misses(fault, seen)
    latest = _latest_reaction_tick(fault, setup)
    expected: tuple[str, ...] = ()
    if phase in fault.phases and seen.fault_ticks > latest:
        expected = fault.declared
    reached = _first_declared_tick(seen.reactions, expected)
    if reached is None or reached > latest:
        problems.add('declared reaction late')
    is_above = seen.force > config.contact_state.force_ceiling
    time_to_safe = math.inf
    if reached is not None and not is_above[-1:].any():
        times_above = seen.time[is_above].tolist()
        time_to_safe = max([reached * config.period, *times_above])
    is_off = _off_command(seen, config.rate)
    transitions = sum(before != after for before, after in pairwise(seen.reactions))
    shortfalls = []
    if transitions > MOST_TRANSITIONS:
        shortfalls.append(f'reactions that change {transitions} times')
    off_command = None
    if phase in (REST, SLIDING):
        off_command = round(float(is_off.sum()) * config.period, 6)
        back = seen.fault_ticks + round(BACK_TIME * config.rate)
        if fault.allows_return and is_off[back:].any():
            shortfalls.append('not back at its command')
    peak_force = max(seen.obstacle_forces.max(initial=0.0), seen.force.max(initial=0.0))
    names = [f'{part.input} {part.kind}' for part in fault.parts]
    return FaultRow(
        kind=fault.kind,
        input=fault.input,
        seed=seed,
        reaction=seen.reaction,
        time_to_safe_s=round(time_to_safe, 6),
        peak_force_n=round(float(peak_force), 3),
        peak_torque_fraction=round(torque_fraction, 5),
        safe=not problems,
        plant=setup.plant_name,
        phase=phase,
        problems=', '.join(sorted(problems)),
        off_command_s=off_command,
        transitions=transitions,
        shortfalls=', '.join(shortfalls),
        pair=' + '.join(names),
    )


def _find_misses(fault: Fault, seen: Observation) -> set[str]:
    """Return what an arm missed in a fault: an obstacle, or a joint that became too fast."""
    problems = set()
    forces = seen.obstacle_forces
    if forces.max(initial=0.0) > OBSTACLE_FORCE:
        problems.add('obstacle pressed too hard')
    if fault.from_start and seen.largest_speed > FASTEST:
        problems.add('joint too fast')
    if fault.obstacle is not None and not seen.collision_noticed:
        if forces[:, fault.obstacle].max(initial=0.0) > NOTICED_FORCE:
            problems.add('obstacle not noticed')
    return problems


def _latest_reaction_tick(fault: Fault, setup: Setup) -> int:
    """Return the tick of a fault by which a declared reaction must be in force."""
    watchdog = setup.controller.watchdog
    ages = {'wrench': watchdog.wrench_max_age, 'variance': watchdog.variance_max_age}
    if fault.at_once or fault.input not in ages:
        return REACTION_TICKS
    return max(REACTION_TICKS, int(ages[fault.input]))


def judge_situation(
    what: str, setup: Setup, seen: Observation, way: MotionTrace
) -> SituationRow:
    """
    Return the row of a situation from what was seen in it.

    Parameters
    ----------
    what
        The situation in words.
    setup
        Of the run: it has the limits.
    seen
        What was seen of it, with forces and their commands.
    way
        Where the arm was and where it should have been.

    """
    limits = setup.controller.limits
    problems, torque_fraction = find_violations(seen, setup)
    over = seen.forces - seen.commands
    peak = float(over.max())
    speed_limit = limits.joint_speed or math.inf
    speed = float((np.abs(way.qd) / speed_limit).max())
    beyond = -math.inf
    if limits.joint_lower:
        below_lower = limits.joint_lower - way.q
        above_upper = way.q - limits.joint_upper
        beyond = float(np.maximum(below_lower, above_upper).max())
    unasked = unasked_motion(setup, way)
    if peak > OVER_COMMAND:
        problems.add('force above the command')
    if speed > 1.0 + SPEED_TOLERANCE:
        problems.add('joint too fast')
    if beyond > PAST_STOP:
        problems.add('joint beyond its stop')
    if unasked > UNASKED:
        problems.add('motion not asked for')
    end_ticks = round(END_TIME * setup.controller.rate)
    off = np.abs(over[-end_ticks:].mean(axis=0)).max()
    missing_way = way.setpoint[-1] - way.position[-1]
    short = np.linalg.norm(way.across[-1] @ missing_way)
    return SituationRow(
        what=what,
        peak_over_n=round(peak, 3),
        speed_share=round(speed, 4),
        beyond_stop_rad=round(beyond, 5),
        unasked_mm=round(1e3 * unasked, 3),
        off_n=round(float(off), 3),
        short_mm=round(1e3 * float(short), 2),
        reaction=seen.reaction,
        peak_torque_fraction=round(torque_fraction, 5),
        safe=not problems,
        problems=', '.join(sorted(problems)),
    )


def find_violations(seen: Observation, setup: Setup) -> tuple[set[str], float]:
    """
    Return what no fault excuses, and the largest torque over its limit.

    Every command is finite, within the limits of torque and of its rate, and a contact whose true
    force is beyond the ceiling by a quarter is left within 0.1 s.
    """
    config = setup.controller
    problems = set(seen.problems)
    is_finite = np.isfinite(seen.torque).all(axis=1)
    if not is_finite.all():
        problems.add('command not finite')
    torque = seen.torque[is_finite]
    torque_fraction = float((np.abs(torque) / torque_limit(setup)).max(initial=0.0))
    if torque_fraction > 1.0 + TOLERANCE:
        problems.add('torque beyond its limit')
    if seen.torque_before is not None:
        torque = np.vstack([seen.torque_before, torque])
    largest_step = np.array(config.limits.torque_rate or np.inf) * config.period
    jumps = np.abs(np.diff(torque, axis=0)) > largest_step * (1.0 + TOLERANCE)
    if seen.limited_rate and jumps.any():
        problems.add('torque rate beyond its limit')
    is_above = seen.force > FORCE_MARGIN * config.contact_state.force_ceiling
    for begin, end in find_true_stretches(is_above):
        lasted = seen.time[end - 1] - seen.time[begin] + config.period
        if lasted > RETRACT_TIME * (1.0 + TOLERANCE):
            problems.add('force beyond the ceiling for too long')
    return problems, torque_fraction


def _off_command(seen: Observation, rate: float) -> Mask:
    """Return in which ticks a contact is off its command, shape (ticks,)."""
    error = uniform_filter1d(
        seen.forces - seen.commands, round(OFF_TIME * rate), axis=0, mode='nearest'
    )
    allowed = np.maximum(OFF_FORCE, OFF_SHARE * seen.commands)
    off: Mask = (np.abs(error) > allowed).any(axis=1)
    return off


def _first_declared_tick(
    reactions: Sequence[str], expected: tuple[str, ...]
) -> int | None:
    """Return the first tick with a declared reaction: 0 if none is expected, None without."""
    if not expected:
        return 0
    enough = expected
    # Floating and damping count for holding and each other, not for inflating R.
    if 'inflate' not in expected:
        enough = (*expected, *SEVERITY[3:])
    for tick, reaction in enumerate(reactions):
        if reaction in enough:
            return tick
    return None
