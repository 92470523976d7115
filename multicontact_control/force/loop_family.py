"""
The force loops of a box of surfaces, delays, tools and arms, as the hull of a few matrices.

One contact, as in `margins.closed_loop` with one: of the state
[k z, k dz/dt, k inputs under way, measured force, prediction x_1 of the observer], one period is
x_(k+1) = (A + N K c^T) x_k, where K is the gain of the observer and c^T x the innovation. By k
a way is the same force on every surface; a surface keeps its k.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
import math

from multicontact_control.arrays import Indices, Mask, Matrix, Vector
from multicontact_control.force.enclosures import UNIT
from multicontact_control.force.observer import ObserverDesign
import numpy as np

Range = tuple[float, float]
DEGREES = (3, 3, 2)  # in k, times k, in B and in t
SERIES_TERMS = 12  # of motions over a period, |a| h^2 and b h below 1


@dataclass(frozen=True)
class Box:
    """What is known of the plant: all of it within these ranges, and but for k constant or not."""

    stiffness: Range  # k [N/m]
    delay: Range  # T_d, within one period: (d - 1) h to d h [s]
    tool_mass: Range  # M_t [kg]
    mobility: Range  # B = N^T Lambda^-1 N [1/kg]


@dataclass(frozen=True)
class ForceLoopModel:
    """What a force loop has that is known exactly: its observer and its settings."""

    observer: ObserverDesign
    period: float  # h [s]
    damping_rate: float  # K_2 [1/s]
    fed_share: float  # g, the share of the desired force in what is fed forward
    surface_damping: float  # c [N s/m]


@dataclass(frozen=True)
class LoopFamily:
    """
    Loops [A, N] whose convex hull, widened by a radius, contains every loop of a box.

    Of s states and n gains.
    """

    vertices: Matrix  # shape (v, s, s + n)
    corners: Indices  # numbers of the vertices that are loops at the corners of the box
    radius: Matrix  # of every entry, shape (s, s + n)
    innovation: Vector  # c, shape (s,)

    @property
    def states(self) -> int:
        """Return s."""
        return len(self.innovation)


def enclose_loops(model: ForceLoopModel, box: Box) -> LoopFamily:
    """
    Return loops whose hull contains those of a box.

    With phi(t) the speed and gamma(t) the way after t of a unit impulse on
    d^2z/dt^2 = -a z - b dz/dt, a = B k and b = B c, once both are affine in a and b and of degree
    2 in t, every entry of [A, N] times k is a polynomial: of degree 3 in k and in B, 2 in the time
    t = d h - T_d for which the newer input acts, and 1 in M_t. Its coefficients in Bernstein's
    form over those of k span a hull; what phi and gamma differ by from theirs is the radius.

    Raises
    ------
    ValueError
        If the delays of the box lie in different periods.

    """
    h = model.period
    first, last = box.delay
    waiting = max(math.ceil(last / h - 1e-9), 1)  # d
    if first < (waiting - 1) * h - 1e-9 * h:
        raise ValueError('the delays of a box are those of one period')
    acting = (max(waiting * h - last, 0.0), min(waiting * h - first, h))
    axes = (box.stiffness, box.mobility, acting)
    points = [
        np.linspace(*axis, 1 if axis[0] == axis[1] else degree + 1)
        for axis, degree in zip(axes, DEGREES)
    ]
    shape = tuple(map(len, points))
    response = _approximate_response(model, box, acting)
    groups = []
    for tool_mass in dict.fromkeys(box.tool_mass):
        for oldest_acts in dict.fromkeys((False, acting[0] == 0.0)):
            values = []
            for k, B, t in product(*points):
                at = _Point(k, B, tool_mass, t, oldest_acts)
                values.append(k * _loop_at(model, waiting, at, response))
            grid = np.array(values).reshape(*shape, *values[0].shape)
            groups.append(_span_hull(grid, points[0]))
    marks = np.tile(_mark_corners(shape), len(groups))
    radius = _radius(model, box, waiting, response)
    vertices = np.concatenate(groups)
    # Of some 200 roundings, in numbers up to 100 times those of the result.
    rounding = 20_000.0 * UNIT * np.abs(vertices).max(axis=0)
    innovation = np.zeros(vertices.shape[1])
    innovation[waiting + 2] = 1.0
    innovation[waiting + 3] = -1.0
    corners = np.flatnonzero(marks)
    return LoopFamily(vertices, corners, radius + rounding, innovation)


@dataclass(frozen=True)
class _Point:
    """A plant, where the entries of a loop are evaluated."""

    k: float
    B: float
    tool_mass: float
    t: float  # for which the newer input acts [s]
    oldest_acts: bool  # still, when the force is measured


@dataclass(frozen=True)
class _Response:
    """
    The response to an impulse after a period and after a part of it, approximated.

    Way gamma [s^2] and speed phi [s] are the last axis; the axis before has the value for a and b
    in the middle of a box, and the derivatives by a and by b there.
    """

    a: float  # of the middle
    b: float
    after_h: Matrix  # shape (3, 2)
    curves: Matrix  # of t^2, t and 1, shape (3, 3, 2)
    way_radius: float
    speed_radius: float

    def evaluate(self, a: float, b: float, t: float) -> tuple[Vector, Vector]:
        """Return way and speed after a period, and after t."""
        by_plant = np.array([1.0, a - self.a, b - self.b])
        after_t = np.tensordot([t * t, t, 1.0], self.curves, 1)
        return by_plant @ self.after_h, by_plant @ after_t


def respond(a: float, b: float, t: float) -> Matrix:
    """
    Return way and speed gamma(t), phi(t) of d^2z/dt^2 = -a z - b dz/dt after a unit impulse.

    By the series of phi; gamma(t) is its integral [s^2], phi(t) [s] as the way of an impulse.
    Shape (3, 2): the values, their derivatives by a and by b.
    """
    coefficient = np.array([1.0, 0.0, 0.0])  # of t^j / j! in phi', from j = 0 on
    before = np.zeros(3)
    way, speed = np.zeros(3), np.zeros(3)
    for j in range(SERIES_TERMS):
        speed += coefficient * t ** (j + 1) / math.factorial(j + 1)
        way += coefficient * t ** (j + 2) / math.factorial(j + 2)
        by_plant = np.array([0.0, before[0], coefficient[0]])
        coefficient, before = -b * coefficient - a * before - by_plant, coefficient
    return np.column_stack([way, speed])


def _approximate_response(model: ForceLoopModel, box: Box, acting: Range) -> _Response:
    """
    Return gamma and phi as parabolas of t, affine in a and b, and how far others are from them.

    |phi'| <= 1 and |phi| <= t, since the energy phi'^2 + a phi^2 does not grow. So
    |phi''| <= b + a h, |phi'''| <= a + b (b + a h), and by variation of constants, once for the
    first derivatives by a and b, and again for the second, the bounds below. A parabola through
    three equal steps of w / 2 is off by w^3 / (72 sqrt 3) of the third derivative at most.
    """
    h, c = model.period, model.surface_damping
    a_range = (box.stiffness[0] * box.mobility[0], box.stiffness[1] * box.mobility[1])
    b_range = (c * box.mobility[0], c * box.mobility[1])
    a, b = 0.5 * sum(a_range), 0.5 * sum(b_range)
    a_half, b_half = a_range[1] - a, b_range[1] - b
    curves = np.zeros((3, 3, 2))
    if acting[0] == acting[1]:
        curves[2] = respond(a, b, acting[0])
    else:
        times = np.linspace(*acting, 3)
        values = np.array([respond(a, b, t) for t in times])
        of_powers = np.linalg.solve(np.vander(times, 3), values.reshape(3, -1))
        curves = of_powers.reshape(3, 3, 2)
    most_a, most_b = a_range[1], b_range[1]
    # Bounds of derivatives by t: the second, the third, and these of the derivatives by a and b.
    phi_2 = most_b + most_a * h
    phi_3 = most_a + most_b * phi_2
    phi_a_2 = h + most_a * h**3 / 6.0 + most_b * h**2 / 2.0
    phi_a_3 = 1.0 + most_a * h**2 / 2.0 + most_b * phi_a_2
    phi_b_2 = 1.0 + most_a * h**2 / 2.0 + most_b * h
    phi_b_3 = phi_2 + most_a * h + most_b * phi_b_2
    by_time = (acting[1] - acting[0]) ** 3 / (72.0 * math.sqrt(3.0))
    # Taylor's remainders of degree 2 in a and b, of gamma and phi.
    way_off = a_half**2 * h**6 / 720.0 + a_half * b_half * h**5 / 60.0
    way_off += b_half**2 * h**4 / 24.0
    speed_off = a_half**2 * h**5 / 120.0 + a_half * b_half * h**4 / 12.0
    speed_off += b_half**2 * h**3 / 6.0
    way_off += by_time * (phi_2 + a_half * phi_a_2 + b_half * phi_b_2)
    speed_off += by_time * (phi_3 + a_half * phi_a_3 + b_half * phi_b_3)
    return _Response(
        a,
        b,
        respond(a, b, h),
        curves,
        1.01 * way_off + 1e-18,
        1.01 * speed_off + 1e-15,
    )


def _loop_at(
    model: ForceLoopModel, waiting: int, at: _Point, response: _Response
) -> Matrix:
    """Return [A, N] of one plant, with the parabolas of its response, shape (s, s + n)."""
    observer = model.observer
    n = len(observer.Gamma)
    d = waiting
    measured, predicted = d + 2, d + 3
    size = predicted + n
    newest = d + 1
    b = at.B * model.surface_damping
    # Of the state, and of K times the innovation, from `size` on: the ways, speeds and inputs
    # themselves, and k times these.
    itself = np.zeros((d + 3, size + n))
    itself[: d + 2, : d + 2] = np.eye(d + 2) / at.k
    of_estimate = -observer.feedback.copy()
    of_estimate[0] += at.B * (1.0 - model.fed_share)
    itself[d + 2, predicted:size] = of_estimate
    itself[d + 2, size:] = of_estimate
    itself[d + 2, 1] = -model.damping_rate / at.k
    by_k = itself.copy()
    by_k[: d + 2, : d + 2] = np.eye(d + 2)
    by_k[d + 2] *= at.k
    by_k[d + 2, 1] = -model.damping_rate

    after_h, after_t = response.evaluate(at.B * at.k, b, at.t)
    way_h, speed_h = after_h
    way_t, speed_t = after_t
    # What the spring does is B times the force, k z.
    of_way = np.zeros(size + n)
    of_way[0] = at.B
    loop = np.zeros((size, size + n))
    way = by_k[0] - at.k * way_h * of_way + speed_h * by_k[1]
    loop[0] = way + (way_h - way_t) * by_k[2] + way_t * by_k[3]
    damped = 1.0 - b * speed_h
    loop[1] = damped * by_k[1] - at.k * (speed_h * of_way)
    loop[1, 1] -= at.B * at.k * way_h
    loop[1] += (speed_h - speed_t) * by_k[2] + speed_t * by_k[3]
    speed = damped * itself[1] - speed_h * of_way
    speed[1] -= at.B * way_h
    speed += (speed_h - speed_t) * itself[2] + speed_t * itself[3]
    loop[2 : newest + 1] = by_k[3:]
    acting = itself[2] if at.oldest_acts else itself[3]
    force = loop[0] + model.surface_damping * speed
    loop[measured] = (1.0 - at.tool_mass * at.B) * force + at.tool_mass * acting
    # The law: x_1 = Phi_c (x_1 + K innovation).
    loop[predicted:, predicted:size] = observer.Phi_c
    loop[predicted:, size:] = observer.Phi_c
    return loop


def _radius(
    model: ForceLoopModel, box: Box, waiting: int, response: _Response
) -> Matrix:
    """Return how far entries may be off because gamma and phi are, shape (s, s + n)."""
    stiffest, most_mobile = box.stiffness[1], box.mobility[1]
    softest = 1.0 / box.stiffness[0]
    at = _Point(stiffest, most_mobile, box.tool_mass[1], 0.0, False)
    stiffest_loop = _loop_at(model, waiting, at, response)
    shape = stiffest_loop.shape
    answer = np.abs(stiffest_loop[waiting + 1])
    a, b = most_mobile * stiffest, most_mobile * model.surface_damping
    way, speed = response.way_radius, response.speed_radius
    radius = np.zeros(shape)
    radius[0, :2] = (a * way, speed)
    radius[1, :2] = (a * speed, b * speed + a * way)
    for j in (2, 3):
        radius[0, j] += 2.0 * way
        radius[1, j] += 2.0 * speed
    if waiting == 1:
        # The least mobile arm answers no more than this either, up to what is fed forward.
        fed = most_mobile * abs(1.0 - model.fed_share) * stiffest
        answer[3 + waiting] += 2.0 * fed
        answer[-len(model.observer.Gamma)] += 2.0 * fed
        radius[0, 3] = radius[1, 3] = 0.0
        radius[0] += way * answer
        radius[1] += speed * answer
    radius[waiting + 2] = max(1.0, most_mobile * box.tool_mass[1]) * (
        radius[0] + model.surface_damping * softest * radius[1]
    )
    return radius


def _mark_corners(shape: tuple[int, ...]) -> Mask:
    """Return which vertices of `_span_hull` are values at corners, one after the other."""
    marks = np.zeros(shape, dtype=bool)
    marks[np.ix_(*([0, count - 1] for count in shape))] = True
    return marks.ravel()


def _span_hull(grid: Matrix, stiffness: Vector) -> Matrix:
    """
    Return points whose hull contains a polynomial of k, B and t over k, by its values on a grid.

    With Bernstein's polynomials, which are positive, sum p_i b_i / sum k_i b_i is a mean of
    p_i / k_i.
    """
    for axis in range(3):
        values = np.moveaxis(grid, axis, 0)
        grid = np.moveaxis(_bernstein(values), 0, axis)
    of_k = _bernstein(stiffness)
    grid = grid / of_k[:, None, None, None, None]
    points: Matrix = grid.reshape(-1, *grid.shape[3:])
    return points


def _bernstein(values: Matrix) -> Matrix:
    """Return coefficients in Bernstein's form of polynomials by values at equal steps."""
    degree = len(values) - 1
    shares = np.linspace(0.0, 1.0, degree + 1)
    basis = np.array(
        [
            math.comb(degree, i) * shares**i * (1.0 - shares) ** (degree - i)
            for i in range(degree + 1)
        ]
    )
    coefficients = np.linalg.solve(basis.T, values.reshape(degree + 1, -1))
    return coefficients.reshape(values.shape)
