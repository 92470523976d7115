"""What speaks for which cause of a collision: what the residual of a joint follows."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Vector
from multicontact_control.control.arm import (
    ACCELERATION,
    DIRECTION,
    RELEASE,
    REST_TIME,
    SPEED,
    WRENCH,
)
from multicontact_control.diagnosis.friction import UNDECLARED
from multicontact_control.records import Joint, Momentum, Records, ResidualStatistics
import numpy as np

# Share of the residual's power, from which on what it follows is its cause.
EXPLAINED = 0.7
# Share of the time at rest in which all is learnt, from which on a residual may have grown later.
RESTED_SHARE = 0.5
# Share of the residual that was there at rest, above which it has not.
AT_REST_SHARE = 0.5
# As `EXPLAINED`, over the joints at rest, of the torque of gravity.
MULTIPLE = 0.95
# Distance of that multiple from -1, within which it is another sign.
NEAR_OPPOSITE = 0.2
OTHER_UNIT = 1.5  # size of that multiple, from which on it is another unit
# What to say of a residual that follows one of `REGRESSORS`.
FOLLOWED = {
    DIRECTION: UNDECLARED,
    SPEED: 'is {} N m s/rad times the speed: check friction.viscous and the scale of '
    'the velocities',
    ACCELERATION: 'is {} kg m^2 times the acceleration: check robot.armature and the '
    'scale of the effort',
    WRENCH: 'follows the wrench, of which the torques show {} times: check its sign, '
    'unit and frame (robot.sensor_frame), and the scale of the effort',
}


@np.errstate(all='ignore')  # of impossible efforts
def explain_collision(
    joints: Records[Joint], momentum: Momentum, names: Sequence[str]
) -> str:
    """
    Return what speaks for which cause of a collision, from the records of the observer.

    Parameters
    ----------
    joints, momentum
        Records of `JOINT`, shape (n,), and the observer's in `CONTROL`.
    names
        Of the joints, in this order.

    """
    watch = joints['watch']
    residual = watch['residual']
    shares = np.abs(residual) / (watch['threshold'] + watch['dynamic_threshold'])
    worst = int(np.argmax(shares))
    name = names[worst]
    statistics = watch['residual_statistics'][worst]
    loaded = [joint for joint, share in zip(names, shares) if share > RELEASE]
    if not loaded:
        loaded = [name]
    hardly_rested = statistics['time_at_rest'] < RESTED_SHARE * REST_TIME
    if (
        hardly_rested
        or statistics['residual_at_rest'] / residual[worst] > AT_REST_SHARE
    ):
        settled = 1.0 - np.exp(
            -momentum['config']['bandwidth'] * statistics['time_at_rest']
        )
        cause = _explain_rest(residual / settled, joints['bias_torque'], len(loaded))
        return f'{name}: the residual is there from the first sample on{cause}'
    followed = _explain_motion(residual[worst], statistics)
    if followed:
        return f'{name}: the residual {followed}'
    return (
        f'the residual grew in {", ".join(loaded)}: something touches the arm at or before '
        f'the link that {loaded[-1]} moves; if not, check robot.armature and the effort of '
        f'{name}, the frame of the wrench, and that no other node commands the arm'
    )


def _explain_motion(residual: float, statistics: ResidualStatistics) -> str:
    """Return which regressor the residual of a joint [N m] has followed; empty if none."""
    squares = np.maximum(statistics['regressor_power'], np.finfo(float).tiny)
    explained = statistics['correlation'] ** 2 / squares
    slope = statistics['correlation'] / squares
    against = slope < 0.0
    against[WRENCH] = False  # a wrench may be read with another sign
    explained[against] = 0.0  # what pushes a joint moves it that way, too
    best = int(np.argmax(explained))
    if not explained[best] > EXPLAINED * statistics['residual_power']:
        return ''
    if best == DIRECTION:
        friction = max(abs(residual), statistics['friction'])
        factor = f'at least {friction:.2g}'
    elif best == WRENCH:  # the residual is what is beyond the wrench that is read
        factor = f'{1.0 + slope[best]:.2g}'
    else:
        factor = f'{slope[best]:.2g}'
    return FOLLOWED[best].format(factor)


def _explain_rest(residual: Vector, gravity: Vector, loaded: int) -> str:
    """Return what residuals of an arm at rest, shape (n,) [N m], speak for; `loaded` count."""
    product = residual @ gravity
    square = gravity @ gravity
    factor = product / square
    is_multiple = product**2 > MULTIPLE * square * (residual @ residual)
    is_wrong = abs(factor + 1.0) < NEAR_OPPOSITE or abs(factor) > OTHER_UNIT
    if is_multiple and is_wrong:
        return (
            f', {factor:.2g} times the torque of gravity: check unit and sign of the effort, '
            'and whether it lacks gravity (robot.adds_gravity)'
        )
    if loaded == 1:
        return ', in this joint alone: check scale, sign and offset of its effort'
    return (
        ': check the masses of tool and links, sign and offset of the wrench, the offsets of '
        'the effort, and that no other node commands the arm'
    )
