"""What takes the place of the control law: after a fault, after a deactivation, and how long."""

from __future__ import annotations

import math
from typing import Any

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.config.supervision import RELEASE_FORCE
from multicontact_control.control.arm import ArmState
from multicontact_control.control.controller import Controller, ControlOutput
from multicontact_control.dynamics.operational_space import (
    compute_mobility_and_inertia,
    INERTIA_SPACE,
    InertiaSpace,
)
from multicontact_control.records import Records, Task
from multicontact_control.supervision.velocities import (
    OFFSET_TOLERANCE,
    SHARE_TOLERANCE,
)
import numpy as np

NONE, INFLATE, HOLD, FLOAT, DAMP = 'none', 'inflate', 'hold', 'float', 'damp'
SEVERITY = (NONE, INFLATE, HOLD, FLOAT, DAMP)
# The safe behaviour after a deactivation, which is no reaction to a fault.
SAFE = 'safe'
# By which the gate tells what answers; a control law has a positive number.
NUMBERS = {NONE: -1, INFLATE: -2, HOLD: -3, FLOAT: -4, DAMP: -5, SAFE: -6}
SAFE_BEHAVIOURS = {
    'hold_position': HOLD,
    'gravity_compensation': DAMP,
    'zero_torque': SAFE,
}
COAST_TIME = 0.1  # s, in which an arm that cannot be seen any more is brought to rest
# 1/s, of `damp` and gravity compensation: joint damping over inertia.
DAMPING_RATE = 5.0
# Of 1 / w of a hold, which its delay is at most: 40 degrees of phase margin.
DELAY_SHARE = 0.3
ESTIMATE_DELAY = 1.5  # periods, of a velocity that is estimated from positions
FREE_FREQUENCY = 10.0  # rad/s, of what the operational point does not see of a posture
# A hold that shakes is given less damping first (a ratio), then a lower natural frequency, by this
# factor, down to so many rad/s; and so many s to calm down each time.
LESS_DAMPING = 0.5
SOFTER = 0.8
SOFTEST_HOLD = 10.0
SETTLING_TIME = 0.2
UNLIKELY_TIME = 0.1  # s, for which velocities are not used after one was unlikely
# A joint that turns round by more than SWING [rad/s] counts a turn, and forgets it within
# TURN_TIME [s]. From TURNS of them on it shakes, 13 times a second or more; an arm that is held
# by rigid drives does not swing so fast.
SWING = 0.05
TURN_TIME = 0.15
TURNS = 4.0
DIRECTION, EXTREME, TURNED = range(3)  # rows of what is known of swings
AHEAD = 0.2  # of v / w, by which an arm in motion is held ahead of where a hold begins
# rad/s of each joint, at which a hold goes back to where the first one began.
RETURN_SPEED = 0.05
RETURN_WAY = 0.05  # rad of a joint, beyond which it has gone somewhere else
# m or rad of the reference since then, beyond which it was led elsewhere.
COMMANDED_WAY = 5e-3
FADE_TIME = 0.5  # s, by which a contact's force fades while the wrench is not known
DROP_TIME = 0.02  # s, in which the force on a surface that has gone is dropped
DROPPED = 1e-3  # N m in every joint, below which that counts as done

# Two reactions that take turns: so many changes, each forgotten within FLICKER_TIME [s], and the
# severer one stays until nothing has called for it over CALM_TIME [s].
FLICKERS = 3.5
FLICKER_TIME = 1.0
CALM_TIME = 0.5

# Causes of a control that has not resumed yet.
RECOVERING = 'recovering'
LATCHED = 'latched'
WAITING = (RECOVERING,), (LATCHED,)
RELAPSE_TIME = 5.0  # s after control has resumed, in which a reaction is a relapse
SOON = 1.0  # s, the same where readings are missing, which come and go by chance
# In a row, of what the arm does or meets, after which control waits for an operator.
RELAPSES = 3
LONGEST_RECOVERY = 2.0  # s that all must be well, at most
GROWTH = 3.0  # of the time that all must be well, from relapse to relapse
# What comes from what the arm does and meets, and not from readings that are missing.
PHYSICAL = (
    'motion',
    'law',
    'internal',
    'joints_velocity',
    'wrench_pull',
    'wrench_stray',
    'wrench_sideways',
    'wrench_saturated',
    'collision',
)


def hold_torque(
    arm: ArmState, way: Vector, velocity: Vector, frequency: float, damping: float
) -> Vector:
    """
    Return the torque that holds a posture, shape (n,) [N m].

    Gamma = C v + g + J^T Lambda J a(w, d) + (M - J^T Lambda J) a(w_0, 1), where
    a(w, d) = w^2 (q_0 - q) - 2 d w v.
    The operational point is as stiff as under the motion law, M w^2 with six joints; what it does
    not see stays softer: with M w^2 there, the rotors behind flexible drives would swing.

    Parameters
    ----------
    arm
        The arm, for C v + g, M and J, and for how Lambda is damped near singularities.
    way, velocity
        q_0 - q [rad] and v [rad/s], shape (n,).
    frequency, damping
        w [rad/s] and d.

    """
    least = min(frequency, FREE_FREQUENCY)
    free = least**2 * way - 2.0 * least * velocity
    terms = arm.robot.terms
    upper = np.triu(terms.mass_matrix)
    torque: Vector = arm.bias_torque + (upper + np.triu(upper, 1).T) @ free
    inertia: InertiaSpace = np.zeros(1, dtype=INERTIA_SPACE)[0]
    singular, _ = compute_mobility_and_inertia(
        terms.mass_matrix,
        terms.jacobian,
        arm.controls['law']['singular_mobility'][0],
        inertia,
    )
    if singular < 0.0:
        return torque
    stiffer = frequency**2 * way - 2.0 * damping * frequency * velocity - free
    torque += terms.jacobian.T @ (inertia['Lambda'] @ (terms.jacobian @ stiffer))
    return torque


def count_reversals(rate: Vector, swings: Matrix, keep: float) -> float:
    """
    Take in velocities, shape (n,) [rad/s]; return how often the joint that turned most has turned.

    `swings` has the rows above, shape (3, n), and is changed; `keep` is what is left of the count.
    """
    beyond = (rate - swings[EXTREME]) * swings[DIRECTION]
    turns = beyond < -SWING
    goes_on = beyond >= 0.0
    swings[EXTREME] = np.where(turns | goes_on, rate, swings[EXTREME])
    swings[DIRECTION] = np.where(turns, -swings[DIRECTION], swings[DIRECTION])
    swings[TURNED] = keep * swings[TURNED] + turns
    return float(swings[TURNED].max())


class Reactions:
    """
    The torques of the reactions and of the safe behaviour.

    All but `zero_torque` carry the arm once its joints were known.
    `hold`: see `hold_torque`; q_0 is where it began, of holds one soon after another where the
    first one began, and it goes there slowly. It is as stiff as the motion law. If that makes a
    joint shake, it gets softer, and stays so: behind springs rotors swing that the model does not
    have, above all with velocities that are late, being made up from positions.
    `damp`: Gamma = C v + g - c diag(M) v. `float`, where the joint state is not known: gravity of
    the last posture, and the last motion brought to rest open loop.

    An arm that lets go of what it presses on is pushed away by it, so `hold` and `float` add
    J^T N alpha of the contacts that were held. Each keeps its force while it is felt; the force
    of one that is not felt any more is dropped within 20 ms; it fades while the wrench is unknown.
    """

    def __init__(self, config: ControllerConfig, controller: Controller) -> None:
        self._period = config.period
        self._robot = controller.robot
        self._contacts = controller.contacts
        self._added: Vector = controller.arm.joints['drive_gravity_torque']
        self._task: Records[Task] = controller.controls['task']
        self._swings: Matrix = np.zeros((3, self._robot.joint_count))
        self._begin_swings()
        self._keep_turns = math.exp(-config.period / TURN_TIME)
        self._stiffest = math.nan
        self._settling_time = 0.0
        self._unlikely_time = 0.0
        self.apply_config(config)
        self.forget_postures()
        velocity = controller.arm.velocity  # no tick is to wait for numba
        self._hold_posture(controller.arm, velocity)
        self.forget_postures()

    def apply_config(self, config: ControllerConfig) -> None:
        """Set what follows from values that may change while the arm is controlled."""
        self.safe_behaviour = config.safe_behaviour
        delay = config.force.input_delay + ESTIMATE_DELAY * config.period
        stiffest = min(config.motion.natural_frequency, DELAY_SHARE / delay)
        if stiffest != self._stiffest:
            self._stiffest = stiffest
            self._frequency = stiffest
            self._damping = 1.0

    def forget_postures(self) -> None:
        """Let the next hold be the first one."""
        self._first: Vector | None = None  # posture in which that began
        self._reference: Vector | None = None  # of the task then
        self.end_reaction()

    def end_reaction(self) -> None:
        """Control has resumed: the next reaction begins anew, and goes back if it comes soon."""
        self._posture: Vector | None = None
        # J^T N_i alpha_i of each contact, shape (n, r).
        self._pressing: Matrix | None = None
        self._coasting_ticks = 0

    def begin_pressing(self, answered: ControlOutput) -> None:
        """
        Go on pressing with the forces of the contacts that were held at an answer.

        Each is the estimated force, between 0 and the desired one; a couple may have either sign.
        """
        contacts = answered.contacts
        answer = contacts['answer']
        is_couple = contacts['config']['leader'] != np.arange(len(contacts))
        most = np.abs(answer['alpha_des'])
        least = np.where(is_couple, -most, 0.0)
        forces = np.clip(answer['alpha_est'], least, most)
        alpha = np.where(answer['active'], forces, 0.0)
        self._pressing = self._robot.terms.jacobian.T @ (contacts['N'].T * alpha)

    def keep_present_hold(self) -> None:
        """Let the next hold be the first one, and the present one go on."""
        self._reference = None

    def return_to_first_hold(self) -> None:
        """Let a hold that begins be the first one, unless the arm was not led on since that."""
        position, rotation = self._task['position'][0], self._task['rotation'][0]
        reference = np.concatenate([position, rotation.ravel()])
        if self._reference is not None:
            if np.abs(reference - self._reference).max() <= COMMANDED_WAY:
                return
        self.forget_postures()
        self._reference = reference

    @property
    def presses_contact(self) -> bool:
        """Whether a contact is still pressed, since the law held it."""
        if self._pressing is None:
            return False
        return bool((np.abs(self._pressing) > DROPPED).any())

    def reaction_torque(
        self,
        reaction: str,
        arm: ArmState | None,
        wrench_known: bool,
        rate: Vector,
        *,
        timed: bool = True,
    ) -> Vector:
        """
        Return what answers instead of the law, shape (n,) [N m].

        `wrench_known` as of now; `rate` has the velocities that positions make up for, [rad/s],
        which are of another size where the clock is wrong: not `timed`, a hold is soft.
        """
        self._coasting_ticks += 1
        if reaction != FLOAT:
            self._coasting_ticks = 0
        if arm is None:
            return np.zeros(self._robot.joint_count)
        behaviour = reaction
        if reaction == SAFE:
            behaviour = SAFE_BEHAVIOURS[self.safe_behaviour]
        if behaviour == DAMP:
            self.forget_postures()  # it may be moved away
            return _damping_torque(arm, DAMPING_RATE)
        if behaviour == SAFE:
            # Zero is what is commanded: what the drives add goes on acting.
            self.forget_postures()
            return self._added.copy()
        pressing = self._pressing_torque(wrench_known)
        if behaviour == HOLD:
            return self._hold_posture(arm, rate, timed=timed) + pressing
        self._posture = None  # wherever it has gone meanwhile
        coasting_time = self._coasting_ticks * self._period
        if coasting_time > COAST_TIME:
            self._first = None
        fade = math.exp(-coasting_time / COAST_TIME)
        state = self._robot.update(arm.q, arm.velocity)
        braking = state.mass_matrix @ state.velocity * (fade / COAST_TIME)
        floating: Vector = state.gravity - braking + pressing
        return floating

    def _hold_posture(
        self, arm: ArmState, rate: Vector, *, timed: bool = True
    ) -> Vector:
        """Return the torque that keeps the arm where it is, or leads it back, shape (n,) [N m]."""
        if self._posture is None:
            # It goes on by 0.37 v / w, and comes back: less so if that is allowed for.
            self._posture = arm.q.copy()
            if timed:
                self._posture += AHEAD / self._frequency * rate
            self._begin_swings()
        if self._first is not None:
            if np.abs(self._first - self._posture).max() > RETURN_WAY:
                self._first = None
        if self._first is None:
            self._first = self._posture.copy()
        step = RETURN_SPEED * self._period
        self._posture += np.clip(self._first - self._posture, -step, step)
        turns = count_reversals(rate, self._swings, self._keep_turns)
        self._settling_time = max(self._settling_time - self._period, 0.0)
        if turns > TURNS and not self._settling_time:
            self._soften_hold()
        # What may soon be refuted would push the arm: the estimate damps it already.
        tolerance = OFFSET_TOLERANCE + SHARE_TOLERANCE * np.abs(rate)
        self._unlikely_time -= self._period
        if (np.abs(arm.velocity - rate) > tolerance).any():
            self._unlikely_time = UNLIKELY_TIME
        velocity = arm.velocity
        if self._unlikely_time > 0.0:
            velocity = rate
        frequency = self._frequency
        if not timed:
            frequency = min(frequency, FREE_FREQUENCY)
        return hold_torque(
            arm, self._posture - arm.q, velocity, frequency, self._damping
        )

    def _begin_swings(self) -> None:
        self._swings[:] = 0.0
        self._swings[DIRECTION] = 1.0

    def _soften_hold(self) -> None:
        """Reduce what makes the rotors shake: damping by velocities that come late."""
        self._settling_time = SETTLING_TIME
        if self._damping > LESS_DAMPING:
            self._damping = LESS_DAMPING
        else:
            self._frequency = max(
                SOFTER * self._frequency, min(SOFTEST_HOLD, self._stiffest)
            )

    def _pressing_torque(self, wrench_known: bool) -> Vector | float:
        """Return what is left of the contacts' forces at the next tick, shape (n,) [N m]."""
        if self._pressing is None:
            return 0.0
        keep: Any = math.exp(-self._period / FADE_TIME)
        if wrench_known:
            felt: Mask = self._contacts['alpha_meas'] > RELEASE_FORCE
            felt = felt[self._contacts['config']['leader']]  # a couple with its contact
            keep = np.where(felt, 1.0, math.exp(-self._period / DROP_TIME))
        self._pressing = self._pressing * keep
        total: Vector = self._pressing.sum(axis=1)
        return total


def _damping_torque(arm: ArmState, rate: float) -> Vector:
    """Return Gamma = C v + g - c diag(M) v, shape (n,) [N m], with c in [1/s]."""
    torque: Vector = arm.bias_torque - rate * arm.inertia * arm.velocity
    return torque


class ReactionHysteresis:
    """Keeps to the severer of two reactions that take turns, as with joints that come and go."""

    def __init__(self, period: float) -> None:
        self._keep = math.exp(-period / FLICKER_TIME)
        self._calm_ticks_needed = round(CALM_TIME / period)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._before = ''
        self._severer = ''
        self._changes = 0.0
        self._calm_ticks = 0

    def steady_reaction(self, reaction: str) -> str:
        """Return what answers a tick for which a reaction is called for, the law aside."""
        self._changes *= self._keep
        if self._before and reaction != self._before:
            self._changes += 1.0
            if self._changes > FLICKERS:
                self._severer = max(
                    reaction, self._before, self._severer, key=_rank_severity
                )
        self._before = reaction
        self._calm_ticks += 1
        if _rank_severity(reaction) >= _rank_severity(self._severer):
            self._calm_ticks = 0
        if self._calm_ticks > self._calm_ticks_needed:
            self._severer = ''
        return max(reaction, self._severer, key=_rank_severity)


def _rank_severity(reaction: str) -> int:
    """Return how severe a reaction is, -1 for none that is known."""
    if reaction not in SEVERITY:
        return -1
    return SEVERITY.index(reaction)


class RecoveryPolicy:
    """
    Counts relapses, so that holding and resuming do not alternate for ever.

    A reaction soon after control has resumed is a relapse, as is a law that cannot resume: each
    makes the time that all must be well three times as long. After three in a row of what the arm
    does or meets control is `latched`: the posture is held until an operator resumes it.
    """

    def __init__(self, recovery_time: float, period: float) -> None:
        self._shortest = recovery_time
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._wait = self._shortest
        self.resumed_at = -math.inf  # tick of control's own count
        self.unlatch_control()

    def unlatch_control(self) -> None:
        """Let control resume although it is latched; the next relapse is the first."""
        self.latched = False
        self._relapses = 0

    def note_reaction(self, causes: tuple[str, ...], tick: int) -> bool:
        """Take note of a reaction that begins at a tick of control; return if it is new."""
        if 'wrench_stray' in causes:  # it presses on what is there
            self.latched = True
        soon = SOON
        if _is_physical(causes):
            soon = RELAPSE_TIME
        if (tick - self.resumed_at) * self._period > soon:
            self._relapses = 0
            self._wait = self._shortest
            return True
        self.note_relapse(causes)
        return False

    def note_relapse(self, causes: tuple[str, ...]) -> None:
        """Take note that control has stopped too soon, or could not even resume."""
        self._wait = min(GROWTH * self._wait, max(LONGEST_RECOVERY, self._shortest))
        if _is_physical(causes):
            self._relapses += 1
            self.latched = self._relapses >= RELAPSES

    def waiting_causes(self, good_ticks: int) -> tuple[str, ...]:
        """Return what control still waits for after so many good ticks, if anything."""
        if self.latched:
            return (LATCHED,)
        if good_ticks * self._period < self._wait:
            return (RECOVERING,)
        return ()


def _is_physical(causes: tuple[str, ...]) -> bool:
    """Return whether a reaction comes from what the arm does or meets."""
    return any(cause.startswith(PHYSICAL) for cause in causes)
