"""
Runs that many tests look at.

They are kept in ``.pytest_cache/runs`` by a hash of their configuration, seed and sources.
"""

from __future__ import annotations

from pathlib import Path

from joblib import Memory
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.closed_loop import LoopResult, run_in_process
from multicontact_control.runs.scenario import Setup
from multicontact_control.study.jobs import outcome_key

MEMORY = Memory(
    Path(__file__).resolve().parents[1] / '.pytest_cache' / 'runs', verbose=0
)


def run_of(setup: Setup, *, supervised: bool = True) -> LoopResult:
    """Return the result of `run_in_process`."""
    key = outcome_key('test', setup, supervised=supervised)
    return _run(key, setup, supervised)


@MEMORY.cache(ignore=['setup', 'supervised'])
def _run(key: str, setup: Setup, supervised: bool) -> LoopResult:
    return run_in_process(setup, supervised=supervised)


def summary_of(setup: Setup, *, supervised: bool = True) -> dict:
    """Return the content of its ``summary.json``."""
    result = run_of(setup, supervised=supervised)
    return summarise_run(
        RunMetrics(result.data, setup),
        mode='in_process',
        timing={},
        ended_early=result.ended_early,
        events=result.events if supervised else None,
    )
