"""`multicontact run`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, NoReturn

from multicontact_control.cli import options
from multicontact_control.cli.exits import (
    end_by_verdict,
    errors_in_one_line,
    EXIT_FAILED,
    EXIT_SIGNAL,
)
from multicontact_control.experiment.graph.node_process import prepare_nodes
import typer


def run(
    context: typer.Context,
    scenario: options.Scenario = 'paper', robot: options.Robot = '', plant: options.Plant = '',
    seed: options.Seed = 0, duration: options.Duration = None,
    noise_estimator: options.Estimator = None, out: options.Out = None,
    overwrite: options.Overwrite = False, bare: options.Bare = False,
    preset: options.Preset = 'best', law: options.Law = None, settings: options.Settings = None,
    engine: options.Engine = '',
    external: Annotated[bool, typer.Option(
        '--external', help='On your own robot or simulator, which is behind the topics: starts '
        'controller, noise estimator and recorder only, waits for the robot, and obeys the '
        'command topics, or a --scenario. Ends after --duration, or with Ctrl-C. Takes '
        '--controller; --noise-estimator may then be a parameter file, too.')] = False,
    controller: options.ControllerFiles = None,
    robot_timeout: Annotated[float, typer.Option(
        help='With --external: time without a sample after which the robot counts as gone '
        '[s].')] = 5.0,
    commanded: Annotated[bool, typer.Option(
        '--commanded', help='Let the simulated arm obey the command topics, as a robot does, '
        'instead of playing the scenario, of which contacts, surfaces and disturbances stay. Ends '
        'after --duration, or with Ctrl-C.')] = False,
    speed: Annotated[float, typer.Option(
        min=0.0, max=100.0, help='Simulated time per wall time at most; 0 for as fast as it '
        'goes. The torques are those of `simulate`, bit for bit, at any speed.')] = 1.0,
    free_running: Annotated[bool, typer.Option(
        '--free-running', help='Let the simulated arm run on without waiting for commands, as a '
        'robot does; missed deadlines are counted.')] = False,
    domain_id: Annotated[int | None, typer.Option(
        help='ROS_DOMAIN_ID of the graph; that of the environment, or the first one without '
        'participants on this machine (0 with --external), if not given.')] = None,
    realtime: Annotated[bool, typer.Option(
        '--realtime', help='Ask for SCHED_FIFO, a processor and locked memory for the nodes that '
        'control, and say at the end what they got.')] = False,
    namespace: Annotated[str, typer.Option(
        help='Namespace of the graph, e.g. `left`: two graphs can then share one domain.')] = '',
) -> None:
    """
    Run a scenario on the ROS 2 graph, record it to MCAP and report it.

    Starts simulator, controller, noise estimator and recorder, each in a process of its own, stops
    them together, then draws the figures from the bag. The simulator waits for the controller: on
    a busy machine simulated time is slow, and the forces stay the same.
    Exit code 0: stable, or not judged (nothing was ever pressed, or a free run missed more than
    1 % of its deadlines); 1: not stable, held by the supervisor, or a node died; 2: bad input;
    128 + n: ended by signal n.
    With --external 0 also without ground truth, where nothing is called stable, and 1 also if the
    robot is gone.
    """
    from multicontact_control.experiment.graph.domain import check_namespace

    with errors_in_one_line():
        namespace = check_namespace(namespace)
        given = options.given_options(context)
        # The nodes' modules are loaded by another process, while this one loads its own.
        prepare_nodes()
        if external:
            options.refuse_options(given, ('robot', 'plant', 'seed', 'commanded', 'speed',
                                           'free_running', 'engine'), '--external')
            resolved, folder = options.prepare_external(
                controller or (), scenario if 'scenario' in given else None, duration,
                noise_estimator, out, overwrite, preset=preset if 'preset' in given else '',
                law=law, settings=settings)
            from multicontact_control.experiment.run import GraphOptions, run_external

            outcome, interrupted = run_external(resolved, folder, GraphOptions(
                domain_id=domain_id, namespace=namespace, realtime=realtime),
                robot_timeout=robot_timeout, supervised=not bare)
            end(outcome, interrupted)
        options.refuse_options(given, ('controller', 'robot_timeout'), 'a simulated plant')
        if commanded:
            refuse_scenario(settings)
        setup, folder = options.prepare(
            scenario, plant, seed, duration, noise_estimator, out, overwrite, preset=preset,
            law=law, settings=settings, robot=robot, engine=engine)
        setup = replace(setup, commanded_by_topic=commanded)
        from multicontact_control.experiment.run import GraphOptions, run_real_time

        summary, interrupted = run_real_time(setup, folder, GraphOptions(
            free_running=free_running, speed=speed, domain_id=domain_id, namespace=namespace,
            realtime=realtime, endless=commanded and duration is None), supervised=not bare)
    end(summary, interrupted)


def refuse_scenario(settings: Sequence[str] | None) -> None:
    """Refuse settings of a scenario that is not played; ConfigError naming the first."""
    from multicontact_control.errors import ConfigError
    from multicontact_control.experiment.overrides import read_settings

    for name in read_settings(settings or ()):
        if name.startswith('scenario.'):
            raise ConfigError(f'--set {name}', 'nothing with --commanded, which plays no scenario '
                              '(its length is --duration)', 'it')


def end(summary: dict[str, Any] | None, interrupted: int | None) -> NoReturn:
    """Exit as a run has ended: by a signal, without a sample, or by its verdict."""
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    if summary is None:
        raise typer.Exit(EXIT_FAILED)
    end_by_verdict(summary)
    raise typer.Exit
