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
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace these files.')] = False,
) -> None:
    """
    Write the files of a new robot from its URDF.

    The command lists what they lack. Joints, limits and masses are those of the URDF; home is a
    posture with the tool straight down, by inverse kinematics. `multicontact simulate --robot FILE
    --scenario one_contact` then simulates it, and `multicontact run --external --controller FILE`
    runs the real arm.
    """
    target = out or Path(f'{urdf.stem}.yaml')
    for name, path in (('out', target), ('controller', controller)):
        if path.exists() and not overwrite:
            raise ConfigError(name, 'a new file, or --overwrite', path)
    # Only now: bad input is refused before pinocchio is loaded.
    from sim_bridge.new_robot import new_robot as write
    from sim_bridge.new_robot import write_controller

    robot = write(urdf, sensor, tip, target)
    write_controller(robot, controller)
    for text in (*robot.remarks, *(f'missing: {text}' for text in robot.missing)):
        typer.echo(text)
    typer.echo(f'written to {target}; try: multicontact simulate --robot {target} '
               '--scenario one_contact')
    typer.echo(f'and to {controller}, for the arm itself: multicontact run --external '
               f'--controller {controller}')
