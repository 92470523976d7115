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

from multicontact_control.arrays import Indices, Matrix, Vector
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
LEADING = 3  # directions of a gain's ellipsoid that the program sees
ROUNDS = 5  # of the search, each with the worst moves of the last
WANTED_SHARE = 0.03  # of the fall of V at rest, that is searched for
LARGEST_WANTED = 5e-4  # in a period
NEARBY = np.geomspace(
    0.1, 10.0, 21
)  # multipliers that are tried, over that of the program
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

    def choose_nodes(self) -> Indices:
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
    at_rest = _fall_at_rest(loop)
    if at_rest <= 0.0:
        return None
    wanted = min(LARGEST_WANTED, WANTED_SHARE * at_rest)
    nodes = loop.choose_nodes()
    moves = _list_moves(loop.tube, nodes)
    searched = [i for i, move in enumerate(moves) if move.leaves_node()]
    for _ in range(ROUNDS):
        some = [moves[i] for i in searched]
        found = _search(loop, nodes, some, wanted)
        if found is None:
            return None
        P, of_some = found
        first = _interpolate_multipliers(moves, some, of_some)
        multipliers, falls = _choose_multipliers(loop, P, moves, first)
        worst = _find_worst(moves, falls, 0.5 * wanted)
        left_out = [i for i in worst if i not in searched]
        if not left_out:
            break
        searched += left_out
    if falls.min() <= 0.0:
        return None
    for share in DECAYS:
        contraction = 1.0 - share * falls.min()
        if _is_proved(loop, P, moves, multipliers, contraction):
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


def _fall_at_rest(loop: GainScheduledLoop) -> float:
    """Return by which share V could fall with middle gains held, on any plant of the family."""
    radius = 0.0
    for gain in loop.tube.centres[:: max(len(loop.tube.centres) // 8, 1)]:
        closed = loop.close(loop.family.vertices, gain)
        radius = max(radius, float(np.abs(np.linalg.eigvals(closed)).max()))
    return 1.0 - radius**2


@dataclass(frozen=True)
class _Move:
    """P before and after one period, as shares of P at the nodes, by gains of one interval."""

    interval: int
    segment: int  # number of the node below the interval
    before: Vector  # shape (m,)
    after: Vector

    def leaves_node(self) -> bool:
        """Whether it begins at a node and ends between the two nodes of its gains."""
        inwards = self.after[self.segment : self.segment + 2].all()
        return bool(self.before.max() == 1.0 and inwards)


def _mix(count: int, segment: int, share: float) -> Vector:
    """Return the shares of `count` nodes at a share of the way through a segment."""
    shares = np.zeros(count)
    shares[segment] = 1.0 - share
    shares[segment + 1] = share
    return shares


def _list_moves(tube: GainTube, nodes: Indices) -> list[_Move]:
    """
    Return what P can do in a period: with these moves every other one is proved.

    R in an interval may go up or down by one step. The inequality is affine in P before, in P
    after and in the multiplier, so the ends of what P goes through on straight lines are enough.
    P after a move that passes a node lies between that of a move from the node and of one that
    ends there, and that of a shorter one between these and staying at the node. Nothing passes
    floor and ceiling.
    """
    m = len(nodes)
    if m == 1:
        return [_Move(0, 0, np.ones(1), np.ones(1))]
    widths = np.diff(tube.edges[nodes])
    steps = tube.step / widths
    moves = []
    for interval in range(len(tube.centres)):
        i = int(np.searchsorted(nodes[1:-1], interval, side='right'))
        edges = tube.edges[interval : interval + 2] - tube.edges[nodes[i]]
        low, high = edges / widths[i]
        at_low, at_high = _mix(m, i, low), _mix(m, i, high)
        pairs = [
            (at_low, _mix(m, i, low + steps[i])),
            (at_high, _mix(m, i, high - steps[i])),
        ]
        if interval > nodes[i]:
            pairs.append((at_low, _mix(m, i, low - steps[i])))
        else:
            pairs += [(at_low, at_low), (_mix(m, i, steps[i]), at_low)]
            if i > 0:
                pairs.append((at_low, _mix(m, i - 1, 1.0 - steps[i - 1])))
        if interval + 1 < nodes[i + 1]:
            pairs.append((at_high, _mix(m, i, high + steps[i])))
        else:
            pairs += [(at_high, at_high), (_mix(m, i, 1.0 - steps[i]), at_high)]
            if i + 2 < m:
                pairs.append((at_high, _mix(m, i + 1, steps[i + 1])))
        moves += [_Move(interval, i, before, after) for before, after in pairs]
    return moves


def _find_worst(moves: list[_Move], falls: Vector, enough: float) -> list[int]:
    """Return which move of each segment makes V fall least, where that is too little."""
    segments = np.array([move.segment for move in moves])
    worst = []
    for segment in np.unique(segments):
        inside = np.flatnonzero(segments == segment)
        least = int(inside[falls[inside].argmin()])
        if falls[least] < enough:
            worst.append(least)
    return worst


def _interpolate_multipliers(
    moves: list[_Move], some: list[_Move], of_some: Vector
) -> Vector:
    """Return multipliers of all moves from those of some, by interval, in the logarithm."""
    known = np.array([move.interval for move in some])
    order = np.argsort(known)
    intervals = [move.interval for move in moves]
    return np.exp(np.interp(intervals, known[order], np.log(of_some[order])))


def _choose_multipliers(
    loop: GainScheduledLoop, P: Matrix, moves: list[_Move], first: Vector
) -> tuple[Vector, Vector]:
    """
    Return for every move a multiplier, and by which share V seems to fall.

    The multiplier is the best of some around the `first`, for all vertices of the family; nothing
    is proved by it.
    """
    chosen = []
    falls = []
    for move, multiplier in zip(moves, first):
        tried, fall = _measure_falls(loop, P, move, multiplier * NEARBY)
        chosen.append(tried[fall.argmax()])
        falls.append(fall.max())
    return np.array(chosen), np.array(falls)


def _measure_falls(
    loop: GainScheduledLoop, P: Matrix, move: _Move, multipliers: Vector
) -> tuple[Vector, Vector]:
    """Return multipliers, none of them too small, and by which share V falls with each."""
    s = loop.family.states
    plants = loop.family.vertices
    before, after = np.tensordot(move.before, P, 1), np.tensordot(move.after, P, 1)
    A = loop.close(plants, loop.tube.centres[move.interval])
    H = plants[:, :, s:] @ loop.tube.shapes[move.interval]
    values, vectors = np.linalg.eigh(np.swapaxes(H, -1, -2) @ after @ H)
    possible: Vector = np.maximum(multipliers, 1.001 * values.max())
    # In coordinates in which P before is 1, and Y = N M in its eigenvectors.
    root = np.linalg.inv(np.linalg.cholesky(before))
    normed = root @ np.swapaxes(A, -1, -2)
    X = normed @ after @ H @ vectors
    c = root @ loop.family.innovation
    rest = np.eye(s) - normed @ after @ np.swapaxes(normed, -1, -2)
    rest = rest - possible[:, None, None, None] * np.outer(c, c)
    inner = 1.0 / (possible[:, None, None] - values)
    rest = rest - (X * inner[:, :, None, :]) @ np.swapaxes(X, -1, -2)
    falls: Vector = np.linalg.eigvalsh(rest)[..., 0].min(axis=1)
    return possible, falls


def _is_proved(
    loop: GainScheduledLoop,
    P: Matrix,
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
            before = np.tensordot(move.before, P, 1)
            after = np.tensordot(move.after, P, 1)
            # Of the numbers that both were made of, entry by entry.
            after_size = 3.0 * np.tensordot(move.before + move.after, np.abs(P), 1)
            rest = -np.swapaxes(F, -1, -2) @ after @ F
            rest[:, :s, :s] += contraction * before
            rest[:, :s, :s] -= multiplier * np.outer(c, c)
            rest[:, s:, s:] += multiplier * np.eye(n)
            bent = np.swapaxes(F_size, -1, -2) @ (np.abs(after) @ off)
            whole = np.swapaxes(F_size, -1, -2) @ (after_size @ F_size)
            whole[:, :s, :s] += after_size
            radius = 1.01 * (bent + np.swapaxes(bent, -1, -2))
            radius += 32.0 * (s + n) * UNIT * whole + SMALLEST
            places = np.arange(s)
            radius[:, places, places] += 8.0 * UNIT * multiplier * np.abs(c)
            if not are_positive_definite(rest, radius).all():
                return False
            rounding = 16.0 * UNIT * after_size
            if not are_positive_definite(before, rounding):
                return False
    return True


def _search(
    loop: GainScheduledLoop, nodes: Indices, moves: list[_Move], wanted: float
) -> tuple[Matrix, Vector] | None:
    """
    Return P at the nodes and a multiplier of each move, from a semidefinite program, or None.

    Minimised is the sum of traces of P, in coordinates in which a P for R at rest is 1, with the
    inequalities of `_is_proved` >= 1 for the wanted fall of V, for the corners of the family, and
    for the leading directions of the gains.
    """
    import clarabel
    from scipy import sparse

    program = _Program(loop, nodes, moves)
    coefficients, constants = program.inequalities(wanted)
    cost = np.zeros(program.variables)
    cost[: program.of_P] = np.tile(to_vector(np.eye(program.s)), len(nodes))
    cost /= 100.0 * program.of_P
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 50
    settings.max_threads = 1
    # Far from the least trace, where P is as bad as the inequalities that are searched allow.
    settings.tol_gap_rel = settings.tol_gap_abs = 1.0
    settings.tol_feas = 1e-5
    # A slow loop's P is large: with the usual tolerance it seems impossible.
    settings.tol_infeas_rel = settings.tol_infeas_abs = 1e-12
    no_square = sparse.csc_matrix((program.variables, program.variables))
    cones = [clarabel.PSDTriangleConeT(program.q)] * len(program.constraints)
    solver = clarabel.DefaultSolver(
        no_square, cost, coefficients, constants, cones, settings
    )
    solution = solver.solve()
    if 'Infeasible' in str(solution.status):
        return None
    vectors = np.array(solution.x[: program.of_P]).reshape(len(nodes), -1)
    P = program.back.T @ to_matrix(vectors, program.s) @ program.back
    P = 0.5 * (P + np.swapaxes(P, -1, -2))
    if not np.isfinite(P).all() or np.linalg.eigvalsh(P).min() <= 0.0:
        return None
    multipliers = np.array(solution.x[program.of_P :]) / program.balance**2
    return P, np.maximum(multipliers, np.finfo(float).tiny)


@dataclass(frozen=True)
class _Constraint:
    """The inequality of one move and one corner of the family."""

    move: _Move
    multiplier: int
    F: Matrix  # [A, leading directions of N M], in the coordinates of the program
    innovation: Vector  # c


class _Program:
    """The semidefinite program of `_search` as matrices."""

    def __init__(
        self, loop: GainScheduledLoop, nodes: Indices, moves: list[_Move]
    ) -> None:
        tube = loop.tube
        self.s = s = loop.family.states
        self.q = s + min(LEADING, tube.centres.shape[-1])
        self.back = back = _coordinates(loop, nodes)
        self.of_P = len(nodes) * s * (s + 1) // 2
        forth = np.linalg.inv(back)
        c = loop.family.innovation @ forth
        self.constraints: list[_Constraint] = []
        self.balance = np.zeros(len(moves))
        for number, move in enumerate(moves):
            balance = 0.0
            for vertex in loop.family.vertices[loop.family.corners]:
                A = back @ loop.close(vertex, tube.centres[move.interval]) @ forth
                H = back @ vertex[:, s:] @ tube.shapes[move.interval]
                vectors, values, _ = np.linalg.svd(H, full_matrices=False)
                leading = vectors[:, : self.q - s] * values[: self.q - s]
                # Both of one size; all corners have one multiplier.
                if not balance:
                    balance = math.sqrt(np.linalg.norm(c) / max(values[0], 1e-300))
                self.balance[number] = balance
                F = np.hstack([A, leading * balance])
                self.constraints.append(_Constraint(move, number, F, c / balance))
        self.variables = self.of_P + len(moves)

    def inequalities(self, wanted: float) -> tuple[Matrix, Vector]:
        """Return A and b of A x + slack = b, the slack of every constraint in the cone."""
        from scipy import sparse

        s, q = self.s, self.q
        size = q * (q + 1) // 2
        of_node = s * (s + 1) // 2
        kept = (1.0 - wanted) * congruence(np.eye(s, q)[None])[0]
        after = congruence(np.array([each.F for each in self.constraints]))
        target = np.zeros((q, q))
        target[:s, :s] = np.eye(s)
        rows, columns, values = [], [], []
        for number, constraint in enumerate(self.constraints):
            before, shares_after = constraint.move.before, constraint.move.after
            multiplier = np.zeros((q, q))
            multiplier[:s, :s] = np.outer(constraint.innovation, constraint.innovation)
            multiplier[s:, s:] = -np.eye(q - s)
            blocks = [
                (self.of_P + constraint.multiplier, to_vector(multiplier)[:, None])
            ]
            for node in np.flatnonzero(before + shares_after).tolist():
                of_P = shares_after[node] * after[number] - before[node] * kept
                blocks.append((node * of_node, of_P))
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


def _coordinates(loop: GainScheduledLoop, nodes: Indices) -> Matrix:
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


def _triangle(size: int) -> tuple[Indices, Indices, Vector]:
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
