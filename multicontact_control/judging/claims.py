"""The paper's claims (P04 sec. 4.1, 4.2, 5.2): what each measures, and within which bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from statistics import median
from typing import Any, NamedTuple

from multicontact_control.judging.contact_metrics import LASTING_PUSH
from multicontact_control.judging.evidence import collect_evidence, Evidence
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.quality import (
    DESIGNED_MOTION_ERROR,
    LONGEST_RISE,
    SHORTEST_RISE,
)

PAPER_SCENARIO = 'paper'
MISMATCH = 0.1  # of the modelled stiffness, beyond which it counts as not known exactly
# Estimators of R with their variant, as the evidence of a study's runs has them.
PAPER_ESTIMATOR = 'lead_window'
FIXED_VARIANCE = 'fixed'
UNFILTERED = 'window rescaled'
MAYBECK = 'innovation'
# With a Q that makes its observer as fast as the paper's at rest.
MATCHED_MAYBECK = 'innovation matched'

Runs = Sequence[Evidence]  # the first one is that to be judged
# Of a run, by contact, or '' for the whole run: None if not known, infinite for `never`.
Measurements = Iterable[tuple[str, float | None]]
Numbers = list[tuple[str, float]]


def select_own_run(runs: Runs, estimators: Sequence[str]) -> Runs:
    """
    Return the run to be judged, if its R is from one of the estimators, or none is named.

    The list has one run or none. What other runs of a study show has no say in such a claim.
    """
    if estimators and runs[0]['estimator'] not in estimators:
        return []
    return runs[:1]


def select_study_runs(runs: Runs, estimators: Sequence[str]) -> Runs:
    """
    Return the runs of a study, with active state and right model, of one estimator.

    It is the first of the estimators that has any run. Without any, the run to be judged is
    taken, if it is of one of them.
    """
    candidates = _list_active_runs(runs[1:], mismatched=False)
    for estimator in estimators:
        chosen = [run for run in candidates if run['estimator'] == estimator]
        if chosen:
            return chosen
    return select_own_run(runs, estimators)


def select_mismatched_runs(runs: Runs, estimators: Sequence[str]) -> Runs:
    """
    Return the runs, with active state, whose surfaces are not as stiff as modelled.

    The run to be judged is among them if it is one. An estimator's name may be the beginning of
    that of a variant.
    """
    names = tuple(estimators)
    candidates = _list_active_runs(runs, mismatched=True)
    return [run for run in candidates if run['estimator'].startswith(names)]


def _list_active_runs(runs: Runs, *, mismatched: bool) -> Runs:
    """Return the runs with active state whose surfaces are, or are not, mismatched."""
    active = []
    for run in runs:
        if run['active_state_order'] > 0 and _is_mismatched(run) == mismatched:
            active.append(run)
    return active


def _list_pressed_contacts(run: Evidence) -> Iterator[tuple[str, Evidence]]:
    """Yield the contacts: the paper speaks of normal forces, and couples may well be 0."""
    for name, contact in run['contacts'].items():
        if contact['stiffness_ratio'] is not None:
            yield name, contact


def _is_mismatched(run: Evidence) -> bool:
    """Return whether any surface is not as stiff as modelled."""
    for _, contact in _list_pressed_contacts(run):
        if abs(contact['stiffness_ratio'] - 1.0) > MISMATCH:
            return True
    return False


def _divide(value: float | None, base: float | None) -> float | None:
    """Return a ratio, None where a part of it is not known or the base is zero."""
    if value is None or not base:
        return None
    return value / base


def _never_if_none(value: float | None) -> float:
    if value is None:
        return math.inf
    return value


def measure_rise(run: Evidence) -> Measurements:
    """
    Yield the rise times of the steps up over the designed one, infinite for `never`.

    The designed one includes the loop's delay. A run that the supervisor held tells no `never`,
    and then nothing of its rise.
    """
    rises = []
    for name, contact in _list_pressed_contacts(run):
        for rise in contact['rises_s']:
            was_held = run['stable'] is None
            if was_held and rise is None:
                return []
            rises.append((name, _never_if_none(rise) / run['designed_rise_s']))
    return rises


def measure_motion_error(run: Evidence) -> Measurements:
    """
    Yield the rms error of the position in motion [mm].

    It counts along the directions that no contact constrains, in the window `moving`. A run that
    ended before the motion yields nothing.
    """
    error = run['motion']['moving_position_rms_m']
    if error is not None and run['ran_in_motion']:
        yield '', 1e3 * error


def measure_orientation_error(run: Evidence) -> Measurements:
    """
    Yield the largest error of the orientation under load [rad].

    It is the angle between the measured and the desired orientation, of a run that came to its
    motion.
    """
    if run['ran_in_motion']:
        yield '', run['motion']['orientation_max_rad']


def measure_variance_at_rest(run: Evidence) -> Measurements:
    """
    Yield the median R of each contact at rest [N^2].

    The median of the window `rest`, pushes left out; of couples nothing, since the paper speaks of
    forces.
    """
    for name, contact in _list_pressed_contacts(run):
        yield name, contact['rest']['variance_n2']


def measure_variance_in_motion(run: Evidence) -> Measurements:
    """
    Yield the median R of each contact in motion [N^2].

    The median of the window `moving`, from 2 s after the start of the motion on: R is greatest at
    the start itself.
    """
    for name, contact in _list_pressed_contacts(run):
        yield name, contact['moving']['variance_n2']


def measure_variance_peak(run: Evidence) -> Measurements:
    """
    Yield the largest R of each contact at a push over its median at rest.

    It is None where there was no push, or R at rest is not known or 0.
    """
    for name, contact in _list_pressed_contacts(run):
        yield name, _divide(contact['variance_peak_n2'], contact['rest']['variance_n2'])


def count_unstable(run: Evidence) -> Measurements:
    """
    Yield 1 for a run that was not stable, 0 for one that was and ran in motion.

    A stable run without motion yields nothing: the paper's point is what happens in motion. So
    does one that was not judged.
    """
    stable = run['stable']
    if stable is False or (stable and run['ran_in_motion']):
        yield '', float(not stable)


def count_unstable_in_motion(run: Evidence) -> Measurements:
    """
    Yield what `count_unstable` does, and 0 for a run that was not stable before its motion.

    Such a run does not show that it is the motion that made it unstable.
    """
    after_motion = run['unstable_after_motion_s']
    began_in_motion = after_motion is not None and after_motion >= 0.0
    for name, unstable in count_unstable(run):
        yield name, unstable and float(began_in_motion)


def measure_error_in_motion(run: Evidence) -> Measurements:
    """
    Yield the rms error in motion over the command, infinite where the contact is lost.

    It is infinite for each contact of a run that was not stable, too. A run that was not judged
    yields nothing.
    """
    for name, contact in _list_pressed_contacts(run):
        moving = contact['moving']
        if run['stable'] is False or (run['stable'] and moving['lost']):
            yield name, math.inf
        elif run['stable'] and moving['rms_n'] is not None:
            yield name, float(moving['rms_n'] / moving['command_n'])


def measure_error_at_rest(run: Evidence) -> Measurements:
    """
    Yield the mean error at rest over the command, infinite if the run is not stable.

    The mean takes out the noise: what stays is what the active state is to compensate. A run that
    was not judged yields nothing.
    """
    for name, contact in _list_pressed_contacts(run):
        rest = contact['rest']
        if rest['command_n'] and run['stable']:
            yield name, abs(rest['mean_n']) / rest['command_n']
        elif rest['command_n'] and run['stable'] is False:
            yield name, math.inf


def measure_start_of_motion(run: Evidence) -> Measurements:
    """
    Yield the largest error as the motion starts over the standard deviation at rest.

    The start is its first 2 s, until the window `moving` begins. Runs that ended before yield
    nothing.
    """
    if run['ran_in_motion']:
        for name, contact in _list_pressed_contacts(run):
            yield name, _divide(contact['start_peak_n'], contact['rest']['std_n'])


def measure_recovery(run: Evidence) -> Measurements:
    """
    Yield how long lasting pushes at rest take to be controlled out [s].

    A push lasts if it takes 0.5 s or more: a shorter one is over before any law could answer.
    Infinite if the force never settled.
    """
    for name, contact in _list_pressed_contacts(run):
        for answer in contact['recoveries']:
            if not answer['moving'] and answer['duration'] >= LASTING_PUSH:
                yield name, _never_if_none(answer['recovery'])


@dataclass(frozen=True)
class Statement:
    """
    What the paper says, how it is measured, and between which numbers it holds.

    It holds if every number that the selected runs give lies within `low` and `high`, both
    included. `select` and `measure` are named functions of this module; what differs from claim to
    claim is data.
    """

    text: str
    paper: str  # where, or the figure it gives
    measure: Callable[[Evidence], Measurements]  # of a run that tells
    what: str  # the numbers are
    form: str = ''  # of a number, with its unit
    # In place of a number: what a run of which the number is 1 is called.
    counted: str = ''
    low: float = 0.0  # bounds of every number
    high: float = math.inf
    select: Callable[[Runs, Sequence[str]], Runs] = select_own_run  # runs that tell
    estimators: tuple[str, ...] = ()  # those whose runs tell, the first one first
    # Estimator: median over its runs, that the median is relative to; of the worst of each run.
    relative_to: str = ''

    def collect_numbers(self, runs: Runs) -> Numbers:
        """
        Return the numbers of the runs that it is about, none if they do not tell.

        Each comes with the name of its contact. With `relative_to` there is a single one: a ratio
        of medians over runs, none where the base is 0 or infinite.
        """
        chosen = self.select(runs, self.estimators)
        if not self.relative_to:
            numbers = []
            for run in chosen:
                numbers += self._measure_known(run)
            return numbers
        base_runs = select_study_runs(runs, (self.relative_to,))
        worst = self._find_median_of_worst(chosen)
        base = self._find_median_of_worst(base_runs)
        if worst is None or base is None or not 0.0 < base < math.inf:
            return []
        return [('', worst / base)]

    def _measure_known(self, run: Evidence) -> Numbers:
        numbers = []
        for name, value in self.measure(run):
            if value is not None:
                numbers.append((name, value))
        return numbers

    def _find_median_of_worst(self, runs: Runs) -> float | None:
        """Return the median over some runs of the largest number of each, None without any."""
        worst = []
        for run in runs:
            numbers = self._measure_known(run)
            if numbers:
                worst.append(max(value for _, value in numbers))
        if not worst:
            return None
        return median(worst)

    def describe_numbers(self, numbers: Numbers) -> str:
        """
        Return numbers as text: their range for each name, or of how many runs it is true.

        An infinite number is `never`. A range whose ends read the same is written once.
        """
        if self.counted:
            count = sum(value for _, value in numbers)
            return f'{count:.0f} of {len(numbers)} {self.counted}'
        by_name: dict[str, list[float]] = {}
        for name, value in numbers:
            by_name.setdefault(name, []).append(value)
        ranges = []
        for name, values in by_name.items():
            smallest = self._describe_number(min(values))
            largest = self._describe_number(max(values))
            text = smallest
            if largest != smallest:
                text = f'{smallest} to {largest}'
            ranges.append(f'{name} {text}'.strip())
        return ', '.join(ranges)

    def _describe_number(self, value: float) -> str:
        if math.isinf(value):
            return 'never'
        return self.form.format(value)

    def describe_bounds(self) -> str:
        """
        Return between which numbers it holds, as text.

        What is counted holds for all runs or for none, since the numbers are 0 or 1 and the bounds
        one of them.
        """
        if self.counted:
            share = 'all' if self.low else 'none'
            return f'{share} {self.counted}'
        low = self.form.format(self.low)
        high = self.form.format(self.high)
        if math.isinf(self.high):
            return f'at least {low}'
        if self.low == 0.0:
            return f'at most {high}'
        return f'{low} to {high}'


class Claim(NamedTuple):
    """
    One row of the claims table: what the paper says, and what the data say of it.

    The fields are the keys of `claims` in ``summary.json``; `why` has the quantity and its bounds,
    so that a reader can disagree with the verdict.
    """

    claim: str
    paper: str
    measured: str
    holds: bool | None  # None if the data cannot tell
    why: str


def judge_claims_of_run(
    run: RunMetrics, summary: Mapping[str, Any], *, any_scenario: bool = False
) -> list[Claim]:
    """
    Judge the paper's claims by a simulated run of its scenario, or of `any_scenario`.

    `summary` is the content of the run's ``summary.json``. Of other runs there are no claims.
    """
    setup = run.setup
    is_scenario = setup.simulated and not setup.commanded_by_topic
    is_meant = any_scenario or setup.scenario.name == PAPER_SCENARIO
    if not (is_scenario and is_meant):
        return []
    return judge_claims(collect_evidence(run, summary))


def judge_claims(evidence: Evidence, comparison: Runs = ()) -> list[Claim]:
    """
    Judge every claim by the evidence of a run; runs of another plant or K_2 are left out.

    `comparison` are the runs of a study, which may have the judged one among them. Without them,
    claims that compare estimators are not judged: their `holds` is None.
    """
    runs = [evidence]
    for run in comparison:
        same_plant = run['plant'] == evidence['plant']
        if same_plant and run['damping_rate'] == evidence['damping_rate']:
            runs.append(run)
    return [_judge_statement(statement, runs) for statement in STATEMENTS]


def _judge_statement(statement: Statement, runs: Runs) -> Claim:
    numbers = statement.collect_numbers(runs)
    measured = 'not measured by this run'
    holds = None
    if numbers:
        measured = statement.describe_numbers(numbers)
        values = [value for _, value in numbers]
        holds = statement.low <= min(values) and max(values) <= statement.high
    why = f'{statement.what}: {statement.describe_bounds()}'
    return Claim(statement.text, statement.paper, measured, holds, why)


STATEMENTS = (
    Statement(
        text="Maybeck's innovation-based estimate of R is too sensitive to disturbances",
        paper='sec. 4.2',
        select=select_study_runs,
        estimators=(MATCHED_MAYBECK, MAYBECK),
        measure=measure_variance_peak,
        what="rise of R at a push, over that with the paper's filter",
        form='{:.1f} x',
        low=5.0,
        relative_to=PAPER_ESTIMATOR,
    ),
    Statement(
        text='The contact forces follow their commands with the designed time constant',
        paper='time constant 0.02 s (Figs 3, 4)',
        measure=measure_rise,
        what='63 % of a step, over the design',
        form='{:.2f} x',
        low=SHORTEST_RISE,
        high=LONGEST_RISE,
    ),
    Statement(
        text='The motion is tracked',
        paper='Fig. 5',
        measure=measure_motion_error,
        what='rms error of the position in motion',
        form='{:.2f} mm',
        high=1e3 * DESIGNED_MOTION_ERROR,
    ),
    Statement(
        text='The orientation stays fixed',
        paper='Fig. 5',
        measure=measure_orientation_error,
        what='largest error',
        form='{:.4f} rad',
        high=0.02,
    ),
    Statement(
        text='The noise variance is about 0.6 N² at rest',
        paper='0.6 N² (Fig. 6)',
        estimators=(PAPER_ESTIMATOR,),
        measure=measure_variance_at_rest,
        what='median, for which the simulated noise is calibrated',
        form='{:.2f} N²',
        low=0.3,
        high=1.2,
    ),
    Statement(
        text='It rises to about 100 N² when the arm moves',
        paper='100 N² (Fig. 6)',
        estimators=(PAPER_ESTIMATOR,),
        measure=measure_variance_in_motion,
        what='median, for which the simulated roughness is calibrated',
        form='{:.2f} N²',
        low=100.0 / 3.0,
        high=300.0,
    ),
    Statement(
        text='On-line estimation of R keeps the control working in motion',
        paper='Figs 3-6',
        estimators=(PAPER_ESTIMATOR,),
        measure=count_unstable,
        what='runs',
        counted='unstable',
        high=0.0,
    ),
    Statement(
        text='The contact forces are not too affected by the motion',
        paper='Figs 3, 4',
        measure=measure_error_in_motion,
        what='rms error in motion over the command, no contact lost',
        form='{:.1%}',
        high=0.2,
    ),
    Statement(
        text='Starting the motion disturbs both contact forces significantly',
        paper='near 195, 205 and 217 s',
        measure=measure_start_of_motion,
        what='largest error in the first 2 s over the standard deviation at rest',
        form='{:.1f} x',
        low=5.0,
    ),
    Statement(
        text='A stiffness that is not known exactly is compensated',
        paper='6000 N/m for both, "not perfect"',
        select=select_mismatched_runs,
        estimators=(PAPER_ESTIMATOR,),
        measure=measure_error_at_rest,
        what='mean error at rest over the command',
        form='{:.1%}',
        high=0.02,
    ),
    Statement(
        text='It leaves the force dynamics as designed',
        paper='6000 N/m for both, "not perfect"',
        select=select_mismatched_runs,
        estimators=(PAPER_ESTIMATOR,),
        measure=measure_rise,
        what='63 % of a step, over the design',
        form='{:.2f} x',
        low=SHORTEST_RISE,
        high=LONGEST_RISE,
    ),
    Statement(
        text='Without on-line R the control works only at rest; motion makes it unstable',
        paper='sec. 5.2',
        select=select_study_runs,
        estimators=(FIXED_VARIANCE,),
        measure=count_unstable_in_motion,
        what='runs',
        counted='unstable in motion',
        low=1.0,
    ),
    Statement(
        text='Without the high-pass filter the system responds much slower to disturbances',
        paper='sec. 5.2',
        select=select_study_runs,
        estimators=(UNFILTERED,),
        measure=measure_recovery,
        what='recovery from a lasting push, over that with the filter',
        form='{:.1f} x',
        low=2.0,
        relative_to=PAPER_ESTIMATOR,
    ),
)
