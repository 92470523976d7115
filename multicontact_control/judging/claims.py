"""The paper's claims (P04 sec. 4.1, 4.2, 5.2): a table of measures and bounds, and one loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from statistics import median
from typing import Any, NamedTuple

from multicontact_control.judging import metrics
from multicontact_control.judging.verdict import (
    DESIGNED_MOTION_ERROR,
    HELD,
    LONGEST_RISE,
    SHORTEST_RISE,
)
from multicontact_control.runs.recording import RunData
from multicontact_control.runs.scenario import Setup
import numpy as np

PAPER_SCENARIO = 'paper'
AFTER_PUSH = 0.5  # s, in which the estimate of R is watched for a reaction
MISMATCH = 0.1  # of the modelled stiffness, beyond which it counts as not known exactly
PAPER_ESTIMATOR, FIXED, UNFILTERED, MAYBECK = (
    'lead_window',
    'fixed',
    'window rescaled',
    'innovation',
)
MATCHED = 'innovation matched'  # with a Q that makes its observer as fast as the paper's at rest

Evidence = Mapping[
    str, Any
]  # of a run, as from `evidence_of`, or of one of its contacts
Runs = Sequence[Evidence]  # `estimator` is with its variant, e.g. `window rescaled`
Numbers = list[tuple[str, float]]  # of contacts or runs by name; infinite for `never`


@dataclass(frozen=True)
class Statement:
    """What the paper says, and between which numbers it holds."""

    text: str
    paper: str  # where, or the figure it gives
    select: Callable[
        [Runs], Runs
    ]  # runs that tell, of which that to be judged is the first
    measure: Callable[[Evidence], Numbers]  # of one of them
    what: str  # the numbers are
    form: str = (
        '{:.2f}'  # of a number, with its unit; without a number what is counted of runs
    )
    low: float = 0.0  # bounds of every number
    high: float = math.inf
    over: str = ''  # estimator that medians of the worst of each run are relative to

    def numbers(self, runs: Runs) -> Numbers:
        """Return the numbers of the runs that it is about, none if they do not tell."""
        if not self.over:
            return [number for run in self.select(runs) for number in self.measure(run)]
        chosen, base = (
            [
                max(value for _, value in numbers)
                for run in some
                if (numbers := self.measure(run))
            ]
            for some in (self.select(runs), runs_with(self.over)(runs))
        )
        if not chosen or not base or not 0.0 < median(base) < math.inf:
            return []
        return [('', median(chosen) / median(base))]

    def show(self, numbers: Numbers) -> str:
        """Return numbers as text: their range for each name, or of how many runs it is true."""
        if '{' not in self.form:
            return f'{sum(value for _, value in numbers):.0f} of {len(numbers)} {self.form}'
        ranges = []
        for name in dict.fromkeys(name for name, _ in numbers):
            values = sorted(value for each, value in numbers if each == name)
            ends = (
                self.form.format(value) if math.isfinite(value) else 'never'
                for value in (values[0], values[-1])
            )
            ranges.append(f'{name} {" to ".join(dict.fromkeys(ends))}'.strip())
        return ', '.join(ranges)

    def bound(self) -> str:
        """Return between which numbers it holds, as text."""
        if '{' not in self.form:
            return f'{"all" if self.low else "none"} {self.form}'
        low, high = self.form.format(self.low), self.form.format(self.high)
        if math.isinf(self.high):
            return f'at least {low}'
        return f'at most {high}' if self.low == 0.0 else f'{low} to {high}'


class Claim(NamedTuple):
    """One row of the claims table: what the paper says, and what the data say of it."""

    claim: str
    paper: str
    measured: str
    holds: bool | None  # None if the data cannot tell
    why: str


def claims_of(
    data: RunData,
    setup: Setup,
    summary: Mapping[str, Any],
    *,
    asked: bool = False,
) -> list[Claim]:
    """Judge the paper's claims by a simulated run of its scenario, if `asked` by any scenario."""
    of_the_paper = setup.scenario.name == PAPER_SCENARIO
    if setup.commanded_by_topic or not setup.simulated or not (asked or of_the_paper):
        return []
    return judge_claims(evidence_of(data, setup, summary))


def judge_claims(evidence: Evidence, comparison: Runs = ()) -> list[Claim]:
    """Judge every claim by the evidence of a run; runs of another plant or K_2 are left out."""
    runs = [
        evidence,
        *(
            run
            for run in comparison
            if all(run[name] == evidence[name] for name in ('plant', 'damping_rate'))
        ),
    ]
    claims = []
    for each in STATEMENTS:
        numbers = each.numbers(runs)
        claims.append(
            Claim(
                each.text,
                each.paper,
                each.show(numbers) if numbers else 'not measured by this run',
                all(each.low <= value <= each.high for _, value in numbers)
                if numbers
                else None,
                f'{each.what}: {each.bound()}',
            )
        )
    return claims


def evidence_of(
    data: RunData, setup: Setup, summary: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what studies tabulate and claims rest on, of a simulated run, as JSON values."""
    force, run = setup.controller.force, metrics.RunMetrics(data, setup)
    unstable_at, start = summary['unstable_at_s'], run.motion_start
    return {
        'plant': setup.plant_name,
        'seed': setup.seed,
        'estimator': setup.noise_estimator.estimator,
        'active_state_order': force.active_state_order,
        'damping_rate': force.damping_rate,
        'designed_rise_s': metrics.designed_rise(force),
        # What the supervisor holds tells nothing of what the law alone would do.
        'stable': None if summary['verdict'] == HELD else summary['stable'],
        'unstable_after_motion_s': None
        if unstable_at is None or math.isinf(start)
        else (unstable_at - start),
        'ran_in_motion': float(data.time[-1]) > start + metrics.SETTLE_AFTER_START,
        'contacts': {
            name: {
                **_contact_evidence(run, i),
                'recoveries': run.recoveries(i, unstable_at),
                'rises_s': [
                    step['rise_63_s']
                    for step in summary['contacts'][name]['steps']
                    if step['size_n'] > 0.0
                ],
            }
            for i, name in enumerate(data.contact_names)
        },
        'motion': summary['motion'],
    }


def _contact_evidence(run: metrics.RunMetrics, i: int) -> dict[str, Any]:
    plant, start = run.setup.plant, run.motion_start
    error, variance = run.error[:, i], run.data.noise_variance[:, i]
    ratios = [
        plant.stiffness_of(column.name) / column.stiffness
        for column in run.setup.controller.columns
        if column.leader == i
    ]
    pushed = np.zeros(run.data.ticks, dtype=bool)
    for begin, duration in run.pushes:
        pushed |= run.between(begin, min(begin + duration + AFTER_PUSH, start))
    return {
        **{
            name: {
                'command_n': metrics.value_in(window, run.command[:, i], np.median),
                'rms_n': metrics.rms_in(window, error),
                'mean_n': metrics.value_in(window, error),
                'std_n': metrics.value_in(window, error, np.std),
                'lost': run.lost_share(i, window),
                'variance_n2': metrics.value_in(window, variance, np.median),
            }
            for name, window in zip(('rest', 'moving'), run.quiet)
        },
        # None of a couple.
        'stiffness_ratio': max(
            ratios, key=lambda ratio: abs(ratio - 1.0), default=None
        ),
        'start_peak_n': metrics.value_in(
            run.between(start, start + metrics.SETTLE_AFTER_START),
            np.abs(error),
            np.max,
        ),
        'variance_peak_n2': metrics.value_in(pushed, variance, np.max),
    }


def the_run(*estimators: str) -> Callable[[Runs], Runs]:
    """Select the run itself, with R from one of some estimators, or from any."""
    return lambda runs: [
        run for run in runs[:1] if not estimators or run['estimator'] in estimators
    ]


def runs_with(*estimators: str) -> Callable[[Runs], Runs]:
    """Select the runs of the first estimator that has any, with active state and right model."""

    def select(runs: Runs) -> Runs:
        candidates = (
            [
                run
                for run in runs[1:]
                if run['estimator'] == estimator
                and not _mismatched(run)
                and run['active_state_order'] > 0
            ]
            for estimator in estimators
        )
        return next(filter(None, candidates), the_run(*estimators)(runs))

    return select


def wrong_stiffness(runs: Runs) -> Runs:
    """Select the runs of the paper's filter whose surfaces are not as stiff as modelled."""
    return [
        run
        for run in runs
        if run['estimator'].startswith(PAPER_ESTIMATOR)
        and _mismatched(run)
        and run['active_state_order'] > 0
    ]


def _pressed(run: Evidence) -> dict[str, Evidence]:
    """Return the contacts: the paper speaks of normal forces, and couples may well be 0."""
    return {
        name: contact
        for name, contact in run['contacts'].items()
        if contact['stiffness_ratio'] is not None
    }


def _mismatched(run: Evidence) -> bool:
    return any(
        abs(contact['stiffness_ratio'] - 1.0) > MISMATCH
        for contact in _pressed(run).values()
    )


def of_contacts(
    number: Callable[[Evidence, Evidence], float | None],
) -> Callable[[Evidence], Numbers]:
    """Return the measure of a number of each contact, from its evidence and that of the run."""
    return lambda run: [
        (name, value)
        for name, contact in _pressed(run).items()
        if (value := number(contact, run)) is not None
    ]


def _rises(run: Evidence) -> Numbers:
    """Return rise times over the designed one; a run that did not go on tells no `never`."""
    rises = [
        (name, rise)
        for name, contact in _pressed(run).items()
        for rise in contact['rises_s']
    ]
    return (
        []
        if run['stable'] is None and any(rise is None for _, rise in rises)
        else [
            (name, math.inf if rise is None else rise / run['designed_rise_s'])
            for name, rise in rises
        ]
    )


def _motion(name: str, scale: float) -> Callable[[Evidence], Numbers]:
    return lambda run: (
        [('', scale * run['motion'][name])]
        if (run['motion'][name] is not None and run['ran_in_motion'])
        else []
    )


def _moving_error(contact: Evidence, run: Evidence) -> float | None:
    """Return the rms error in motion over the command, infinite where the contact is lost."""
    moving = contact['moving']
    if run['stable'] is None or run['stable'] and moving['rms_n'] is None:
        return None
    kept = run['stable'] and not moving['lost']
    return float(moving['rms_n'] / moving['command_n']) if kept else math.inf


def _static_error(contact: Evidence, run: Evidence) -> float | None:
    """Return the mean error at rest over the command, infinite if the run is not stable."""
    rest = contact['rest']
    if run['stable'] is None or not rest['command_n']:
        return None
    return abs(rest['mean_n']) / rest['command_n'] if run['stable'] else math.inf


def _ratio(value: float | None, base: float | None) -> float | None:
    return value / base if value is not None and base else None


def _unstable(*, in_motion: bool) -> Callable[[Evidence], Numbers]:
    def measure(run: Evidence) -> Numbers:
        if run['stable'] is None or run['stable'] and not run['ran_in_motion']:
            return []
        moved = (run['unstable_after_motion_s'] or -1.0) >= 0.0
        return [('', float(not run['stable'] and (moved or not in_motion)))]

    return measure


def _recoveries(run: Evidence) -> Numbers:
    """Return how long lasting pushes at rest take to be controlled out [s]."""
    return [
        (name, math.inf if answer['recovery'] is None else answer['recovery'])
        for name, contact in _pressed(run).items()
        for answer in contact['recoveries']
        if not answer['moving'] and answer['duration'] >= metrics.LASTING
    ]


STATEMENTS = (
    Statement(
        "Maybeck's innovation-based estimate of R is too sensitive to disturbances",
        'sec. 4.2',
        runs_with(MATCHED, MAYBECK),
        of_contacts(
            lambda contact, run: _ratio(
                contact['variance_peak_n2'], contact['rest']['variance_n2']
            )
        ),
        "rise of R at a push, over that with the paper's filter",
        '{:.1f} x',
        low=5.0,
        over=PAPER_ESTIMATOR,
    ),
    Statement(
        'The contact forces follow their commands with the designed time constant',
        'time constant 0.02 s (Figs 3, 4)',
        the_run(),
        _rises,
        '63 % of a step, over the design',
        '{:.2f} x',
        SHORTEST_RISE,
        LONGEST_RISE,
    ),
    Statement(
        'The motion is tracked',
        'Fig. 5',
        the_run(),
        _motion('moving_position_rms_m', 1e3),
        'rms error of the position in motion',
        '{:.2f} mm',
        high=1e3 * DESIGNED_MOTION_ERROR,
    ),
    Statement(
        'The orientation stays fixed',
        'Fig. 5',
        the_run(),
        _motion('orientation_max_rad', 1.0),
        'largest error',
        '{:.4f} rad',
        high=0.02,
    ),
    Statement(
        'The noise variance is about 0.6 N² at rest',
        '0.6 N² (Fig. 6)',
        the_run(PAPER_ESTIMATOR),
        of_contacts(lambda contact, run: contact['rest']['variance_n2']),
        'median, for which the simulated noise is calibrated',
        '{:.2f} N²',
        0.3,
        1.2,
    ),
    Statement(
        'It rises to about 100 N² when the arm moves',
        '100 N² (Fig. 6)',
        the_run(PAPER_ESTIMATOR),
        of_contacts(lambda contact, run: contact['moving']['variance_n2']),
        'median, for which the simulated roughness is calibrated',
        '{:.2f} N²',
        100.0 / 3.0,
        300.0,
    ),
    Statement(
        'On-line estimation of R keeps the control working in motion',
        'Figs 3-6',
        the_run(PAPER_ESTIMATOR),
        _unstable(in_motion=False),
        'runs',
        'unstable',
        high=0.0,
    ),
    Statement(
        'The contact forces are not too affected by the motion',
        'Figs 3, 4',
        the_run(),
        of_contacts(_moving_error),
        'rms error in motion over the command, no contact lost',
        '{:.1%}',
        high=0.2,
    ),
    Statement(
        'Starting the motion disturbs both contact forces significantly',
        'near 195, 205 and 217 s',
        the_run(),
        of_contacts(
            lambda contact, run: _ratio(
                contact['start_peak_n'] if run['ran_in_motion'] else None,
                contact['rest']['std_n'],
            )
        ),
        'largest error in the first 2 s over the standard deviation at rest',
        '{:.1f} x',
        low=5.0,
    ),
    Statement(
        'A stiffness that is not known exactly is compensated',
        '6000 N/m for both, "not perfect"',
        wrong_stiffness,
        of_contacts(_static_error),
        'mean error at rest over the command',
        '{:.1%}',
        high=0.02,
    ),
    Statement(
        'It leaves the force dynamics as designed',
        '6000 N/m for both, "not perfect"',
        wrong_stiffness,
        _rises,
        '63 % of a step, over the design',
        '{:.2f} x',
        SHORTEST_RISE,
        LONGEST_RISE,
    ),
    Statement(
        'Without on-line R the control works only at rest; motion makes it unstable',
        'sec. 5.2',
        runs_with(FIXED),
        _unstable(in_motion=True),
        'runs',
        'unstable in motion',
        low=1.0,
    ),
    Statement(
        'Without the high-pass filter the system responds much slower to disturbances',
        'sec. 5.2',
        runs_with(UNFILTERED),
        _recoveries,
        'recovery from a lasting push, over that with the filter',
        '{:.1f} x',
        low=2.0,
        over=PAPER_ESTIMATOR,
    ),
)
