"""`multicontact new-robot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.errors import ConfigError
import typer


def new_robot(
    urdf: Annotated[Path, typer.Argument(metavar='URDF', help="The vendor's URDF.")],
    tip: Annotated[str, typer.Option(help='Link that touches.')],
    sensor: Annotated[str, typer.Option(
        help='Link that carries the wrist sensor; all beyond it is the tool.')],
    out: Annotated[Path | None, typer.Option(
        help='Robot file to write; NAME.yaml of NAME.urdf if not given.')] = None,
    controller: Annotated[Path, typer.Option(
        help='Parameter file to write, of the controller on the real arm.',
        )] = Path('controller.yaml'),
    lock: Annotated[list[str] | None, typer.Option(
        metavar='JOINT=POSITION', help='A joint that is no part of the arm, e.g. of a mobile base '
        'or gripper, and where it stays [rad or m]; may be repeated.')] = None,
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace these files.')] = False,
) -> None:
    """
    Write the files of a new robot from its URDF.

    Prints what is yet to be added to them. Joints, limits and masses are those of the URDF; home
    is a posture with the tool straight down, by inverse kinematics. `multicontact simulate --robot
    FILE --scenario one_contact` then simulates it, and `multicontact run --external --controller
    FILE` runs the real arm.
    """
    target = out or Path(f'{urdf.stem}.yaml')
    for name, path in (('out', target), ('controller', controller)):
        if path.exists() and not overwrite:
            raise ConfigError(f'--{name}', 'a new file, or --overwrite', path)
    # Only now: bad input is refused before pinocchio is loaded.
    from sim_bridge.new_robot import new_robot as write

    for text in write(urdf, sensor, tip, target, controller, lock or ()):
        typer.echo(text)
    typer.echo(f'written to {target}; try: multicontact simulate --robot {target} '
               '--scenario one_contact')
    typer.echo(f'and to {controller}, for the arm itself: multicontact run --external '
               f'--controller {controller}')
