"""`multicontact export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
import typer

OF_THE_SIMULATED_ARM = ('robot', 'plant', 'seed', 'engine')


@options.flatten_options
def export(
    context: typer.Context,
    folder: Annotated[
        Path, typer.Argument(metavar='DIR', help='Folder to write, or to replace.')
    ],
    chosen: options.SetupOptions,
    controller: options.ControllerFiles = None,
    target: Annotated[
        str,
        typer.Option(
            metavar='TRIPLE',
            help='Machine that is to run it, e.g. aarch64-linux-gnu; this one if not given.',
        ),
    ] = '',
) -> None:
    """
    Write the tick of a controller as a C library, with header, records and a C++ example.

    The library is made from the kernels that run in Python, and needs none of it. The controller
    is that of --controller, or of a simulated arm. Its forces and motions are written by the C
    program, not by a scenario. Needs `ar` and `cc`; the shared library of another target needs
    TRIPLE-gcc.
    """
    from multicontact_control.export.library import export_library
    from multicontact_control.loop import ControlLoop
    from multicontact_control.runs.compilation import ensure_compiled
    from multicontact_control.supervision.command_limits import CommandLimits

    if controller:
        options.refuse_options(context, OF_THE_SIMULATED_ARM, 'with --controller')
        setup = chosen.external(controller, context)
    else:
        setup = chosen.setup()
    ensure_compiled()
    loop = ControlLoop(setup.controller, None, CommandLimits(), setup.urdf_dir)
    files = export_library(loop, folder, target=target)
    typer.echo('\n'.join(map(str, files)))
    if not any(path.suffix == '.so' for path in files):
        typer.echo(f'without a shared library: no {target}-gcc on PATH', err=True)
