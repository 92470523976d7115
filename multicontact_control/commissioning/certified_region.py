"""
For which surfaces and delays a configured force loop is certified; what attacks it withstands.

`force/certificate.py` proves one box of plants; here boxes are put side by side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.commissioning.arm_loop import ArmLoop
from multicontact_control.config import ForceConfig, NoiseEstimatorConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.adversary import attack, AttackedLoops
from multicontact_control.force.certificate import (
    Certificate,
    find_certificate,
    GainScheduledLoop,
)
from multicontact_control.force.gain_tube import enclose_gains, RateLimit
from multicontact_control.force.laws.aob import design_aob
from multicontact_control.force.laws.design import LoopModel
from multicontact_control.force.loop_family import (
    Box,
    enclose_loops,
    ForceLoopModel,
    Range,
)
from multicontact_control.force.observer import solve_steady_gain
from multicontact_control.runs.scenario import Setup
import numpy as np
from numpy.random import Generator
from scipy.linalg import solve_discrete_lyapunov

FIRST_FACTOR = 1.25  # of the stiffness, over the first box that is tried
LAST_FACTOR = 1.07  # at which the search for a boundary ends
LOWEST_RATIO, HIGHEST_RATIO = 0.1, 10.0  # true over modelled stiffness, of the search
STRIP = 0.5  # of a period, delays of one box
LONGEST_ATTACK = 2000  # periods
LARGEST_FALL = 1e4  # of V, after which an attack ends
RUNS_PER_POINT = 8
TIME_CONSTANTS = np.geomspace(0.01, 0.16, 13).tolist()  # s, of a design
OUTSIDE = """outside the model, and so of the proof: flexible drives, stiction, torque limits, loss
of contact, what the contacts do to each other through the arm, samples without a force"""


@dataclass(frozen=True)
class CertifiedLoop:
    """A force loop whose region is asked for, and what is known of its R, tool and arm."""

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

    def sample(self, stiffness: float, delay: float, rng: Generator) -> Matrix:
        """Return [A, N] of one plant, of a tool and an arm within their ranges."""
        tool_mass, mobility = rng.uniform(self.tool_mass), rng.uniform(self.mobility)
        point = Box(
            (stiffness, stiffness),
            (delay, delay),
            (tool_mass, tool_mass),
            (mobility, mobility),
        )
        loop: Matrix = enclose_loops(self.model, point).vertices[0]
        return loop


def describe_loop(
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
        arm.model_of(0),
        float(arm.stiffness[0]),
        RateLimit(bounds.smallest, bounds.largest, slew_time),
        tool_mass or (own_mass, own_mass),
        mobility or (own_mobility, own_mobility),
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


def find_region(loop: CertifiedLoop, delay: Range) -> Iterator[CertifiedBox]:
    """
    Yield certified boxes of one strip of delays, from a ratio of 1 upwards, then downwards.

    Where a box is not certified its factor becomes its square root, until that is below 1.07;
    there the region ends.
    """
    for upwards in (True, False):
        reached = 1.0
        factor = FIRST_FACTOR
        while factor >= LAST_FACTOR and LOWEST_RATIO < reached < HIGHEST_RATIO:
            ratio = (reached, reached * factor)
            if not upwards:
                ratio = (reached / factor, reached)
            k = (ratio[0] * loop.stiffness, ratio[1] * loop.stiffness)
            certificate = loop.certify(k, delay)
            if certificate is None:
                factor = math.sqrt(factor)
                continue
            yield CertifiedBox(ratio, delay, certificate)
            reached = ratio[1] if upwards else ratio[0]


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
    per_box = max(runs // len(boxes), 1)
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


def withstand_attacks(
    loop: CertifiedLoop, delay: Range, ratios: Vector, rng: Generator
) -> Mask:
    """
    Return at which ratios no attack made a loop grow, in the middle of a strip of delays.

    The greedy adversaries follow a Lyapunov function of the middle gain; shape (m,).
    """
    middle = 0.5 * (delay[0] + delay[1])
    gain = solve_steady_gain(
        loop.model.observer, math.sqrt(loop.limit.smallest * loop.limit.largest)
    )
    withstood = []
    for ratio in ratios:
        matrices = []
        for _ in range(RUNS_PER_POINT):
            matrices.append(loop.sample(ratio * loop.stiffness, middle, rng))
        attacked = _make_attacked(loop, matrices, delay)
        s = len(attacked.innovation)
        held = matrices[0][:, :s] + np.outer(
            matrices[0][:, s:] @ gain, attacked.innovation
        )
        radius = np.abs(np.linalg.eigvals(held)).max()
        if radius >= 1.0:
            withstood.append(False)
            continue
        scale = np.array([1e-4, 1e-3] + [0.1] * (s - 2))
        inner = held / scale[:, None] * scale
        P = solve_discrete_lyapunov(inner.T, np.eye(s)) / np.outer(scale, scale)
        measure = Certificate(np.zeros(1), P[None], 1.0)
        result = attack(attacked, measure, LONGEST_ATTACK, rng)
        grows = (result.growth > 0.0) & (result.late_growth > 0.0)
        withstood.append(not grows.any())
    return np.array(withstood)


class CertifiedDesign(NamedTuple):
    """The fastest time constant whose region contains what was asked for."""

    time_constant: float  # [s]
    decay_rate: float  # the slowest that is certified [1/s]


def design_certified(
    loop: CertifiedLoop, force: ForceConfig, stiffness: Range, delay: Range
) -> CertifiedDesign:
    """
    Return the fastest of the `TIME_CONSTANTS` with which all surfaces and delays are certified.

    The model has the geometric mean of the stiffness [N/m] and the middle delay [s]. Found by
    bisection: a slower loop is taken to be certified where a faster one is.

    Raises
    ------
    ConfigError
        If not even the slowest is certified.

    """
    middle = LoopModel(
        math.sqrt(stiffness[0] * stiffness[1]),
        loop.model.damping_rate,
        0.5 * (delay[0] + delay[1]),
        loop.model.period,
    )

    def certify(time_constant: float) -> CertifiedDesign | None:
        observer = design_aob(
            middle, force.model_copy(update={'time_constant': time_constant})
        )
        candidate = replace(loop, model=replace(loop.model, observer=observer))
        rates = []
        for strip in split_delays(delay, loop.model.period):
            for k in _split_stiffness(stiffness):
                certificate = candidate.certify(k, strip)
                if certificate is None:
                    return None
                rates.append(certificate.decay_rate(loop.model.period))
        return CertifiedDesign(time_constant, min(rates))

    low, high = 0, len(TIME_CONSTANTS) - 1
    best = certify(TIME_CONSTANTS[high])
    if best is None:
        raise ConfigError(
            'stiffness',
            'a range that a time constant up to '
            f'{1e3 * TIME_CONSTANTS[-1]:.0f} ms is certified on',
            f'{stiffness[0]:g} to {stiffness[1]:g} N/m',
        )
    while low < high:
        tried = (low + high) // 2
        found = certify(TIME_CONSTANTS[tried])
        if found is None:
            low = tried + 1
        else:
            best = found
            high = tried
    return best


def _split_stiffness(stiffness: Range) -> list[Range]:
    """Return ranges of stiffness [N/m] of equal factors, as wide as a box mostly bears."""
    factor = FIRST_FACTOR
    count = max(math.ceil(math.log(stiffness[1] / stiffness[0]) / math.log(factor)), 1)
    edges = np.geomspace(*stiffness, count + 1).tolist()
    return list(zip(edges[:-1], edges[1:]))


def describe_assumptions(loop: CertifiedLoop, estimator: NoiseEstimatorConfig) -> str:
    """Return under which conditions a certificate holds, as lines of text."""
    limit = loop.limit
    rate = 'may jump'
    if limit.slew_time > 0.0:
        rate = f'changes by a factor e in {limit.slew_time:g} s at most'
    lines = [
        f'R: {limit.smallest:g} to {limit.largest:g} N^2, {rate}',
        f'tool: {loop.tool_mass[0]:.3g} to {loop.tool_mass[1]:.3g} kg; '
        f'mobility: {loop.mobility[0]:.4g} to {loop.mobility[1]:.4g} 1/kg; '
        f'model: {loop.stiffness:g} N/m',
        OUTSIDE,
    ]
    if estimator.slew_time < limit.slew_time:
        lines.append(
            f'for this to hold set noise_estimator.slew_time to {limit.slew_time:g} s; the '
            f'configuration has {estimator.slew_time:g} s'
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


def describe_attacks(result: AttackResult) -> str:
    """Return what attacks came to, as a line of text."""
    return (
        f'{result.runs} attacks: {result.violations} with less than the certified fall of V; '
        f'largest V {result.largest_share:.4f} of what is certified, '
        f'largest growth of a norm by e^{result.largest_growth:.1f}'
    )


def describe_certified(
    found: CertifiedDesign, force: ForceConfig, stiffness: Range
) -> str:
    """Return a certified design and what it costs, as lines of text."""
    middle = math.sqrt(stiffness[0] * stiffness[1])
    return f"""force:
  time_constant: {found.time_constant:.4g}
model: {middle:.0f} N/m (--set 'controller.contacts.*.stiffness={middle:.0f}')
certified decay     {found.decay_rate:.3g} 1/s or faster
the preset has      {1e3 * force.time_constant:.3g} ms, {
        found.time_constant / force.time_constant:.2f} times as slow is certified"""
