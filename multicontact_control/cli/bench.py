"""`multicontact bench`."""

from __future__ import annotations

from enum import Enum
import json
import sys
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line
from multicontact_control.terminal import terminal
import typer


class Rival(str, Enum):
    """What the control law can be measured against."""

    TSID = 'tsid'


def bench(
    as_json: Annotated[bool, typer.Option(
        '--json', help='Print one JSON object and nothing else.')] = False,
    quick: Annotated[bool, typer.Option(
        '--quick', help='Fewer ticks and repeats, shorter runs: enough to see a ratio that is '
        'wrong by a factor.')] = False,
    ticks: Annotated[int | None, typer.Option(
        min=100, help='Controller ticks per repeat; 20 000 if not given.')] = None,
    graph: Annotated[bool, typer.Option(
        '--graph/--no-graph', help='Whether to measure the ROS 2 graph, too.')] = True,
    against: Annotated[Rival | None, typer.Option(
        help='Measure the tick of another controller beside the control law, too.')] = None,
    tsid_python: Annotated[str | None, typer.Option(
        envvar='MULTICONTACT_TSID_PYTHON', metavar='PATH',
        help='Python in whose environment TSID is; this one if not given.')] = None,
) -> None:
    """
    Measure how fast everything is, each part against its floor in the same run.

    The tick is measured bare, the control law and the estimator alone, and within the supervisor.
    Ratios are what to compare between machines; a machine that was too noisy is named as such.
    """
    from multicontact_control.experiment.bench.run import print_bench, run_bench

    with errors_in_one_line():
        result = run_bench(
            ticks=ticks, quick=quick, graph=graph,
            tsid_python=(tsid_python or sys.executable) if against else None)
    if as_json:
        typer.echo(json.dumps(result))
    else:
        print_bench(result, terminal())
