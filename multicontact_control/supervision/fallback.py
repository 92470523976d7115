"""Torques that replace the control law: after a fault, and after a deactivation."""

from __future__ import annotations

import math

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_state import ArmState
from multicontact_control.control.controller import Controller, ControlOutput
from multicontact_control.dynamics.robot import RobotModel
import numpy as np

NONE, INFLATE, HOLD, FLOAT, DAMP = 'none', 'inflate', 'hold', 'float', 'damp'
SEVERITY = (NONE, INFLATE, HOLD, FLOAT, DAMP)
COAST_TIME = 0.1  # s, in which an arm that cannot be seen any more is brought to rest
DAMPING_RATE = 5.0  # 1/s, of `damp` and gravity compensation: joint damping over inertia
HOLD_FREQUENCY = 10.0  # rad/s, of the critically damped joints that are held
FADE_TIME = 0.5  # s, by which a contact's force fades while the wrench is not known
DROP_TIME = 0.02  # s, in which the force on a surface that has gone is dropped
DROPPED = 1e-3  # N m in every joint, below which that counts as done


class Reactions:
    """
    The torques of the declared reactions.

    All of them carry the arm as soon as its joints were known once. `hold`: the joints are sprung
    to where they were when it began, Gamma = C v + g + diag(M) (w^2 (q_0 - q) - 2 w v). `float`:
    the joint state is not known; gravity of the last posture, and the last motion brought to rest
    open loop. `damp`: free to be moved, Gamma = C v + g - c diag(M) v. The first two go on
    pressing, J^T N alpha, as `Pressing` says.

    Parameters
    ----------
    config
        Period, release threshold.
    controller
        The law whose place they take, for its arm and its contacts.

    """

    def __init__(self, config: ControllerConfig, controller: Controller) -> None:
        self._period = config.period
        self._robot, self._contacts = controller.robot, controller.contacts
        self._release_threshold = config.contact_state.release_threshold
        self._pressing = Pressing(config.period)
        self.end()

    def begin(self, answered: ControlOutput) -> None:
        """Go on pressing with the forces of the contacts that were held at an answer."""
        contacts = answered.contacts
        wanted, couple = contacts['alpha_des'], contacts['leader'] != np.arange(len(contacts))
        least, most = np.where(couple, -np.abs(wanted), 0.0), np.abs(wanted)
        alpha = np.where(
            contacts['active'], np.clip(contacts['alpha_est'], least, most), 0.0)
        self._pressing.begin(self._robot.terms.jacobian.T @ (contacts['N'].T * alpha))

    @property
    def presses(self) -> bool:
        """Whether a contact is still pressed, since the law held it."""
        return self._pressing.left

    def end(self) -> None:
        """Control has resumed: the next reaction begins anew."""
        self._begin_anew()
        self._coasting = 0

    def _begin_anew(self) -> None:
        """Hold whatever posture it has next, and press no more."""
        self._posture: Vector | None = None
        self._pressing.end()

    def torque(self, reaction: str, arm: ArmState | None, wrench_known: bool) -> Vector:
        """
        Return the torque of a reaction.

        Parameters
        ----------
        reaction
            `HOLD`, `FLOAT` or `DAMP`.
        arm
            At its last valid state; None if there was none.
        wrench_known
            Whether the wrench is of this tick, and tells which contacts are felt.

        """
        self._coasting = self._coasting + 1 if reaction == FLOAT else 0
        if arm is None:
            return np.zeros(self._robot.joint_count)
        if reaction == DAMP:
            self._begin_anew()  # it may be moved away
            damped: Vector = arm.bias_torque - (
                DAMPING_RATE * arm.inertia * arm.velocity)
            return damped
        felt = self._contacts['alpha_meas'] > self._release_threshold
        felt = felt[self._contacts['leader']]  # a couple is there as long as its contact is
        pressing = self._pressing.torque(felt if wrench_known else None)
        if reaction == FLOAT:
            self._posture = None  # wherever it has gone meanwhile
            fade = math.exp(-self._coasting * self._period / COAST_TIME)
            state = self._robot.update(arm.q, arm.velocity)
            braking = state.mass_matrix @ state.velocity * (fade / COAST_TIME)
            floating: Vector = state.gravity - braking + pressing
            return floating
        if self._posture is None:
            self._posture = arm.q.copy()
        w = HOLD_FREQUENCY
        held: Vector = arm.bias_torque + arm.inertia * (
            w * w * (self._posture - arm.q) - 2.0 * w * arm.velocity) + pressing
        return held


class Pressing:
    """
    What contacts were held with, while no law controls it.

    An arm that lets go of what it presses on is pushed away by it. So each contact keeps its
    force as long as it is felt; what is known not to be felt any more is dropped within 20 ms,
    and what is not known, as the wrench is missing, fades.

    Parameters
    ----------
    period
        h [s].

    """

    def __init__(self, period: float) -> None:
        self._keep_unknown = math.exp(-period / FADE_TIME)
        self._keep_unfelt = math.exp(-period / DROP_TIME)
        self.end()

    def end(self) -> None:
        """Forget it."""
        self._torques: Matrix | None = None

    @property
    def left(self) -> bool:
        """Whether there is anything left of it."""
        return self._torques is not None and bool((np.abs(self._torques) > DROPPED).any())

    def begin(self, torques: Matrix) -> None:
        """Take note of J^T N_i alpha_i of each contact, columns of shape (n, r) [N m]."""
        self._torques = torques

    def torque(self, felt: Mask | None) -> Vector | float:
        """
        Return what is left of it at the next tick, shape (n,) [N m].

        Parameters
        ----------
        felt
            Which contacts are felt now, shape (r,); None if that is not known.

        """
        if self._torques is None:
            return 0.0
        self._torques = self._torques * (
            self._keep_unknown if felt is None else np.where(felt, 1.0, self._keep_unfelt))
        total: Vector = self._torques.sum(axis=1)
        return total


class SafeBehaviour:
    """
    Gravity compensation with damping, zero torque, or the posture held; needs no wrench.

    Parameters
    ----------
    kind
        `safe_behaviour` of the configuration.
    robot
        The arm.

    """

    def __init__(self, kind: str, robot: RobotModel) -> None:
        self.kind, self._robot = kind, robot
        self.start()

    def start(self) -> None:
        """Take the posture of the next sample for the one to hold."""
        self._held: Vector | None = None

    def torque(self, q: Vector, qd: Vector, added: Vector | float = 0.0) -> Vector:
        """
        Return the joint torque for a sample.

        Parameters
        ----------
        q, qd
            Joint positions [rad] and velocities [rad/s], shape (n,).
        added
            To a command by the drives themselves, shape (n,) [N m].

        Returns
        -------
        Vector
            Shape (n,) [N m].

        """
        if self.kind != 'hold_position':
            self._held = None  # the arm may be moved away before a posture is to be held
        elif self._held is None:
            self._held = np.array(q, dtype=float)
        if self.kind == 'zero_torque':  # of what is commanded
            return np.zeros_like(q) + added
        state = self._robot.update(q, qd)
        if self._held is None:
            acceleration = -DAMPING_RATE * qd
        else:
            w = HOLD_FREQUENCY
            acceleration = w * w * (self._held - q) - 2.0 * w * qd
        torque: Vector = state.mass_matrix @ acceleration + state.coriolis + state.gravity
        return torque
