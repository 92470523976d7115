"""What is run and measured in every cell of a matrix."""

from __future__ import annotations

import math

from multicontact_control.errors import MulticontactError
from multicontact_control.experiment.claim_metrics import evidence_of
from multicontact_control.experiment.disturbances import disturbance_summary
from multicontact_control.experiment.engine import CellResult, RunCell
from multicontact_control.experiment.loop import run_in_process
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.results import finite
from multicontact_control.experiment.summary import summarise
import numpy as np

LAST = 0.5  # s, the end of a run that tells whether it has settled
TRACES = {
    'true': 'alpha_true', 'desired': 'alpha_des', 'estimated': 'alpha_est',
    'variance': 'noise_variance'}


def measure_cell(cell: RunCell) -> CellResult:
    """
    Run a cell in this process and measure it.

    A run that cannot go on to its end counts as unstable; it does not end the matrix.

    Parameters
    ----------
    cell
        The run.

    Returns
    -------
    CellResult
        `metrics`: the content of ``summary.json`` under `summary`, the answers to disturbances
        under `disturbances`, what claims rest on under `evidence`, and `final_error_share`.
        `traces`: time and the forces
        of every contact, shapes (m,) and (m, r).

    """
    setup = cell.setup()
    result = run_in_process(setup, supervised=cell.supervised)
    data = result.data
    if data.ticks < 2:
        raise MulticontactError(f'{cell}: the run ended at once: {result.ended_early}')
    summary = summarise(data, setup, mode='in_process', timing={},
                        ended_early=result.ended_early,
                        events=result.events if cell.supervised else None)
    metrics = {
        'summary': summary,
        'disturbances': disturbance_summary(data, setup, bool(result.ended_early)),
        'evidence': evidence_of(data, setup, summary),
        'final_error_share': final_error_share(data)}
    traces = {name: getattr(data, series) for name, series in TRACES.items()}
    return CellResult(finite(metrics), {'time': data.time, **traces}, result.wall_time)


def final_error_share(data: RunData) -> float:
    """Return the largest force error of the last 0.5 s, relative to the command."""
    last = data.time > data.time[-1] - LAST
    desired = data.alpha_des[last]
    if not (desired > 0.0).all():
        return math.inf
    return float(np.max(np.abs(data.alpha_true[last] - desired) / desired))
