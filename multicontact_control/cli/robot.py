"""What brings up a robot: `multicontact new-robot`, `calibrate` and `push-test`."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.errors import ConfigError
import typer


@dataclass(frozen=True)
class RobotFileOptions:
    """Options of `new-robot`: the files that it writes."""

    out: Annotated[
        Path | None,
        typer.Option(help='Robot file to write; NAME.yaml of NAME.urdf if not given.'),
    ] = None
    controller: Annotated[
        Path, typer.Option(help="Parameter file of the arm's controller to write.")
    ] = Path('controller.yaml')
    overwrite: options.Overwrite = False


@options.flatten_options
def new_robot(
    urdf: Annotated[Path, typer.Argument(metavar='URDF', help="The vendor's URDF.")],
    tip: Annotated[str, typer.Option(help='Link that touches.')],
    sensor: Annotated[
        str,
        typer.Option(
            help='Link that carries the wrist sensor; all beyond it is the tool.'
        ),
    ],
    files: RobotFileOptions,
    lock: Annotated[
        list[str] | None,
        typer.Option(
            metavar='JOINT=POSITION',
            help='A joint that is no part of the arm, e.g. of a mobile base '
            'or gripper, and where it stays [rad or m]; may be repeated.',
        ),
    ] = None,
) -> None:
    """
    Write the files of a new robot from its URDF.

    Prints what is yet to be added to them, and which command tries them. Joints, limits and masses
    are those of the URDF; home is a posture with the tool straight down, by inverse kinematics.
    """
    target = files.out
    if target is None:
        target = Path(f'{urdf.stem}.yaml')
    controller = files.controller
    for name, path in (('out', target), ('controller', controller)):
        if path.exists() and not files.overwrite:
            raise ConfigError(f'--{name}', 'a new file, or --overwrite', path)
    # Only now: bad input is refused before pinocchio is loaded.
    from sim_bridge.new_robot import new_robot as write

    for text in write(urdf, sensor, tip, target, controller, lock or ()):
        typer.echo(text)
    typer.echo(
        f'written to {target}; try: multicontact simulate --robot {target} '
        '--scenario one_contact'
    )
    typer.echo(
        f'and to {controller}, for the arm itself: multicontact run --external '
        f'--controller {controller}'
    )


@dataclass(frozen=True)
class TiltOptions:
    """Options of `calibrate`: how the tool is tilted to be weighed."""

    tilt: Annotated[
        float,
        typer.Option(
            help='Tilt of the tool to each side [deg].',
            min=10.0,  # with less, four poses do not determine the tool
            max=90.0,
        ),
    ] = 25.0
    move_time: Annotated[
        float, typer.Option(help='Time from pose to pose [s].', min=0.1)
    ] = 3.0


@options.flatten_options
def calibrate(
    context: typer.Context,
    *,
    controller: options.ControllerFiles = None,
    from_bag: Annotated[
        Path | None,
        typer.Option(
            metavar='BAG',
            help='Take the rests from a recording of joint_states and '
            'ft_sensor/wrench: 4 or more of 1.5 s that tilt the tool differently.',
        ),
    ] = None,
    motion: TiltOptions,
    place: options.PlaceOptions,
    out: Annotated[
        Path, typer.Option(help='Folder for tool.yaml, which is replaced.')
    ] = Path('.'),
) -> None:
    """
    Weigh the tool, and find the bias of the wrist sensor.

    The running controller lifts the tool off its contacts and tilts it to four sides: leave room.
    A pose that gives no quiet rest is tried again, and then goes without: four are enough. Needs
    the controller's parameter file, --controller. The result is tool.yaml, a parameter file to lay
    over it.
    """
    from multicontact_control.commissioning import weighing

    files = controller or ()
    if from_bag is None:
        result = weighing.weigh_running(
            files,
            namespace=place.namespace or '',
            domain_id=place.domain_id,
            tilt=math.radians(motion.tilt),
            move_time=motion.move_time,
            tell=typer.echo,
        )
    else:
        options.refuse_options(
            context, ('tilt', 'move_time', 'domain_id'), 'with --from-bag'
        )
        result = weighing.weigh_recording(from_bag, files, place.namespace, typer.echo)
    path = weighing.write_tool(out, result)
    typer.echo('\n'.join([*weighing.describe_tool(result), f'written to {path}']))


@options.flatten_options
def push_test(place: options.PlaceOptions) -> None:
    """
    Prove sign, frame and scale of the wrist sensor by pushes.

    Starts the push test of the running controller and prints where to push the tool: with a spring
    balance, or, if it is simulated, on the page of `view --graph` or by the topic sim_node/push.
    """
    from multicontact_control.commissioning.guided_push_test import lead_push_test

    if not lead_push_test(typer.echo, place.namespace or '', place.domain_id):
        raise typer.Exit(options.EXIT_FAILED)
