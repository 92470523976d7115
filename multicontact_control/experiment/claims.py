"""
The paper's claims (P04 sec. 4.1, 4.2, 5.2), each put to the recorded data.

A claim is judged from `evidence_of` a run, and, where it compares ways of estimating R, from the
evidence of the runs of a comparison on the same plant. What is not in the data is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
import math
from statistics import median
from typing import Any, NamedTuple

from multicontact_control.arrays import Mask
from multicontact_control.config import ForceConfig
from multicontact_control.experiment.judge import HELD, verdict_text
from multicontact_control.experiment.metrics import (
    after_motion,
    force_error,
    lost_share,
    mean_in,
    median_in,
    motion_start,
    motion_summary,
    quiet_windows,
    rms_in,
    SETTLE_AFTER_START,
    step_responses,
    torque_summary,
    value_in,
)
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np
from scipy.optimize import brentq

REST_FACTOR = 2.0  # R at rest agrees with the paper's within this factor,
MOVING_FACTOR = 3.0  # R in motion within this one
RISE_TOLERANCE = 0.4  # of the designed rise time
LARGEST_MOVING_SHARE = 0.2  # of the command, for a force error "not too affected" by motion
LARGEST_STATIC_SHARE = 0.02  # of the command, for a compensated error at rest
START_FACTOR = 5.0  # standard deviations at rest, for a start of motion that disturbs
SLOWER_FACTOR = 2.0  # for a recovery that is "much slower"
SENSITIVE_FACTOR = 5.0  # more than the paper's estimator, for one "too sensitive"
LARGEST_TRACKING_ERROR = 5e-3  # m
LARGEST_TURN = 0.02  # rad
AFTER_PUSH = 0.5  # s, in which the estimate of R is watched for a reaction
MISMATCH = 0.1  # from which on a stiffness counts as not known exactly

PAPER_ESTIMATOR = 'lead_window'
FIXED = 'fixed'
UNFILTERED = 'window rescaled'
MAYBECK = 'innovation'
MATCHED = 'innovation matched'  # with a Q that makes its observer as fast as the paper's at rest


@dataclass(frozen=True)
class Claim:
    """One row of the claims table: what the paper says, and what the data say of it."""

    claim: str
    paper: str  # the figure it gives
    measured: str
    holds: bool | None  # None if the data cannot tell
    why: str

    def to_json(self) -> dict[str, Any]:
        """Return the row as in ``summary.json``."""
        return asdict(self)


class Row(NamedTuple):
    """The evidence of one cell of a comparison."""

    label: str  # of the estimator and its variant, e.g. `fixed` or `window rescaled`
    evidence: Mapping[str, Any]  # as from `evidence_of`
    recoveries: Mapping[str, Sequence[Mapping[str, Any]]]  # of each contact, from its pushes


NOT_MEASURED = 'not measured by this run'
Evidence = Mapping[str, Any]
Rows = Sequence[Row]
Verdict = tuple[str, bool | None, str]  # what was measured, whether the claim holds, why


class ClaimOverDamping(NamedTuple):
    """One claim at several values of K_2, which the paper leaves open."""

    verdicts: Mapping[float, Claim]  # by K_2 [1/s]

    @property
    def depends(self) -> bool:
        """Return whether the data say yes at one K_2 and no at another."""
        return len({claim.holds for claim in self.verdicts.values()} - {None}) > 1


def judge_over_damping(claims: Mapping[float, Sequence[Claim]]) -> list[ClaimOverDamping]:
    """Put the verdicts on every claim side by side; `claims` are those of each K_2 [1/s]."""
    return [ClaimOverDamping(dict(zip(claims, each))) for each in zip(*claims.values())]


def designed_rise(force: ForceConfig) -> float:
    """
    Return the time in which the designed loop reaches 63 % of a step of the true force [s].

    T_d of the input plus the time at which the response of the two poles reaches 1 - 1/e.
    """
    tau, ratio = force.time_constant, force.second_pole_ratio

    def missing(t: float) -> float:
        if abs(ratio - 1.0) < 1e-6:
            return (1.0 + t) * math.exp(-t) - math.exp(-1.0)
        return (ratio * math.exp(-t) - math.exp(-ratio * t)) / (ratio - 1.0) - math.exp(-1.0)

    return float(force.input_delay + tau * brentq(missing, 0.0, 10.0))


def evidence_of(data: RunData, setup: Setup, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the claims rest on, of a run and its summary, as JSON values."""
    start = motion_start(setup)
    return {
        'scenario': setup.scenario.name, 'plant': setup.plant_name, 'seed': setup.seed,
        'drives': setup.plant.drives, 'estimator': setup.noise_estimator.estimator,
        'active_state_order': setup.controller.force.active_state_order,
        'damping_rate': setup.controller.force.damping_rate,
        'input_delay_s': setup.controller.force.input_delay,
        'designed_rise_s': designed_rise(setup.controller.force),
        **{name: summary[name] for name in (
            'verdict', 'instabilities', 'unjudged', 'unstable_at_s')},
        # What the supervisor holds tells nothing of what the law alone would do.
        'stable': None if summary['verdict'] == HELD else summary['stable'],
        'unstable_after_motion_s': after_motion(setup, summary['unstable_at_s']),
        'ran_in_motion': float(data.time[-1]) > start + SETTLE_AFTER_START,
        # The paper speaks of normal forces; couples may well be 0, or of either sign.
        'contacts': {data.contact_names[i]: _contact_evidence(data, setup, i)
                     for i in setup.controller.leaders},
        'motion': motion_summary(data, setup), 'torque': torque_summary(data, setup)}


def _contact_evidence(data: RunData, setup: Setup, i: int) -> dict[str, Any]:
    rest, moving = quiet_windows(data, setup)
    error, command = force_error(data, setup, i), setup.commanded(data.time)[:, i]
    variance = data.noise_variance[:, i]
    steps = [step for step in step_responses(data, setup, i) if step.size > 0.0]
    ratios = [setup.plant.stiffness_of(column.name) / column.stiffness
              for column in setup.controller.columns if column.leader == i]
    start = motion_start(setup)
    return {
        'stiffness_ratio': max(ratios, key=lambda ratio: abs(ratio - 1.0)),
        'variance_rest_n2': median_in(rest, variance),
        'variance_moving_n2': median_in(moving, variance),
        'rises_s': [step.rise_63 for step in steps],
        'overshoot_percent': max((step.overshoot_percent for step in steps), default=None),
        'rest_command_n': median_in(rest, command),
        'rest_mean_error_n': mean_in(rest, error), 'rest_std_n': value_in(rest, error, np.std),
        'moving_command_n': median_in(moving, command),
        'moving_rms_n': rms_in(moving, error),
        'moving_lost': lost_share(data, setup, i, moving),
        'start_peak_n': value_in(
            (data.time >= start) & (data.time - start < SETTLE_AFTER_START), np.abs(error),
            np.max),
        'variance_peak_n2': value_in(_pushed_at_rest(data, setup), variance, np.max)}


def _pushed_at_rest(data: RunData, setup: Setup) -> Mask:
    """Return the samples of the pushes at rest and of 0.5 s after each."""
    until = motion_start(setup)
    mask = np.zeros(data.ticks, dtype=bool)
    for start, duration in zip(setup.plant.push_start, setup.plant.push_duration):
        if start < until:
            end = min(start + duration + AFTER_PUSH, until)
            mask |= (data.time >= start) & (data.time < end)
    return mask


def claims_of(
    data: RunData, setup: Setup, summary: Mapping[str, Any], comparison: Rows = (),
) -> list[Claim]:
    """
    Judge the paper's claims by a run and the rows of a comparison.

    They are about a simulated plant that plays its scenario; of other runs there are none.
    """
    if setup.commanded_by_topic or not setup.simulated:
        return []
    return judge_claims(evidence_of(data, setup, summary), comparison)


def judge_claims(evidence: Evidence, comparison: Rows = ()) -> list[Claim]:
    """
    Judge every claim by the evidence of a run, in the paper's order.

    Rows of another plant or K_2 are left out.
    """
    rows = [row for row in comparison if all(
        row.evidence.get(name) == evidence.get(name) for name in ('plant', 'damping_rate'))]
    return [Claim(claim, paper, *judge(evidence, rows)) for claim, paper, judge in CLAIMS]


def _values(evidence: Evidence, name: str) -> list[float]:
    return [contact[name] for contact in evidence['contacts'].values()
            if contact[name] is not None]


def _unknown(why: str) -> Verdict:
    return NOT_MEASURED, None, why


def _each(evidence: Evidence, name: str, digits: int, unit: str) -> str:
    return ', '.join(f'{contact} {values[name]:.{digits}f} {unit}' for contact, values
                     in evidence['contacts'].items() if values[name] is not None)


def _variance(
    evidence: Evidence, rows: Rows, *, name: str, paper: float, factor: float,
) -> Verdict:
    if evidence['estimator'] != PAPER_ESTIMATOR:
        return _unknown(
            f'R came from `{evidence["estimator"]}`, not from the paper\'s filter')
    values = _values(evidence, name)
    if not values:
        return _unknown('the run has no such stretch')
    holds = all(paper / factor <= value <= paper * factor for value in values)
    return (_each(evidence, name, 2, 'N²'), holds,
            'calibrated, not found: noise and roughness of the simulated plant set it; medians '
            f'{"all" if holds else "not all"} within a factor {factor:g} of the paper\'s')


def _rises(evidence: Evidence, rows: Rows) -> Verdict:
    wanted = evidence['designed_rise_s']
    rises = {name: contact['rises_s'] for name, contact in evidence['contacts'].items()}
    if not any(rises.values()):
        return _unknown('the run has no force step at rest')
    found = [rise for answers in rises.values() for rise in answers]
    if evidence['stable'] is None and None in found:  # which may have come later
        return _unknown(verdict_text(evidence))
    holds = all(rise is not None and abs(rise / wanted - 1.0) <= RISE_TOLERANCE for rise in found)
    text = '; '.join(
        f'{name} ' + ', '.join('never' if rise is None else f'{1e3 * rise:.0f}'
                               for rise in answers) + ' ms' for name, answers in rises.items())
    return (f'63 % after {text}', holds,
            f'the two designed poles and T_d take {1e3 * wanted:.0f} ms; '
            f'{"all" if holds else "not all"} steps within {100 * RISE_TOLERANCE:.0f} % of that')


def _start_disturbs(evidence: Evidence, rows: Rows) -> Verdict:
    contacts = evidence['contacts'].values()
    if not evidence['ran_in_motion'] or any(
            c['start_peak_n'] is None or c['rest_std_n'] is None for c in contacts):
        return _unknown('the run has no start of motion after a stretch at rest')
    holds = all(c['start_peak_n'] > START_FACTOR * c['rest_std_n'] for c in contacts)
    return (f"largest error {_each(evidence, 'start_peak_n', 1, 'N')} in the first 2 s, against "
            f"a standard deviation of {_each(evidence, 'rest_std_n', 3, 'N')} at rest", holds,
            f'{"all" if holds else "not all"} contacts beyond {START_FACTOR:g} standard '
            'deviations at rest')


def _moving(evidence: Evidence, rows: Rows) -> Verdict:
    if evidence['stable'] is None:
        return _unknown(verdict_text(evidence))
    contacts = evidence['contacts'].values()
    if any(c['moving_rms_n'] is None for c in contacts):
        if evidence['unstable_after_motion_s'] is not None:
            return 'unstable before the motion was under way', False, verdict_text(evidence)
        return _unknown('the run has no motion')
    holds = evidence['stable'] and all(
        c['moving_rms_n'] <= LARGEST_MOVING_SHARE * c['moving_command_n']
        and not c['moving_lost'] for c in contacts)
    lost = max(c['moving_lost'] for c in contacts)
    return (f"true error {_each(evidence, 'moving_rms_n', 2, 'N')} rms, contact lost for "
            f'{100.0 * lost:.1f} % of the time', holds,
            f'{"within" if holds else "not within"} {100 * LARGEST_MOVING_SHARE:.0f} % of the '
            'command with no contact lost' + ('' if evidence['stable'] else
                                              f'; {verdict_text(evidence)}'))


def _online(evidence: Evidence, rows: Rows) -> Verdict:
    if evidence['estimator'] != PAPER_ESTIMATOR:
        return _unknown(f'R came from `{evidence["estimator"]}`')
    if evidence['stable'] is None:
        return _unknown(verdict_text(evidence))
    if not evidence['ran_in_motion'] and evidence['stable']:
        return _unknown('the run has no motion')
    if evidence['stable']:
        return 'stable at rest and in motion', True, 'no limit of the verdict `stable` was passed'
    return _unstable_text(evidence), False, verdict_text(evidence)


def _unstable_text(evidence: Evidence) -> str:
    after = evidence['unstable_after_motion_s']
    if after is None or after < 0.0:
        return f'before any motion {verdict_text(evidence)}'
    return f'unstable {after:.2f} s after the motion began'


def _tracking(evidence: Evidence, rows: Rows) -> Verdict:
    position = evidence['motion']['moving_position_rms_m']
    turn = evidence['motion']['orientation_max_rad']
    if position is None or not evidence['ran_in_motion']:
        return _unknown('the run has no motion')
    holds = position <= LARGEST_TRACKING_ERROR and turn <= LARGEST_TURN
    return (f'{1e3 * position:.2f} mm rms, orientation within {turn:.4f} rad', holds,
            f'limits {1e3 * LARGEST_TRACKING_ERROR:g} mm and {LARGEST_TURN:g} rad')


def _standard(rows: Rows, label: str) -> list[Row]:
    """Return the runs of one estimator with active state and the right stiffness."""
    return [row for row in rows if row.label == label
            and row.evidence['active_state_order'] > 0
            and not _mismatched(row.evidence)]


def _mismatched(evidence: Evidence) -> bool:
    return any(abs(ratio - 1.0) > MISMATCH for ratio in _values(evidence, 'stiffness_ratio'))


def _stiffness(evidence: Evidence, rows: Rows) -> Verdict:
    judged = [entry for entry in [evidence, *(row.evidence for row in rows if row.label.startswith(
        PAPER_ESTIMATOR) and row.evidence['active_state_order'] > 0)]
        if entry['stable'] is not None and _mismatched(entry)]
    if not judged:
        return _unknown('the simulated stiffness is that of the model; see the cells `stiffness` '
                        'of `multicontact compare`')
    static, dynamic, parts = True, True, []
    for entry in judged:
        ratio = max(_values(entry, 'stiffness_ratio'))
        share = max((abs(c['rest_mean_error_n']) / c['rest_command_n']
                     for c in entry['contacts'].values()
                     if c['rest_mean_error_n'] is not None and c['rest_command_n']),
                    default=float('inf'))
        static = static and entry['stable'] and share <= LARGEST_STATIC_SHARE
        dynamic = dynamic and _rises(entry, ())[1] is True
        parts.append(f'{ratio:g} x: ' + (
            f'mean error {100.0 * share:.1f} % of the command, {_rises(entry, ())[0]}'
            if entry['stable'] else _unstable_text(entry)))
    why = ('' if static else 'not ') + (
        f'every run is stable within {100 * LARGEST_STATIC_SHARE:g} % of its command; the steps '
        f'{"" if dynamic else "do not all "}rise as designed')
    return '; '.join(parts), static and dynamic, why


def _fixed(evidence: Evidence, rows: Rows) -> Verdict:
    judged = [row.evidence for row in _standard(rows, FIXED)]
    if evidence['estimator'] == FIXED and not judged:
        judged = [evidence]
    judged = [entry for entry in judged if entry['stable'] is not None and (
        entry['ran_in_motion'] or not entry['stable'])]
    if not judged:
        known = evidence['estimator'] != FIXED or evidence['stable'] is not None
        return _unknown('needs runs with the estimator `fixed` in motion' if known else
                        verdict_text(evidence))
    in_motion = [entry['unstable_after_motion_s'] for entry in judged
                 if not entry['stable'] and (entry['unstable_after_motion_s'] or -1.0) >= 0.0]
    holds = len(in_motion) == len(judged)
    text = f'unstable in {len(in_motion)} of {len(judged)} runs'
    if in_motion:
        text += f', {min(in_motion):.2f} to {max(in_motion):.2f} s after the motion began'
    why = f'{"" if holds else "not "}every run became unstable in motion'
    return text, holds, why


def _unfiltered(evidence: Evidence, rows: Rows) -> Verdict:
    lead = _recovery(_standard(rows, PAPER_ESTIMATOR), lasting=True)
    slow = _recovery(_standard(rows, UNFILTERED), lasting=True)
    if lead is None or slow is None:
        return _unknown(f'needs cells of `{PAPER_ESTIMATOR}` and `{UNFILTERED}`')
    if not math.isfinite(lead[0]):
        return _unknown('with the filter a lasting push was not controlled out')
    short = [_recovery(_standard(rows, label), lasting=False)
             for label in (PAPER_ESTIMATOR, UNFILTERED)]
    holds = slow[0] >= SLOWER_FACTOR * lead[0]
    text = (f'a lasting push is controlled out {_within(slow[0])}, '
            f'with the filter {_within(lead[0])}')
    if short[0] is not None and short[1] is not None:
        text += (f'; a push of 0.1 s {_within(short[1][0])}, with it {_within(short[0][0])}, '
                 f'peak {short[1][1]:.2f} N against {short[0][1]:.2f} N')
    return text, holds, f'at the same R at rest; {SLOWER_FACTOR:g} times counts as much slower'


def _within(recovery: float) -> str:
    return f'in {recovery:.3f} s' if math.isfinite(recovery) else 'never'


def _recovery(rows: Rows, *, lasting: bool) -> tuple[float, float] | None:
    """Return the median over runs of the slower contact's recovery [s] and larger peak [N]."""
    slowest, peaks = [], []
    for row in rows:
        answers = [answer for answers in row.recoveries.values() for answer in answers
                   if not answer['moving'] and (answer['duration'] >= 0.5) == lasting]
        if answers:
            slowest.append(max(float('inf') if answer['recovery'] is None else answer['recovery']
                               for answer in answers))
            peaks.append(max(answer['peak'] for answer in answers))
    return (median(slowest), median(peaks)) if slowest else None


def _maybeck(evidence: Evidence, rows: Rows) -> Verdict:
    lead = _reaction(_standard(rows, PAPER_ESTIMATOR))
    matched = _standard(rows, MATCHED)
    judged = matched or _standard(rows, MAYBECK)
    other = _reaction(judged)
    if lead is None or other is None:
        return _unknown(f'needs cells of `{PAPER_ESTIMATOR}` and `{MAYBECK}`')
    unstable = sum(row.evidence['stable'] is False for row in judged)
    return (f'pushes at rest lift R to {other:.1f} times its value at rest, against {lead:.1f} '
            f'times with the filter; unstable in {unstable} of {len(judged)} runs',
            other >= SENSITIVE_FACTOR * lead,
            f'{SENSITIVE_FACTOR:g} times the reaction of the filter counts as too sensitive; '
            + ('Q is matched, so that both observers are as fast at rest' if matched else
               'it works at another bandwidth than the filter, with the same Q'))


def _reaction(rows: Rows) -> float | None:
    """Return the median over runs of the largest rise of R at a push, relative to rest."""
    ratios = []
    for row in rows:
        contacts = row.evidence['contacts'].values()
        values = [c['variance_peak_n2'] / c['variance_rest_n2'] for c in contacts
                  if c['variance_peak_n2'] is not None and c['variance_rest_n2']]
        if values:
            ratios.append(max(values))
    return median(ratios) if ratios else None


CLAIMS: tuple[tuple[str, str, Callable[..., Verdict]], ...] = (
    ("Maybeck's innovation-based estimate of R is too sensitive to disturbances", 'sec. 4.2',
     _maybeck),
    ('The contact forces follow their commands with the designed time constant',
     'time constant 0.02 s (Figs 3, 4)', _rises),
    ('The motion is tracked while the orientation stays fixed', 'Fig. 5', _tracking),
    ('The noise variance is about 0.6 N² at rest', '0.6 N² (Fig. 6)',
     partial(_variance, name='variance_rest_n2', paper=0.6, factor=REST_FACTOR)),
    ('It rises to about 100 N² when the arm moves', '100 N² (Fig. 6)',
     partial(_variance, name='variance_moving_n2', paper=100.0, factor=MOVING_FACTOR)),
    ('On-line estimation of R keeps the control working in motion', 'Figs 3-6', _online),
    ('The contact forces are not too affected by the motion', 'Figs 3, 4', _moving),
    ('Starting the motion disturbs both contact forces significantly',
     'near 195, 205 and 217 s', _start_disturbs),
    ('A stiffness that is not known exactly is compensated, with the desired force dynamics',
     '6000 N/m for both, "not perfect"', _stiffness),
    ('Without on-line R the control works only at rest; motion makes it unstable', 'sec. 5.2',
     _fixed),
    ('Without the high-pass filter the system responds much slower to disturbances', 'sec. 5.2',
     _unfiltered))
