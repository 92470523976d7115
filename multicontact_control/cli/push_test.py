"""`multicontact push-test`."""

from __future__ import annotations

from multicontact_control.cli import options
import typer


def push_test(
    domain_id: options.DomainId = None, namespace: options.Namespace = None,
) -> None:
    """
    Prove sign, frame and scale of the wrist sensor by pushes.

    Starts the push test of the running controller, and shows where to push the tool with a spring
    balance, or a simulated one by the page of `view --graph` or the topic sim_node/push.
    """
    from multicontact_control.experiment.push_test import push_running

    if not push_running(typer.echo, namespace=namespace or '', domain_id=domain_id):
        raise typer.Exit(options.EXIT_FAILED)
