"""`multicontact identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def identify(
    run: Annotated[Path, typer.Argument(
        metavar='RUN', help='Folder of `run` or `simulate`, or a bag (folder or .mcap file) with '
        '--config.')],
    config: Annotated[Path | None, typer.Option(
        help='Parameter file of the controller, for a bag; its URDF is looked for beside '
        'it.')] = None,
    out: Annotated[Path | None, typer.Option(help='JSON file to write.')] = None,
) -> None:
    """
    Identify the contacts of a run from its force steps.

    For each contact: stiffness and damping of the surface, friction of the others, inertia of the
    tool, noise of the sensor, and the delay from a commanded torque to the motion, each with its
    standard error, by the band-pass and the regression of the on-line estimate.
    """
    from multicontact_control.experiment.contact_identification import (
        identify_contacts,
        read_recording,
        show,
    )
    from multicontact_control.files import finite, write_json

    result = identify_contacts(*read_recording(run, config))
    typer.echo(show(result))
    if out is not None:
        write_json(out, finite(result))
        typer.echo(f'written to {out}')
