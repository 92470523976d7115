"""Friction that the residuals show and nothing declares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from multicontact_control.control.arm import LEARNING_TIME, RELEASE
from multicontact_control.records import Joint, Records

UNDECLARED = (
    'follows the sign of the speed: {} N m of friction that friction.coulomb does not '
    'declare'
)
# Share of the time in motion after which all is learnt, from which on friction is reported.
MOVED_SHARE = 0.5


def undeclared_friction(joints: Records[Joint], names: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each joint that has shown friction which is not declared."""
    for joint, name in zip(joints, names):
        statistics = joint['watch']['residual_statistics']
        friction = statistics['friction']
        has_moved = statistics['time_in_motion'] > MOVED_SHARE * LEARNING_TIME
        counts = friction > RELEASE * joint['config']['least_threshold']
        if has_moved and counts:
            yield f'{name}: the residual {UNDECLARED.format(f"{friction:.2g}")}'
