"""`multicontact follow`: a path of a file on a controller that runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.cli.options import DomainId
from multicontact_control.errors import ConfigError, RunError
import numpy as np
import typer

if TYPE_CHECKING:
    from multicontact_control.client import MultiContactClient

EXIT_HELD = 130  # as of what Ctrl-C ends


class HeldError(Exception):
    """Ctrl-C has held the arm."""


def follow(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar='PATH',
            help='CSV file with the columns x, y, z in world axes, or u, v along the surface of '
            'the contact that is pressed, from where the tool is [m], and speed [m/s] if it '
            'changes.',
        ),
    ] = None,
    force: Annotated[
        list[str] | None,
        typer.Option(
            metavar='CONTACT=NEWTONS',
            help='Press first, e.g. table=20; may be repeated.',
        ),
    ] = None,
    speed: Annotated[
        float, typer.Option(help='Speed along the path [m/s].', min=1e-4)
    ] = 0.05,
    resume: Annotated[
        bool, typer.Option('--resume', help='Go on with the path that is held.')
    ] = False,
    end: Annotated[
        bool, typer.Option('--end', help='End the path that is followed or held.')
    ] = False,
    namespace: Annotated[str, typer.Option(help='That of the controller.')] = '',
    domain_id: DomainId = None,
) -> None:
    r"""
    Lead a running controller along a path of a CSV file, and show how far it is.

    The controller follows the path by itself. Ctrl-C holds the arm, which goes on pressing:
    `multicontact follow --resume` goes on, `multicontact follow --end` ends the path. The forces
    stay at the end.

    \b
    multicontact follow path.csv --force table=20 --speed 0.05
    """
    from multicontact_control.client import MultiContactClient
    from multicontact_control.nodes.runtime import collect_stop_signals

    if [path is not None, resume, end].count(True) != 1:
        raise ConfigError('PATH', 'a file, or --resume, or --end')
    points: list[dict[str, Any]] = []
    if path is not None:
        points = read_path(path)
    forces = parse_forces(force or [])
    stop = collect_stop_signals()
    with MultiContactClient(namespace, domain_id=domain_id) as client:
        watch = _ProgressLine(client, stop)
        try:
            if end:
                client.end_path()
                client.hold(False)
                typer.echo('ended')
            elif resume:
                client.hold(False)
                client.await_path(watch.show)
            else:
                if forces:
                    typer.echo('pressing')
                    client.set_forces(forces)
                    client.wait_until_reached()
                positions, times = plan_path(client, points, [*forces], speed)
                client.follow(positions, times=times, on_progress=watch.show)
        except HeldError:
            typer.echo('\nheld: multicontact follow --resume goes on, --end ends it')
            raise typer.Exit(EXIT_HELD) from None
        if not end:
            typer.echo('\ndone')


class _ProgressLine:
    """Shows how far a path is on one line, and holds the arm once a signal has come."""

    def __init__(self, client: MultiContactClient, stop: Sequence[Any]) -> None:
        self._client = client
        self._stop = stop

    def show(self, status: Any) -> None:
        """Show the progress in a status; HeldError after Ctrl-C."""
        if self._stop:
            self._client.hold()
            raise HeldError
        remaining = status.remaining_time or 0.0
        state = status.trajectory.partition(' ')[0] or 'there'
        line = (
            f'{state}: {100.0 * status.trajectory_share:.0f} %, {remaining:.1f} s left'
        )
        typer.echo(f'\r{line:<60}', nl=False)


def read_path(path: Path) -> list[dict[str, Any]]:
    """Return the points of a file; ConfigError, also for a force, which only scenarios have."""
    from multicontact_control.control.motions import read_waypoints

    points = read_waypoints(path)
    if not points:
        raise ConfigError(str(path), 'at least one point', 'none')
    for index, point in enumerate(points):
        if 'force' in point:
            raise ConfigError(
                f'{path}: point {index}',
                'no force: give --force; a scenario may have one',
            )
    return points


def parse_forces(texts: Sequence[str]) -> dict[str, float]:
    """Return forces by contact [N] of texts such as `table=20`; ConfigError for others."""
    forces = {}
    for text in texts:
        name, _, number = text.partition('=')
        try:
            forces[name] = float(number)
        except ValueError:
            raise ConfigError('--force', 'CONTACT=NEWTONS', repr(text)) from None
    return forces


def plan_path(
    client: MultiContactClient,
    points: Sequence[dict[str, Any]],
    contacts: Sequence[str],
    speed: float,
) -> tuple[Matrix, Vector]:
    """
    Return positions of points in world axes, shape (k, 3) [m], and when they are to be passed [s].

    Coordinates along a surface count from where the tool is, on the surface of the first of the
    `contacts`, or of the one that is pressed. RunError if there is none.
    """
    from multicontact_control.control.motions import surface_axes

    positions = np.array([point['position'] for point in points])
    if positions.shape[1] == 2:
        state = client.read()
        status = client.status()
        placing: dict[str, Any] = {}
        if status is not None:
            placing = dict(status.placing)
        name = next(iter([*contacts, *placing]), '')
        if name not in placing:
            raise RunError(
                'u, v: expected a contact that is pressed, got none; give --force'
            )
        axes = surface_axes(np.array(placing[name][:3]))
        positions = state.position_desired + positions @ axes[:2]
    speeds = np.array([point.get('speed', speed) for point in points])
    ways = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return positions, np.concatenate([[0.0], np.cumsum(ways / speeds[1:])])
