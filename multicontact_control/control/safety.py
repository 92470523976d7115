"""The last gate: what leaves it is finite, within every limit, and brakes before the stops."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import all_finite, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_view import ArmView
import numpy as np

SPEED_GAIN = 50.0  # 1/s, how fast a joint is brought back to the speed it may have


@dataclass(frozen=True, slots=True)
class GateResult:
    """A torque that may be commanded [N m], and which limits had to be enforced for it."""

    torque: Vector
    limits: tuple[str, ...]


class TorqueGate:
    """
    Every command passes here, whoever made it.

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

    """

    def __init__(self, config: ControllerConfig, joints: int) -> None:
        limits, unlimited = config.limits, np.full(joints, np.inf)
        self._limit = np.array(config.torque_limit) if config.torque_limit else unlimited
        self._step = (np.array(limits.torque_rate) * config.period if limits.torque_rate
                      else unlimited)
        margin = limits.joint_margin
        self._lower = np.array(limits.joint_lower) + margin if limits.joint_lower else -unlimited
        self._upper = np.array(limits.joint_upper) - margin if limits.joint_upper else unlimited
        self._speed = np.array(limits.joint_speed) if limits.joint_speed else unlimited
        self._braking = limits.joint_braking
        self.reset()

    def reset(self) -> None:
        """Forget the last command: the next one may be anything within the limits."""
        self.last: Vector | None = None

    def apply(
        self, torque: Vector, fallback: Vector, arm: ArmView | None,
    ) -> GateResult:
        """
        Let a torque through as far as the limits allow.

        Parameters
        ----------
        torque, fallback
            What is wanted, and what to do if that is not finite, shape (n,) [N m].
        arm
            The arm as it is believed to be; None if that is not known.

        Returns
        -------
        GateResult
            Finite and within limits, whatever came in.

        """
        limits = []
        if torque.shape != self._limit.shape or not all_finite(torque):
            limits.append('not_finite')
            torque = np.where(np.isfinite(fallback), fallback, 0.0)
        if arm is not None:
            braked = self._braked(torque, arm)
            if braked is not torque:
                limits.append('joint')
                torque = np.where(np.isfinite(braked), braked, 0.0)
        clipped = np.minimum(np.maximum(torque, -self._limit), self._limit)
        if (clipped != torque).any():
            limits.append('torque')
        if self.last is not None:
            slowed = np.minimum(np.maximum(clipped, self.last - self._step),
                                self.last + self._step)
            if (slowed != clipped).any():
                limits.append('torque_rate')
            clipped = slowed
        self.last = clipped.copy()
        return GateResult(clipped, tuple(limits))

    def _braked(self, torque: Vector, arm: ArmView) -> Vector:
        """Return the torque bounded such that no joint passes a stop or its speed limit."""
        speed, q = arm.velocity, arm.q
        ahead = np.sqrt(2.0 * self._braking * np.maximum(self._upper - q, 0.0))
        behind = np.sqrt(2.0 * self._braking * np.maximum(q - self._lower, 0.0))
        fastest = np.minimum(ahead, self._speed)
        slowest = -np.minimum(behind, self._speed)
        if (speed < 0.7 * fastest).all() and (speed > 0.7 * slowest).all():
            return torque
        highest = arm.bias_torque + SPEED_GAIN * arm.inertia * (fastest - speed)
        lowest = arm.bias_torque + SPEED_GAIN * arm.inertia * (slowest - speed)
        bounded = np.minimum(np.maximum(torque, lowest), highest)
        return torque if (bounded == torque).all() else bounded
