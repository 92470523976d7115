"""What takes the place of the control law: after a fault, after a deactivation, and how long."""

from __future__ import annotations

import math
from typing import Any

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm import ArmState
from multicontact_control.control.controller import Controller, ControlOutput
import numpy as np

NONE, INFLATE, HOLD, FLOAT, DAMP = 'none', 'inflate', 'hold', 'float', 'damp'
SEVERITY = (NONE, INFLATE, HOLD, FLOAT, DAMP)
SAFE = 'safe'  # the safe behaviour after a deactivation, which is no reaction to a fault
SAFE_BEHAVIOURS = {'hold_position': HOLD, 'gravity_compensation': DAMP, 'zero_torque': SAFE}
COAST_TIME = 0.1  # s, in which an arm that cannot be seen any more is brought to rest
DAMPING_RATE = 5.0  # 1/s, of `damp` and gravity compensation: joint damping over inertia
HOLD_FREQUENCY = 10.0  # rad/s, of the critically damped joints that are held
FADE_TIME = 0.5  # s, by which a contact's force fades while the wrench is not known
DROP_TIME = 0.02  # s, in which the force on a surface that has gone is dropped
DROPPED = 1e-3  # N m in every joint, below which that counts as done

RECOVERING, LATCHED = 'recovering', 'latched'
WAITING = (RECOVERING,), (LATCHED,)  # causes of a control that has not resumed yet
RELAPSE_TIME = 5.0  # s after control has resumed, in which a reaction is a relapse
SOON = 1.0  # s, the same where readings are missing, which come and go by chance
RELAPSES = 3  # in a row, of what the arm does or meets, after which control waits for an operator
LONGEST_RECOVERY = 2.0  # s that all must be well, at most
GROWTH = 3.0  # of the time that all must be well, from relapse to relapse
# What comes from what the arm does and meets, and not from readings that are missing.
PHYSICAL = ('motion', 'law', 'internal', 'joints_velocity', 'wrench_pull', 'wrench_stray',
            'wrench_sideways', 'wrench_saturated', 'collision')


class Reactions:
    """
    The torques of the reactions and of the safe behaviour.

    All but `zero_torque` carry the arm once its joints were known.
    `hold`: Gamma = C v + g + diag(M) (w^2 (q_0 - q) - 2 w v), q_0 where it began.
    `damp`: Gamma = C v + g - c diag(M) v. `float`, where the joint state is not known: gravity of
    the last posture, and the last motion brought to rest open loop.

    An arm that lets go of what it presses on is pushed away by it, so `hold` and `float` add
    J^T N alpha of the contacts that were held. Each keeps its force while it is felt; the force
    of one that is not felt any more is dropped within 20 ms; it fades while the wrench is unknown.
    """

    def __init__(self, config: ControllerConfig, controller: Controller) -> None:
        self._period = config.period
        self._robot, self._contacts = controller.robot, controller.contacts
        self._added: Vector = controller.arm.joints['added']
        self._release_threshold = config.contact_state.release_threshold
        self.safe_behaviour = config.safe_behaviour
        self.end()

    def end(self) -> None:
        """Control has resumed: the next reaction begins anew."""
        self._posture: Vector | None = None
        self._pressing: Matrix | None = None  # J^T N_i alpha_i of each contact, shape (n, r)
        self._coasting = 0

    def begin(self, answered: ControlOutput) -> None:
        """Go on pressing with the forces of the contacts that were held at an answer."""
        contacts = answered.contacts
        answer = contacts['answer']
        couple = contacts['config']['leader'] != np.arange(len(contacts))
        most = np.abs(answer['alpha_des'])
        least = np.where(couple, -most, 0.0)
        alpha = np.where(answer['active'], np.clip(answer['alpha_est'], least, most), 0.0)
        self._pressing = self._robot.terms.jacobian.T @ (contacts['N'].T * alpha)

    @property
    def presses(self) -> bool:
        """Whether a contact is still pressed, since the law held it."""
        return self._pressing is not None and bool((np.abs(self._pressing) > DROPPED).any())

    def torque(self, reaction: str, arm: ArmState | None, wrench_known: bool) -> Vector:
        """Return what answers instead of the law, shape (n,) [N m]; `wrench_known` as of now."""
        self._coasting = self._coasting + 1 if reaction == FLOAT else 0
        if arm is None:
            return np.zeros(self._robot.joint_count)
        does = SAFE_BEHAVIOURS[self.safe_behaviour] if reaction == SAFE else reaction
        if does in (DAMP, SAFE):
            self.end()  # it may be moved away
            # Zero is what is commanded: what the drives add goes on acting.
            return _damped(arm, DAMPING_RATE) if does == DAMP else self._added.copy()
        pressing = self._press(wrench_known)
        if does == HOLD:
            if self._posture is None:
                self._posture = arm.q.copy()
            held: Vector = _damped(arm, 2.0 * HOLD_FREQUENCY) + arm.inertia * (
                HOLD_FREQUENCY ** 2 * (self._posture - arm.q))
            return held + pressing
        self._posture = None  # wherever it has gone meanwhile
        fade = math.exp(-self._coasting * self._period / COAST_TIME)
        state = self._robot.update(arm.q, arm.velocity)
        braking = state.mass_matrix @ state.velocity * (fade / COAST_TIME)
        floating: Vector = state.gravity - braking + pressing
        return floating

    def _press(self, wrench_known: bool) -> Vector | float:
        """Return what is left of the contacts' forces at the next tick, shape (n,) [N m]."""
        if self._pressing is None:
            return 0.0
        keep: Any = math.exp(-self._period / FADE_TIME)
        if wrench_known:
            felt: Mask = self._contacts['alpha_meas'] > self._release_threshold
            felt = felt[self._contacts['config']['leader']]  # a couple with its contact
            keep = np.where(felt, 1.0, math.exp(-self._period / DROP_TIME))
        self._pressing = self._pressing * keep
        total: Vector = self._pressing.sum(axis=1)
        return total


def _damped(arm: ArmState, rate: float) -> Vector:
    """Return Gamma = C v + g - c diag(M) v, shape (n,) [N m], with c in [1/s]."""
    torque: Vector = arm.bias_torque - rate * arm.inertia * arm.velocity
    return torque


class Recovery:
    """
    Counts relapses, so that holding and resuming do not alternate for ever.

    A reaction soon after control has resumed is a relapse, as is a law that cannot resume: each
    makes the time that all must be well three times as long. After three in a row of what the arm
    does or meets control is `latched`: the posture is held until an operator resumes it.
    """

    def __init__(self, recovery_time: float, period: float) -> None:
        self._shortest, self._period = recovery_time, period
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._wait = self._shortest
        self.resumed_at = -math.inf  # tick of control's own count
        self.allow()

    def allow(self) -> None:
        """Let control resume although it is latched; the next relapse is the first."""
        self.latched, self._relapses = False, 0

    def stopped(self, causes: tuple[str, ...], tick: int) -> None:
        """Take note that a reaction has begun at a tick of control's count."""
        self.latched = self.latched or 'wrench_stray' in causes  # it presses on what is there
        soon = RELAPSE_TIME if _is_physical(causes) else SOON
        if (tick - self.resumed_at) * self._period > soon:
            self._relapses, self._wait = 0, self._shortest
        else:
            self.relapsed(causes)

    def relapsed(self, causes: tuple[str, ...]) -> None:
        """Take note that control has stopped too soon, or could not even resume."""
        self._wait = min(GROWTH * self._wait, max(LONGEST_RECOVERY, self._shortest))
        if _is_physical(causes):
            self._relapses += 1
            self.latched = self._relapses >= RELAPSES

    def missing(self, good_ticks: int) -> tuple[str, ...]:
        """Return what control still waits for after so many good ticks, if anything."""
        if self.latched:
            return (LATCHED,)
        return (RECOVERING,) if good_ticks * self._period < self._wait else ()


def _is_physical(causes: tuple[str, ...]) -> bool:
    """Return whether a reaction comes from what the arm does or meets."""
    return any(cause.startswith(PHYSICAL) for cause in causes)
