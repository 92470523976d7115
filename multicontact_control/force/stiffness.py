"""
The stiffness of a surface, estimated on-line, and the observer that follows it.

On the surface alpha = k z + c dz/dt; the wrist sensor reads with it the inertia m d^2z/dt^2 of the
tool, and mu times the friction w of the other contacts, which this one's motion drags over their
surfaces; z is the way of the contact point into the surface, from the encoders. All of these pass
the same band-pass filter, and k, c and mu are fitted to what comes out by least squares with a
memory that counts accepted samples.

While sliding, such a fit in closed loop is biased low, so that only samples after a touch or a
step of the command are accepted. A second, faster fit always listens; where it finds the surface
1.5 times as stiff or more, k is what it says.

The model of the observer follows, at a bounded rate: its x_1 = k z, x_2 = k dz/dt, its output
alpha = x_1 + (c / k) x_2. Its poles stay where they are as long as the tool's inertia allows.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from multicontact_control.algebra import cholesky, dot, multiply, solve_cholesky
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ForceConfig
from multicontact_control.config.contact import FORCE
from multicontact_control.force.plant import DelayedPlant
import numpy as np

SLOW_BAND, FAST_BAND = (3.0, 20.0), (6.0, 30.0)  # Hz: of the high-pass, and of three low-passes
FAST_MEMORY = 0.04  # s
DAMPING_TIME = 0.02  # s, in which the damping of the model settles
STEP = 0.3  # N, a change of the command that counts as a step
BEGIN, END = 1.0, 0.5  # N: a tool that is shaken reads 0.5 N of its inertia without a surface
SLIP_SPEED = 3e-3  # m/s, at which friction is near its full value
SLOW_SHARE, FAST_SHARE = 0.3, 0.5  # r^2 from which on a fit is believed
FAST_EXCESS = 1.5  # how much stiffer than the slow fit the fast one has to find the surface
INERTIA_SHARE = 0.8  # of k / m, which the square of the fastest pole stays below
SLOWEST_POLE = 10.0  # 1/s, of the second pole
MEMORY = 0.1  # s, of the slow fit, in time of samples that are accepted
WINDOW = 0.3  # s after a touch or a step of the command in which it accepts samples
LARGEST_DAMPING = 60.0  # N s/m, of the model
FALL_TIME, RISE_TIME = 0.02, 0.004  # s, shortest in which the model's k changes by a factor e
INPUT_LIMIT = 40.0  # m/s^2, of |u|
APPROACH_LIMIT = 0.25  # m/s into the surface, at which the desired force is followed at most
SMALLEST_RESIDUAL = 0.03  # N; what is left is never taken for smaller
CORRELATION = 8.0  # samples of a band-passed signal for one that is independent
LEAST_WEIGHT = 5.0  # samples, for a fit
SMALLEST_PIVOT = 1e-6  # what must be left of a scaled column that the others do not explain
LARGEST_FRICTION = 1.0
SMALLEST_SIGNAL = 0.15  # N, filtered, from which on a sample is accepted


def adopt_band(fit: Any, band: tuple[float, float], period: float, memory: float) -> None:
    """Set the band [Hz] and the memory [s] of a record of `STIFFNESS_FIT`; h in [s]."""
    fit['high'], fit['low'] = (
        -math.expm1(-2.0 * math.pi * frequency * period) for frequency in band)
    fit['keep'] = math.exp(-period / memory)


@compiled
def take_sample(
    fit: Any, sample: Vector, period: float, mass: float, accepted: bool,
) -> None:
    """
    Filter a sample, and if it is accepted and large enough, fit k, c and mu anew.

    A sample: way into the surface [m], its rate [m/s], the friction of the other contacts per mu
    [N] and the measured force [N], shape (4,). Period h [s], mass of the tool [kg].
    """
    filtered = np.empty(4)
    for i in range(4):
        stages = fit.stages[i]
        stages[0] += fit.high * (sample[i] - stages[0])
        entering = sample[i] - stages[0]
        for j in range(1, 4):
            stages[j] += fit.low * (entering - stages[j])
            entering = stages[j]
        filtered[i] = entering
    filtered[3] -= mass * (filtered[1] - fit.speed) / period
    fit.speed = filtered[1]
    if not accepted or abs(filtered[3]) < SMALLEST_SIGNAL:
        return
    for i in range(4):
        for j in range(i, 4):
            fit.sums[i, j] = fit.keep * fit.sums[i, j] + filtered[i] * filtered[j]
    fit.weight = fit.keep * fit.weight + 1.0
    if fit.weight >= LEAST_WEIGHT:
        solve_fit(fit)


@compiled
def solve_fit(fit: Any) -> None:
    """
    Fit y = k z + c v + mu w to the sums of a record of `STIFFNESS_FIT` by least squares.

    A mu beyond 0 to 1 is set there, and the rest is fitted again. The fit stays as it was where
    the regressors do not tell the parameters apart.
    """
    sums, fixed = fit.sums, False  # mu
    value, variance, solution, scale = np.zeros(3), np.zeros(3), np.zeros(3), np.ones(3)
    normal, L = np.zeros((3, 3)), np.zeros((3, 3))
    if sums[0, 0] <= 0.0:
        return
    for _ in range(2):
        for i in range(3):
            variance[i], solution[i], scale[i] = 0.0, 0.0, 1.0
            for j in range(3):
                normal[i, j] = 0.0
            if (fixed and i == 2) or sums[i, i] <= 0.0:  # known, or it never moved
                normal[i, i] = 1.0
                continue
            scale[i] = 1.0 / np.sqrt(sums[i, i])
            solution[i] = sums[i, 3]
            for j in range(3):
                product = sums[min(i, j), max(i, j)]
                if fixed and j == 2:
                    solution[i] -= product * value[j]
                elif j >= i:
                    normal[i, j] = product
        for i in range(3):
            solution[i] *= scale[i]
            for j in range(i, 3):
                normal[i, j] *= scale[i] * scale[j]
        if not cholesky(normal, L, SMALLEST_PIVOT):
            return
        variance[0] = 1.0
        solve_cholesky(L, solution)
        solve_cholesky(L, variance)
        for i in range(2 if fixed else 3):
            value[i] = solution[i] * scale[i]
        bounded = min(max(value[2], 0.0), LARGEST_FRICTION)
        if bounded == value[2]:
            break
        value[2], fixed = bounded, True
    left = sums[3, 3]
    for i in range(3):
        left -= 2.0 * value[i] * sums[i, 3]
        for j in range(3):
            left += value[i] * value[j] * sums[min(i, j), max(i, j)]
    left = max(left, 0.0)
    fit.k, fit.c, fit.mu = value[0], value[1], value[2]
    fit.share = 1.0 - left / sums[3, 3]
    fit.k_std = np.sqrt(CORRELATION * (variance[0] * (scale[0] * scale[0])) * max(
        left / fit.weight, SMALLEST_RESIDUAL * SMALLEST_RESIDUAL))


def adopt_stiffness(
    record: Any, plant: DelayedPlant, stiffness: float, config: ForceConfig, *, period: float,
    tool_mass: float, ratio_limits: Sequence[float],
) -> None:
    """
    Fill in a record of `STIFFNESS` whose model starts from a stiffness [N/m] and its plant.

    Period h [s], mass beyond the sensor [kg], and the true over modelled stiffness up to which
    the loop is stable, of `LIMITS` models from the softest to the stiffest, equal ratios apart.
    """
    values = {
        'adaptive': True, 'period': period, 'tool_mass': tool_mass,
        'lowest': config.adaptive.lowest, 'highest': config.adaptive.highest,
        'fastest_pole': 1.0 / config.time_constant, 'pole_ratio': config.second_pole_ratio,
        'ratio_limit': ratio_limits, 'k': stiffness, 'c': 0.0}
    for name, value in values.items():
        record[name] = value
    record['transition'] = plant.Phi[0, 1], plant.Phi[1, 1]
    gains, input_gain = predictor_gains(plant, stiffness)
    record['delay_gain'][:len(gains)], record['input_gain'] = gains, input_gain
    adopt_band(record['slow'], SLOW_BAND, period, MEMORY)
    adopt_band(record['fast'], FAST_BAND, period, FAST_MEMORY)


def predictor_gains(plant: DelayedPlant, stiffness: float) -> tuple[Matrix, Vector]:
    """
    Return what turns a delayed plant into one without delay.

    With eta_k = [alpha, dalpha/dt]_k + sum_j E_j v_{k-j}, eta_{k+1} = Phi_s eta_k + B v_k: the
    feedback L_0 of the undelayed plant gives L = [L_0, L_0 E_d, ..., L_0 E_1] of P04 eq. 36, with
    the poles of the delay states at 0. Returns E_d to E_1, shape (d, 2), and B, shape (2,), both
    per N/m.
    """
    Phi_s, delayed = plant.Phi[:2, :2], plant.Phi[:2, 2:].T / stiffness
    d = len(delayed)
    gains = np.zeros((d, 2))
    under_way = np.zeros(2)  # E_{j+1}
    for j in range(1, d + 1):  # from the oldest input, v_{k-d}, on
        under_way = np.linalg.solve(Phi_s, delayed[j - 1] + under_way)
        gains[j - 1] = under_way
    return gains, plant.Gamma[:2] / stiffness + under_way


def keep_stiffness(law: Any, other: Any) -> None:
    """Take over what another design has found out; records of `FORCE_LAW`, the first changed."""
    record, known = law['stiffness'], other['stiffness']
    for name in ('slow', 'fast', 'k_est', 'k_std', 'alpha_ref', 'alpha_des', 'since', 'depth',
                 'speed', 'felt'):
        record[name] = known[name]
    use_stiffness(law['observer'], record, float(known['k']), float(known['c']))


@compiled
def use_stiffness(observer: Any, stiffness: Any, k: float, c: float) -> None:
    """
    Give an observer another model, and the feedback that belongs to it.

    Poles at omega_1 = min(1 / tau, sqrt(0.8 k / m_tool)) and omega_2 = k / c, between 10 /s and
    that of the configuration; see `predictor_gains`. What is known of the rate, x_2 = k dz/dt,
    goes with k [N/m]; c [N s/m].
    """
    factor = k / stiffness.k
    n, plain = observer.states, observer.states - observer.order
    if factor != 1.0:
        observer.Phi_n[:2, 2:n] *= factor
        observer.Phi_c[:2, 2:n] *= factor
        observer.Gamma[:2] *= factor
        observer.x_est[1] *= factor
        observer.P[1, :n] *= factor
        observer.P[:n, 1] *= factor
    stiffness.k = k
    stiffness.c = c
    observer.damping_time = c / k
    omega_1 = stiffness.fastest_pole
    if stiffness.tool_mass > 0.0:
        omega_1 = min(omega_1, np.sqrt(INERTIA_SHARE * k / stiffness.tool_mass))
    omega_2 = omega_1 * stiffness.pole_ratio
    if c > 0.0:
        omega_2 = min(omega_2, max(k / c, SLOWEST_POLE))
    p_1, p_2 = np.exp(-stiffness.period * omega_1), np.exp(-stiffness.period * omega_2)
    f, e = stiffness.transition[0], stiffness.transition[1]
    b_1, b_2 = stiffness.input_gain[0], stiffness.input_gain[1]
    total, product = p_1 + p_2, p_1 * p_2
    scale = 1.0 / (b_2 * (b_1 * (e - 1.0) - f * b_2))
    L_1 = -scale * b_2 * (1.0 - total + product)
    L_2 = scale * (b_1 * (e * e - total * e + product) - b_2 * f * (1.0 + e - total))
    observer.feedback[0] = L_1 / k
    observer.feedback[1] = L_2 / k
    for j in range(2, plain):
        gain = stiffness.delay_gain[j - 2]
        observer.feedback[j] = L_1 * gain[0] + L_2 * gain[1]


@compiled
def friction_of_others(frame: Any, contacts: Any, which: int) -> float:
    """
    Return what the friction of the other contacts adds to the force of contact i, per mu [N].

    The robot drags each surface along its sliding velocity v: sum_j alpha_j v_j . n_i / |v_j|.
    """
    normal, twist = contacts[which].normal, frame.twist
    total = 0.0
    lever, velocity = np.empty(3), np.empty(3)
    for j in range(contacts.shape[0]):
        other = contacts[j]
        if j == which or other.config.kind != FORCE or other.alpha_meas <= 0.0:
            continue
        multiply(frame.rotation, other.config.point, lever)
        velocity[0] = twist[0] + twist[4] * lever[2] - twist[5] * lever[1]
        velocity[1] = twist[1] + twist[5] * lever[0] - twist[3] * lever[2]
        velocity[2] = twist[2] + twist[3] * lever[1] - twist[4] * lever[0]
        into = dot(velocity, other.normal)
        velocity -= into * other.normal
        total += other.alpha_meas * dot(velocity, normal) / np.sqrt(
            dot(velocity, velocity) + SLIP_SPEED * SLIP_SPEED)
    return total


@compiled
def find_stiffness(
    stiffness: Any, alpha: float, alpha_des: float, speed: float, friction: float,
) -> None:
    """
    Take a sample into the estimate of a stiffness, whatever law moves the contact.

    The filters begin anew when a force is felt: before, the surface is not there. Measured and
    desired force [N], speed of the contact point INTO the surface [m/s], `friction_of_others` [N].
    """
    h = stiffness.period
    stiffness.since += h
    if abs(alpha_des - stiffness.alpha_des) > STEP:
        stiffness.since = 0.0
    stiffness.alpha_des = alpha_des
    if not stiffness.felt:
        if alpha <= BEGIN:
            return
        stiffness.slow.stages[:] = stiffness.fast.stages[:] = 0.0
        stiffness.slow.stages[3, 0] = stiffness.fast.stages[3, 0] = alpha
        stiffness.slow.speed = stiffness.fast.speed = 0.0
        stiffness.since = 0.0
        stiffness.depth = 0.0
        stiffness.felt = True
    else:
        stiffness.depth += 0.5 * h * (speed + stiffness.speed)
        stiffness.felt = alpha > END
    stiffness.speed = speed
    sample = np.array([stiffness.depth, speed, friction, alpha])
    mass = stiffness.tool_mass
    take_sample(stiffness.slow, sample, h, mass, stiffness.felt and stiffness.since <= WINDOW)
    take_sample(stiffness.fast, sample, h, mass, stiffness.felt)
    if stiffness.slow.k > 0.0 and stiffness.slow.share > SLOW_SHARE:
        stiffness.k_est = stiffness.slow.k
        stiffness.k_std = stiffness.slow.k_std


@compiled
def learn_stiffness(laws: Any, contacts: Any, which: int, control: Any, speed: float) -> None:
    """
    Take a sample into the model of a contact's surface, which follows at a bounded rate.

    That of a couple follows the normal force of its contact. Of records of `FORCE_LAW` and
    `CONTACT`, shape (r,), those of number `which` are changed; `control` is a record of `CONTROL`,
    the speed of the contact point is that INTO the surface [m/s].
    """
    contact, observer, stiffness = contacts[which], laws[which].observer, laws[which].stiffness
    if contact.config.kind != FORCE:
        leader, whole = contacts[contact.config.leader], laws[contact.config.leader].stiffness
        share = stiffness.share
        k = min(max(share * whole.k, stiffness.lowest), stiffness.highest)
        if k != stiffness.k:
            use_stiffness(observer, stiffness, k, share * whole.c)
        contact.stiffness = k
        contact.stiffness_est = share * leader.stiffness_est
        contact.stiffness_std = share * leader.stiffness_std
        contact.ratio_bound, contact.margin = leader.ratio_bound, leader.margin
        return
    alpha = contact.alpha_meas if control.measured else contact.answer.alpha_est
    find_stiffness(stiffness, alpha, contact.answer.alpha_des, speed,
                   friction_of_others(control.frame, contacts, which))
    slow, fast = stiffness.slow, stiffness.fast
    h, k, c = stiffness.period, stiffness.k, stiffness.c
    target = k
    if slow.k > 0.0 and slow.share > SLOW_SHARE:
        target = slow.k + 2.0 * slow.k_std
        damping = min(max(slow.c, 0.0), LARGEST_DAMPING)
        c += h / DAMPING_TIME * (damping - c)
    # Against what the slow fit says, and not against k in use, which it would drive up and down.
    if fast.share > FAST_SHARE and fast.k - fast.k_std > FAST_EXCESS * target:
        target = fast.k
    target = min(max(target, stiffness.lowest), stiffness.highest)
    # A model changes once a period: e times its value in less would be a jump.
    change = min(max(np.log(target / k), -min(h / FALL_TIME, 1.0)), min(h / RISE_TIME, 1.0))
    if change != 0.0 or c != stiffness.c:
        use_stiffness(observer, stiffness, k * np.exp(change), c)
    contact.stiffness = stiffness.k
    contact.stiffness_est = stiffness.k_est
    contact.stiffness_std = stiffness.k_std
    contact.ratio_bound = contact.margin = 0.0  # as long as nothing is known
    if stiffness.k_est > 0.0:
        contact.ratio_bound = (stiffness.k_est + 2.0 * stiffness.k_std) / stiffness.k
        limits = stiffness.ratio_limit
        place = np.log(stiffness.k / stiffness.lowest) / np.log(
            stiffness.highest / stiffness.lowest)
        contact.margin = np.interp(
            place, np.linspace(0.0, 1.0, limits.shape[0]), limits) / contact.ratio_bound
