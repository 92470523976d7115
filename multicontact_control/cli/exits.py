"""How a command ends: its exit code, and one line for an error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import signal
from types import FrameType
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


@contextmanager
def resumable() -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into a line that says how to go on, and exit code 128 + n."""
    ended_by = signal.SIGINT

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal ended_by
        ended_by = signal.SIGTERM
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    except KeyboardInterrupt:
        typer.echo('multicontact: interrupted; what is finished is kept, and the same command '
                   'goes on from there', err=True)
        raise typer.Exit(EXIT_SIGNAL + ended_by) from None
    finally:
        signal.signal(signal.SIGTERM, before)


def end_by_verdict(summary: dict[str, Any]) -> None:
    """Exit with 1 if the run was not stable, or was held by the supervisor."""
    if summary['stable'] is False:
        raise typer.Exit(EXIT_FAILED)
