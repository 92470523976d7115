"""What became of a fault, or of a situation: one row, by the same limits for all."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Matrix, Vector
from multicontact_control.faults.unasked import unasked_motion, Way
from multicontact_control.faults.vocabulary import Fault, REST, SLIDING
from multicontact_control.judging.metrics import torque_limit
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np
from scipy.ndimage import uniform_filter1d

REACTION_TICKS = 2
FORCE_MARGIN = 1.25  # times the force ceiling
RETRACT_TIME = 0.1  # s, in which a contact beyond that must have been left
TOLERANCE = 1e-9  # of a limit
MET_FORCE = 40.0  # N on what is in the way, at most; unlike a contact it is to be touched lightly
# rad/s of a joint while its speed or the sensor is wrong: 0.3 beyond a right run of the scenario.
FASTEST = 0.7
NOTICED_FORCE = (
    30.0  # N on what the wrist sensor does not feel, from where it must be noticed
)
OFF_TIME, OFF_FORCE, OFF_SHARE = (
    0.02,
    2.0,
    0.2,
)  # s, N, share of the command: off it beyond both
BACK_TIME = (
    0.6  # s after a fault, in which the arm is back: waiting, and five time constants
)
UNKNOWN = np.zeros((0, 1))  # forces
AGAIN = 10  # changes of the reaction, within a run of 1.2 s and 2/s over 5 s
# In a situation, where nothing is wrong.
OVER_COMMAND = 20.0  # N on a surface above what is commanded, also while that is 0
SPEED_TOLERANCE = 0.01  # of a joint's largest speed
PAST_STOP = 0.01  # rad
UNASKED = 5e-3  # m, of a motion that was not asked for
END_TIME = 0.5  # s, the end of a run that tells what it has come to


@dataclass(frozen=True)
class FaultRow:
    """What became of one fault."""

    kind: str
    input: str  # noqa: A003
    seed: int
    reaction: str  # the strongest while it lasted
    # From its beginning until a declared reaction is in force, if one is declared, and every true
    # force is, and stays, within the ceiling [s]; infinite if that never comes.
    time_to_safe_s: float
    peak_force_n: float  # largest true normal force, also on what is in the way [N]
    peak_torque_fraction: (
        float  # largest commanded torque over its limit, 0 without one
    )
    safe: bool  # nothing of `problems`
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
    """What was seen of a fault; times are from its beginning [s]."""

    torque: Matrix  # commands, shape (ticks, n) [N m]
    time: Vector  # of the largest true forces `force` [N]
    force: Vector
    reaction: str  # for the row
    before: Vector | None = None  # the last torque before, if known
    limited_rate: bool = True  # torques may not jump; they may where a process begins
    reactions: Sequence[str] = ()  # in each tick
    # True forces, those that the task asks for, and those on obstacles, shape (ticks, count) [N].
    forces: Matrix = UNKNOWN
    commands: Matrix = UNKNOWN
    met: Matrix = UNKNOWN
    noticed: bool = False  # whether a collision was reported
    speed: float = 0.0  # largest true speed of a joint [rad/s]
    lasted: int = 0  # ticks of the fault
    problems: Collection[str] = ()  # what is known to have gone wrong


@dataclass(frozen=True)
class SituationRow:
    """What became of one situation."""

    what: str  # it is
    peak_over_n: float  # largest true normal force above the one commanded [N]
    speed_share: float  # largest true speed of a joint over its limit
    beyond_stop_rad: (
        float  # how far a joint was beyond its stop, below 0 before it [rad]
    )
    unasked_mm: (
        float  # largest motion that was not asked for [mm]; see `unasked_motion`
    )
    off_n: float  # mean distance of the worst force from its command, at the end [N]
    short_mm: float  # distance from the setpoint at the end, but for normals [mm]
    reaction: str  # the strongest
    peak_torque_fraction: float
    safe: bool  # nothing of `problems`
    problems: str = ''


def judge(
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
    """
    config = setup.controller
    problems, fraction = never_allowed(seen, setup)
    met = float(seen.met.max(initial=0.0))
    if met > MET_FORCE:
        problems.add('obstacle pressed too hard')
    if fault.from_start and seen.speed > FASTEST:
        problems.add('joint too fast')
    if (
        fault.meets is not None
        and not seen.noticed
        and (seen.met[:, fault.meets].max(initial=0.0) > NOTICED_FORCE)
    ):
        problems.add('obstacle not noticed')
    ages = {
        'wrench': config.watchdog.wrench_max_age,
        'variance': config.watchdog.variance_max_age,
    }
    latest = max(
        REACTION_TICKS, 0 if fault.at_once else int(ages.get(fault.input, 0.0))
    )
    expected = fault.declared if phase in fault.phases and seen.lasted > latest else ()
    reached = _reaction_tick(seen.reactions, expected)
    if reached is None or reached > latest:
        problems.add('declared reaction late')
    over = seen.force > config.contact_state.force_ceiling
    never = reached is None or bool(over.size and over[-1])
    off_command = _off_command(seen, config.rate)
    transitions = sum(a != b for a, b in pairwise(seen.reactions))
    shortfalls = (
        [f'reactions that change {transitions} times'] if transitions > AGAIN else []
    )
    back = seen.lasted + round(BACK_TIME * config.rate)
    at_work = phase in (REST, SLIDING)
    if fault.passes and at_work and off_command[back:].any():
        shortfalls.append('not back at its command')
    return FaultRow(
        kind=fault.kind,
        input=fault.input,
        seed=seed,
        reaction=seen.reaction,
        time_to_safe_s=math.inf
        if never
        else round(
            max((reached or 0) * config.period, *seen.time[over].tolist(), 0.0), 6
        ),
        peak_force_n=round(max(met, float(seen.force.max(initial=0.0))), 3),
        peak_torque_fraction=round(fraction, 5),
        safe=not problems,
        plant=setup.plant_name,
        phase=phase,
        problems=', '.join(sorted(problems)),
        off_command_s=round(float(off_command.sum()) * config.period, 6)
        if at_work
        else None,
        transitions=transitions,
        shortfalls=', '.join(shortfalls),
        pair=' + '.join(f'{part.input} {part.kind}' for part in fault.parts),
    )


def judge_situation(
    what: str, setup: Setup, seen: Observation, way: Way
) -> SituationRow:
    """Return the row of a situation from what was seen in it."""
    limits = setup.controller.limits
    problems, fraction = never_allowed(seen, setup)
    peak = float((seen.forces - seen.commands).max())
    speed = float((np.abs(way.qd) / (limits.joint_speed or math.inf)).max())
    beyond = -math.inf
    if limits.joint_lower:
        beyond = float(
            np.maximum(limits.joint_lower - way.q, way.q - limits.joint_upper).max()
        )
    unasked = unasked_motion(setup, way)
    for problem, wrong in (
        ('force above the command', peak > OVER_COMMAND),
        ('joint too fast', speed > 1.0 + SPEED_TOLERANCE),
        ('joint beyond its stop', beyond > PAST_STOP),
        ('motion not asked for', unasked > UNASKED),
    ):
        if wrong:
            problems.add(problem)
    last = round(END_TIME * setup.controller.rate)
    off = np.abs((seen.forces - seen.commands)[-last:].mean(axis=0)).max()
    short = np.linalg.norm(way.across[-1] @ (way.setpoint[-1] - way.position[-1]))
    return SituationRow(
        what=what,
        peak_over_n=round(peak, 3),
        speed_share=round(speed, 4),
        beyond_stop_rad=round(beyond, 5),
        unasked_mm=round(1e3 * unasked, 3),
        off_n=round(float(off), 3),
        short_mm=round(1e3 * float(short), 2),
        reaction=seen.reaction,
        peak_torque_fraction=round(fraction, 5),
        safe=not problems,
        problems=', '.join(sorted(problems)),
    )


def died(what: str, error: Exception) -> SituationRow:
    """Return the row of a situation that ended by an error."""
    unknown = math.inf
    return SituationRow(
        what,
        unknown,
        unknown,
        unknown,
        unknown,
        unknown,
        unknown,
        'died',
        unknown,
        False,
        f'{type(error).__name__}: {error}',
    )


def never_allowed(seen: Observation, setup: Setup) -> tuple[set[str], float]:
    """Return what may not be seen whatever happens, and the largest torque over its limit."""
    config, problems = setup.controller, set(seen.problems)
    finite = np.isfinite(seen.torque).all(axis=1)
    if not finite.all():
        problems.add('command not finite')
    torque = seen.torque[finite]
    fraction = float((np.abs(torque) / torque_limit(setup)).max(initial=0.0))
    if fraction > 1.0 + TOLERANCE:
        problems.add('torque beyond its limit')
    if seen.before is not None:
        torque = np.vstack([seen.before, torque])
    step = np.array(config.limits.torque_rate or np.inf) * config.period
    if (
        seen.limited_rate
        and (np.abs(np.diff(torque, axis=0)) > step * (1.0 + TOLERANCE)).any()
    ):
        problems.add('torque rate beyond its limit')
    above = seen.force > FORCE_MARGIN * config.contact_state.force_ceiling
    if any(
        seen.time[end - 1] - seen.time[begin] + config.period
        > RETRACT_TIME * (1.0 + TOLERANCE)
        for begin, end in find_true_stretches(above)
    ):
        problems.add('force beyond the ceiling for too long')
    return problems, fraction


def _off_command(seen: Observation, rate: float) -> Mask:
    """Return in which ticks a contact is off its command, shape (ticks,)."""
    error = uniform_filter1d(
        seen.forces - seen.commands, round(OFF_TIME * rate), axis=0, mode='nearest'
    )
    off: Mask = (np.abs(error) > np.maximum(OFF_FORCE, OFF_SHARE * seen.commands)).any(
        axis=1
    )
    return off


def _reaction_tick(reactions: Sequence[str], expected: tuple[str, ...]) -> int | None:
    """Return the first tick with a declared reaction, which stronger ones imply."""
    if not expected:
        return 0
    # Floating and damping count for holding and each other, not for inflating R.
    enough = expected if 'inflate' in expected else (*expected, *SEVERITY[3:])
    return next((n for n, reaction in enumerate(reactions) if reaction in enough), None)
