"""`multicontact compile`."""

from __future__ import annotations

import typer


def compile_kernels() -> None:
    """
    Compile the numerical kernels now, in half a minute, instead of at the first run.

    `make setup` calls this; every command compiles what is missing or outdated. NUMBA_CACHE_DIR
    names the folder that keeps the kernels.
    """
    from multicontact_control.experiment.compilation import ensure_compiled

    typer.echo(f'{ensure_compiled()} kernels compiled')
