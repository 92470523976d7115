"""Certificates against known bounds, exact arithmetic, the loops they are for, and adversaries."""

from fractions import Fraction
import math

from force_loop import H, observer_of
from multicontact_control.force.adversary import attack, AttackedLoops
from multicontact_control.force.certificate import find_certificate, GainScheduledLoop
from multicontact_control.force.enclosures import are_positive_definite
from multicontact_control.force.gain_tube import (
    enclose_gains,
    GainTube,
    predict_covariance,
    RateLimit,
)
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.loop_family import (
    Box,
    enclose_loops,
    ForceLoopModel,
    LoopFamily,
)
from multicontact_control.force.margins import closed_loop, LinearArmPlant
from multicontact_control.force.observer import (
    solve_steady_covariance,
    solve_steady_gain,
)
import numpy as np
from numpy.testing import assert_allclose
import pytest

K = 6000.0
LIMIT = RateLimit(0.1, 1000.0, 0.1)
TEXTBOOK_STEP = 1e-3  # s
QUADRATIC_BOUND = 1.0 + 2.0 * math.sqrt(2.0)


def model_of(damping_rate=20.0):
    observer = observer_of(damping_rate=damping_rate).design
    return ForceLoopModel(observer, H, damping_rate, 0.0, 30.0)


@pytest.fixture
def needs_solver():
    pytest.importorskip('clarabel', reason='the extra [certify] is not installed')


def arm_loop(model, k, delay, tool_mass, mobility, gain):
    """Return the loop of a plant as `margins` has it, of forces k z in place of ways z."""
    plant = LinearArmPlant(
        np.array([[mobility]]),
        np.array([k]),
        np.array([model.surface_damping]),
        np.array([[tool_mass]]),
        delay,
    )
    law = make_steady_law(model.observer, gain)
    loop = closed_loop(
        plant, law, model.damping_rate, model.period, fed_share=model.fed_share
    )
    by_force = np.ones(len(loop))
    by_force[: len(loop) - len(model.observer.Gamma) - 1] = k
    return by_force[:, None] * loop / by_force


@pytest.mark.parametrize('delay', [0.0005, 0.002, 0.0031, 0.006, 0.0079])
def test_loop_of_one_plant_is_that_of_the_margins(delay):
    model = model_of()
    gain = solve_steady_gain(model.observer, 3.0)
    family = enclose_loops(model, Box((K, K), (delay, delay), (0.4, 0.4), (0.2, 0.2)))
    expected = arm_loop(model, K, delay, 0.4, 0.2, gain)
    s = family.states
    size = np.abs(expected) + 1e-6
    differences = []
    for vertex in family.vertices:
        loop = vertex[:, :s] + np.outer(vertex[:, s:] @ gain, family.innovation)
        differences.append((np.abs(loop - expected) / size).max())
    assert min(differences) < 1e-8


def test_family_contains_the_loops_of_its_box():
    """No linear function of a loop inside is above that of all vertices and the radius."""
    rng = np.random.default_rng(1)
    model = model_of()
    gain = solve_steady_gain(model.observer, 3.0)
    box = Box((5000.0, 8000.0), (0.0042, 0.0058), (0.3, 0.6), (0.1, 0.3))
    family = enclose_loops(model, box)
    s = family.states
    to_loop = np.vstack([np.eye(s), np.outer(gain, family.innovation)])
    vertices = family.vertices @ to_loop
    radius = family.radius @ np.abs(to_loop)
    scale = np.abs(vertices).max(axis=0) + 1e-12
    for _ in range(200):
        k, delay, mass, mobility = (
            rng.uniform(*axis) if rng.random() < 0.7 else axis[rng.integers(2)]
            for axis in (box.stiffness, box.delay, box.tool_mass, box.mobility)
        )
        inside = arm_loop(model, k, delay, mass, mobility, gain)
        weights = rng.standard_normal((20, s, s)) / scale
        most = np.einsum('wij,vij->wv', weights, vertices).max(axis=1)
        slack = np.einsum('wij,ij->w', np.abs(weights), radius)
        assert (np.einsum('wij,ij->w', weights, inside) <= most + slack + 1e-12).all()


def test_tube_contains_the_gains_of_any_course_of_R():
    rng = np.random.default_rng(2)
    observer = model_of().observer
    tube = enclose_gains(observer, LIMIT, H)
    low, high = tube.edges[[0, -1]]
    for course in range(6):
        log_R = rng.uniform(low, high)
        P_1 = solve_steady_covariance(observer, math.exp(log_R))
        target = log_R
        for tick in range(1500):
            if rng.random() < 0.02 or course == 0 and tick % 500 == 0:
                target = rng.choice([low, high, rng.uniform(low, high)])
            R = math.exp(log_R)
            gain = P_1[:, 0] / (P_1[0, 0] + R)
            interval = np.searchsorted(tube.edges[1:-1], log_R, side='right')
            off = np.linalg.solve(tube.shapes[interval], gain - tube.centres[interval])
            assert np.linalg.norm(off) <= 1.0
            P_1 = predict_covariance(observer, P_1, R)
            log_R += np.clip(target - log_R, -tube.step, tube.step)


@pytest.mark.parametrize(
    'least, expected', [(1e-9, True), (0.0, False), (-1e-9, False)]
)
def test_positive_definite_is_what_has_no_other_eigenvalue(least, expected):
    rng = np.random.default_rng(3)
    vectors, _ = np.linalg.qr(rng.standard_normal((8, 8)))
    values = np.array([least, 0.1, 0.2, 0.5, 1.0, 1.0, 2.0, 3.0])
    matrix = vectors * values @ vectors.T
    assert are_positive_definite(matrix, np.zeros((8, 8))) == expected
    assert not are_positive_definite(matrix, np.full((8, 8), 1e-9))


def textbook_loop(largest, intervals=1, step=None):
    """
    Return d^2x/dt^2 + dx/dt + (2 + q) x = 0 with 0 <= q <= largest, by Euler's rule.

    Zelentsovsky's example (IEEE Transactions on Automatic Control 39(1), 1994). A quadratic
    function proves it up to q = 1 + 2 sqrt(2) = 3.82, by the circle criterion; it is unstable
    under switching from about 7 on.
    """
    A = np.array([[0.0, 1.0], [-2.0, -1.0]])
    loop = np.hstack([np.eye(2) + TEXTBOOK_STEP * A, [[0.0], [-TEXTBOOK_STEP]]])
    family = LoopFamily(
        loop[None], np.zeros(1, dtype=int), np.zeros((2, 3)), np.array([1.0, 0.0])
    )
    edges = np.linspace(0.0, largest, intervals + 1)
    centres = 0.5 * (edges[:-1] + edges[1:])[:, None]
    half = np.full((intervals, 1, 1), 0.5 * largest / intervals)
    return GainScheduledLoop(family, GainTube(edges, step or largest, centres, half))


def test_textbook_example_is_certified_up_to_its_published_bound(needs_solver):
    assert find_certificate(textbook_loop(QUADRATIC_BOUND - 0.4)) is not None
    assert find_certificate(textbook_loop(QUADRATIC_BOUND + 0.05)) is None


def test_bounded_rate_certifies_more_than_any_rate(needs_solver):
    slow = textbook_loop(10.0, intervals=40, step=1e-4)  # 0.1 1/s
    assert find_certificate(slow) is not None


def worst_switching_growth(largest):
    """Return how x grows in 40 s if q switches so that the energy grows most."""
    x = np.array([1.0, 0.0])
    for _ in range(40_000):
        q = largest if x[0] * x[1] < 0.0 else 0.0
        acceleration = -(2.0 + q) * x[0] - x[1]
        x = x + TEXTBOOK_STEP * np.array([x[1], acceleration])
    return np.linalg.norm(x)


def test_loop_that_is_unstable_under_switching_alone_is_refused(needs_solver):
    loop = textbook_loop(10.0)
    for q in np.linspace(0.0, 10.0, 21):
        closed = loop.close(loop.family.vertices, np.array([q]))
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    assert worst_switching_growth(10.0) > 10.0
    assert find_certificate(loop) is None


def is_positive_definite_exactly(matrix):
    """Return whether all pivots of Gauss's elimination are positive, in fractions."""
    rows = [[Fraction(value) for value in row] for row in matrix]
    for i, row in enumerate(rows):
        if row[i] <= 0:
            return False
        for below in rows[i + 1 :]:
            factor = below[i] / row[i]
            for j in range(i, len(row)):
                below[j] -= factor * row[j]
    return True


def test_certificate_holds_in_exact_arithmetic(needs_solver):
    """rho^2 P - (A + q N c^T)^T P' (A + q N c^T) > 0 for P before and after, in fractions."""
    loop = textbook_loop(8.0, intervals=32, step=2e-4)
    found = find_certificate(loop)
    assert found is not None
    low, high = loop.tube.edges[[0, -1]]
    for q in np.linspace(low, high, 33):
        closed = loop.close(loop.family.vertices[0], np.array([q]))
        A = [[Fraction(value) for value in row] for row in closed]
        before = found.matrix_at(q)
        for move in (-loop.tube.step, 0.0, loop.tube.step):
            after = found.matrix_at(min(max(q + move, low), high))
            rest = np.empty((2, 2), dtype=object)
            for i in range(2):
                for j in range(2):
                    total = Fraction(found.contraction) * Fraction(before[i, j])
                    for k in range(2):
                        for m in range(2):
                            total -= A[k][i] * Fraction(after[k, m]) * A[m][j]
                    rest[i, j] = total
            assert is_positive_definite_exactly(rest)


def test_narrow_box_within_a_certified_one_is_certified(needs_solver):
    """A program on few gains and one plant finds a P that others do not bear."""
    model = model_of()
    tube = enclose_gains(model.observer, LIMIT, H)
    narrow = Box((K, K), (0.0066, 0.0066), (0.49, 0.49), (0.1, 0.1))
    loop = GainScheduledLoop(enclose_loops(model, narrow), tube)
    assert find_certificate(loop) is not None


@pytest.mark.nightly
def test_certified_loop_of_the_paper_withstands_adversaries(needs_solver):
    model = model_of()
    box = Box((6000.0, 6600.0), (0.0005, 0.001), (0.49, 0.49), (0.1, 0.1))
    tube = enclose_gains(model.observer, LIMIT, H)
    family = enclose_loops(model, box)
    found = find_certificate(GainScheduledLoop(family, tube))
    assert found is not None
    rng = np.random.default_rng(4)
    loops = np.repeat(family.vertices[family.corners], 30, axis=0)
    attacked = AttackedLoops(loops, family.innovation, model.observer, LIMIT, H)
    result = attack(attacked, found, 1000, rng)
    assert (result.worst_ratio <= found.contraction).all()
    assert (result.growth < 0.0).all()


def test_gains_at_rest_stay_within_a_tube_without_a_rate():
    observer = model_of().observer
    tube = enclose_gains(observer, RateLimit(0.5, 1.0, 0.0), H)
    for R in (0.5, 0.7, 1.0):
        off = np.linalg.solve(
            tube.shapes[0], solve_steady_gain(observer, R) - tube.centres[0]
        )
        assert np.linalg.norm(off) <= 1.0
    assert_allclose(tube.edges, np.log([0.5, 1.0]))
