"""What is run and kept for every run of a sweep."""

from __future__ import annotations

import time

from multicontact_control.experiment.engine import CellResult, RunCell
from multicontact_control.experiment.results import finite
from multicontact_control.experiment.summary import summarise

SHORTEST = 2  # samples that a summary can be made of


def summarise_cell(cell: RunCell) -> CellResult:
    """
    Run a cell in this process and summarise it, whatever happens in it.

    Parameters
    ----------
    cell
        The run.

    Returns
    -------
    CellResult
        `metrics`: the content of ``summary.json`` under `summary`, None if there is none, and
        why the run ended before its time under `error`, None if it did not.

    """
    # Only here: who gives out the work to others needs neither kernels nor simulator.
    from multicontact_control.experiment.loop import run_in_process

    start = time.perf_counter()
    try:
        setup = cell.setup()
        result = run_in_process(setup, supervised=cell.supervised)
        error, summary = result.ended_early or None, None
        if result.data.ticks >= SHORTEST:
            summary = summarise(result.data, setup, mode='in_process', timing={},
                                ended_early=result.ended_early,
                                events=result.events if cell.supervised else None)
    except Exception as problem:
        # Whatever one combination does to the law or the simulator, the others shall be run.
        error, summary = f'{type(problem).__name__}: {problem}', None
    return CellResult(finite({'summary': summary, 'error': error}), {},
                      time.perf_counter() - start)
