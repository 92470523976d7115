"""The ROS 2 graph: lockstep factor, latency against a bare echo, what the recorder takes."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from multicontact_control.experiment.bench.echo import echo_latency
from multicontact_control.experiment.bench.spread import percentiles
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.run import GraphSpec, run_graph
from multicontact_control.experiment.scenario import resolve


def bench_graph(duration: float) -> dict[str, Any]:
    """
    Run the graph in lockstep and in real time, and the echo with the same period.

    Parameters
    ----------
    duration
        Of each run [s].

    """
    with TemporaryDirectory() as name:
        lockstep = _run(Path(name) / 'lockstep', duration, lockstep=True)
        real_time = _run(Path(name) / 'real_time', duration, lockstep=False)
    with reserve_domain(None) as domain_id:
        os.environ['ROS_DOMAIN_ID'] = str(domain_id)
        echo = percentiles(echo_latency(int(500 * duration), 1.0 / 500.0))
    latency = real_time['sim_node']['latency_us']
    recorder = real_time['recorder_node']
    wall = real_time['sim_node']['wall_s']
    return {
        'lockstep_realtime_factor': round(duration / lockstep['sim_node']['wall_s'], 3),
        'latency_us': latency, 'echo_us': echo,
        'latency_to_echo': round(latency['p50'] / echo['p50'], 3),
        'deadline_misses': real_time['sim_node']['deadline_misses'],
        'recorder_cpu_share': round(recorder['cpu_s'] / wall, 4),
        'recorder_messages_per_s': round(recorder['messages'] / wall, 1),
        'recorder_lost': recorder['lost']}


def _run(folder: Path, duration: float, *, lockstep: bool) -> dict[str, Any]:
    """Run the scenario `quick` and return what each node counted."""
    setup = resolve('quick', plant='rigid', seed=0, duration=duration)
    config = folder / 'config'
    setup.write(config)
    result = run_graph(GraphSpec(
        out=folder, ticks=setup.ticks, rate=setup.controller.rate, lockstep=lockstep,
        reference_file=config / 'reference.yaml', parameter_files={
            'controller_node': config / 'controller.yaml', 'sim_node': config / 'plant.yaml',
            'noise_estimator_node': config / 'noise_estimator.yaml'}))
    return dict(result.timing)
