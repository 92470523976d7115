"""
For which surfaces and delays a configured force loop is certified; what attacks it withstands.

`force/certificate.py` proves one box of plants; here boxes are put side by side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

from joblib import delayed, Parallel
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.commissioning.arm_loop import ArmLoop
from multicontact_control.errors import ConfigError
from multicontact_control.force.adversary import attack, AttackedLoops
from multicontact_control.force.certificate import (
    Certificate,
    find_certificate,
    GainScheduledLoop,
)
from multicontact_control.force.gain_tube import enclose_gains, RateLimit
from multicontact_control.force.loop_family import (
    Box,
    enclose_loops,
    ForceLoopModel,
    LoopFamily,
    Range,
)
from multicontact_control.force.margins import find_last_stable, spectral_radius
from multicontact_control.force.observer import solve_steady_gain
from multicontact_control.runs.scenario import Setup
import numpy as np
from numpy.random import Generator
from scipy.linalg import solve_discrete_lyapunov

FIRST_FACTOR = 1.5  # of the stiffness, over the first box that is tried
LAST_FACTOR = 1.07  # at which the search for a boundary ends
STARTS = (1.0, 0.5, 2.0)  # true over modelled stiffness, where a region is looked for
LOWEST_RATIO, HIGHEST_RATIO = 0.1, 10.0  # true over modelled stiffness, of the search
STRIP = 0.5  # of a period, delays of one box
LONGEST_ATTACK = 2000  # periods
LARGEST_FALL = 1e4  # of V, after which an attack ends
RUNS_PER_POINT = 16
HELD = 12  # values of R of a boundary
EDGE_TOLERANCE = 0.02  # relative, of simulated boundaries
OUTSIDE = """outside the model, and so of the proof: flexible drives, stiction, torque limits, loss
of contact, what the contacts do to each other through the arm, samples without a force"""


@dataclass(frozen=True)
class CertifiedLoop:
    """A force loop whose region is asked for, and what is known of its R, tool and arm."""

    contact: str
    model: ForceLoopModel
    stiffness: float  # of the model, to which ratios refer [N/m]
    limit: RateLimit
    tool_mass: Range  # [kg]
    mobility: Range  # [1/kg]

    def certify(self, stiffness: Range, delay: Range) -> Certificate | None:
        """Return a certificate for a box of stiffness [N/m] and delay [s], or None."""
        box = Box(stiffness, delay, self.tool_mass, self.mobility)
        tube = enclose_gains(self.model.observer, self.limit, self.model.period)
        family = enclose_loops(self.model, box)
        return find_certificate(GainScheduledLoop(family, tube))

    def of_plant(
        self, stiffness: float, delay: float, tool_mass: float, mobility: float
    ) -> LoopFamily:
        """Return the loop of one plant: a family of one."""
        point = Box(
            (stiffness, stiffness),
            (delay, delay),
            (tool_mass, tool_mass),
            (mobility, mobility),
        )
        return enclose_loops(self.model, point)

    def sample(self, stiffness: float, delay: float, rng: Generator) -> Matrix:
        """Return [A, N] of one plant, of a tool and an arm within their ranges."""
        tool_mass = float(rng.uniform(*self.tool_mass))
        mobility = float(rng.uniform(*self.mobility))
        loop: Matrix = self.of_plant(stiffness, delay, tool_mass, mobility).vertices[0]
        return loop


def make_certified_loop(
    setup: Setup,
    slew_time: float,
    tool_mass: Range | None = None,
    mobility: Range | None = None,
) -> CertifiedLoop:
    """
    Return the loop of the first contact of a setup.

    Parameters
    ----------
    setup
        Of the arm, with the active observer as force law.
    slew_time
        In which R changes by a factor e at most [s].
    tool_mass, mobility
        Their ranges [kg], [1/kg]; those of the setup at its home if not given.

    """
    arm = ArmLoop(setup)
    bounds = setup.controller.noise_variance
    own_mass, own_mobility = arm.tool_inertia[0, 0], arm.mobility[0, 0]
    return CertifiedLoop(
        setup.controller.contact_names[0],
        arm.model_of(0),
        float(arm.stiffness[0]),
        RateLimit(bounds.smallest, bounds.largest, slew_time),
        tool_mass or (own_mass, own_mass),
        mobility or (own_mobility, own_mobility),
    )


def require_range(name: str, limits: Range | None, *, positive: bool = False) -> None:
    """Raise a ConfigError if a range, if there is one, does not rise from 0 or above it."""
    if limits is None:
        return
    low, high = limits
    if not 0.0 <= low <= high < math.inf or (positive and low == 0.0):
        least = 'above 0' if positive else '0 or more'
        raise ConfigError(
            name, f'a range of rising values, {least}', f'{low:g} {high:g}'
        )


class CertifiedBox(NamedTuple):
    """A box of the region: ratios of true and modelled stiffness, delays [s]."""

    ratio: Range
    delay: Range
    certificate: Certificate


def split_delays(delay: Range, period: float) -> list[Range]:
    """Return strips of delays [s], each within one half of a period."""
    width = STRIP * period
    first = math.floor(delay[0] / width + 1e-9)
    last = max(math.ceil(delay[1] / width - 1e-9), first + 1)
    edges = np.clip(width * np.arange(first, last + 1), *delay).tolist()
    return list(zip(edges[:-1], edges[1:]))


class SimulatedEdges(NamedTuple):
    """Up to which ratio of true and modelled stiffness a loop is stable, from 0.1 upwards."""

    held: float  # with every R that is held
    attacked: float  # and with those of adversaries


class CertifiedStrip(NamedTuple):
    """The region of one strip of delays."""

    delay: Range  # [s]
    boxes: list[CertifiedBox]
    edges: SimulatedEdges


def map_region(
    loop: CertifiedLoop, delay: Range, jobs: int
) -> Iterator[CertifiedStrip]:
    """Yield the strips of a range of delays [s], computed by so many jobs, 0 for every core."""
    tasks = (
        delayed(_map_strip)(loop, strip, number)
        for number, strip in enumerate(split_delays(delay, loop.model.period))
    )
    yield from Parallel(jobs or -1, return_as='generator')(tasks)


def _map_strip(loop: CertifiedLoop, delay: Range, seed: int) -> CertifiedStrip:
    edges = find_simulated_edges(loop, delay, np.random.default_rng(seed))
    return CertifiedStrip(delay, find_region(loop, delay), edges)


def find_region(loop: CertifiedLoop, delay: Range) -> list[CertifiedBox]:
    """Return certified boxes of one strip of delays, around the first start that has one."""
    for start in STARTS:
        boxes = _grow_region(loop, delay, start, upwards=True)
        boxes += _grow_region(loop, delay, start, upwards=False)
        if boxes:
            return boxes
    return []


def _grow_region(
    loop: CertifiedLoop, delay: Range, start: float, *, upwards: bool
) -> list[CertifiedBox]:
    """
    Return certified boxes that follow each other from a ratio on.

    Where a box is not certified its factor becomes its square root, until that is below 1.07;
    there the region ends.
    """
    boxes = []
    reached = start
    factor = FIRST_FACTOR
    while factor >= LAST_FACTOR and LOWEST_RATIO < reached < HIGHEST_RATIO:
        ratio = (reached, min(reached * factor, HIGHEST_RATIO))
        if not upwards:
            ratio = (max(reached / factor, LOWEST_RATIO), reached)
        k = (ratio[0] * loop.stiffness, ratio[1] * loop.stiffness)
        certificate = loop.certify(k, delay)
        if certificate is None:
            factor = math.sqrt(factor)
            continue
        boxes.append(CertifiedBox(ratio, delay, certificate))
        reached = ratio[1] if upwards else ratio[0]
    return boxes


class AttackResult(NamedTuple):
    """What attacks on certified boxes came to."""

    runs: int
    violations: int  # runs in which V fell by less than certified in some period
    largest_share: float  # largest V after a period over what is certified of it
    largest_growth: float  # of the logarithm of the norm in a run


def attack_region(
    loop: CertifiedLoop, boxes: Sequence[CertifiedBox], runs: int, rng: Generator
) -> AttackResult:
    """
    Attack certified boxes, half of the runs at their edges.

    Each period of each run is held against the certificate: V must have fallen by its share.
    """
    per_box = math.ceil(runs / len(boxes))
    violations = 0
    share = 0.0
    growth = -math.inf
    for box in boxes:
        certificate = box.certificate
        ticks = math.ceil(math.log(LARGEST_FALL) / -math.log(certificate.contraction))
        attacked = _attacked_loops(loop, box, per_box, rng)
        result = attack(attacked, certificate, min(ticks, LONGEST_ATTACK), rng)
        violations += int((result.worst_ratio > certificate.contraction).sum())
        share = max(share, result.worst_ratio.max() / certificate.contraction)
        growth = max(growth, result.growth.max())
    return AttackResult(per_box * len(boxes), violations, share, growth)


def _attacked_loops(
    loop: CertifiedLoop, box: CertifiedBox, count: int, rng: Generator
) -> AttackedLoops:
    """Return plants of a box, every other one at an edge of it."""
    matrices = []
    for number in range(count):
        of_ratio, of_delay = rng.random(2)
        if number % 4 == 1:
            of_ratio = round(of_ratio)
        if number % 4 == 3:
            of_delay = round(of_delay)
        ratio = box.ratio[0] * (box.ratio[1] / box.ratio[0]) ** of_ratio
        # The first delay may be the last of the period before, with a state less.
        first = box.delay[0] + 1e-6 * loop.model.period
        delay = first + of_delay * (box.delay[1] - first)
        matrices.append(loop.sample(ratio * loop.stiffness, delay, rng))
    return _make_attacked(loop, matrices, box.delay)


def _make_attacked(
    loop: CertifiedLoop, matrices: Sequence[Matrix], delay: Range
) -> AttackedLoops:
    k = (loop.stiffness, loop.stiffness)
    family = enclose_loops(loop.model, Box(k, delay, loop.tool_mass, loop.mobility))
    return AttackedLoops(
        np.array(matrices),
        family.innovation,
        loop.model.observer,
        loop.limit,
        loop.model.period,
    )


def find_simulated_edges(
    loop: CertifiedLoop, delay: Range, rng: Generator
) -> SimulatedEdges:
    """
    Return up to which ratio a loop is stable by eigenvalues and by simulation.

    In the middle of a strip of delays [s], with the middle of tools and arms for R held; 0 if not
    even the smallest ratio is stable.
    """
    middle = 0.5 * (delay[0] + delay[1])
    gains = [
        solve_steady_gain(loop.model.observer, R)
        for R in np.geomspace(loop.limit.smallest, loop.limit.largest, HELD)
    ]

    def is_stable(ratio: float) -> bool:
        return _radius(loop, ratio, middle, gains) < 1.0

    ratios = np.geomspace(LOWEST_RATIO, HIGHEST_RATIO, 41).tolist()
    stable, _ = find_last_stable(is_stable, ratios, EDGE_TOLERANCE)
    held = min(stable, HIGHEST_RATIO)
    if held == 0.0:
        return SimulatedEdges(0.0, 0.0)

    def withstands(ratio: float) -> bool:
        return withstands_attacks(loop, delay, ratio, rng)

    tried = np.geomspace(LOWEST_RATIO, held, 9).tolist()
    attacked, _ = find_last_stable(withstands, tried, EDGE_TOLERANCE)
    return SimulatedEdges(held, min(attacked, held))


def _radius(
    loop: CertifiedLoop, ratio: float, delay: float, gains: Sequence[Vector]
) -> float:
    """Return the largest spectral radius with some held gains."""
    tool, arm = float(np.mean(loop.tool_mass)), float(np.mean(loop.mobility))
    family = loop.of_plant(ratio * loop.stiffness, delay, tool, arm)
    s = family.states
    A, N = family.vertices[0][:, :s], family.vertices[0][:, s:]
    return max(spectral_radius(A + np.outer(N @ K, family.innovation)) for K in gains)


def withstands_attacks(
    loop: CertifiedLoop, delay: Range, ratio: float, rng: Generator
) -> bool:
    """
    Return whether no attack makes a loop grow, in the middle of a strip of delays.

    The greedy adversaries follow a Lyapunov function of the middle gain.
    """
    middle = 0.5 * (delay[0] + delay[1])
    gain = solve_steady_gain(
        loop.model.observer, math.sqrt(loop.limit.smallest * loop.limit.largest)
    )
    k = ratio * loop.stiffness
    matrices = [loop.sample(k, middle, rng) for _ in range(RUNS_PER_POINT)]
    attacked = _make_attacked(loop, matrices, delay)
    s = len(attacked.innovation)
    held = matrices[0][:, :s] + np.outer(matrices[0][:, s:] @ gain, attacked.innovation)
    if spectral_radius(held) >= 1.0:
        return False
    P = solve_discrete_lyapunov(held.T, np.eye(s))
    measure = Certificate(np.zeros(1), P[None], 1.0)
    result = attack(attacked, measure, LONGEST_ATTACK, rng)
    grows = (result.growth > 0.0) & (result.late_growth > 0.0)
    return not grows.any()


class RegionShare(NamedTuple):
    """Areas of a region in the plane of ln(k ratio) and T_d, over one another."""

    of_held: float  # certified over stable with every R that is held
    of_attacked: float  # over what withstands attacks


def measure_share(strips: Sequence[CertifiedStrip]) -> RegionShare:
    """Return which share of the stable area boxes cover, by the edges of every strip."""
    certified = held = attacked = 0.0
    for strip in strips:
        width = strip.delay[1] - strip.delay[0]
        for box in strip.boxes:
            certified += width * math.log(box.ratio[1] / box.ratio[0])
        if strip.edges.held > 0.0:
            held += width * math.log(strip.edges.held / LOWEST_RATIO)
        if strip.edges.attacked > 0.0:
            attacked += width * math.log(strip.edges.attacked / LOWEST_RATIO)
    return RegionShare(
        certified / held if held else 0.0, certified / attacked if attacked else 0.0
    )


def draw_region(strips: Sequence[CertifiedStrip], title: str) -> Figure:
    """Return the plane of k ratio and T_d: certified, simulated stable, not stable."""
    figure = Figure(figsize=(5.2, 3.4), layout='constrained')
    axes = figure.subplots()
    names: set[str] = set()

    def paint(delay: Range, ratio: Range, colour: str, name: str) -> None:
        low, high = math.log10(ratio[0]), math.log10(ratio[1])
        axes.add_patch(
            Rectangle(
                (1e3 * delay[0], low),
                1e3 * (delay[1] - delay[0]),
                high - low,
                facecolor=colour,
                edgecolor='white',
                linewidth=0.4,
                label='_' if name in names else name,
            )
        )
        names.add(name)

    for delay, boxes, edges in strips:
        held, attacked = (max(ratio, LOWEST_RATIO) for ratio in edges)
        paint(delay, (LOWEST_RATIO, attacked), '#9ecae1', 'withstands attacks')
        paint(delay, (attacked, held), '#fdd0a2', 'stable with R held alone')
        paint(delay, (held, HIGHEST_RATIO), '#d9d9d9', 'unstable')
        for box in boxes:
            paint(delay, box.ratio, '#2171b5', 'certified')
    delays = [1e3 * edge for strip in strips for edge in strip.delay]
    axes.set_xlim(min(delays), max(delays))
    axes.set_ylim(math.log10(LOWEST_RATIO), math.log10(HIGHEST_RATIO))
    ticks = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
    axes.set_yticks([math.log10(tick) for tick in ticks], [f'{t:g}' for t in ticks])
    axes.set_xlabel('T_d [ms]')
    axes.set_ylabel('stiffness over its model')
    axes.set_title(title, fontsize=9)
    figure.legend(loc='outside lower center', ncols=2, fontsize=8)
    return figure


def describe_assumptions(loop: CertifiedLoop, setup: Setup) -> str:
    """Return under which conditions a certificate holds, as lines of text."""
    limit = loop.limit
    rate = 'may jump'
    if limit.slew_time > 0.0:
        rate = f'changes by a factor e in {limit.slew_time:g} s at most'
    lines = [
        f'R: {limit.smallest:g} to {limit.largest:g} N^2, {rate}',
        f'tool: {loop.tool_mass[0]:.3g} to {loop.tool_mass[1]:.3g} kg; '
        f'mobility: {loop.mobility[0]:.4g} to {loop.mobility[1]:.4g} 1/kg; '
        f'model of {loop.contact}: {loop.stiffness:g} N/m',
        OUTSIDE,
    ]
    if setup.controller.force.stiffness == 'adaptive':
        lines.append('the stiffness of the model: held, not while it is found')
    slew_time = setup.noise_estimator.slew_time
    if slew_time < limit.slew_time:
        lines.append(
            f'for this to hold set noise_estimator.slew_time to {limit.slew_time:g} s; the '
            f'configuration has {slew_time:g} s'
        )
    return '\n'.join(lines)


def describe_box(box: CertifiedBox, period: float) -> str:
    """Return a certified box as a line of text."""
    first, last = (1e3 * delay for delay in box.delay)
    low, high = box.ratio
    rate = box.certificate.decay_rate(period)
    return (
        f'T_d {first:.1f} to {last:.1f} ms, {low:.3f} to {high:.3f} of the stiffness: '
        f'decays at {rate:.3g} 1/s or faster'
    )


def describe_strip(strip: CertifiedStrip, period: float) -> str:
    """Return the boxes of a strip, and up to where it is stable, as lines of text."""
    first, last = (1e3 * edge for edge in strip.delay)
    lines = [describe_box(box, period) for box in strip.boxes]
    lines.append(
        f'T_d {first:.1f} to {last:.1f} ms: withstands attacks up to '
        f'{strip.edges.attacked:.3f}, stable with R held up to {strip.edges.held:.3f} of the '
        'stiffness'
    )
    return '\n'.join(lines)


def describe_share(share: RegionShare) -> str:
    """Return how much of the stable area is certified, as a line of text."""
    return (
        f'certified: {100.0 * share.of_attacked:.0f} % of the area that withstands attacks, '
        f'{100.0 * share.of_held:.0f} % of that with R held (from a ratio of {LOWEST_RATIO:g} on)'
    )


def describe_attacks(result: AttackResult) -> str:
    """Return what attacks came to, as a line of text."""
    return (
        f'{result.runs} attacks: {result.violations} with less than the certified fall of V; '
        f'largest V {result.largest_share:.4f} of what is certified, '
        f'largest growth of a norm by e^{result.largest_growth:.1f}'
    )
