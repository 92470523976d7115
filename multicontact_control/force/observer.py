"""The active observer (AOB): a Kalman filter with an input-disturbance state (P04 eqs 34-41)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Annotated, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.force.plant import ForceLoop
from multicontact_control.records import (
    Contact,
    MAX_STATES,
    Record,
    record_dtype,
    Records,
)
import numpy as np
from scipy.linalg import solve_discrete_are

INITIAL_VARIANCE = 1e-3  # of every state


class ObserverGains(Record, Protocol):
    """
    The model and the noise that an active observer works by.

    The first `states` rows and columns of matrices are used.
    """

    # N, and how many of them are active states.
    states: int
    order: int

    Phi_c: Annotated[Matrix, MAX_STATES, MAX_STATES]  # transition of the closed loop
    Phi_n: Annotated[Matrix, MAX_STATES, MAX_STATES]  # transition of the open loop
    Gamma: Annotated[Vector, MAX_STATES]  # input vector
    feedback: Annotated[Vector, MAX_STATES]  # [L_r 1]
    Q: Annotated[Vector, MAX_STATES]  # diagonal of the process noise's covariance
    P_0: float  # initial variance of every state
    damping_time: float  # c / k of the surface, which the force reads with its rate [s]


class Observer(Record, Protocol):
    """The active observer of one contact."""

    design: ObserverGains
    running: bool  # whether there was a sample before
    command: float  # r = L_1 f_des of the sample before [m/s^2]

    # State estimate; the first is the force [N], then its rate [N/s].
    x_est: Annotated[Vector, MAX_STATES]

    P: Annotated[Matrix, MAX_STATES, MAX_STATES]  # its covariance
    x_1: Annotated[Vector, MAX_STATES]  # prediction of the state


OBSERVER = record_dtype(Observer)


class ObserverSpace(Record, Protocol):
    """What `observe_force` works in; one."""

    half: Annotated[Matrix, MAX_STATES, MAX_STATES]  # Phi_n P

    # P_1 C^T, of the state with the force that is read.
    covariance: Annotated[Vector, MAX_STATES]


OBSERVER_SPACE = record_dtype(ObserverSpace)


@dataclass(frozen=True, slots=True)
class ObserverDesign:
    """
    An active observer of the state [x_r, p_k, p_{k-1}, ...].

    x_r is the state of the delayed plant; p adds to its input.

    """

    loop: ForceLoop  # plant and state feedback
    order: int  # number of active states
    Phi_n: Matrix  # transition of the open loop (P04 eq. 41), shape (n, n)
    Phi_c: Matrix  # of the closed one (eq. 37), shape (n, n)
    Gamma: Vector  # input vector, shape (n,)
    feedback: Vector  # [L_r 1] of P04 eq. 36, shape (n,)
    Q: Vector  # diagonal of the process noise's covariance, shape (n,)


def design_observer(
    loop: ForceLoop,
    *,
    order: int = 1,
    process_noise: float = 1e-3,
) -> ObserverDesign:
    """
    Design an active observer (P04 eqs 34-37, 41).

    Parameters
    ----------
    loop
        The plant and its state feedback.
    order
        Order of the active state, 0 to 3; 1 is the paper's random walk, 0 leaves plain pole
        placement on the Kalman estimate.
    process_noise
        Q = process_noise I over x_r and the newest p; older copies of p are exact.

    """
    n = loop.plant.Phi.shape[0]
    size = n + order
    Phi_n = np.zeros((size, size))
    Phi_c = np.zeros((size, size))
    Phi_n[:n, :n] = loop.plant.Phi
    Phi_c[:n, :n] = loop.closed_loop
    Phi_n[n:, n:] = active_state_matrix(order)
    Phi_c[n:, n:] = active_state_matrix(order)
    feedback = np.concatenate([loop.L, np.zeros(order)])
    if order:
        Phi_n[:n, n] = loop.plant.Gamma
        feedback[n] = 1.0
    Q = np.zeros(size)
    Q[: n + min(order, 1)] = process_noise
    return ObserverDesign(
        loop,
        order,
        Phi_n,
        Phi_c,
        np.concatenate([loop.plant.Gamma, np.zeros(order)]),
        feedback,
        Q,
    )


def solve_steady_covariance(observer: ObserverDesign, noise_variance: float) -> Matrix:
    """Return the covariance P_1, shape (n, n), of predictions with a constant R [N^2]."""
    C = np.zeros((observer.Q.shape[0], 1))
    C[0] = 1.0
    P_1: Matrix = solve_discrete_are(
        observer.Phi_n.T, C, np.diag(observer.Q), np.array([[noise_variance]])
    )
    return P_1


def solve_steady_gain(observer: ObserverDesign, noise_variance: float) -> Vector:
    """
    Return the gain K, shape (n,), that an observer settles at with a constant R [N^2].

    From the stabilising solution P_1 of the discrete Riccati equation of P04 eqs 39-40.
    """
    P_1 = solve_steady_covariance(observer, noise_variance)
    gain: Vector = P_1[:, 0] / (P_1[0, 0] + noise_variance)
    return gain


def active_state_matrix(order: int) -> Matrix:
    """
    Return the transition of [p_{k-1}, ..., p_{k-n}] to [p_k, ..., p_{k-n+1}], shape (n, n).

    p_k = sum_j (-1)^(j+1) binom(n, j) p_{k-j} + noise; `order` 1 is the random walk of P04 eq. 34.
    """
    matrix: Matrix = np.eye(order, k=-1)
    for j in range(1, order + 1):
        matrix[0, j - 1] = (-1.0) ** (j + 1) * comb(order, j)
    return matrix


def make_observers(designs: Sequence[ObserverDesign]) -> Records[Observer]:
    """Return one observer per contact that knows nothing yet, shape (r,)."""
    observers = np.zeros(len(designs), dtype=OBSERVER)
    for record, design in zip(observers['design'], designs):
        n = design.Gamma.shape[0]
        record['states'] = n
        record['order'] = design.order
        record['P_0'] = INITIAL_VARIANCE
        for name in ('Phi_c', 'Phi_n'):
            record[name][:n, :n] = getattr(design, name)
        for name in ('Gamma', 'feedback', 'Q'):
            record[name][:n] = getattr(design, name)
    return observers


def continue_observers_from(
    observers: Records[Observer], others: Records[Observer]
) -> None:
    """
    Take over the states of others, of as many states, records of `OBSERVER`, shape (r,).

    The first prediction is that of the plant under the input that the others have commanded.
    """
    for name in ('x_est', 'P', 'running'):
        observers[name] = others[name]
    difference = _predicted_feedback(observers) - _predicted_feedback(others)
    observers['command'] = others['command'] + np.einsum(
        'ij,ij->i', difference, others['x_est']
    )


def _predicted_feedback(observers: Records[Observer]) -> Matrix:
    """Return the feedback that is in the predictions, and so not in the commands; shape (r, n)."""
    design = observers['design']
    closed = (design['Phi_c'] != design['Phi_n']).any(axis=(1, 2))
    feedback: Matrix = np.where(closed[:, None], design['feedback'], 0.0)
    return feedback


@compiled
def command_rest(observer: Observer) -> None:
    """Let what has been commanded be what keeps the force as it is estimated, and at rest."""
    design = observer.design
    n = design.states
    closed = False
    for i in range(n):
        for j in range(n):
            closed = closed or design.Phi_c[i, j] != design.Phi_n[i, j]
    has_feedback = False
    for i in range(n):
        has_feedback = has_feedback or design.feedback[i] != 0.0
    if closed and has_feedback:  # which takes p off already
        observer.command = design.feedback[0] * observer.x_est[0]
        return
    observer.command = 0.0
    if design.order > 0:
        observer.command = -observer.x_est[n - design.order]


@compiled
def predict_state(observer: Observer, space: ObserverSpace) -> None:
    """
    Predict state and covariance of the next sample, in a record of `OBSERVER`.

    x_1 = Phi_c x + Gamma r with the closed loop (P04 eqs 37-38), P_1 = Phi_n P Phi_n^T + Q with
    the open one (eqs 40-41); P becomes P_1, its upper triangle mirrored. `space` is a record of
    `OBSERVER_SPACE`.
    """
    design = observer.design
    n = design.states
    Phi_c = design.Phi_c
    Phi_n = design.Phi_n
    Gamma = design.Gamma
    Q = design.Q
    P = observer.P
    x_est = observer.x_est
    x_1 = observer.x_1
    half = space.half
    for i in range(n):
        total = Gamma[i] * observer.command
        for j in range(n):
            total += Phi_c[i, j] * x_est[j]
            half[i, j] = 0.0
        x_1[i] = total
        for k in range(n):
            factor = Phi_n[i, k]
            if factor != 0.0:  # the shift register makes most of them zero
                for j in range(n):
                    half[i, j] += factor * P[k, j]
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(n):
                if Phi_n[j, k] != 0.0:
                    total += half[i, k] * Phi_n[j, k]
            P[i, j] = total
            P[j, i] = total
        P[i, i] += Q[i]


@compiled
def correct_prediction(
    observer: Observer,
    innovation: float,
    noise_variance: float,
    space: ObserverSpace,
) -> None:
    """
    Correct the prediction by the innovation.

    K = P_1 C^T / (C P_1 C^T + R) with C = e_1^T, x = x_1 + K (y - C x_1), P = P_1 - K C P_1
    (P04 eqs 37, 39, 40). The first row of P is R / (C P_1 C^T + R) times that of P_1, without the
    difference of two nearly equal numbers: the variance of the measured state stays positive
    however far R drops. Where the model of the surface damps, C = (1, c / k, 0, ...).

    `observer` is a record of `OBSERVER` after `predict_state`; innovation y - C x_1 [N],
    R_k [N^2]; `space` is a record of `OBSERVER_SPACE`.
    """
    n = observer.design.states
    tau = observer.design.damping_time
    P = observer.P
    covariance = space.covariance
    for i in range(n):
        covariance[i] = P[0, i] + tau * P[1, i]
    total_variance = covariance[0] + tau * covariance[1] + noise_variance
    for i in range(n):
        observer.x_est[i] = (
            observer.x_1[i] + covariance[i] / total_variance * innovation
        )
    if tau != 0.0:
        for i in range(n):
            for j in range(i, n):
                P[i, j] -= covariance[i] * covariance[j] / total_variance
                P[j, i] = P[i, j]
        return
    remainder = noise_variance / total_variance
    for i in range(n):
        P[0, i] = covariance[i] * remainder
        P[i, 0] = P[0, i]
    for i in range(1, n):
        gain = covariance[i] / total_variance
        for j in range(i, n):
            P[i, j] -= gain * covariance[j]
            P[j, i] = P[i, j]


@compiled
def command_acceleration(observer: Observer, alpha_des: float) -> float:
    """
    Return u_k = L_1 f_des - [L_r 1] [x_est; p_est] (P04 eq. 36), and keep r = L_1 f_des.

    u is the acceleration along the contact normal, without the damping K_2 [m/s^2].
    """
    feedback = observer.design.feedback
    x_est = observer.x_est
    observer.command = feedback[0] * alpha_des
    total = observer.command
    for j in range(observer.design.states):
        total -= feedback[j] * x_est[j]
    return total


@compiled
def continue_observer_after_pause(observer: Observer, held: bool, force: float) -> None:
    """
    Go on after a pause with an observer, a record of `OBSERVER`, changed.

    That of a contact that stayed pressed, `held`, goes on from the measured force [N], at rest,
    with the disturbance p from before. Any other starts anew.
    """
    if not held:
        observer.running = False
        return
    observer.x_est[: observer.design.states - observer.design.order] = 0.0
    observer.x_est[0] = force
    command_rest(observer)


@compiled
def observe_force(
    observer: Observer,
    contact: Contact,
    measured: bool,
    rate: float,
    disturbance: float,
    space: ObserverSpace,
) -> None:
    """
    Take the measured force of an active contact into its observer.

    An observer that has not run starts from that force, from a rate x_2 that is as uncertain as it
    is large [N/s], and from the disturbance p that the motion had along the normal [m/s^2].
    Without a measurement of this sample it only predicts (R = inf). `space` is a record of
    `OBSERVER_SPACE`.
    """
    n = observer.design.states
    tau = observer.design.damping_time
    P = observer.P
    x_est = observer.x_est
    x_1 = observer.x_1
    answer = contact.answer
    if not observer.running:
        for i in range(n):
            x_est[i] = 0.0
            for j in range(n):
                P[i, j] = 0.0
            P[i, i] = observer.design.P_0
        x_est[0] = contact.alpha_meas
        x_est[1] = rate
        P[1, 1] += rate * rate
        for i in range(n - observer.design.order, n):
            x_est[i] = disturbance
        observer.running = True
    else:
        predict_state(observer, space)
        if measured:
            answer.prior_variance = P[0, 0] + tau * (2.0 * P[0, 1] + tau * P[1, 1])
            answer.innovation = contact.alpha_meas - (x_1[0] + tau * x_1[1])
            answer.variance_used = contact.noise_variance
            correct_prediction(
                observer, answer.innovation, contact.noise_variance, space
            )
        else:
            for i in range(n):
                x_est[i] = x_1[i]
    answer.alpha_est = x_est[0] + tau * x_est[1]
    answer.alpha_rate_est = x_est[1]
