"""Torques of the reactions that replace the control law after a fault."""

from __future__ import annotations

import math

from multicontact_control.arrays import Vector
from multicontact_control.config import WatchdogConfig
from multicontact_control.control.arm_state import ArmState
from multicontact_control.dynamics.robot import RobotModel
import numpy as np

NONE, INFLATE, HOLD, FLOAT, DAMP = 'none', 'inflate', 'hold', 'float', 'damp'
SEVERITY = (NONE, INFLATE, HOLD, FLOAT, DAMP)
COAST_TIME = 0.1  # s, in which an arm that cannot be seen any more is brought to rest


class Reactions:
    """
    The torques of the declared reactions.

    `hold`: gravity compensated, the joints sprung to where they were when it began,
    Gamma = C v + g + diag(M) (w^2 (q_0 - q) - 2 w v). `float`: the joint state is not known;
    gravity of the last posture, and the last motion brought to rest open loop. `damp`: uses no
    model but diag(M); zero torque with damping, Gamma = -c diag(M) v.

    Parameters
    ----------
    config
        Frequencies and rates.
    robot
        The arm.
    period
        h [s].

    """

    def __init__(self, config: WatchdogConfig, robot: RobotModel, period: float) -> None:
        self._config, self._robot, self._period = config, robot, period
        self.end()

    def end(self) -> None:
        """Control has resumed: the next reaction begins anew."""
        self._posture: Vector | None = None
        self._since = 0

    def torque(self, reaction: str, arm: ArmState | None) -> Vector:
        """
        Return the torque of a reaction.

        Parameters
        ----------
        reaction
            `HOLD`, `FLOAT` or `DAMP`.
        arm
            At its last valid state; None if there was none.

        """
        self._since += 1
        if arm is None:
            return np.zeros(self._robot.joint_count)
        if reaction == DAMP:
            damped: Vector = -self._config.damping_rate * arm.inertia * arm.velocity
            return damped
        if reaction == FLOAT:
            self._posture = None  # wherever it has gone meanwhile
            fade = math.exp(-self._since * self._period / COAST_TIME)
            state = self._robot.update(arm.q, arm.velocity)
            braking = state.mass_matrix @ state.velocity * (fade / COAST_TIME)
            floating: Vector = state.gravity - braking
            return floating
        if self._posture is None:
            self._posture = arm.q.copy()
        w = self._config.hold_frequency
        held: Vector = arm.bias_torque + arm.inertia * (
            w * w * (self._posture - arm.q) - 2.0 * w * arm.velocity)
        return held
