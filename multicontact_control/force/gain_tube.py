"""
What gains an active observer can have while R changes at a bounded rate.

The covariance P_1 of the prediction follows P04 eqs 39-40,
P_1 -> Phi_n (P_1 - P_1 C^T C P_1 / (C P_1 C^T + R)) Phi_n^T + Q, which grows with P_1 and with R
in the order of positive semidefinite matrices. So no history of R that ends at some value leads
to a larger P_1 than the one that falls to it from the ceiling as fast as R may, and none to a
smaller one than the rise from the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.force.enclosures import are_positive_definite, product_error
from multicontact_control.force.observer import ObserverDesign, solve_steady_covariance
import numpy as np

INTERVAL = 0.08  # of ln R, of which gains are enclosed together
SLACK = 1e-4  # relative, of the bounds: what they are proved by, in spite of rounding


@dataclass(frozen=True)
class RateLimit:
    """Where R may be, and how fast it may change."""

    smallest: float  # [N^2]
    largest: float  # [N^2]
    slew_time: float  # in which R changes by a factor e at most [s]; 0 if it may jump

    def largest_step(self, period: float) -> float:
        """Return by how much ln R may change in a period."""
        whole = math.log(self.largest / self.smallest)
        if self.slew_time == 0.0:
            return whole
        return min(period / self.slew_time, whole)


@dataclass(frozen=True)
class GainTube:
    """
    Gains K in ellipsoids centre + shape * unit ball, one for each of m intervals of R.

    The edges of the intervals are equal steps of ln R apart.
    """

    edges: Vector  # ln R, shape (m + 1,), R in N^2
    step: float  # by which ln R changes in a period at most
    centres: Matrix  # shape (m, n)
    shapes: Matrix  # shape (m, n, n)


def enclose_gains(
    observer: ObserverDesign, limit: RateLimit, period: float
) -> GainTube:
    """
    Return ellipsoids that contain every gain that an observer can have, by R.

    They hold once the observer has forgotten its start: P_1 then lies within the bounds, which are
    1e-4 wider than what is reached.

    Raises
    ------
    ValueError
        If the bounds do not prove themselves, for an observer without process noise.

    """
    step = limit.largest_step(period)
    whole = math.log(limit.largest / limit.smallest)
    # An interval is of several steps where they are short; a step is no longer than its own.
    steps = max(round(INTERVAL / step), 1)
    intervals = math.floor(whole / (steps * step) + 1e-9)
    count = max(intervals, 1) * steps
    R = np.geomspace(limit.smallest, limit.largest, count + 1)
    lowest, highest = bound_covariances(observer, R)
    centres, shapes = _enclose(lowest[:-steps:steps], highest[steps::steps], R[::steps])
    return GainTube(np.log(R[::steps]), step, centres, shapes)


def bound_covariances(observer: ObserverDesign, R: Vector) -> tuple[Matrix, Matrix]:
    """
    Return a lower and an upper bound of P_1 when it meets an R, at edges a period's change apart.

    L_j is a bound where R >= r_j, and U_j where R <= r_j; each of shape (m + 1, n, n). R of the
    period before was r_(j-1) at least, or r_(j+1) at most: proved is F(L_(j-1), r_(j-1)) > L_j and
    F(U_(j+1), r_(j+1)) < U_j, where F is one step of the recursion; by induction all that can be
    reached lies between.
    """
    lowest = [solve_steady_covariance(observer, R[0])]
    for before in R[:-1]:
        lowest.append(predict_covariance(observer, lowest[-1], before))
    highest = [solve_steady_covariance(observer, R[-1])]
    for before in R[:0:-1]:
        highest.append(predict_covariance(observer, highest[-1], before))
    L = (1.0 - SLACK) * np.array(lowest)
    U = (1.0 + SLACK) * np.array(highest[::-1])
    lower_R, higher_R = np.append(R[0], R[:-1]), np.append(R[1:], R[-1])
    from_below = np.concatenate([L[:1], L[:-1]])
    from_above = np.concatenate([U[1:], U[-1:]])
    _prove(observer, from_below, lower_R, L, 1.0)
    _prove(observer, from_above, higher_R, U, -1.0)
    return L, U


def predict_covariance(
    observer: ObserverDesign, P_1: Matrix, R: float | Vector
) -> Matrix:
    """Return the next P_1 after a correction with R (P04 eqs 39-40), shape (..., n, n)."""
    column = P_1[..., :, :1]
    variance = P_1[..., :1, :1] + np.asarray(R)[..., None, None]
    corrected = P_1 - column @ np.swapaxes(column, -1, -2) / variance
    predicted = observer.Phi_n @ corrected @ observer.Phi_n.T + np.diag(observer.Q)
    result: Matrix = 0.5 * (predicted + np.swapaxes(predicted, -1, -2))
    return result


def _prove(
    observer: ObserverDesign, P_1: Matrix, R: Vector, bound: Matrix, sign: float
) -> None:
    """Prove that a step of the recursion leaves its bound on the inner side."""
    Phi = observer.Phi_n
    difference = sign * (predict_covariance(observer, P_1, R) - bound)
    # Two products follow a subtraction: the magnitudes of P_1 carry its rounding along.
    size = np.abs(Phi) @ np.abs(P_1)
    radius = 4.0 * product_error(size, np.abs(Phi.T)) + 1e-15 * np.abs(bound)
    if not are_positive_definite(difference, radius).all():
        raise ValueError('the bounds of the covariance do not prove themselves')


def _enclose(L: Matrix, U: Matrix, R: Vector) -> tuple[Matrix, Matrix]:
    """
    Return ellipsoids of the gains of L <= P_1 <= U and R within an interval.

    P_1 e_1 = L e_1 + W e_1 / 2 + sqrt(W_11) / 2 W^(1/2) eta with |eta| <= 1, W = U - L. Of
    K = P_1 e_1 / (e_1^T P_1 e_1 + R) the centre K_c is that of the middle of P_1 and R; what is
    left, ((1 - K_c e_1^T) dp - K_c dR) / (p_1 + R), is linear but for its denominator, whose
    smallest value is taken.
    """
    n = L.shape[-1]
    centres, shapes = [], []
    for lower, upper, low, high in zip(L, U, R[:-1], R[1:]):
        W = upper - lower
        root = _widened_root(W)
        p = 0.5 * (lower + upper)[:, 0]
        ways = 0.5 * math.sqrt(max(W[0, 0], 0.0)) * root
        total = p[0] + 0.5 * (low + high)
        smallest = total - float(np.linalg.norm(ways[0])) - 0.5 * (high - low)
        centre = p / total
        one = np.eye(n)
        by_covariance = (one - np.outer(centre, one[0])) @ ways / smallest
        by_noise = centre * 0.5 * (high - low) / smallest
        shapes.append(_sum_ellipsoids(by_covariance, by_noise))
        centres.append(centre)
    return np.array(centres), np.array(shapes)


def _sum_ellipsoids(shape: Matrix, way: Vector) -> Matrix:
    """Return an ellipsoid around the sum of one and a segment from -way to way."""
    size = float(np.linalg.norm(shape))
    length = float(np.linalg.norm(way))
    if size == 0.0:
        ratio = 1.0
    else:
        ratio = length / size
    gram = (1.0 + ratio) * (shape @ shape.T)
    if length:
        gram += (1.0 + 1.0 / max(ratio, 1e-12)) * np.outer(way, way)
    return _widened_root(gram)


def _widened_root(gram: Matrix) -> Matrix:
    """
    Return X with X X^T > gram, a positive semidefinite matrix, by more than any rounding.

    Equilibrated by powers of 2 its entries are of one size, and known to some 1e-15 of it.
    """
    diagonal = np.maximum(np.einsum('ii->i', gram), np.finfo(float).tiny)
    scale = 2.0 ** np.round(0.5 * np.log2(diagonal))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    widened = np.sqrt((1.0 + 1e-6) * np.maximum(values, 0.0) + 1e-12)
    root: Matrix = scale[:, None] * vectors * widened
    return root
