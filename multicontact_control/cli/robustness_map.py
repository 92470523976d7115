"""`multicontact map`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, resumable
from multicontact_control.cli.options import split_list
import typer


def robustness_map(
    quick: Annotated[bool, typer.Option(
        '--quick', help='Two estimators on plant `rigid`, a coarse grid.')] = False,
    plants: Annotated[str, typer.Option(
        help='Plants, with commas between; rigid,puma, or rigid with --quick.')] = '',
    estimators: Annotated[str, typer.Option(
        help='Noise estimators, with commas between. All if not given.')] = '',
    jobs: Annotated[int, typer.Option(help='Runs at once; 0 for every core.')] = 0,
    out: Annotated[Path, typer.Option(
        help='Folder for the results. Runs that are finished there are not run again.',
    )] = Path('runs/map'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Run everything again.')] = False,
) -> None:
    """
    Map how wrong stiffness and delay may be, simulated and by the linear loop.

    True stiffness 0.1 to 20 times the model's, actuator delay 0 to 3 periods. Everything runs
    bare, the control law without its supervisor: its own limits are the point. Writes
    robustness.json, robustness.png and robustness.html.
    """
    from multicontact_control.experiment.robustness.run import map_and_report, MapRequest

    with resumable(), errors_in_one_line():
        map_and_report(MapRequest(
            plants=split_list(plants), estimators=split_list(estimators), jobs=jobs, quick=quick,
            out=out, overwrite=overwrite))
