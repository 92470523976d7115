"""`multicontact echo`."""

from __future__ import annotations

import os
import sys
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, require_ros
from multicontact_control.cli.options import DomainId
import typer


def echo(
    topic: Annotated[str, typer.Argument(help='Topic, e.g. /contact_forces/measured.')],
    field: Annotated[str, typer.Option(
        help='Show only this field, e.g. `effort` or `header.stamp`.')] = '',
    once: Annotated[bool, typer.Option(
        '--once', help='End after one message.')] = False,
    full_length: Annotated[bool, typer.Option(
        '--full-length', '-f', help='Show lists and strings beyond 128 entries in full.')] = False,
    timeout: Annotated[float, typer.Option(
        help='Longest wait for a publisher [s].', min=0.0)] = 5.0,
    domain_id: DomainId = None,
) -> None:
    """
    Print the messages of a topic, like `ros2 topic echo`.

    The type is found from the graph. YAML documents, `---` after each; Ctrl-C ends it. Exit code
    1: nobody publishes the topic or its type is not installed; 2: there is no such field.
    """
    with errors_in_one_line():
        require_ros()
        from multicontact_control.tools.echo import echo as run_echo

        try:
            run_echo(topic, lambda text: print(text, flush=True), field=field, once=once,
                     full_length=full_length, timeout=timeout, domain_id=domain_id)
        except BrokenPipeError:
            # Whoever read it has had enough; nor may the last flush complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
