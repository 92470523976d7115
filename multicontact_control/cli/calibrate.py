"""`multicontact calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, EXIT_FAILED
from multicontact_control.cli.options import Plant, Seed
from multicontact_control.errors import ConfigError
from rich.console import Console
import typer


def calibrate(
    plant: Plant = 'puma', seed: Seed = 0,
    out: Annotated[Path, typer.Option(help='Folder for tool.yaml.')] = Path('.'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Replace a tool.yaml that is already there.')] = False,
) -> None:
    """
    Weigh the tool of the simulated arm: mass, centre of mass and bias of the wrist sensor.

    The arm goes through the poses of config/calibration.yaml. What is found is shown beside the
    truth, which includes a bias drawn from the seed, and written to tool.yaml, to lay over the
    controller's parameters. Exit code 0: mass within 2 %, centre of mass within 3 mm, force bias
    within 0.1 N; 1: not; 2: bad input.
    """
    from multicontact_control.experiment import calibration

    with errors_in_one_line():
        target = out / calibration.TOOL_FILE
        if target.exists() and not overwrite:
            raise ConfigError('out', 'a folder without a tool.yaml, or --overwrite', out)
        setup = calibration.sensor_setup(plant, seed)
        result = calibration.calibrate(setup, calibration.calibration_config())
        calibration.write_tool(out, result)
    found, (mass, com, bias) = result.found, result.errors
    console = Console()
    console.print(calibration.calibration_table(result, f'tool of {plant}, seed {seed}'))
    for line in (
            f'{found.poses} poses, condition {found.condition:.3g}, residual '
            f'{found.force_residual:.3g} N and {found.torque_residual:.3g} N m rms',
            f'mass {100.0 * mass:.3f} %, centre of mass {1e3 * com:.3f} mm, force bias '
            f'{bias:.4f} N off: {"within" if result.good else "NOT within"} 2 %, 3 mm and 0.1 N',
            f'written to {target}'):
        console.print(line, highlight=False, soft_wrap=True)
    if not result.good:
        raise typer.Exit(EXIT_FAILED)
