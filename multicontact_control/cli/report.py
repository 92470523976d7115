"""`multicontact report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line
import typer


def report(
    runs: Annotated[list[Path], typer.Argument(
        metavar='RUN...', help='Folders of `run` or `simulate`.')],
    comparison: Annotated[Path | None, typer.Option(
        help='Folder of `compare`, for the claims that compare estimators.')] = None,
    out: Annotated[Path | None, typer.Option(
        help='Folder for report.html and the figures; the first run if not given.')] = None,
) -> None:
    """Judge recorded runs by the claims of the paper: report.html, and figures as PNG and PDF."""
    from multicontact_control.experiment.report import write_report
    from multicontact_control.experiment.results import load_run
    from multicontact_control.experiment.study.presets.compare.results import read_comparison

    with errors_in_one_line():
        content = read_comparison(comparison) if comparison is not None else None
        paths = write_report([load_run(folder) for folder in runs], out or runs[0], content)
    typer.echo(f'report in {paths[0]}, {len(paths) - 1} figures')
