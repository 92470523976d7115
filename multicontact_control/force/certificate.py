"""
Certificates: a force loop stays exponentially stable however R changes within its rate.

V(x, R) = x^T P(R) x with P linear in ln R between nodes. It is found by semidefinite programming
(Clarabel), on few nodes, gains and plants, and then proved for all of them: a solver's tolerance
proves nothing. docs/certificate.md has the mathematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.force.enclosures import (
    are_positive_definite,
    SMALLEST,
    UNIT,
)
from multicontact_control.force.gain_tube import GainTube
from multicontact_control.force.loop_family import LoopFamily
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

NODES = 13  # of ln R, between which P is linear
CLUSTERING = 0.7  # of the nodes, 0 for equal steps
LEADING = 2  # directions of a gain's ellipsoid that the program sees
WEIGHTS = np.geomspace(1.001, 1e6, 60)  # of a multiplier, over its smallest
DECAYS = (0.9, 0.7, 0.5, 0.25, 0.1, 0.03)  # shares of what seems possible
SCALING_ROUNDS = 4


@dataclass(frozen=True)
class Certificate:
    """V(x, R) = x^T P(R) x falls to `contraction` of its value, or below, in every period."""

    nodes: Vector  # ln R, shape (m,)
    P: Matrix  # at the nodes, shape (m, s, s)
    contraction: float  # rho^2 < 1

    def matrix_at(self, log_R: float) -> Matrix:
        """Return P(R), shape (s, s), by ln R within the nodes."""
        if len(self.nodes) == 1:
            constant: Matrix = self.P[0]
            return constant
        i = int(np.searchsorted(self.nodes[1:-1], log_R, side='right'))
        width = self.nodes[i + 1] - self.nodes[i]
        share = (log_R - self.nodes[i]) / width
        between: Matrix = (1.0 - share) * self.P[i] + share * self.P[i + 1]
        return between

    def decay_rate(self, period: float) -> float:
        """Return the rate at which the state decays at least, -ln(rho) / h [1/s]."""
        return -math.log(self.contraction) / (2.0 * period)


@dataclass(frozen=True)
class GainScheduledLoop:
    """x_(k+1) = (A + N K c^T) x_k, with [A, N] of a family and K of a tube."""

    family: LoopFamily
    tube: GainTube

    @cached_property
    def nominal(self) -> Matrix:
        """Return one [A, N] in the middle of the family, shape (s, s + n)."""
        middle: Matrix = self.family.vertices.mean(axis=0)
        return middle

    def jumps(self) -> bool:
        """Whether R may go from anywhere to anywhere in one period."""
        return len(self.tube.centres) == 1

    def close(self, vertices: Matrix, gain: Vector) -> Matrix:
        """Return A + N K c^T of stacked [A, N]."""
        s = self.family.states
        by_gain = vertices[..., s:] @ gain
        closed: Matrix = vertices[..., :s] + by_gain[..., None] * self.family.innovation
        return closed

    def choose_nodes(self) -> Vector:
        """Return intervals of the tube, by the number of their first edge, that P bends at."""
        if self.jumps():
            return np.zeros(1, dtype=int)
        count = min(NODES, len(self.tube.edges))
        # Closer at the ends, where gains change most from one interval to the next.
        share = np.linspace(0.0, 1.0, count)
        clustered = 0.5 - 0.5 * np.cos(math.pi * share)
        places = (1.0 - CLUSTERING) * share + CLUSTERING * clustered
        return np.unique(np.round(len(self.tube.centres) * places).astype(int))


def find_certificate(loop: GainScheduledLoop) -> Certificate | None:
    """
    Return a proved certificate, or None if none was found.

    None does not say that the loop is unstable.

    Raises
    ------
    ConfigError
        If Clarabel is not installed.

    """
    require_solver()
    if not _is_stable_at_rest(loop):
        return None
    nodes = loop.choose_nodes()
    P = _search(loop, nodes)
    if P is None:
        return None
    slopes = _list_moves(loop.tube, nodes, P)
    multipliers, possible = _choose_multipliers(loop, slopes)
    if possible <= 0.0:
        return None
    for share in DECAYS:
        contraction = 1.0 - share * possible
        if _is_proved(loop, slopes, multipliers, contraction):
            return Certificate(loop.tube.edges[nodes], P, contraction)
    return None


def require_solver() -> None:
    """Raise ConfigError, with what to install, where there is no Clarabel."""
    if find_spec('clarabel') is None:
        raise ConfigError(
            'certify',
            'the package clarabel',
            'none',
            hint="pip install 'multicontact_control[certify]'",
        )


def _is_stable_at_rest(loop: GainScheduledLoop) -> bool:
    """Return whether the middle gains, held, make every plant of the family stable."""
    for gain in loop.tube.centres[:: max(len(loop.tube.centres) // 8, 1)]:
        closed = loop.close(loop.family.vertices, gain)
        if np.abs(np.linalg.eigvals(closed)).max() >= 1.0:
            return False
    return True


@dataclass(frozen=True)
class _Move:
    """P before and after one period, of gains of one interval of the tube."""

    interval: int
    before: Matrix
    after: Matrix
    size: Matrix  # of the numbers that both were made of, entry by entry


def _list_moves(tube: GainTube, nodes: Vector, P: Matrix) -> list[_Move]:
    """
    Return what P can do in a period: with these moves every other one is proved.

    R in an interval may go up or down by one step. The inequality is affine in P before and in P
    after, so the ends of the interval and the longest moves are enough. Where a move passes a node
    it is a mean of one that goes on with the slope it begins with, and one that has the next slope
    from the beginning.
    """
    moves = []
    if len(nodes) == 1:
        return [_Move(0, P[0], P[0], np.abs(P[0]))]
    widths = np.diff(tube.edges[nodes])
    slopes = np.diff(P, axis=0) / widths[:, None, None]
    for interval in range(len(tube.centres)):
        i = int(np.searchsorted(nodes[1:-1], interval, side='right'))
        directions = [slopes[i], -slopes[i]]
        if interval + 1 == nodes[i + 1] and i + 1 < len(slopes):
            directions.append(slopes[i + 1])
        if interval == nodes[i] and i > 0:
            directions.append(-slopes[i - 1])
        size = np.abs(P[max(i - 1, 0) : i + 3]).sum(axis=0)
        for end in (interval, interval + 1):
            before = P[i] + (tube.edges[end] - tube.edges[nodes[i]]) * slopes[i]
            for direction in directions:
                after = before + tube.step * direction
                moves.append(_Move(interval, before, after, size))
    return moves


def _choose_multipliers(
    loop: GainScheduledLoop, moves: list[_Move]
) -> tuple[Vector, float]:
    """
    Return a multiplier for every move, and by which share V seems to fall at least.

    By the eigenvalues of the nominal plant alone; nothing is proved by them.
    """
    s = loop.family.states
    nominal = loop.nominal
    best = []
    falls = []
    for move in moves:
        A = loop.close(nominal, loop.tube.centres[move.interval])
        H = nominal[:, s:] @ loop.tube.shapes[move.interval]
        root = np.linalg.cholesky(move.before)
        Y = H.T @ move.after @ H
        largest = np.linalg.eigvalsh(Y)[-1]
        X = np.linalg.solve(root, A.T @ move.after @ H)
        normed = np.linalg.solve(root, A.T)
        left = np.eye(s) - normed @ move.after @ normed.T
        c = np.linalg.solve(root, loop.family.innovation)
        multipliers = largest * WEIGHTS[:, None, None]
        inner = np.linalg.inv(multipliers * np.eye(len(Y)) - Y)
        rest = left - multipliers * np.outer(c, c) - X @ inner @ X.T
        fall = np.linalg.eigvalsh(rest)[:, 0]
        best.append(largest * WEIGHTS[fall.argmax()])
        falls.append(fall.max())
    return np.array(best), float(min(falls))


def _is_proved(
    loop: GainScheduledLoop,
    moves: list[_Move],
    multipliers: Vector,
    contraction: float,
) -> bool:
    """
    Prove that V falls to `contraction` of itself in every move, on every plant, by every gain.

    With K = K_c + M eta, |eta| <= 1, it does if a multiplier lambda makes positive definite
    diag(rho^2 P - lambda c c^T, lambda 1) - [A, N M]^T P' [A, N M], A = A_0 + N K_c c^T
    (S-procedure). It is concave in [A, N], so the vertices of the family are enough. Bounds
    of all roundings and the radius of the family are taken off.
    """
    family = loop.family
    s = family.states
    c = family.innovation
    for interval in range(len(loop.tube.centres)):
        gain, shape = loop.tube.centres[interval], loop.tube.shapes[interval]
        # [A, N M] = [A, N] times these; its radius by the radius of [A, N], and by rounding.
        n = len(gain)
        transform = np.eye(s + n)
        transform[s:, :s] = np.outer(gain, c)
        transform[s:, s:] = shape
        spread = np.abs(transform)
        F = family.vertices @ transform
        off = family.radius @ spread
        off = off + 8.0 * (s + n) * UNIT * (np.abs(family.vertices) @ spread)
        F_size = np.abs(F) + off
        for move, multiplier in zip(moves, multipliers):
            if move.interval != interval:
                continue
            after_size = 3.0 * move.size
            rest = -np.swapaxes(F, -1, -2) @ move.after @ F
            rest[:, :s, :s] += contraction * move.before
            rest[:, :s, :s] -= multiplier * np.outer(c, c)
            rest[:, s:, s:] += multiplier * np.eye(n)
            bent = np.swapaxes(F_size, -1, -2) @ (np.abs(move.after) @ off)
            whole = np.swapaxes(F_size, -1, -2) @ (after_size @ F_size)
            whole[:, :s, :s] += after_size
            radius = 1.01 * (bent + np.swapaxes(bent, -1, -2))
            radius += 32.0 * (s + n) * UNIT * whole + SMALLEST
            places = np.arange(s)
            radius[:, places, places] += 8.0 * UNIT * multiplier * np.abs(c)
            if not are_positive_definite(rest, radius).all():
                return False
            rounding = 16.0 * UNIT * after_size
            if not are_positive_definite(move.before, rounding):
                return False
    return True


def _search(loop: GainScheduledLoop, nodes: Vector) -> Matrix | None:
    """
    Return P at the nodes, shape (m, s, s), from a semidefinite program, or None.

    Minimised is the sum of traces of P, in coordinates in which a P for R at rest is 1, with the
    inequalities of `_is_proved` at the nodes >= 1 for rho = 1: for moves towards the neighbouring
    nodes, for the corners of the family, and for the leading directions of the gains.
    """
    import clarabel
    from scipy import sparse

    program = _Program(loop, nodes)
    coefficients, constants = program.inequalities()
    cost = np.zeros(program.variables)
    cost[: program.of_P] = np.tile(to_vector(np.eye(program.s)), len(nodes))
    cost /= 100.0 * program.of_P
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 35
    settings.max_threads = 1
    settings.tol_gap_rel = settings.tol_gap_abs = 1e-2
    settings.tol_feas = 1e-5
    no_square = sparse.csc_matrix((program.variables, program.variables))
    cones = [clarabel.PSDTriangleConeT(program.q)] * len(program.constraints)
    solver = clarabel.DefaultSolver(
        no_square, cost, coefficients, constants, cones, settings
    )
    solution = solver.solve()
    if str(solution.status) in ('PrimalInfeasible', 'DualInfeasible'):
        return None
    vectors = np.array(solution.x[: program.of_P]).reshape(len(nodes), -1)
    P = program.back.T @ to_matrix(vectors, program.s) @ program.back
    P = 0.5 * (P + np.swapaxes(P, -1, -2))
    if not np.isfinite(P).all() or np.linalg.eigvalsh(P).min() <= 0.0:
        return None
    found: Matrix = P
    return found


@dataclass(frozen=True)
class _Constraint:
    """One inequality of the program."""

    node: int
    other: int  # node towards which R moves
    share: float  # of the difference of P between them
    F: Matrix  # [A, leading directions of N M], in the coordinates of the program
    innovation: Vector  # c


class _Program:
    """The semidefinite program of `_search` as matrices."""

    def __init__(self, loop: GainScheduledLoop, nodes: Vector) -> None:
        tube = loop.tube
        self.s = s = loop.family.states
        self.q = s + min(LEADING, tube.centres.shape[-1])
        self.nodes = nodes
        self.back = back = _coordinates(loop, nodes)
        self.of_P = len(nodes) * s * (s + 1) // 2
        forth = np.linalg.inv(back)
        self.constraints: list[_Constraint] = []
        for node, edge in enumerate(nodes):
            interval = min(edge, len(tube.centres) - 1)
            for vertex in loop.family.vertices[loop.family.corners]:
                A = back @ loop.close(vertex, tube.centres[interval]) @ forth
                H = back @ vertex[:, s:] @ tube.shapes[interval]
                vectors, values, _ = np.linalg.svd(H, full_matrices=False)
                leading = vectors[:, : self.q - s] * values[: self.q - s]
                c = loop.family.innovation @ forth
                # Both of one size.
                balance = math.sqrt(np.linalg.norm(c) / max(values[0], 1e-300))
                F = np.hstack([A, leading * balance])
                for other, share in self._list_neighbours(tube, node):
                    self.constraints.append(
                        _Constraint(node, other, share, F, c / balance)
                    )
        self.variables = self.of_P + len(self.constraints)

    def _list_neighbours(self, tube: GainTube, node: int) -> list[tuple[int, float]]:
        """Return the nodes that R moves to or from, and by which share of the way."""
        if len(self.nodes) == 1:
            return [(0, 0.0)]
        positions = tube.edges[self.nodes]
        neighbours = []
        for other in (node - 1, node + 1):
            if 0 <= other < len(positions):
                share = tube.step / abs(positions[other] - positions[node])
                neighbours.append((other, share))
                if len(positions) - 1 in (node, other) or 0 in (node, other):
                    if node in (0, len(positions) - 1):
                        neighbours.append((other, -share))
        return neighbours

    def inequalities(self) -> tuple[Matrix, Vector]:
        """Return A and b of A x + slack = b, the slack of every constraint in the cone."""
        from scipy import sparse

        s, q = self.s, self.q
        size = q * (q + 1) // 2
        of_node = s * (s + 1) // 2
        before = congruence(np.eye(s, q)[None])[0]
        after = congruence(np.array([each.F for each in self.constraints]))
        target = np.zeros((q, q))
        target[:s, :s] = np.eye(s)
        rows, columns, values = [], [], []
        for number, constraint in enumerate(self.constraints):
            share = constraint.share
            multiplier = np.zeros((q, q))
            multiplier[:s, :s] = np.outer(constraint.innovation, constraint.innovation)
            multiplier[s:, s:] = -np.eye(q - s)
            blocks = [
                (constraint.node * of_node, (1.0 - share) * after[number] - before),
                (constraint.other * of_node, share * after[number]),
                (self.of_P + number, to_vector(multiplier)[:, None]),
            ]
            for column, block in blocks:
                at = np.nonzero(block)
                rows.append(at[0] + number * size)
                columns.append(at[1] + column)
                values.append(block[at])
        entries = (
            np.concatenate(values),
            (np.concatenate(rows), np.concatenate(columns)),
        )
        shape = (size * len(self.constraints), self.variables)
        constants = np.tile(-to_vector(target), len(self.constraints))
        return sparse.csc_matrix(entries, shape=shape), constants


def _coordinates(loop: GainScheduledLoop, nodes: Vector) -> Matrix:
    """Return Y of y = Y x in which a Lyapunov matrix of the middle node is 1, shape (s, s)."""
    middle = min(nodes[len(nodes) // 2], len(loop.tube.centres) - 1)
    A = loop.close(loop.nominal, loop.tube.centres[middle])
    scale = np.ones(len(A))
    for _ in range(SCALING_ROUNDS):
        scaled = A / scale[:, None] * scale
        P = solve_discrete_lyapunov(scaled.T, 0.01 * np.eye(len(A)))
        next_scale = scale / np.sqrt(np.diag(P))
        scale, of_scale = next_scale, scale
    coordinates: Matrix = np.linalg.cholesky(P).T / of_scale
    return coordinates


def _triangle(size: int) -> tuple[Vector, Vector, Vector]:
    """Return row and column of the upper triangle, column by column, and 1 or sqrt(2) there."""
    columns, rows = np.tril_indices(size)
    return rows, columns, np.where(rows == columns, 1.0, math.sqrt(2.0))


def to_vector(matrix: Matrix) -> Vector:
    """Return a symmetric matrix as a vector of equal norm, as Clarabel's cones have it."""
    rows, columns, weights = _triangle(matrix.shape[-1])
    vector: Vector = matrix[..., rows, columns] * weights
    return vector


def to_matrix(vector: Vector, size: int) -> Matrix:
    """Return the symmetric matrix of such a vector."""
    rows, columns, weights = _triangle(size)
    matrix = np.zeros((*vector.shape[:-1], size, size))
    matrix[..., rows, columns] = vector / weights
    matrix[..., columns, rows] = vector / weights
    return matrix


def congruence(F: Matrix) -> Matrix:
    """
    Return what turns P into F^T P F, both as vectors.

    F is a stack of shape (m, s, q), the answer of shape (m, q (q + 1) / 2, s (s + 1) / 2).
    """
    rows, columns, weights = _triangle(F.shape[1])
    first, second, out_weights = _triangle(F.shape[2])
    upper = F[:, rows][:, :, first] * F[:, columns][:, :, second]
    lower = F[:, columns][:, :, first] * F[:, rows][:, :, second]
    lower[:, rows == columns] = 0.0
    products = (upper + lower) * out_weights / weights[:, None]
    return np.swapaxes(products, -1, -2)
