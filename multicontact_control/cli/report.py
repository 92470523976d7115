"""`multicontact report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
import typer


def report(
    context: typer.Context,
    runs: Annotated[list[Path], typer.Argument(
        metavar='RUN', help='Folders of `run` or `simulate`, bag folders, or .mcap files.')],
    comparison: Annotated[Path | None, typer.Option(
        help='Folder of `study compare`, for the claims that compare estimators.')] = None,
    out: Annotated[Path | None, typer.Option(
        help='Folder for report.html and the figures; the first run, or beside the first '
        'recording, if not given.')] = None,
    controller: options.ControllerFiles = None,
    namespace: options.Namespace = None,
) -> None:
    """
    Judge recorded runs by the claims of the paper, in HTML.

    Of a recording without ground truth the measured forces are shown, and the run is not judged.
    Names and rate are those of the messages, or of --controller.
    """
    from multicontact_control.experiment.report import write_report
    from multicontact_control.experiment.results import is_whole_run, load, report_folder
    from multicontact_control.experiment.study.presets.compare import read_claim_rows

    if all(map(is_whole_run, runs)):
        options.refuse_options(
            options.given_options(context), ('controller', 'namespace'),
            'runs of this package, which know their own')
    rows = read_claim_rows(comparison) if comparison is not None else ()
    loaded = [load(path, controller or (), namespace) for path in runs]
    paths = write_report(loaded, out or report_folder(runs[0]), rows)
    for run in loaded:
        for remark in run.summary.get('remarks', ()):
            typer.echo(f'{run.folder}: {remark}')
    typer.echo(f'report in {paths[0]}, {len(paths) - 1} figures')
