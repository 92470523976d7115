"""`multicontact run`."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

from multicontact_control.cli.exits import end_by_verdict, errors_in_one_line, EXIT_SIGNAL
from multicontact_control.cli.options import (
    Bare,
    Duration,
    Estimator,
    Law,
    Out,
    Overwrite,
    Plant,
    prepare,
    Preset,
    Scenario,
    Seed,
    Settings,
)
import typer


class Composed(str, Enum):
    """Which nodes share a process."""

    AUTO = 'auto'
    NONE = 'none'
    CONTROL = 'control'
    ALL = 'all'


def run(
    scenario: Scenario = 'paper', plant: Plant = 'puma', seed: Seed = 0,
    duration: Duration = None, noise_estimator: Estimator = None, out: Out = None,
    overwrite: Overwrite = False, bare: Bare = False, preset: Preset = 'best',
    law: Law = None, settings: Settings = None,
    lockstep: Annotated[bool, typer.Option(
        '--lockstep', help='Let the nodes wait for each other instead of for the wall clock: '
        'the same torques as `simulate`, bit for bit.')] = False,
    domain_id: Annotated[int | None, typer.Option(
        help='ROS_DOMAIN_ID of the graph; that of the environment, or the first one without '
        'participants on this machine, if not given.')] = None,
    composed: Annotated[Composed, typer.Option(
        help='Which nodes share a process and hand each other their messages: `none`, `control` '
        '(controller and noise estimator), `all` (the simulated plant, too), or `auto`: none, '
        'unless deadlines are missed in the first seconds, and all in lockstep. Topics, services '
        'and torques stay the same.')] = Composed.AUTO,
    realtime: Annotated[bool, typer.Option(
        '--realtime', help='Ask for SCHED_FIFO, a processor and locked memory for the nodes that '
        'control, and say at the end what they got.')] = False,
    namespace: Annotated[str, typer.Option(
        help='Namespace of the graph, e.g. `left`: two graphs can then share one domain.')] = '',
) -> None:
    """
    Run a scenario on the ROS 2 graph, record it to MCAP and report it.

    Starts simulator, controller, noise estimator and recorder, each in a process of its own unless
    the machine is too slow for that, stops them together, then draws the figures from the bag.
    Exit code 0: stable, or not judged, since the machine missed a tenth of the deadlines; 1: not
    stable, held by the supervisor, or a node died; 2: bad input; 128 + n: ended by signal n.
    """
    from multicontact_control.experiment.graph.domain import check_namespace

    with errors_in_one_line():
        namespace = check_namespace(namespace)
        setup, folder = prepare(
            scenario, plant, seed, duration, noise_estimator, out, overwrite, preset=preset,
            law=law, settings=settings)
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import GraphOptions, run_real_time

        summary, interrupted = run_real_time(setup, folder, GraphOptions(
            lockstep=lockstep, domain_id=domain_id, namespace=namespace, composed=composed.value,
            realtime=realtime), supervised=not bare)
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    end_by_verdict(summary)
