"""`multicontact run` and `multicontact simulate`."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from multicontact_control.cli.options import (
    ControllerFiles,
    end_at_signals,
    EXIT_FAILED,
    EXIT_SIGNAL,
    refuse_options,
    RunOptions,
)
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.graph.node_process import prepare_nodes
import typer

OF_THE_PLANT = ('robot', 'plant', 'seed', 'commanded', 'speed', 'free_running', 'engine')


def run(
    context: typer.Context, options: RunOptions,
    commanded: Annotated[bool, typer.Option(
        '--commanded', help='The simulated arm obeys the command topics instead of the '
        "scenario's reference. Ends after --duration, or with Ctrl-C.")] = False,
    speed: Annotated[float, typer.Option(
        min=0.0, max=100.0, help='Largest real-time factor; 0 for as fast as it goes. The torques '
        'are those of `simulate`, bit for bit, at any speed.')] = 1.0,
    free_running: Annotated[bool, typer.Option(
        '--free-running', help='The simulated arm runs on without waiting for commands, as a '
        'robot does; missed deadlines are counted.')] = False,
    external: Annotated[bool, typer.Option(
        '--external', help='Your own robot or simulator is behind the topics: start controller, '
        'noise estimator and recorder only, wait for the robot, and obey the command topics, or a '
        '--scenario. Ends after --duration, or with Ctrl-C. Needs --controller.')] = False,
    controller: ControllerFiles = None,
    robot_timeout: Annotated[float, typer.Option(
        help='With --external: time without a sample after which the robot counts as gone '
        '[s].')] = 5.0,
    domain_id: Annotated[int | None, typer.Option(
        envvar='ROS_DOMAIN_ID', min=0, max=101,
        help='ROS_DOMAIN_ID of the graph; that of the environment, or the first one that is free '
        'on this machine (0 with --external), if not given.')] = None,
    namespace: Annotated[str, typer.Option(
        help='Namespace of the graph: two graphs can then share one domain.')] = '',
    realtime: Annotated[bool, typer.Option(
        '--realtime', help='Ask for SCHED_FIFO, a processor and locked memory for the nodes that '
        'control, and print what they got.')] = False,
) -> None:
    """
    Run a scenario on the ROS 2 graph, and record it.

    Starts simulator, controller, noise estimator and recorder, each in a process of its own. At
    its end, or at Ctrl-C, the recording is judged and drawn; a second Ctrl-C skips that. The
    simulator waits for the controller: a busy machine makes simulated time slow, and the forces
    stay the same. Exit code 0: stable, poor, or not judged because no contact was under load, a
    free run missed more than 1 % of its deadlines, or an external run has no ground truth; 1: not
    stable, held by the supervisor, a node died, or the external robot is gone.
    """
    from multicontact_control.experiment.graph.domain import check_namespace

    namespace = check_namespace(namespace)
    end_at_signals('interrupted')
    # The nodes' modules are loaded by another process, while this one loads its own.
    prepare_nodes()
    robot = None
    if external:
        refuse_options(context, OF_THE_PLANT, 'with --external')
        robot = options.external(controller or (), context)
        setup = robot.setup
    else:
        refuse_options(context, ('controller', 'robot_timeout'), 'without --external')
        if commanded and any(x.startswith('scenario.') for x in options.settings or ()):
            raise ConfigError('--set scenario', hint='leave it out with --commanded, which plays '
                              'no scenario; --duration sets the length')
        setup = replace(options.setup(), commanded_by_topic=commanded)
    with options.folder(setup) as folder:
        # Only now: bad input is refused before the simulator is loaded.
        from multicontact_control.experiment.run import run_on_graph

        summary, interrupted = run_on_graph(
            setup, folder, endless=commanded and options.duration is None, external=robot,
            robot_timeout=robot_timeout, supervised=not options.bare, free_running=free_running,
            speed=speed, domain_id=domain_id, namespace=namespace, realtime=realtime)
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    end_by_verdict(summary)


def simulate(options: RunOptions) -> None:
    """
    Run a scenario in one process, without ROS, as fast as it goes.

    The same seed gives the same run, bit for bit; Ctrl-C discards it. Exit code 0: stable, poor,
    or not judged because no contact was under load; 1: not stable, or held by the supervisor.
    """
    end_at_signals('interrupted; nothing of this run is kept')
    setup = options.setup()
    from multicontact_control.experiment.run import run_simulate

    with options.folder(setup) as folder:
        summary = run_simulate(setup, folder, supervised=not options.bare)
    end_by_verdict(summary)


def end_by_verdict(summary: dict[str, Any] | None) -> None:
    """Exit with 1 if there is no run, or it was judged and its loop is not known to be stable."""
    if summary is None or not (summary['stable'] or summary['unjudged']):
        raise typer.Exit(EXIT_FAILED)
