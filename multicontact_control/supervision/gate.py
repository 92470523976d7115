"""
The last gate: what leaves it is finite, within every limit, and brakes before the stops.

Every command passes here.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_vector
from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_state import ArmState
from multicontact_control.records import JOINT, JOINT_LIMITS, Records
import numpy as np

# What `gate_torque` returns, added up.
NOT_FINITE, JOINT_STOP, TORQUE, TORQUE_RATE = 1, 2, 4, 8
NAMES = (('not_finite', NOT_FINITE), ('joint', JOINT_STOP), ('torque', TORQUE),
         ('torque_rate', TORQUE_RATE))
ENFORCED = tuple(tuple(name for name, bit in NAMES if flags & bit) for flags in range(16))
SPEED_GAIN = 50.0  # 1/s, how fast a joint is brought back to the speed it may have
JOINT_MARGIN = 0.02  # rad before its stop, where a joint is to stand still
JOINT_BRAKING = 5.0  # rad/s^2 counted on before a stop
BRAKING_SHARE = 0.7  # of the speed a joint may have, from where on that is looked after


@compiled
def all_finite(values: Vector) -> bool:
    """Return whether all values are finite."""
    for i in range(values.shape[0]):
        if not np.isfinite(values[i]):
            return False
    return True


@compiled
def brake_joints(joints: Any, limits: Any, torque: Vector) -> bool:
    """
    Bound a torque such that no joint passes a stop or its speed limit; return whether it was.

    A joint may have the speed v_max = sqrt(2 a d) at a distance d from its stop.
    """
    n = torque.shape[0]
    fastest, slowest = np.empty(n), np.empty(n)
    slow = True
    for j in range(n):
        q, speed, limit = joints[j].q, joints[j].velocity, limits[j]
        ahead = np.sqrt(2.0 * limit.braking * np.maximum(limit.upper - q, 0.0))
        behind = np.sqrt(2.0 * limit.braking * np.maximum(q - limit.lower, 0.0))
        fastest[j] = np.minimum(ahead, limit.speed)
        slowest[j] = -np.minimum(behind, limit.speed)
        slow = slow and speed < BRAKING_SHARE * fastest[j] and speed > BRAKING_SHARE * slowest[j]
    if slow:
        return False
    braked = False
    for j in range(n):
        joint = joints[j]
        gain = SPEED_GAIN * joint.inertia
        highest = joint.bias_torque + gain * (fastest[j] - joint.velocity)
        lowest = joint.bias_torque + gain * (slowest[j] - joint.velocity)
        bounded = np.minimum(np.maximum(torque[j], lowest), highest)
        if bounded != torque[j]:  # also if it is not a number
            torque[j] = bounded if np.isfinite(bounded) else 0.0
            braked = True
    return braked


@compiled
def gate_torque(
    torque: Vector, fallback: Vector, joints: Any, known: bool, limits: Any, started: bool,
    gated: Vector,
) -> int:
    """
    Fill in `gated` as far as the limits allow; return the sum of the limits that were enforced.

    See `TorqueGate.apply`. `joints` are records of `JOINT` and `limits` of `JOINT_LIMITS`, `last`
    of which is overwritten; `started` says whether there was a last command.
    """
    enforced = 0
    n = gated.shape[0]
    if torque.shape[0] == n and all_finite(torque):
        copy_vector(torque, gated)
    else:
        enforced = NOT_FINITE
        for j in range(n):
            gated[j] = fallback[j] if np.isfinite(fallback[j]) else 0.0
    if known and brake_joints(joints, limits, gated):
        enforced |= JOINT_STOP
    for j in range(n):
        limit = limits[j]
        clipped = min(max(gated[j], limit.added - limit.torque), limit.added + limit.torque)
        if clipped != gated[j]:
            enforced |= TORQUE
        if started:
            slowed = min(max(clipped, limit.last - limit.step), limit.last + limit.step)
            if slowed != clipped:
                enforced |= TORQUE_RATE
            clipped = slowed
        gated[j] = clipped
        limit.last = clipped
    return enforced


class TorqueGate:
    """
    Bounds torques.

    In turn: numbers that are not finite are replaced by the fallback; near a stop or above its
    speed a joint's torque is bounded so that it brakes, v_max = sqrt(2 a d) at a distance d; the
    result is clipped to the torque limits and to their rate from the last command. The last two
    hold whatever came in.

    Parameters
    ----------
    config
        Limits.
    joints
        Number of joints.

    Attributes
    ----------
    limits
        Records of `JOINT_LIMITS`, shape (n,).

    """

    def __init__(self, config: ControllerConfig, joints: int) -> None:
        self.limits: Any = joint_limits(config, joints)
        self._last: Vector = self.limits['last']
        self._nowhere = np.zeros(joints, dtype=JOINT)
        self._started = False
        nothing = np.zeros(joints)
        self.apply(nothing, nothing, None)  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget the last command: the next one may be anything within the limits."""
        self._started = False
        self.limits['added'] = 0.0

    def allow_for(self, added: Vector, change: Vector) -> None:
        """Take in what the drives add to a command, and its change since the last one [N m]."""
        self.limits['added'] = added
        self._last += change

    def passed(self) -> Vector:
        """Return the torque that has come through the gate last, shape (n,) [N m]."""
        return self._last.copy()

    def carry(self, arm: ArmState | None) -> Vector:
        """Return what carries an arm, within limit and rate, by numpy alone; zero if unknown."""
        limit, step, added = (self.limits[name] for name in ('torque', 'step', 'added'))
        carried: Vector = np.zeros(limit.shape) if arm is None else np.clip(
            arm.bias_torque, added - limit, added + limit)
        if self._started:
            carried = np.clip(carried, self._last - step, self._last + step)
        self._started = True
        self._last[:] = carried
        return carried

    def apply(
        self, torque: Vector, fallback: Vector, arm: ArmState | None, *, limited: bool = False,
    ) -> tuple[Vector, tuple[str, ...]]:
        """
        Let a torque through as far as the limits allow.

        Parameters
        ----------
        torque, fallback
            What is wanted, and what to do if that is not finite, shape (n,) [N m].
        arm
            The arm at its last valid state; None if there was none.
        limited
            Whether the torque has been brought within the torque limits already.

        Returns
        -------
        torque : Vector
            That may be commanded: finite and within limits, whatever came in, shape (n,) [N m].
        limits : tuple of str
            Names of the limits that had to be enforced for it.

        """
        gated = np.empty(self._last.shape)
        enforced = gate_torque(
            torque, fallback, self._nowhere if arm is None else arm.joints, arm is not None,
            self.limits, self._started, gated)
        self._started = True
        return gated, ENFORCED[enforced | TORQUE if limited else enforced]


def joint_limits(config: ControllerConfig, joints: int) -> Records:
    """Return the limits as records of `JOINT_LIMITS`, shape (n,)."""
    limits, records = config.limits, np.zeros(joints, dtype=JOINT_LIMITS)
    records['torque'] = config.torque_limit or np.inf
    records['step'] = np.array(limits.torque_rate or np.inf) * config.period
    records['lower'] = np.array(limits.joint_lower or -np.inf) + JOINT_MARGIN
    records['upper'] = np.array(limits.joint_upper or np.inf) - JOINT_MARGIN
    records['speed'] = limits.joint_speed or np.inf
    records['braking'] = JOINT_BRAKING
    return records
