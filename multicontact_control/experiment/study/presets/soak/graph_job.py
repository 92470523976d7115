"""Soaks over graphs as jobs."""

from __future__ import annotations

from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.presets.soak.jobs import soak_result, SoakJob


def run_graph_soak_job(job: SoakJob) -> JobResult:
    """Run a soak over graphs, in real time; see `run_soak_job`."""
    # Only now: a soak in process needs no ROS.
    from multicontact_control.experiment.faults.graph_soak import GraphSoak

    outcome = GraphSoak(job.setup(), job.seed).run(job.simulated_time())
    return soak_result(outcome, outcome.simulated_s)
