"""`multicontact push-test`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
import typer


def push_test(
    context: typer.Context, simulated: options.PlantOptions,
    fault: Annotated[str, typer.Option(
        help='What is wrong with the simulated sensor: none, sign (flipped), rotate (by 90 deg '
        'about x, y, z for seeds 0, 1, 2, the other way for 3, 4, 5) or scale (half).')] = 'none',
    external: Annotated[bool, typer.Option(
        '--external', help='On your own robot: start the push test of the controller that runs '
        'on it, and show what to do.')] = False,
    domain_id: options.DomainId = None, namespace: options.Namespace = None,
) -> None:
    """
    Prove sign, frame and scale of the wrist sensor by pushes.

    In simulation a scripted hand pushes; on a robot you do, with a spring balance.
    """
    from multicontact_control.experiment import push_test as test

    given = options.given_options(context)
    if external:
        options.refuse_options(given, ('robot', 'plant', 'seed', 'fault'), '--external')
        passed = test.push_running(typer.echo, namespace=namespace or '', domain_id=domain_id)
    else:
        options.refuse_options(given, ('domain_id', 'namespace'), 'a simulated plant')
        config = test.PushTestConfig()
        setup = test.push_setup(
            simulated.plant, simulated.seed, config, test.fault_mounting(fault, simulated.seed),
            simulated.robot)
        passed = test.push_simulated(setup, config, typer.echo).passed
    if not passed:
        raise typer.Exit(options.EXIT_FAILED)
