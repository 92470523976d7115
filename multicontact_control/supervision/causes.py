"""
Causes of reactions, one bit each, and how severe what they call for is.

A cause is named `<part>_<what>`. Those of the inputs are `<reading>_<problem>`, see `inputs`;
those of the checks are `motion` (`operational_speed`, `joint_speed`), `wrench` (`pull`,
`sideways`, `stray`), `law` (`not_finite`, or the error it raises), `collision` (the joint that it
loads last), `start` (`outside`) and `internal` (an error of the supervision itself). Compiled code
reads the bits as plain integers.
"""

from __future__ import annotations

from multicontact_control.compiled import compiled
from multicontact_control.flags import (
    ANSWER_NOT_FINITE,
    FORCE_SIDEWAYS,
    FORCE_STRAY,
    JOINT_SPEED,
    MODEL_NOT_FINITE,
    NO_ANSWER,
    OPERATIONAL_SPEED,
    RESIDUAL_EXCEEDED,
    SURFACE_PULLS,
)
from multicontact_control.supervision.input_checks import (
    FINE,
    InputFindings,
    SATURATED,
    VELOCITY,
)

PARTS = ('joints', 'wrench', 'variance', 'clock')
# By their numbers in `input_checks`; a reading that is stale has no other problem.
PROBLEMS = (
    'stale',
    'invalid',
    'jump',
    'frozen',
    'saturated',
    'stamp',
    'backwards',
    'rate',
    'velocity',
    'outlier',
)
WIDTH = len(PROBLEMS)  # bits of a part
JOINTS, WRENCH, VARIANCE, CLOCK = (((1 << WIDTH) - 1) << WIDTH * k for k in range(4))
JOINTS_VELOCITY = 1 << VELOCITY
JOINTS_LOST = JOINTS & ~JOINTS_VELOCITY
WRENCH_SATURATED = 1 << WIDTH + SATURATED

# Of what the arm does and meets.
TOO_FAST = 1 << 4 * WIDTH  # the operational point
JOINT_TOO_FAST = TOO_FAST << 1
COLLISION = TOO_FAST << 2
WRENCH_PULL = TOO_FAST << 3
WRENCH_STRAY = TOO_FAST << 4
WRENCH_SIDEWAYS = TOO_FAST << 5
LAW_NOT_FINITE = TOO_FAST << 6
LAW = TOO_FAST << 7  # an error that it raises
INTERNAL = TOO_FAST << 8
START_OUTSIDE = TOO_FAST << 9

# Of a control that has not resumed yet.
RECOVERING = TOO_FAST << 10
LATCHED = TOO_FAST << 11
WAITING = RECOVERING | LATCHED

# What comes from what the arm does and meets, and not from readings that are missing.
PHYSICAL = (
    JOINTS_VELOCITY
    | WRENCH_SATURATED
    | TOO_FAST
    | JOINT_TOO_FAST
    | COLLISION
    | WRENCH_PULL
    | WRENCH_STRAY
    | WRENCH_SIDEWAYS
    | LAW_NOT_FINITE
    | LAW
    | INTERNAL
)

# Names of those that are no inputs'; an error adds its type, a collision its joint.
CHECKS = {
    TOO_FAST: 'motion_operational_speed',
    JOINT_TOO_FAST: 'motion_joint_speed',
    COLLISION: 'collision',
    WRENCH_PULL: 'wrench_pull',
    WRENCH_STRAY: 'wrench_stray',
    WRENCH_SIDEWAYS: 'wrench_sideways',
    LAW_NOT_FINITE: 'law_not_finite',
    LAW: 'law',
    INTERNAL: 'internal',
    START_OUTSIDE: 'start_outside',
    RECOVERING: 'recovering',
    LATCHED: 'latched',
}
NAMES: dict[int, str] = {JOINTS_VELOCITY: 'joints_velocity'}  # which is said first
for number, part in enumerate(PARTS):
    for problem, what in enumerate(PROBLEMS):
        NAMES.setdefault(1 << WIDTH * number + problem, f'{part}_{what}')
NAMES.update(CHECKS)
BITS = {name: bit for bit, name in NAMES.items()}

# What answers a tick, by severity: the law, the law with an R that grows, and reactions.
SEVERITY = ('none', 'inflate', 'hold', 'float', 'damp')
NONE, INFLATE, HOLD, FLOAT, DAMP = SEVERITY
# The same in compiled code; and the safe behaviour after a deactivation, which is no reaction to a
# fault.
TO_NONE, TO_INFLATE, TO_HOLD, TO_FLOAT, TO_DAMP, TO_SAFE = range(6)


@compiled
def find_input_causes(found: InputFindings) -> int:
    """Return the causes that the inputs of a tick are."""
    causes = 0
    shift = 0
    for finding in (found.joints, found.wrench, found.variance, found.clock):
        if finding.stale:
            causes |= 1 << shift + max(finding.problem, FINE)
        shift += WIDTH
    return causes


@compiled
def find_arm_causes(found: int, locked: bool) -> int:
    """Return the causes among what was found of the arm; a locked one may be pushed."""
    causes = 0
    if found & OPERATIONAL_SPEED:
        causes |= TOO_FAST
    if found & JOINT_SPEED:
        causes |= JOINT_TOO_FAST
    if found & RESIDUAL_EXCEEDED and not locked:
        causes |= COLLISION
    return causes


@compiled
def find_refusal_cause(found: int) -> int:
    """
    Return the cause by which an answer is missing or refused.

    Numbers that are not finite come first: a wrench can be told wrong by finite ones only.
    """
    if found & (ANSWER_NOT_FINITE | MODEL_NOT_FINITE):
        return LAW_NOT_FINITE
    if found & NO_ANSWER:
        return LAW
    if found & SURFACE_PULLS:
        return WRENCH_PULL
    if found & FORCE_STRAY:
        return WRENCH_STRAY
    if found & FORCE_SIDEWAYS:
        return WRENCH_SIDEWAYS
    return LAW_NOT_FINITE


@compiled
def choose_severest_reaction(causes: int, collision_reaction: int) -> int:
    """
    Return the severest reaction that causes call for, TO_NONE for no cause.

    Unknown joints are floated, an R that is not renewed is inflated, a collision is answered as
    configured; all else is held, also joints whose velocities are estimated from positions.
    """
    severest = TO_NONE
    if causes & VARIANCE:
        severest = TO_INFLATE
    if causes & COLLISION:
        severest = max(severest, collision_reaction)
    if causes & ~(VARIANCE | COLLISION | JOINTS_LOST):
        severest = max(severest, TO_HOLD)
    if causes & JOINTS_LOST:
        severest = max(severest, TO_FLOAT)
    return severest


def name_causes(causes: int, joint: str = '', error: str = '') -> tuple[str, ...]:
    """Return the names of causes; a collision gets the name of a joint, an error its type."""
    names = []
    for bit, name in NAMES.items():
        if not causes & bit:
            continue
        if bit == COLLISION:
            name = f'{name}_{joint}'
        elif bit in (LAW, INTERNAL):
            name = f'{name}_{error}'
        names.append(name)
    return tuple(names)
