"""
Least squares with a memory, of band-passed samples of a contact: k, c and mu of its surface.

On the surface alpha = k z + c dz/dt; the wrist sensor reads with it the inertia m d^2z/dt^2 of the
tool, and mu times the friction w of the other contacts, which this one's motion drags over their
surfaces; z is the way of the contact point into the surface, from the encoders. All of these pass
the same band-pass filter, and k, c and mu are fitted to what comes out by least squares with a
memory that counts accepted samples.
"""

from __future__ import annotations

import math
from typing import Any

from multicontact_control.algebra import cholesky, solve_cholesky
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np

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
def begin_fit(fit: Any, alpha: float) -> None:
    """Let the filters of a fit start at a touch, at a force [N]; its sums stay."""
    for i in range(4):
        for j in range(4):
            fit.stages[i, j] = 0.0
    fit.stages[3, 0] = alpha
    fit.speed = 0.0


@compiled
def filter_sample(fit: Any, sample: Vector, filtered: Vector) -> None:
    """Pass the four signals of a sample through the band-pass of a record of `STIFFNESS_FIT`."""
    for i in range(4):
        stages = fit.stages[i]
        stages[0] += fit.high * (sample[i] - stages[0])
        entering = sample[i] - stages[0]
        for j in range(1, 4):
            stages[j] += fit.low * (entering - stages[j])
            entering = stages[j]
        filtered[i] = entering


@compiled
def take_sample(
    fit: Any, sample: Vector, period: float, mass: float, accepted: bool,
) -> None:
    """
    Filter a sample, and if it is accepted and large enough, fit k, c and mu anew.

    Parameters
    ----------
    fit
        Record of `STIFFNESS_FIT`, changed.
    sample
        Way into the surface [m], its rate [m/s], the friction of the other contacts per mu [N]
        and the measured force [N], shape (4,).
    period, mass
        h [s], and mass of the tool [kg].
    accepted
        Whether the sample may count.

    """
    filtered = np.empty(4)
    filter_sample(fit, sample, filtered)
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

    A mu beyond 0 to 1 is set there, and the rest is fitted again.
    """
    fixed = np.zeros(3, np.bool_)
    value, variance = np.zeros(3), np.zeros(3)
    for _ in range(2):
        if not least_squares(fit.sums, fixed, value, variance):
            return
        bounded = min(max(value[2], 0.0), LARGEST_FRICTION)
        if bounded == value[2]:
            break
        value[2] = bounded
        fixed[2] = True
    left = fit.sums[3, 3]
    for i in range(3):
        left -= 2.0 * value[i] * fit.sums[i, 3]
        for j in range(3):
            left += value[i] * value[j] * fit.sums[min(i, j), max(i, j)]
    left = max(left, 0.0)
    fit.k, fit.c, fit.mu = value[0], value[1], value[2]
    fit.share = 1.0 - left / fit.sums[3, 3]
    fit.k_std = np.sqrt(CORRELATION * variance[0] * max(
        left / fit.weight, SMALLEST_RESIDUAL * SMALLEST_RESIDUAL))


@compiled
def least_squares(sums: Matrix, fixed: Mask, value: Vector, variance: Vector) -> bool:
    """
    Solve the normal equations of three parameters, shape (3,), of which some are fixed.

    `sums` are those of the products of three regressors and of what they explain, shape (4, 4),
    upper triangle. Of `variance` the first is filled in, over that of a sample. False where the
    regressors do not tell the parameters apart.
    """
    normal, L = np.zeros((3, 3)), np.zeros((3, 3))
    solution, scale = np.zeros(3), np.ones(3)
    for i in range(3):
        variance[i] = 0.0
        if fixed[i]:
            normal[i, i] = 1.0
            continue
        if sums[i, i] <= 0.0:  # it never moved: nothing is known, and nothing explained by it
            if i == 0:
                return False
            normal[i, i] = 1.0
            continue
        scale[i] = 1.0 / np.sqrt(sums[i, i])
        solution[i] = sums[i, 3]
        for j in range(3):
            product = sums[min(i, j), max(i, j)]
            if fixed[j]:
                solution[i] -= product * value[j]
            elif j >= i:
                normal[i, j] = product
    for i in range(3):
        solution[i] *= scale[i]
        for j in range(i, 3):
            normal[i, j] *= scale[i] * scale[j]
    if not cholesky(normal, L, SMALLEST_PIVOT):
        return False
    variance[0] = 1.0
    solve_cholesky(L, solution)
    solve_cholesky(L, variance)
    variance[0] *= scale[0] * scale[0]
    for i in range(3):
        if not fixed[i]:
            value[i] = solution[i] * scale[i]
    return True
