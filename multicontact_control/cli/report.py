"""`multicontact report` and `multicontact identify`, of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
import typer


def report(
    context: typer.Context,
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar='RUN',
            help='Folders of `run` or `simulate`, bag folders, or .mcap files.',
        ),
    ],
    claims: Annotated[
        bool,
        typer.Option(
            '--claims', help='Judge the claims of the paper by other scenarios, too.'
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help='Folder for report.html, the figures and the passes of a path; the first run, or '
            'beside the first recording, if not given.'
        ),
    ] = None,
    controller: options.ControllerFiles = None,
    namespace: options.Namespace = None,
) -> None:
    """
    Show verdict, numbers and figures of runs on a page in HTML, and print the verdict.

    A run of the scenario `paper` is judged by the claims of the paper, too; page and terminal have
    their table. Of a recording without ground truth the measured forces are shown, and the run is
    not judged. Names and rate are those of the messages, or of --controller. Of a run along a path
    there are a table of its passes and a map of the force, too.
    """
    from multicontact_control.judging.claims import judge_claims_of_run
    from multicontact_control.judging.display import print_claims
    from multicontact_control.judging.report import write_report
    from multicontact_control.judging.results import load
    from multicontact_control.judging.run_folders import (
        find_report_folder,
        is_finished_run,
    )
    from multicontact_control.judging.verdict import describe_verdict
    from rich.console import Console

    if all(is_finished_run(path) for path in runs):
        options.refuse_options(
            context,
            ('controller', 'namespace'),
            'with runs of this package, which know their own',
        )
    loaded = [load(path, controller or (), namespace) for path in runs]
    paths = write_report(loaded, out or find_report_folder(runs[0]), claims=claims)
    for run in loaded:
        quality = run.summary.get('quality')  # which an older version did not write
        remarks = run.summary.get('remarks', ())
        for line in (describe_verdict(run.summary), quality, *remarks):
            if line:
                typer.echo(f'{run.folder}: {line}')
        judged = judge_claims_of_run(run.metrics, run.summary, any_scenario=claims)
        if judged:
            console = Console(highlight=False, soft_wrap=True)
            print_claims(console, [claim._asdict() for claim in judged])
    typer.echo(f'report in {paths[0]}, {len(paths) - 1} figures')


def identify(
    run: Annotated[
        Path,
        typer.Argument(
            metavar='RUN',
            help='Folder of `run` or `simulate`, or a bag (folder or .mcap file) with '
            '--controller.',
        ),
    ],
    controller: options.ControllerFiles = None,
) -> None:
    """
    Identify the contacts of a run from its force steps.

    For each contact: stiffness and damping of the surface in series with the arm, friction of the
    others, inertia of the tool, noise of the sensor, and the delay from a commanded torque to the
    motion, each with its standard error.
    """
    from multicontact_control.commissioning.contact_identification import (
        describe_contacts,
        identify_contacts,
    )
    from multicontact_control.judging.results import load

    loaded = load(run, controller or ())
    typer.echo(describe_contacts(identify_contacts(loaded.data, loaded.setup)))
