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
    d^2z/dt^2 = -a z - b dz/dt, a = B k and b = B c, every entry of [A, N] is affine in k and
    1 / k, and a polynomial of degree 2 in B and in the time t = d h - T_d for which the newer
    input acts, and 1 in M_t, once phi(t) and gamma(t) are of degree 2. The curve (k, 1 / k) is
    within the triangle of its ends and of where its tangents there meet; the coefficients of
    Bernstein's form span a hull of the polynomial; what phi and gamma differ by from theirs is
    the radius.

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
    axes = (box.mobility, acting)
    response = _approximate_response(model, box, acting)
    groups = []
    marks = []
    at_corners = _mark_corners(axes)
    for tool_mass in dict.fromkeys(box.tool_mass):
        for oldest_acts in dict.fromkeys((False, acting[0] == 0.0)):
            for k, softness in _enclose_stiffness(box.stiffness):
                values = []
                for B, t in product(*(_three_points(axis) for axis in axes)):
                    at = _Point(k, softness, B, tool_mass, t, oldest_acts)
                    values.append(_loop_at(model, waiting, at, response))
                grid = np.array(values).reshape(3, 3, *values[0].shape)
                groups.append(_bernstein(grid, axes))
                marks.append(at_corners & (k in box.stiffness))
    radius = _radius(model, box, waiting, response)
    vertices = np.concatenate(groups)
    # Of some 200 roundings, in numbers up to 8 times those of the result.
    rounding = 2000.0 * UNIT * np.abs(vertices).max(axis=0)
    innovation = np.zeros(vertices.shape[1])
    innovation[waiting + 2] = 1.0
    innovation[waiting + 3] = -1.0
    corners = np.flatnonzero(np.concatenate(marks))
    return LoopFamily(vertices, corners, radius + rounding, innovation)


@dataclass(frozen=True)
class _Point:
    """A plant, where the entries of a loop are evaluated."""

    k: float
    softness: float  # 1 / k
    B: float
    tool_mass: float
    t: float  # for which the newer input acts [s]
    oldest_acts: bool  # still, when the force is measured


@dataclass(frozen=True)
class _Response:
    """The response to an impulse after a period and, as parabolas, after a part of it."""

    way_h: float  # gamma(h) [s^2]
    speed_h: float  # phi(h) [s]
    way: Vector  # coefficients of gamma(t), highest first
    speed: Vector  # of phi(t)
    way_radius: float
    speed_radius: float


def respond(a: float, b: float, t: float) -> tuple[float, float]:
    """
    Return way and speed gamma(t), phi(t) of d^2z/dt^2 = -a z - b dz/dt after a unit impulse.

    By the series of phi; gamma(t) is its integral [s^2], phi(t) [s] as the way of an impulse.
    """
    coefficient = 1.0  # of t^j / j! in phi', from j = 0 on
    before = 0.0
    way = speed = 0.0
    for j in range(SERIES_TERMS):
        speed += coefficient * t ** (j + 1) / math.factorial(j + 1)
        way += coefficient * t ** (j + 2) / math.factorial(j + 2)
        coefficient, before = -b * coefficient - a * before, coefficient
    return way, speed


def _approximate_response(model: ForceLoopModel, box: Box, acting: Range) -> _Response:
    """
    Return parabolas of gamma and phi for the middle of a box, and how far others are from them.

    |phi'| <= 1 and |phi| <= t, since the energy phi'^2 + a phi^2 does not grow; so
    |phi''| <= b + a h, |phi'''| <= a + b (b + a h), and by variation of constants
    |dphi/da| <= t^3 / 6, |dphi/db| <= t^2 / 2, |dgamma/da| <= t^4 / 24, |dgamma/db| <= t^3 / 6. A
    parabola through three equal steps of w / 2 is off by w^3 / (72 sqrt 3) of the third derivative
    at most.
    """
    h, c = model.period, model.surface_damping
    a_range = (box.stiffness[0] * box.mobility[0], box.stiffness[1] * box.mobility[1])
    b_range = (c * box.mobility[0], c * box.mobility[1])
    a, b = 0.5 * sum(a_range), 0.5 * sum(b_range)
    a_half, b_half = a_range[1] - a, b_range[1] - b
    times = np.array(_three_points(acting))
    curves = np.array([respond(a, b, t) for t in times])
    if acting[0] == acting[1]:
        parabolas = np.zeros((3, 2))
        parabolas[2] = curves[0]
    else:
        parabolas = np.linalg.solve(np.vander(times, 3), curves)
    most_a, most_b = a_range[1], b_range[1]
    bend = most_b + most_a * h
    off = (acting[1] - acting[0]) ** 3 / (72.0 * math.sqrt(3.0))
    way_h, speed_h = respond(a, b, h)
    return _Response(
        way_h,
        speed_h,
        parabolas[:, 0],
        parabolas[:, 1],
        1.01 * (off * bend + a_half * h**4 / 24.0 + b_half * h**3 / 6.0) + 1e-18,
        1.01
        * (off * (most_a + most_b * bend) + a_half * h**3 / 6.0 + b_half * h**2 / 2.0)
        + 1e-15,
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
    itself[: d + 2, : d + 2] = at.softness * np.eye(d + 2)
    of_estimate = -observer.feedback.copy()
    of_estimate[0] += at.B * (1.0 - model.fed_share)
    itself[d + 2, predicted:size] = of_estimate
    itself[d + 2, size:] = of_estimate
    itself[d + 2, 1] = -model.damping_rate * at.softness
    by_k = itself.copy()
    by_k[: d + 2, : d + 2] = np.eye(d + 2)
    by_k[d + 2] *= at.k
    by_k[d + 2, 1] = -model.damping_rate

    way_t = float(np.polyval(response.way, at.t))
    speed_t = float(np.polyval(response.speed, at.t))
    # What the spring does is B times the force, k z.
    of_way = np.zeros(size + n)
    of_way[0] = at.B
    loop = np.zeros((size, size + n))
    way = by_k[0] - at.k * response.way_h * of_way + response.speed_h * by_k[1]
    loop[0] = way + (response.way_h - way_t) * by_k[2] + way_t * by_k[3]
    after_h = 1.0 - b * response.speed_h
    loop[1] = after_h * by_k[1] - at.k * (response.speed_h * of_way)
    loop[1, 1] -= at.B * at.k * response.way_h
    loop[1] += (response.speed_h - speed_t) * by_k[2] + speed_t * by_k[3]
    speed = after_h * itself[1] - response.speed_h * of_way
    speed[1] -= at.B * response.way_h
    speed += (response.speed_h - speed_t) * itself[2] + speed_t * itself[3]
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
    at = _Point(stiffest, softest, most_mobile, box.tool_mass[1], 0.0, False)
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


def _three_points(axis: Range) -> tuple[float, float, float]:
    return axis[0], 0.5 * (axis[0] + axis[1]), axis[1]


def _enclose_stiffness(stiffness: Range) -> list[tuple[float, float]]:
    """Return k and 1 / k at the corners of a triangle around the curve."""
    low, high = stiffness
    if low == high:
        return [(low, 1.0 / low)]
    whole = low + high
    return [
        (low, 1.0 / low),
        (2.0 * low * high / whole, 2.0 / whole),
        (high, 1.0 / high),
    ]


def _mark_corners(axes: tuple[Range, ...]) -> Mask:
    """Return which coefficients of `_bernstein` are values at corners, one after the other."""
    marks = np.ones(1, dtype=bool)
    for low, high in axes:
        of_axis = np.array([True]) if low == high else np.array([True, False, True])
        marks = np.logical_and.outer(marks, of_axis).ravel()
    return marks


def _bernstein(grid: Matrix, axes: tuple[Range, ...]) -> Matrix:
    """
    Return the coefficients of Bernstein's form of parabolas given at three points of every axis.

    Of f_0, f_1, f_2 they are f_0, 2 f_1 - (f_0 + f_2) / 2 and f_2; an axis of one point has one.
    """
    for number, (low, high) in enumerate(axes):
        values = np.moveaxis(grid, number, 0)
        if low == high:
            coefficients = values[:1]
        else:
            middle = 2.0 * values[1] - 0.5 * (values[0] + values[2])
            coefficients = np.stack([values[0], middle, values[2]])
        grid = np.moveaxis(coefficients, 0, number)
    vertices: Matrix = grid.reshape(-1, *grid.shape[len(axes) :])
    return vertices
