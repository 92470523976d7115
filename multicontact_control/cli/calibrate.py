"""`multicontact calibrate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, EXIT_FAILED
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.terminal import terminal
import typer

if TYPE_CHECKING:
    from multicontact_control.experiment.calibration import Calibration


SIMULATED = ('robot', 'plant', 'seed')
RUNNING = ('tilt', 'move_time', 'domain_id')  # what only a robot that runs is asked


def calibrate(
    context: typer.Context, robot: options.Robot = '', plant: options.Plant = '',
    seed: options.Seed = 0,
    out: Annotated[Path, typer.Option(help='Folder for tool.yaml.')] = Path('.'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace a tool.yaml that is already there.')] = False,
    from_bag: Annotated[Path | None, typer.Option(
        metavar='BAG', help='Weigh the tool of your robot from a recording of joint_states and '
        'ft_sensor/wrench, in which it rests in 4 poses or more that tilt the tool differently, '
        '1.5 s in each; takes --controller.')] = None,
    external: Annotated[bool, typer.Option(
        '--external', help='Weigh the tool of your robot by the controller that runs on it, which '
        'tilts the tool to four sides; takes --controller.')] = False,
    controller: options.ControllerFiles = None,
    tilt: Annotated[float, typer.Option(
        help='With --external: how far to tilt the tool [deg].', min=5.0, max=90.0)] = 25.0,
    move_time: Annotated[float, typer.Option(
        help='With --external: time from pose to pose [s].', min=0.1)] = 3.0,
    domain_id: options.DomainId = None, namespace: options.Namespace = None,
) -> None:
    """
    Weigh the tool: mass, centre of mass and bias of the wrist sensor.

    The simulated arm goes through the poses of its robot (config/calibration.yaml for the PUMA),
    and what is found is shown beside the truth, which includes a bias drawn from the seed; a robot
    is weighed from a recording or by its running controller. The result is written to tool.yaml,
    to lay over the controller's parameters. Exit code 0: mass within 2 %, centre of mass within
    3 mm, force bias within 0.1 N, or found on a robot; 1: not; 2: bad input.
    """
    with errors_in_one_line():
        given = options.given_options(context)
        if from_bag is not None:
            options.refuse_options(given, ('external', *SIMULATED, *RUNNING), '--from-bag')
        elif external:
            options.refuse_options(given, SIMULATED, '--external')
        else:
            options.refuse_options(
                given, ('controller', 'namespace', *RUNNING), 'a simulated plant')
        from multicontact_control.experiment import calibration

        target = out / calibration.TOOL_FILE
        if target.exists() and not overwrite:
            raise ConfigError('out', 'a folder without a tool.yaml, or --overwrite', out)
        files = controller or []
        if from_bag is not None:
            from multicontact_control.experiment.weighing import weigh_recording

            weighed = weigh_recording(from_bag, files, namespace)
        elif external:
            from multicontact_control.experiment.weighing import weigh_running

            weighed = weigh_running(
                files, namespace=namespace or '', domain_id=domain_id, tilt=math.radians(tilt),
                move_time=move_time, tell=typer.echo)
        else:
            setup = calibration.sensor_setup(plant, seed, robot)
            result = calibration.calibrate(
                setup, calibration.calibration_config(setup.plant.robot))
            calibration.write_tool(out, result)
            show(result, f'tool of {setup.plant_name}, seed {seed}', target)
            return
        for remark in weighed.remarks:
            typer.echo(remark)
        result = calibration.Calibration(weighed.found, None)
        calibration.write_tool(out, result)
        show(result, 'tool', target)


def show(result: Calibration, title: str, target: Path) -> None:
    """Show what was found; exit code 1 if it is not what there was to find."""
    from multicontact_control.experiment.calibration import calibration_table

    found, console = result.found, terminal()
    console.print(calibration_table(result, title))
    lines = [f'{found.poses} poses, condition {found.condition:.3g}, residual '
             f'{found.force_residual:.3g} N and {found.torque_residual:.3g} N m rms']
    if result.truth is not None:
        mass, com, bias = result.errors
        lines.append(
            f'mass {100.0 * mass:.3f} %, centre of mass {1e3 * com:.3f} mm, force bias '
            f'{bias:.4f} N off: {"within" if result.good else "NOT within"} 2 %, 3 mm and 0.1 N')
    for line in (*lines, f'written to {target}'):
        console.print(line, highlight=False, soft_wrap=True)
    if result.truth is not None and not result.good:
        raise typer.Exit(EXIT_FAILED)
