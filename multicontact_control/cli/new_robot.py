"""`multicontact new-robot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line
from multicontact_control.errors import ConfigError
import typer


def new_robot(
    urdf: Annotated[Path, typer.Argument(metavar='URDF', help="The vendor's URDF.")],
    tip: Annotated[str, typer.Option(help='Link of the URDF that is to touch.')],
    sensor: Annotated[str, typer.Option(
        help='Link of the URDF that carries the wrist sensor; what is beyond it is the tool.')],
    out: Annotated[Path | None, typer.Option(
        help='File to write; NAME.yaml of NAME.urdf if not given.')] = None,
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace a file that is already there.')] = False,
) -> None:
    """
    Write a configuration for an arm from its URDF, and say what is missing.

    Joints, limits and masses are those of the URDF; home is a posture with the tool straight
    down, by inverse kinematics. `multicontact simulate --robot FILE --scenario one_contact` then
    runs it. Exit code 0: written; 2: bad input.
    """
    with errors_in_one_line():
        target = out or Path(f'{urdf.stem}.yaml')
        if target.exists() and not overwrite:
            raise ConfigError('out', 'a new file, or --overwrite', target)
        # Only now: what is heavy is not loaded for the sake of an error.
        from sim_bridge.new_robot import new_robot as write

        robot = write(urdf, sensor, tip, target)
    for text in robot.found:
        typer.echo(text)
    for text in robot.missing:
        typer.echo(f'missing: {text}')
    typer.echo(f'written to {robot.path}; try: multicontact simulate --robot {robot.path} '
               '--scenario one_contact')
