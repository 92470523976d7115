"""
Where commands print to: colours and moving bars, or plain text.

Nothing is coloured and nothing moves where the output is no terminal, as in a pipe or a file, on a
dumb one, or where NO_COLOR is set (https://no-color.org).
"""

from __future__ import annotations

import os
import stat
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn


def terminal(*, stderr: bool = False) -> Console:
    """Return what prints to the terminal, to the error stream if asked for."""
    if os.environ.get('NO_COLOR'):
        return Console(stderr=stderr, color_system=None)
    return Console(stderr=stderr)


def is_lively(console: Console) -> bool:
    """Return whether something may move there, and have colours."""
    return console.is_terminal and not console.is_dumb_terminal and not console.no_color


def moving_bar(
    *columns: ProgressColumn, console: Console | None = None, **options: Any,
) -> Progress:
    """Return a bar of some columns, which is not shown where nothing may move."""
    console = console or terminal()
    return Progress(*columns, console=console, disable=not is_lively(console), **options)


def leave_terminal() -> None:
    """Say nothing any more, but to a file: a terminal that has hung up would refuse it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        if not stat.S_ISREG(os.fstat(number).st_mode):
            os.dup2(nowhere, number)
    os.close(nowhere)
