"""`multicontact push-test`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, EXIT_FAILED
import typer


def push_test(
    context: typer.Context, robot: options.Robot = '', plant: options.Plant = '',
    seed: options.Seed = 0,
    fault: Annotated[str, typer.Option(
        help='What is wrong with the sensor: none, sign (flipped), rotate (a quarter turn, about '
        'x, y, z for seeds 0, 1, 2, the other way for 3, 4, 5) or scale (half).')] = 'none',
    external: Annotated[bool, typer.Option(
        '--external', help='On your own robot: asks the controller that runs on it for its push '
        'test, and shows what to do.')] = False,
    domain_id: options.DomainId = None, namespace: options.Namespace = None,
) -> None:
    """
    Prove sign, frame and scale of the wrist sensor by pushing the tool.

    In simulation a scripted hand pushes as the test asks; on a robot you do, with a spring
    balance. Exit code 0: passed; 1: refused, naming what is wrong; 2: bad input.
    """
    with errors_in_one_line():
        given = options.given_options(context)
        if external:
            options.refuse_options(given, ('robot', 'plant', 'seed', 'fault'), '--external')
            from multicontact_control.experiment.push_running import push_running

            if not push_running(namespace=namespace or '', domain_id=domain_id,
                                on_instruction=typer.echo):
                raise typer.Exit(EXIT_FAILED)
            return
        options.refuse_options(given, ('domain_id', 'namespace'), 'a simulated plant')
        from multicontact_control.experiment import push_trial

        config = push_trial.PushTestConfig()
        setup = push_trial.push_setup(
            plant, seed, config, push_trial.fault_mounting(fault, seed), robot)
        result = push_trial.run_push_test(setup, config, on_instruction=typer.echo)
    if not result.passed:
        raise typer.Exit(EXIT_FAILED)
