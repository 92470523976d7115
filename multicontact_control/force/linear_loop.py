"""Stability of one force loop whose real contact is not the one that the observer models."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Literal

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.force.observer import ObserverDesign
from multicontact_control.force.plant_model import delayed_hold
import numpy as np
from scipy.linalg import solve_discrete_are

SEARCH_STEP = 1.05


@dataclass(frozen=True, slots=True)
class RealContact:
    """
    What the force loop really acts on.

    alpha = k z + c dz/dt, d^2z/dt^2 = u(t - T) - K_2 dz/dt + (alpha_est(t - T) - alpha) / m,
    where z is the way of the contact point into the surface; measured is alpha + m_t d^2z/dt^2.
    With c = 0, m infinite and m_t = 0 it is G(s) of P04 eq. 32. The term in m is what the
    compensation of the contact force by its estimate (P04 eq. 24) leaves over; m_t is carried
    by a wrist sensor, which weighs it away but reads its inertia.

    Attributes
    ----------
    stiffness
        k [N/m].
    damping_rate
        K_2 [1/s].
    input_delay
        T, from the sample to the torque that answers it [s]: the actuator's ticks and all else.
    period
        h [s].
    damping
        Where K_2 acts (paper notes 13). `plant`: on the motion of the contact as it is, without
        delay, as eq. 32 and the observer have it. `commanded`: on the motion measured in the
        same sample as the force, held and delayed by T with the rest of the command, as a
        controller in discrete time does it.
    contact_damping
        c of the surface [N s/m].
    effective_mass
        m, the inertia felt at the contact along its normal, 1 / (N_i^T Lambda^-1 N_i) [kg]. Two
        equal contacts move together: with D = N^T Lambda^-1 N the loop that gives way first is
        that of D's smallest eigenvalue 1/m.
    carried_mass
        m_t, what hangs on the sensor [kg].

    """

    stiffness: float
    damping_rate: float
    input_delay: float
    period: float
    damping: Literal['plant', 'commanded'] = 'plant'
    contact_damping: float = 0.0
    effective_mass: float = math.inf
    carried_mass: float = 0.0


@dataclass(frozen=True, slots=True)
class StabilityRange:
    """
    Ratios of real to modelled stiffness around 1 with which a loop is stable.

    Attributes
    ----------
    lower, upper
        Ends of the range; those of the search if the loop is stable up to there, NaN if it is
        not even stable with the modelled stiffness.

    """

    lower: float
    upper: float


def steady_gain(observer: ObserverDesign, noise_variance: float) -> Vector:
    """
    Return the gain K that an observer settles at with a constant R.

    From the stabilising solution P_1 of the discrete Riccati equation of P04 eqs 39-40.

    Parameters
    ----------
    observer
        Its model and Q.
    noise_variance
        R [N^2].

    Returns
    -------
    Vector
        K, shape (n,).

    Raises
    ------
    ConfigError
        If R is not positive.

    """
    if not (noise_variance > 0.0 and math.isfinite(noise_variance)):
        raise ConfigError('noise_variance', 'a positive number', noise_variance)
    C = np.zeros((observer.Q.shape[0], 1))
    C[0] = 1.0
    P_1 = solve_discrete_are(
        observer.Phi_n.T, C, np.diag(observer.Q), np.array([[noise_variance]]))
    gain: Vector = P_1[:, 0] / (P_1[0, 0] + noise_variance)
    return gain


def closed_loop_matrix(observer: ObserverDesign, gain: Vector, contact: RealContact) -> Matrix:
    """
    Return the transition of [z, dz/dt, inputs under way, x_est] from one tick to the next.

    With s the state of the contact, w = -F x_est the acceleration that is commanded at a tick
    (F the observer's feedback, with the terms of `contact` added) and y' = C s' + m_t a', a'
    the acceleration at the end of the period: s' = Phi s + Gamma w,
    x_est' = (1 - K C) Phi_c x_est + K y' (P04 eqs 36-38). References and disturbances only add
    to it.

    Parameters
    ----------
    observer
        The AOB with its model and feedback.
    gain
        K, shape (n,).
    contact
        What it works on.

    Returns
    -------
    Matrix
        Shape (2 + d + n, 2 + d + n).

    """
    k, c, m = contact.stiffness, contact.contact_damping, contact.effective_mass
    damping_rate = contact.damping_rate if contact.damping == 'plant' else 0.0
    A = np.array([[0.0, 1.0], [-k / m, -damping_rate - c / m]])
    Phi, Gamma = delayed_hold(A, np.array([0.0, 1.0]), contact.input_delay, contact.period)
    real, estimated = Phi.shape[0], gain.shape[0]
    command = np.zeros(real + estimated)  # w as a row
    if contact.damping == 'commanded':
        command[1] = -contact.damping_rate
    command[real:] = -observer.feedback
    command[real] += 1.0 / m
    matrix = np.zeros((real + estimated, real + estimated))
    matrix[:real, :real] = Phi
    matrix[:real] += np.outer(Gamma, command)
    measured = (np.array([k, c]) + contact.carried_mass * A[1]) @ matrix[:2]
    measured += contact.carried_mass * _acting_input(contact, command, real)
    correction = np.eye(estimated)
    correction[:, 0] -= gain
    matrix[real:, real:] = correction @ observer.Phi_c
    matrix[real:] += np.outer(gain, measured)
    return matrix


def _acting_input(contact: RealContact, command: Vector, real: int) -> Vector:
    """Return, as a row, the input that acts at the end of the period."""
    waiting = contact.input_delay / contact.period
    first = math.floor(waiting + 1e-9) == math.ceil(waiting - 1e-9)  # still the oldest
    position = 2 if first else 3
    if position >= real:
        return command
    row = np.zeros_like(command)
    row[position] = 1.0
    return row


def is_stable(matrix: Matrix) -> bool:
    """Return whether every eigenvalue of a transition matrix lies within the unit circle."""
    return bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)


def stability_boundary(
    observer: ObserverDesign, noise_variance: float, modelled: RealContact, *,
    lowest: float = 0.01, highest: float = 100.0, tolerance: float = 1e-4,
) -> StabilityRange:
    """
    Return how wrong the modelled stiffness may be.

    Walks from the ratio 1 up and down in steps of 5 % to the first unstable one and bisects
    the last step. Stable islands beyond it do not count.

    Parameters
    ----------
    observer
        The AOB, designed for the stiffness of `modelled`.
    noise_variance
        R, which the observer has settled at [N^2].
    modelled
        The contact for a ratio of 1. Its other values are what they really are.
    lowest, highest
        Where the search ends.
    tolerance
        Relative accuracy of the ends.

    Returns
    -------
    StabilityRange
        Real over modelled stiffness.

    """
    gain = steady_gain(observer, noise_variance)

    def stable(ratio: float) -> bool:
        contact = replace(modelled, stiffness=ratio * modelled.stiffness)
        return is_stable(closed_loop_matrix(observer, gain, contact))

    if not stable(1.0):
        return StabilityRange(math.nan, math.nan)
    ends = []
    for step, limit in ((1.0 / SEARCH_STEP, lowest), (SEARCH_STEP, highest)):
        good = bad = 1.0
        while bad == good != limit:
            bad = max(good * step, limit) if step < 1.0 else min(good * step, limit)
            if stable(bad):
                good = bad
        while abs(bad / good - 1.0) > tolerance:
            middle = math.sqrt(good * bad)
            good, bad = (middle, bad) if stable(middle) else (good, middle)
        ends.append(good)
    return StabilityRange(lower=ends[0], upper=ends[1])
