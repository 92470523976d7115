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
    controller: Annotated[Path, typer.Option(
        help='Parameter file of the controller on the real arm, for `run --external`.',
        )] = Path('controller.yaml'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace files that are already there.')] = False,
) -> None:
    """
    Write configurations for an arm from its URDF, and say what is missing.

    Joints, limits and masses are those of the URDF; home is a posture with the tool straight
    down, by inverse kinematics. `multicontact simulate --robot FILE --scenario one_contact` then
    runs it. Exit code 0: written; 2: bad input.
    """
    with errors_in_one_line():
        target = out or Path(f'{urdf.stem}.yaml')
        for name, path in (('out', target), ('controller', controller)):
            if path.exists() and not overwrite:
                raise ConfigError(name, 'a new file, or --overwrite', path)
        # Only now: what is heavy is not loaded for the sake of an error.
        from sim_bridge.new_robot import new_robot as write
        from sim_bridge.new_robot import write_controller

        robot = write(urdf, sensor, tip, target)
        write_controller(robot, controller)
    for text in robot.found:
        typer.echo(text)
    for text in robot.missing:
        typer.echo(f'missing: {text}')
    typer.echo(f'written to {robot.path}; try: multicontact simulate --robot {robot.path} '
               '--scenario one_contact')
    typer.echo(f'and to {controller}, for the arm itself: multicontact run --external '
               f'--controller {controller}')
