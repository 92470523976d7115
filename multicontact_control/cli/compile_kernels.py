"""`multicontact compile`."""

from __future__ import annotations

from multicontact_control.cli.exits import errors_in_one_line
import typer


def compile_kernels() -> None:
    """
    Compile the numerical kernels, so that no later command or node has to.

    `make setup` does it, and every command does it by itself where it has not been done: after
    an installation, for another user or processor, after a change of the sources. Takes half a
    minute, and nothing if all is there. NUMBA_CACHE_DIR names the folder to keep them in.
    """
    from multicontact_control.compiled import cache_folder
    from multicontact_control.experiment.compilation import ensure_compiled

    with errors_in_one_line():
        count = ensure_compiled()
    if count:
        typer.echo(f'{count} kernels compiled')
    elif cache_folder() is not None:
        typer.echo('all kernels are compiled')
