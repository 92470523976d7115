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

import math
from typing import Annotated, Protocol

from multicontact_control.algebra import (
    cholesky,
    component_across,
    dot,
    rotate_vector,
    solve_cholesky,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ForceConfig
from multicontact_control.config.contact import FORCE
from multicontact_control.force.observer import Observer
from multicontact_control.force.plant import DelayedPlant
from multicontact_control.records import (
    Contact,
    Control,
    Frame,
    MAX_STATES,
    Record,
    record_dtype,
    Records,
)
import numpy as np

# Hz: of the high-pass, and of three low-passes.
SLOW_BAND = (3.0, 20.0)
FAST_BAND = (6.0, 30.0)
SLOW_MEMORY = 0.1  # s, of the slow fit, in time of samples that are accepted
FAST_MEMORY = 0.04  # s
DAMPING_TIME = 0.02  # s, in which the damping of the model settles
COMMAND_STEP = 0.3  # N, a change of the command that counts as a step
# N: where a surface begins and ends to be felt; a tool that swings reads 0.5 N of its inertia.
FELT_FROM = 1.0
FELT_ABOVE = 0.5
FULL_FRICTION_SPEED = 3e-3  # m/s, of sliding, at which friction is near its full value
# r^2 from which on a fit is believed.
SLOW_SHARE = 0.3
FAST_SHARE = 0.5
# Factor of stiffness from which on the fast fit overrules the slow one.
FAST_EXCESS = 1.5
INERTIA_SHARE = 0.8  # of k / m, which the square of the fastest pole stays below
SLOWEST_POLE = 10.0  # 1/s, of the second pole
ACCEPTED_TIME = 0.3  # s after a touch or a step, in which the slow fit accepts samples
LARGEST_DAMPING = 60.0  # N s/m, of the model
# s, shortest in which the model's k changes by a factor e.
FALL_TIME = 0.02
RISE_TIME = 0.004
INPUT_LIMIT = 40.0  # m/s^2, of |u|
# m/s into the surface, at which a desired force is followed at most.
APPROACH_LIMIT = 0.25
SMALLEST_RESIDUAL = 0.03  # N; what is left is never taken for smaller
CORRELATION = 8.0  # samples of a band-passed signal for one that is independent
LEAST_WEIGHT = 5.0  # samples, for a fit
SMALLEST_FIT_PIVOT = 1e-6  # share of a scaled regressor that the others must leave
LARGEST_FRICTION = 1.0
SMALLEST_SIGNAL = 0.15  # N, filtered, from which on a sample is accepted
LIMITS = 8  # points of the curve of what stiffness a force loop is stable up to
# The regressors of the force, whose factors are k, c and mu.
WAY, RATE, FRICTION = range(3)


class SignalBand(Record, Protocol):
    """The memory of one signal's band-pass: a high-pass and three low-passes."""

    drift: float
    first: float
    second: float
    passed: float


SIGNAL_BAND = record_dtype(SignalBand)


class StiffnessFit(Record, Protocol):
    """
    One frequency band of a stiffness estimator.

    It has filters of four signals, and sums over samples of what passes them: X of way, rate
    and friction, and y of the force without the tool's inertia.
    """

    # Gains of the high-pass and of the three low-passes, per sample.
    high: float
    low: float

    keep: float  # by which the sums shrink with each accepted sample

    # Z into the surface and v [m], [m/s].
    way: SignalBand
    rate: SignalBand

    # W of the others per mu, and alpha [N].
    friction: SignalBand
    force: SignalBand

    products: Annotated[Matrix, 3, 3]  # X^T X, its upper triangle

    # X^T y and y^T y.
    moments: Annotated[Vector, 3]
    power: float

    weight: float  # of the samples in these sums

    # What fits them best [N/m], [N s/m], [-].
    k: float
    c: float
    mu: float

    k_std: float  # standard error of k [N/m]
    share: float  # r^2, of the variance of y that is explained


STIFFNESS_FIT = record_dtype(StiffnessFit)


class InputGain(Record, Protocol):
    """What an input of 1 m/s^2 per k adds to the state."""

    # [s^2], [s].
    way: float
    speed: float


class StiffnessConfig(Record, Protocol):
    """What is set for the on-line stiffness of one contact."""

    adaptive: bool  # whether the observer follows it
    share: float  # of a couple: its stiffness over that of its contact's normal force
    period: float  # h [s]

    # K stays within [N/m].
    lowest: float
    highest: float

    tool_mass: float  # beyond the sensor [kg]

    # 1 / tau [1/s], and of the second pole to it.
    fastest_pole: float
    pole_ratio: float

    # Of the undelayed plant: the way in a period for a speed [s], and the share of it
    # that stays.
    way_of_speed: float
    speed_kept: float

    # K over a model's at which the loop is stable, `lowest` on.
    ratio_limit: Annotated[Vector, LIMITS]

    delay_gain: Annotated[Records[InputGain], MAX_STATES]  # E_j, of inputs under way
    input_gain: InputGain  # B of the undelayed plant


class Stiffness(Record, Protocol):
    """The on-line stiffness of one contact."""

    config: StiffnessConfig
    slow: StiffnessFit
    fast: StiffnessFit

    # Of the model in use [N/m], [N s/m].
    k: float
    c: float

    # Estimate and its standard error; 0 for none [N/m].
    k_est: float
    k_std: float

    alpha_ref: float  # desired force as it is followed [N]
    alpha_des: float  # of the sample before [N]
    since: float  # a touch or a step [s]

    # Of the contact point since the touch [m], and now [m/s].
    depth: float
    speed: float

    felt: bool  # whether a surface is


STIFFNESS = record_dtype(Stiffness)


class AdaptiveLaw(Record, Protocol):
    """What is read here of a record of `FORCE_LAW`."""

    observer: Observer
    stiffness: Stiffness


class FitSpace(Record, Protocol):
    """What `solve_fit` works in; one."""

    # K, c and mu, and the same scaled.
    factors: Annotated[Vector, 3]
    solution: Annotated[Vector, 3]

    variance: Annotated[Vector, 3]  # first column of the inverse of the scaled X^T X

    # Scaled X^T X = L L^T.
    scale: Annotated[Vector, 3]
    normal: Annotated[Matrix, 3, 3]
    L: Annotated[Matrix, 3, 3]


FIT_SPACE = record_dtype(FitSpace)


def set_fit_band(
    fit: StiffnessFit, band: tuple[float, float], period: float, memory: float
) -> None:
    """Set the band [Hz] and the memory [s] of a record of `STIFFNESS_FIT`; h in [s]."""
    high_pass, low_pass = band
    fit['high'] = -math.expm1(-2.0 * math.pi * high_pass * period)
    fit['low'] = -math.expm1(-2.0 * math.pi * low_pass * period)
    fit['keep'] = math.exp(-period / memory)


@compiled
def settle_band_pass(band: SignalBand, value: float) -> None:
    """Let the band-pass of a signal, a record of `SIGNAL_BAND`, be at rest at a value."""
    band.drift = value
    band.first = band.second = band.passed = 0.0


@compiled
def filter_signal(fit: StiffnessFit, band: SignalBand, value: float) -> float:
    """Return what passes the band of a record of `STIFFNESS_FIT` of one of its signals."""
    band.drift += fit.high * (value - band.drift)
    band.first += fit.low * (value - band.drift - band.first)
    band.second += fit.low * (band.first - band.second)
    band.passed += fit.low * (band.second - band.passed)
    return band.passed


@compiled
def add_fit_sample(
    stiffness: Stiffness,
    fit: StiffnessFit,
    friction: float,
    alpha: float,
    accepted: bool,
    space: FitSpace,
) -> None:
    """
    Filter a sample, and if it is accepted and large enough, fit k, c and mu anew.

    Of the record of `STIFFNESS` that the fit is of, depth, speed, period and the tool's mass are
    read; the friction of the other contacts per mu [N], the measured force [N]; `space` is a
    record of `FIT_SPACE`.
    """
    speed_before = fit.rate.passed
    z = filter_signal(fit, fit.way, stiffness.depth)
    v = filter_signal(fit, fit.rate, stiffness.speed)
    w = filter_signal(fit, fit.friction, friction)
    y = filter_signal(fit, fit.force, alpha)
    config = stiffness.config
    y -= config.tool_mass * (v - speed_before) / config.period
    if not accepted or abs(y) < SMALLEST_SIGNAL:
        return
    signals = (z, v, w)
    for i in range(3):
        for j in range(i, 3):
            fit.products[i, j] = fit.keep * fit.products[i, j] + signals[i] * signals[j]
        fit.moments[i] = fit.keep * fit.moments[i] + signals[i] * y
    fit.power = fit.keep * fit.power + y * y
    fit.weight = fit.keep * fit.weight + 1.0
    if fit.weight >= LEAST_WEIGHT:
        solve_fit(fit, space)


@compiled
def solve_fit(fit: StiffnessFit, space: FitSpace) -> None:
    """
    Fit y = k z + c v + mu w to the sums of a record of `STIFFNESS_FIT` by least squares.

    A mu beyond 0 to 1 is set there, and the rest is fitted again. The fit stays as it was where
    the regressors do not tell the parameters apart. `space` is a record of `FIT_SPACE`.
    """
    products, moments, factors = fit.products, fit.moments, space.factors
    if products[WAY, WAY] <= 0.0:
        return
    for friction_known in (False, True):
        if not solve_fit_factors(fit, friction_known, space):
            return
        bounded = min(max(factors[FRICTION], 0.0), LARGEST_FRICTION)
        if bounded == factors[FRICTION]:
            break
        factors[FRICTION] = bounded
    left = fit.power
    for i in range(3):
        left -= 2.0 * factors[i] * moments[i]
        for j in range(3):
            left += factors[i] * factors[j] * products[min(i, j), max(i, j)]
    left = max(left, 0.0)
    fit.k, fit.c, fit.mu = factors[WAY], factors[RATE], factors[FRICTION]
    fit.share = 1.0 - left / fit.power
    variance = space.variance[WAY] * (space.scale[WAY] * space.scale[WAY])
    fit.k_std = np.sqrt(
        CORRELATION
        * variance
        * max(left / fit.weight, SMALLEST_RESIDUAL * SMALLEST_RESIDUAL)
    )


@compiled
def solve_fit_factors(fit: StiffnessFit, friction_known: bool, space: FitSpace) -> bool:
    """
    Fill in the `factors` of least squares; return whether the regressors tell them apart.

    That of friction is left as it is where it is known. A regressor that never moved has 0.
    """
    products, factors, normal = fit.products, space.factors, space.normal
    solution, variance, scale = space.solution, space.variance, space.scale
    for i in range(3):
        variance[i], solution[i], scale[i] = 0.0, 0.0, 1.0
        for j in range(3):
            normal[i, j] = 0.0
        known = friction_known and i == FRICTION
        if known or products[i, i] <= 0.0:
            normal[i, i] = 1.0
            continue
        scale[i] = 1.0 / np.sqrt(products[i, i])
        solution[i] = fit.moments[i]
        for j in range(3):
            product = products[min(i, j), max(i, j)]
            if friction_known and j == FRICTION:
                solution[i] -= product * factors[j]
            elif j >= i:
                normal[i, j] = product
    for i in range(3):
        solution[i] *= scale[i]
        for j in range(i, 3):
            normal[i, j] *= scale[i] * scale[j]
    if not cholesky(normal, space.L, SMALLEST_FIT_PIVOT):
        return False
    variance[WAY] = 1.0
    solve_cholesky(space.L, solution)
    solve_cholesky(space.L, variance)
    for i in range(3):
        if not (friction_known and i == FRICTION):
            factors[i] = solution[i] * scale[i]
    return True


def set_up_stiffness(
    record: Stiffness,
    plant: DelayedPlant,
    stiffness: float,
    config: ForceConfig,
    *,
    period: float,
    tool_mass: float,
) -> None:
    """
    Fill in a record of `STIFFNESS` whose model starts from a stiffness [N/m] and its plant.

    Period h [s] and mass beyond the sensor [kg]. Left to the caller are `config.ratio_limit`, see
    `find_ratio_limits`, and `config.share` of a couple.
    """
    values = {
        'adaptive': True,
        'period': period,
        'tool_mass': tool_mass,
        'lowest': config.adaptive.lowest,
        'highest': config.adaptive.highest,
        'fastest_pole': 1.0 / config.time_constant,
        'pole_ratio': config.second_pole_ratio,
    }
    settings = record['config']
    for name, value in values.items():
        settings[name] = value
    settings['way_of_speed'], settings['speed_kept'] = plant.Phi[:2, 1]
    gains, input_gain = predictor_gains(plant, stiffness)
    for name, of_delayed, gain in zip(('way', 'speed'), gains.T, input_gain):
        settings['delay_gain'][name][: len(gains)] = of_delayed
        settings['input_gain'][name] = gain
    record['k'], record['c'] = stiffness, 0.0
    set_fit_band(record['slow'], SLOW_BAND, period, SLOW_MEMORY)
    set_fit_band(record['fast'], FAST_BAND, period, FAST_MEMORY)


def predictor_gains(plant: DelayedPlant, stiffness: float) -> tuple[Matrix, Vector]:
    """
    Return what turns a delayed plant into one without delay.

    With eta_k = [alpha, dalpha/dt]_k + sum_j E_j v_{k-j}, eta_{k+1} = Phi_s eta_k + B v_k: the
    feedback L_0 of the undelayed plant gives L = [L_0, L_0 E_d, ..., L_0 E_1] of P04 eq. 36, with
    the poles of the delay states at 0. Returns E_d to E_1, shape (d, 2), and B, shape (2,), both
    per N/m.
    """
    Phi_s = plant.Phi[:2, :2]
    delayed = plant.Phi[:2, 2:].T / stiffness
    d = len(delayed)
    gains = np.zeros((d, 2))
    under_way = np.zeros(2)  # E_{j+1}
    for j in range(1, d + 1):  # from the oldest input, v_{k-d}, on
        under_way = np.linalg.solve(Phi_s, delayed[j - 1] + under_way)
        gains[j - 1] = under_way
    return gains, plant.Gamma[:2] / stiffness + under_way


def take_over_stiffness(law: AdaptiveLaw, other: AdaptiveLaw) -> None:
    """Take over what another design has found out; records of `FORCE_LAW`, the first changed."""
    record, known = law['stiffness'], other['stiffness']
    for name in (
        'slow',
        'fast',
        'k_est',
        'k_std',
        'alpha_ref',
        'alpha_des',
        'since',
        'depth',
        'speed',
        'felt',
    ):
        record[name] = known[name]
    use_model_stiffness(law['observer'], record, float(known['k']), float(known['c']))


@compiled
def use_model_stiffness(
    observer: Observer, stiffness: Stiffness, k: float, c: float
) -> None:
    """
    Give an observer another model, and the feedback that belongs to it.

    Poles at omega_1 = min(1 / tau, sqrt(0.8 k / m_tool)) and omega_2 = k / c, between 10 /s and
    that of the configuration; see `predictor_gains`. What is known of the rate, x_2 = k dz/dt,
    goes with k [N/m]; c [N s/m].
    """
    config = stiffness.config
    design = observer.design
    factor = k / stiffness.k
    n = design.states
    plain = design.states - design.order
    if factor != 1.0:
        for i in range(2):
            design.Gamma[i] *= factor
            for j in range(2, n):
                design.Phi_n[i, j] *= factor
                design.Phi_c[i, j] *= factor
        observer.x_est[1] *= factor
        for j in range(n):
            observer.P[1, j] *= factor
            observer.P[j, 1] *= factor
    stiffness.k = k
    stiffness.c = c
    design.damping_time = c / k
    omega_1 = config.fastest_pole
    if config.tool_mass > 0.0:
        omega_1 = min(omega_1, np.sqrt(INERTIA_SHARE * k / config.tool_mass))
    omega_2 = omega_1 * config.pole_ratio
    if c > 0.0:
        omega_2 = min(omega_2, max(k / c, SLOWEST_POLE))
    p_1 = np.exp(-config.period * omega_1)
    p_2 = np.exp(-config.period * omega_2)
    f, e = config.way_of_speed, config.speed_kept
    b_1, b_2 = config.input_gain.way, config.input_gain.speed
    total = p_1 + p_2
    product = p_1 * p_2
    scale = 1.0 / (b_2 * (b_1 * (e - 1.0) - f * b_2))
    L_1 = -scale * b_2 * (1.0 - total + product)
    L_2 = scale * (b_1 * (e * e - total * e + product) - b_2 * f * (1.0 + e - total))
    design.feedback[0] = L_1 / k
    design.feedback[1] = L_2 / k
    for j in range(2, plain):
        gain = config.delay_gain[j - 2]
        design.feedback[j] = L_1 * gain.way + L_2 * gain.speed


@compiled
def friction_of_others(frame: Frame, contacts: Records[Contact], which: int) -> float:
    """
    Return what the friction of the other contacts adds to the force of contact i, per mu [N].

    The robot drags each surface along its sliding velocity v: sum_j alpha_j v_j . n_i / |v_j|.
    """
    normal, twist = contacts[which].normal, frame.twist
    total = 0.0
    for j in range(contacts.shape[0]):
        other = contacts[j]
        if j == which or other.config.kind != FORCE or other.alpha_meas <= 0.0:
            continue
        lever = rotate_vector(frame.rotation, other.config.point)
        velocity = (
            twist[0] + twist[4] * lever[2] - twist[5] * lever[1],
            twist[1] + twist[5] * lever[0] - twist[3] * lever[2],
            twist[2] + twist[3] * lever[1] - twist[4] * lever[0],
        )
        sliding = component_across(velocity, other.normal)
        total += (
            other.alpha_meas
            * dot(sliding, normal)
            / np.sqrt(dot(sliding, sliding) + FULL_FRICTION_SPEED * FULL_FRICTION_SPEED)
        )
    return total


@compiled
def estimate_stiffness(
    stiffness: Stiffness,
    alpha: float,
    alpha_des: float,
    speed: float,
    friction: float,
    space: FitSpace,
) -> None:
    """
    Take a sample into the estimate of a stiffness, whatever law moves the contact.

    The filters begin anew when a force is felt: before, the surface is not there. Measured and
    desired force [N], speed of the contact point INTO the surface [m/s], `friction_of_others` [N];
    `space` is a record of `FIT_SPACE`.
    """
    slow, fast = stiffness.slow, stiffness.fast
    h = stiffness.config.period
    stiffness.since += h
    if abs(alpha_des - stiffness.alpha_des) > COMMAND_STEP:
        stiffness.since = 0.0
    stiffness.alpha_des = alpha_des
    if not stiffness.felt:
        if alpha <= FELT_FROM:
            return
        for fit in (slow, fast):
            settle_band_pass(fit.way, 0.0)
            settle_band_pass(fit.rate, 0.0)
            settle_band_pass(fit.friction, 0.0)
            settle_band_pass(fit.force, alpha)
        stiffness.since = 0.0
        stiffness.depth = 0.0
        stiffness.felt = True
    else:
        stiffness.depth += 0.5 * h * (speed + stiffness.speed)
        stiffness.felt = alpha > FELT_ABOVE
    stiffness.speed = speed
    lately = stiffness.felt and stiffness.since <= ACCEPTED_TIME
    add_fit_sample(stiffness, slow, friction, alpha, lately, space)
    add_fit_sample(stiffness, fast, friction, alpha, stiffness.felt, space)
    if slow.k > 0.0 and slow.share > SLOW_SHARE:
        stiffness.k_est = slow.k
        stiffness.k_std = slow.k_std


@compiled
def follow_stiffness(
    laws: Records[AdaptiveLaw],
    contacts: Records[Contact],
    which: int,
    control: Control,
    speed: float,
    space: FitSpace,
) -> None:
    """
    Take a sample into the model of a contact's surface, which follows at a bounded rate.

    That of a couple follows the normal force of its contact. Of records of `FORCE_LAW` and
    `CONTACT`, shape (r,), those of number `which` are changed; `control` is a record of `CONTROL`,
    the speed of the contact point is that INTO the surface [m/s], `space` a record of `FIT_SPACE`.
    """
    contact = contacts[which]
    observer = laws[which].observer
    stiffness = laws[which].stiffness
    config = stiffness.config
    if contact.config.kind != FORCE:
        leader = contacts[contact.config.leader]
        whole = laws[contact.config.leader].stiffness
        share = config.share
        k = min(max(share * whole.k, config.lowest), config.highest)
        if k != stiffness.k:
            use_model_stiffness(observer, stiffness, k, share * whole.c)
        contact.stiffness = k
        contact.stiffness_est = share * leader.stiffness_est
        contact.stiffness_std = share * leader.stiffness_std
        contact.ratio_bound, contact.margin = leader.ratio_bound, leader.margin
        return
    alpha = contact.alpha_meas
    if not control.measured:
        alpha = contact.answer.alpha_est
    estimate_stiffness(
        stiffness,
        alpha,
        contact.answer.alpha_des,
        speed,
        friction_of_others(control.frame, contacts, which),
        space,
    )
    slow = stiffness.slow
    fast = stiffness.fast
    h = config.period
    k = stiffness.k
    c = stiffness.c
    target = k
    if slow.k > 0.0 and slow.share > SLOW_SHARE:
        target = slow.k + 2.0 * slow.k_std
        damping = min(max(slow.c, 0.0), LARGEST_DAMPING)
        c += h / DAMPING_TIME * (damping - c)
    # Against what the slow fit says, and not against k in use, which it would drive up and down.
    if fast.share > FAST_SHARE and fast.k - fast.k_std > FAST_EXCESS * target:
        target = fast.k
    target = min(max(target, config.lowest), config.highest)
    # A model changes once a period: e times its value in less would be a jump.
    largest_fall = min(h / FALL_TIME, 1.0)
    largest_rise = min(h / RISE_TIME, 1.0)
    change = min(max(np.log(target / k), -largest_fall), largest_rise)
    if change != 0.0 or c != stiffness.c:
        use_model_stiffness(observer, stiffness, k * np.exp(change), c)
    contact.stiffness = stiffness.k
    contact.stiffness_est = stiffness.k_est
    contact.stiffness_std = stiffness.k_std
    contact.ratio_bound = 0.0  # as long as nothing is known
    contact.margin = 0.0
    if stiffness.k_est > 0.0:
        contact.ratio_bound = (stiffness.k_est + 2.0 * stiffness.k_std) / stiffness.k
        contact.margin = interpolate_ratio_limit(stiffness) / contact.ratio_bound


@compiled
def interpolate_ratio_limit(stiffness: Stiffness) -> float:
    """Return k over that of the model in use at which its loop is stable, from the curve of it."""
    config = stiffness.config
    last = LIMITS - 1
    limits = config.ratio_limit
    place = np.log(stiffness.k / config.lowest) / np.log(config.highest / config.lowest)
    step = 1.0 / last
    before = 0
    while before < last and (before + 1) * step <= place:
        before += 1
    if before == last or place <= 0.0:
        return limits[before]
    slope = (limits[before + 1] - limits[before]) / (
        (before + 1) * step - before * step
    )
    return slope * (place - before * step) + limits[before]
