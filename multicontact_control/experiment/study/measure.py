"""What is run and measured in a job that is one run of a scenario."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
import math
from statistics import median
import time
from typing import Any, TYPE_CHECKING

from multicontact_control.experiment.claims import evidence_of
from multicontact_control.experiment.metrics import disturbance_summary
from multicontact_control.experiment.recording import empty_run_data, RunData
from multicontact_control.experiment.results import summarise
from multicontact_control.experiment.study.jobs import JobResult, RunJob
from multicontact_control.files import finite
import numpy as np

if TYPE_CHECKING:
    from multicontact_control.experiment.closed_loop import LoopResult
    from multicontact_control.experiment.scenario import Setup

LAST = 0.5  # s, the end of a run that tells whether it has settled
SHORTEST = 2  # samples that a summary can be made of
TRACES = {
    'true': 'alpha_true', 'desired': 'alpha_des', 'estimated': 'alpha_est',
    'variance': 'noise_variance'}


def measure_run(job: RunJob) -> JobResult:
    """
    Run a job in this process and measure it.

    A run that cannot go on to its end counts as unstable; it does not end the study.

    Returns
    -------
    JobResult
        `metrics`: the content of ``summary.json`` under `summary`, the answers to disturbances
        under `disturbances`, what claims rest on under `evidence`, and `final_error_share`.
        `traces`: time and the forces of every contact, shapes (m,) and (m, r).

    """
    # Only here: what gives out the work to others needs neither kernels nor simulator.
    from multicontact_control.experiment.closed_loop import run_in_process

    setup = job.setup()
    result = long_enough(run_in_process(setup, supervised=job.supervised), setup)
    data = result.data
    summary = _summary(job, setup, result)
    metrics = {
        'summary': summary,
        'disturbances': disturbance_summary(data, setup, summary['unstable_at_s']),
        'evidence': evidence_of(data, setup, summary),
        'final_error_share': final_error_share(data, setup)}
    traces = {name: getattr(data, series) for name, series in TRACES.items()}
    return JobResult(finite(metrics), {'time': data.time, **traces}, result.wall_time)


def long_enough(result: LoopResult, setup: Setup) -> LoopResult:
    """Return what a run leaves; of one that ended at once samples that were not answered."""
    if result.data.ticks >= SHORTEST:
        return result
    return replace(result, data=empty_run_data(SHORTEST, setup.controller))


def summarise_run(job: RunJob) -> JobResult:
    """
    Run a job in this process and summarise it, whatever happens in it.

    Returns
    -------
    JobResult
        `metrics`: the content of ``summary.json`` under `summary`, None if there is none, and
        why the run ended before its time under `error`, None if it did not.

    """
    from multicontact_control.experiment.closed_loop import run_in_process

    start = time.perf_counter()
    summary = None
    try:
        setup = job.setup()
        result = run_in_process(setup, supervised=job.supervised)
        error = result.ended_early or None
        if result.data.ticks >= SHORTEST:
            summary = _summary(job, setup, result)
    except Exception as problem:
        # Whatever one combination does to the law or the simulator, the others shall be run.
        error, summary = f'{type(problem).__name__}: {problem}', None
    return JobResult(finite({'summary': summary, 'error': error}), {},
                     time.perf_counter() - start)


def _summary(job: RunJob, setup: Setup, result: LoopResult) -> dict[str, Any]:
    return summarise(
        result.data, setup, mode='in_process', timing={}, ended_early=result.ended_early,
        events=result.events if job.supervised else None)


def final_error_share(data: RunData, setup: Setup) -> float:
    """Return the largest force error of the last 0.5 s, relative to the task's command."""
    last = data.time > data.time[-1] - LAST
    desired = setup.commanded(data.time)[last]
    if not (desired > 0.0).all():
        return math.inf
    return float(np.max(np.abs(data.alpha_true[last] - desired) / desired))


def largest(values: Iterable[float | None]) -> float | None:
    """Return the largest value, None if one is not known or there is none."""
    known = [math.inf if value is None else value for value in values]
    return _known(max(known, default=math.inf))


def largest_known(values: Iterable[float | None]) -> float | None:
    """Return the largest of the values that are known, None if there is none."""
    return max((value for value in values if value is not None), default=None)


def middle(values: Iterable[float | None]) -> float | None:
    """Return the median; what is not known counts as beyond all, None if it is the median."""
    known = [math.inf if value is None else value for value in values]
    return _known(median(known) if known else math.inf)


def middle_known(values: Iterable[float | None]) -> float | None:
    """Return the median of the values that are known, None if there is none."""
    known = [value for value in values if value is not None]
    return median(known) if known else None


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
