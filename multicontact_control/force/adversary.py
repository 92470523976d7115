"""Courses of R that try to make a force loop diverge, within the rate at which R may change."""

from __future__ import annotations

from dataclasses import dataclass
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.force.certificate import Certificate
from multicontact_control.force.gain_tube import predict_covariance, RateLimit
from multicontact_control.force.observer import ObserverDesign, solve_steady_covariance
import numpy as np
from numpy.random import Generator

STARTS = (
    12  # values of R that runs start from, with the covariance that belongs to them
)
LONGEST_HOLD = 200  # periods, of random courses
SLOWEST_SWITCH = 1000  # periods, of periodic ones


@dataclass(frozen=True)
class AttackedLoops:
    """
    Loops under attack, b of them with s states: x_(k+1) = (A + N K c^T) x_k.

    Runs are divided among four adversaries: one lets R go where the value of x grows most, seen
    one period ahead; one does so for R of the opposite course every other time, at random; one
    drives R up and down at its full rate, with a period of its own; one goes to random values.
    """

    matrices: Matrix  # [A, N], shape (b, s, s + n)
    innovation: Vector  # c, shape (s,)
    observer: ObserverDesign
    limit: RateLimit
    period: float  # h [s]


@dataclass(frozen=True)
class Attack:
    """What came of an attack on b loops."""

    worst_ratio: Vector  # largest V(x_(k+1), R_(k+1)) / V(x_k, R_k) met, shape (b,)
    growth: Vector  # of the norm from start to end, as a logarithm, shape (b,)
    late_growth: Vector  # from the middle to the end


class _Value:
    """V of a certificate, for many states at once."""

    def __init__(self, nodes: Vector, P: Matrix) -> None:
        self.nodes = nodes
        self.P = P

    def __call__(self, x: Matrix, log_R: Vector) -> Vector:
        """Return x^T P(R) x, shape (b,)."""
        at_nodes = np.einsum('bi,mij,bj->mb', x, self.P, x, optimize=True)
        if len(self.nodes) == 1:
            constant: Vector = at_nodes[0]
            return constant
        i = np.searchsorted(self.nodes[1:-1], log_R, side='right')
        share = (log_R - self.nodes[i]) / (self.nodes[i + 1] - self.nodes[i])
        which = np.arange(len(x))
        value: Vector = (1.0 - share) * at_nodes[i, which] + share * at_nodes[
            i + 1, which
        ]
        return value


def attack(
    loops: AttackedLoops,
    certificate: Certificate,
    ticks: int,
    rng: Generator,
) -> Attack:
    """
    Attack every loop once, from a random state, R and adversary.

    A certificate that was made for another loop serves as a measure, too: only what `worst_ratio`
    is to be below then is unknown. The norm is that of the certificate's middle P.

    Parameters
    ----------
    loops
        What is attacked.
    certificate
        V, whose fall in every period is measured.
    ticks
        Periods of a run.
    rng
        Of starts and courses.

    """
    count, s = loops.matrices.shape[:2]
    low, high = math.log(loops.limit.smallest), math.log(loops.limit.largest)
    step = loops.limit.largest_step(loops.period)
    value = _Value(certificate.nodes, certificate.P)
    middle = certificate.P[len(certificate.P) // 2]
    starts = np.linspace(low, high, STARTS)
    chosen = rng.integers(STARTS, size=count)
    covariances = [
        solve_steady_covariance(loops.observer, math.exp(start)) for start in starts
    ]
    P_1 = np.array(covariances)[chosen]
    log_R: Vector = np.array(starts[chosen], dtype=float)
    random = rng.standard_normal((s, count))
    x = np.asarray(np.linalg.solve(np.linalg.cholesky(middle).T, random).T, dtype=float)
    course = _Courses(count, low, high, step, rng)
    x /= _norm(x, middle)[:, None]
    worst = np.zeros(count)
    log_norm = np.zeros(count)
    half = np.zeros(count)
    V = value(x, log_R)
    for tick in range(ticks):
        x_next = _step(loops, x, P_1, np.exp(log_R))
        P_1 = predict_covariance(loops.observer, P_1, np.exp(log_R))
        log_R = course.follow(loops, x_next, P_1, log_R, value)
        V_next = value(x_next, log_R)
        np.maximum(worst, V_next / V, out=worst)
        size = _norm(x_next, middle)
        log_norm += np.log(size)
        # Of one size again: the loop is linear.
        x = x_next / size[:, None]
        V = V_next / size**2
        if tick == ticks // 2:
            half = log_norm.copy()
    return Attack(worst, log_norm, log_norm - half)


def _norm(x: Matrix, P: Matrix) -> Vector:
    """Return the root of x^T P x, shape (b,)."""
    norm: Vector = np.sqrt(np.einsum('bi,ij,bj->b', x, P, x, optimize=True))
    return norm


def _step(loops: AttackedLoops, x: Matrix, P_1: Matrix, R: Vector) -> Matrix:
    """Return the states one period later, shape (b, s)."""
    s = x.shape[1]
    gain = P_1[:, :, 0] / (P_1[:, 0, 0] + R)[:, None]
    extended = np.hstack([x, gain * (x @ loops.innovation)[:, None]])
    moved: Matrix = np.einsum(
        'bij,bj->bi', loops.matrices[:, :, : s + gain.shape[1]], extended
    )
    return moved


class _Courses:
    """Where R goes in each run; ln R changes by a step at most, within its bounds."""

    def __init__(
        self, count: int, low: float, high: float, step: float, rng: Generator
    ) -> None:
        self.rng = rng
        self.low, self.high, self.step = low, high, step
        self.kind = np.arange(count) % 4
        self.greedy = np.flatnonzero(self.kind < 2)
        self.half_period = rng.integers(1, SLOWEST_SWITCH, size=count)
        self.target = rng.uniform(low, high, size=count)
        self.until = np.zeros(count, dtype=int)
        self.tick = 0

    def follow(
        self,
        loops: AttackedLoops,
        x: Matrix,
        P_1: Matrix,
        log_R: Vector,
        value: _Value,
    ) -> Vector:
        """Return ln R of the next period."""
        self.tick += 1
        due = self.until <= self.tick
        self.target[due] = self.rng.uniform(self.low, self.high, size=due.sum())
        self.until[due] = self.tick + self.rng.integers(1, LONGEST_HOLD, size=due.sum())
        rising = (self.tick // self.half_period) % 2 == 0
        periodic = np.where(rising, self.high, self.low)
        target = np.where(self.kind == 2, periodic, self.target)
        target[self.greedy] = self._worst_targets(loops, x, P_1, log_R, value)
        moved = np.clip(target, log_R - self.step, log_R + self.step)
        bounded: Vector = np.clip(moved, self.low, self.high)
        return bounded

    def _worst_targets(
        self,
        loops: AttackedLoops,
        x: Matrix,
        P_1: Matrix,
        log_R: Vector,
        value: _Value,
    ) -> Vector:
        """Return where V of the state after next is largest, for runs with a greedy adversary."""
        rows = self.greedy
        some = AttackedLoops(
            loops.matrices[rows],
            loops.innovation,
            loops.observer,
            loops.limit,
            loops.period,
        )
        candidates = []
        values = []
        for move in (-self.step, 0.0, self.step):
            R = np.clip(log_R[rows] + move, self.low, self.high)
            candidates.append(R)
            values.append(value(_step(some, x[rows], P_1[rows], np.exp(R)), R))
        worst = np.argmax(values, axis=0)
        chosen: Vector = np.array(candidates)[worst, np.arange(len(rows))]
        # The second adversary goes elsewhere now and then, where greed may miss a swing.
        stray = (self.kind[rows] == 1) & (self.rng.random(len(rows)) < 0.2)
        return np.where(stray, self.target[rows], chosen)
