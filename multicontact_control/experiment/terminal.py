"""
Where commands print to: colours and moving bars, or plain text.

Colours and moving bars appear on terminals only: not in a pipe or a file, on a dumb terminal, or
where NO_COLOR is set (https://no-color.org).
"""

from __future__ import annotations

import os
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn


def terminal(*, stderr: bool = False) -> Console:
    """Return the console of the standard output, or of the error stream."""
    return Console(stderr=stderr, color_system=None if os.environ.get('NO_COLOR') else 'auto')


def moving_bar(
    *columns: ProgressColumn, console: Console | None = None, **options: Any,
) -> Progress:
    """Return a bar of some columns, shown where text can move."""
    console = console or terminal()
    lively = console.is_terminal and not console.is_dumb_terminal and not console.no_color
    return Progress(*columns, console=console, disable=not lively, **options)
