"""`multicontact calibrate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.terminal import terminal
import typer

SIMULATED = ('robot', 'plant', 'seed')
RUNNING = ('tilt', 'move_time', 'domain_id')  # of a robot that runs


def calibrate(
    context: typer.Context, simulated: options.PlantOptions,
    from_bag: Annotated[Path | None, typer.Option(
        metavar='BAG', help='Weigh the tool of your robot from a recording of joint_states and '
        'ft_sensor/wrench, with 4 or more rests of 1.5 s that tilt the tool differently. Needs '
        '--controller.')] = None,
    external: Annotated[bool, typer.Option(
        '--external', help='Weigh the tool of your robot: the controller that runs on it tilts '
        'the tool to four sides. Needs --controller.')] = False,
    controller: options.ControllerFiles = None,
    tilt: Annotated[float, typer.Option(
        help='With --external: tilt of the tool [deg].', min=5.0, max=90.0)] = 25.0,
    move_time: Annotated[float, typer.Option(
        help='With --external: time from pose to pose [s].', min=0.1)] = 3.0,
    domain_id: options.DomainId = None, namespace: options.Namespace = None,
    out: Annotated[Path, typer.Option(help='Folder for tool.yaml.')] = Path('.'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace the tool.yaml in that folder.')] = False,
) -> None:
    """
    Weigh the tool, and find the bias of the wrist sensor.

    Without --from-bag or --external a simulated arm goes through the poses of its robot, and the
    result is shown beside the truth, which includes a bias drawn from the seed. The result is
    written to tool.yaml, a parameter file to lay over the controller's. In simulation the exit
    code is 1 if it is not within 2 % of the mass, 3 mm and 0.1 N of the force bias.
    """
    from multicontact_control.experiment import calibration, weighing

    given = options.given_options(context)
    if from_bag is not None:
        options.refuse_options(given, ('external', *SIMULATED, *RUNNING), '--from-bag')
    elif external:
        options.refuse_options(given, SIMULATED, '--external')
    else:
        options.refuse_options(given, ('controller', 'namespace', *RUNNING), 'a simulated plant')
    target = out / calibration.TOOL_FILE
    if target.exists() and not overwrite:
        raise ConfigError('out', 'a folder without a tool.yaml, or --overwrite', out)
    title, files = 'tool', controller or []
    if from_bag is not None:
        result = calibration.Calibration(
            weighing.weigh_recording(from_bag, files, namespace, typer.echo), None)
    elif external:
        result = calibration.Calibration(weighing.weigh_running(
            files, namespace=namespace or '', domain_id=domain_id, tilt=math.radians(tilt),
            move_time=move_time, tell=typer.echo), None)
    else:
        setup = calibration.sensor_setup(
            simulated.plant, simulated.seed, simulated.robot)
        result = calibration.calibrate(setup)
        title = f'tool of {setup.plant_name}, seed {setup.seed}'
    calibration.write_tool(out, result.found)
    terminal().print(calibration.calibration_table(result, title))
    found = result.found
    typer.echo(f'{found.poses} poses, condition {found.condition:.3g}, residual '
               f'{found.force_residual:.3g} N and {found.torque_residual:.3g} N m rms; written to '
               f'{target}')
    if not result.good:
        raise RunError('tool: expected the true one within 2 % of the mass, 3 mm and 0.1 N, found '
                       'the errors in the table')
