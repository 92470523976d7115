"""The last gate: what leaves it is finite, within every limit, and brakes before the stops."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.supervision.arm_state import ArmState
from multicontact_control.supervision.gate_kernels import (
    GATE_JOINT,
    GATE_NUMBERS,
    GATE_RATE,
    GATE_TORQUE,
    gate_torque,
    JOINT_ROWS,
)
import numpy as np

NAMES = (('not_finite', GATE_NUMBERS), ('joint', GATE_JOINT), ('torque', GATE_TORQUE),
         ('torque_rate', GATE_RATE))
ENFORCED = tuple(tuple(name for name, bit in NAMES if flags & bit) for flags in range(16))


class GateResult(NamedTuple):
    """A torque that may be commanded [N m], and which limits had to be enforced for it."""

    torque: Vector
    limits: tuple[str, ...]


class TorqueGate:
    """
    Every command passes here, whoever made it.

    In turn: numbers that are not finite are replaced by the fallback; near a stop or above its
    speed a joint's torque is bounded so that it brakes, v_max = sqrt(2 a d) at a distance d; the
    result is clipped to the torque limits and to their rate from the last command. The last two
    hold whatever came in. The arithmetic is in `gate_kernels`, compiled.

    Parameters
    ----------
    config
        Limits.
    joints
        Number of joints.

    """

    def __init__(self, config: ControllerConfig, joints: int) -> None:
        self._limits = gate_limits(config, joints)
        self._braking = config.limits.joint_braking
        self._nowhere: Matrix = np.zeros((len(JOINT_ROWS), joints))
        self._last: Vector = np.zeros(joints)
        self._started = False
        self.apply(self._last, self._last, None)  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Forget the last command: the next one may be anything within the limits."""
        self._started = False

    @property
    def last(self) -> Vector | None:
        """Return the last command, shape (n,) [N m]; None if there was none."""
        return self._last.copy() if self._started else None

    def apply(
        self, torque: Vector, fallback: Vector, arm: ArmState | None,
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
        gated = np.empty(self._last.shape)
        enforced = gate_torque(
            torque, fallback, self._nowhere if arm is None else arm.joints, arm is not None,
            self._limits, self._braking, self._last, self._started, gated)
        self._started = True
        return GateResult(gated, ENFORCED[enforced])


def gate_limits(config: ControllerConfig, joints: int) -> Matrix:
    """Return the limits for compiled code, rows as `gate_kernels` names them, shape (5, n)."""
    limits, unlimited = config.limits, np.full(joints, np.inf)

    def per_joint(values: tuple[float, ...], default: Vector) -> Vector:
        return np.array(values, dtype=float) if values else default

    return np.stack([
        per_joint(config.torque_limit, unlimited),
        per_joint(limits.torque_rate, unlimited) * config.period,
        per_joint(limits.joint_lower, -unlimited) + limits.joint_margin,
        per_joint(limits.joint_upper, unlimited) - limits.joint_margin,
        per_joint(limits.joint_speed, unlimited)])
