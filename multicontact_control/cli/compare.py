"""`multicontact compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, resumable
from multicontact_control.cli.options import split_list
import typer


def compare(
    quick: Annotated[bool, typer.Option(
        '--quick', help='A reduced matrix: four estimators, one seed, no runs without active '
        'state.')] = False,
    plants: Annotated[str, typer.Option(
        help='Plants, with commas between: presets or paths.')] = 'rigid,puma',
    estimators: Annotated[str, typer.Option(
        help='Noise estimators, with commas between; `window rescaled` is `window` with the same '
        'R at rest as `lead_window`. All if not given.')] = '',
    seeds: Annotated[int | None, typer.Option(
        help='Number of seeds, from 0: 3, or 1 with --quick.')] = None,
    jobs: Annotated[int, typer.Option(help='Runs at once; 0 for every core.')] = 0,
    out: Annotated[Path, typer.Option(
        help='Folder for the results. Runs that are finished there are not run again.',
    )] = Path('runs/compare'),
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Run everything again.')] = False,
) -> None:
    """
    Compare the noise estimators on the paper's disturbances, with and without the active state.

    Everything runs bare, the control law without its supervisor: its own limits are the point.

    Writes comparison.json and comparison.html. Exit code 0, whatever the verdicts; 2: bad input.
    """
    from multicontact_control.experiment.comparison.run import (
        compare_and_report,
        ComparisonRequest,
    )

    with resumable(), errors_in_one_line():
        compare_and_report(ComparisonRequest(
            plants=split_list(plants), estimators=split_list(estimators), seeds=seeds, jobs=jobs,
            quick=quick, out=out, overwrite=overwrite))
