"""How a command ends: its exit code, and one line for an error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from multicontact_control.errors import ConfigError, MulticontactError
import typer

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_SIGNAL = 128


@contextmanager
def errors_in_one_line() -> Iterator[None]:
    """Turn an error of the package into its line on stderr and its exit code."""
    try:
        yield
    except ConfigError as error:
        typer.echo(f'multicontact: {error}', err=True)
        raise typer.Exit(EXIT_USAGE) from None
    except MulticontactError as error:
        typer.echo(f'multicontact: {error}', err=True)
        raise typer.Exit(EXIT_FAILED) from None


def end_by_verdict(summary: dict[str, Any]) -> None:
    """Exit with 1 if the run was not stable, or was held by the supervisor."""
    if summary['stable'] is False:
        raise typer.Exit(EXIT_FAILED)
