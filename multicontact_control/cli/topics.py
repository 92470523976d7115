"""`multicontact topics`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, require_ros
from multicontact_control.cli.options import DomainId
import typer


def topics(
    wait: Annotated[float, typer.Option(
        help='How long to wait for nodes to answer [s].', min=0.0)] = 1.0,
    domain_id: DomainId = None,
) -> None:
    """List the topics of a running graph with their types, like `ros2 topic list -t`."""
    with errors_in_one_line():
        require_ros()
        from multicontact_control.tools.echo import list_topics

        for line in list_topics(wait, domain_id):
            typer.echo(line)
