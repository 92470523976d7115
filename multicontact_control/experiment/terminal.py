"""
Where commands print to: colours and moving bars, or plain text.

Colours and moving bars appear on terminals only: not in a pipe or a file, on a dumb terminal, or
where NO_COLOR is set (https://no-color.org).
"""

from __future__ import annotations

import os
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn, TaskID


def terminal(*, stderr: bool = False) -> Console:
    """Return the console of the standard output, or of the error stream."""
    return Console(stderr=stderr, color_system=None if os.environ.get('NO_COLOR') else 'auto')


def is_lively(console: Console) -> bool:
    """Return whether a console shows moving text and colours."""
    return console.is_terminal and not console.is_dumb_terminal and not console.no_color


def moving_bar(
    *columns: ProgressColumn, console: Console | None = None, kind: type[Progress] = Progress,
    **options: Any,
) -> Progress:
    """Return a bar of some columns, shown on a lively console only."""
    console = console or terminal()
    return kind(*columns, console=console, disable=not is_lively(console), **options)


class CountBar(Progress):
    """A bar that counts; where it is not shown, a line tells the state once a minute."""

    told_every = 60.0  # s

    def __init__(self, *columns: ProgressColumn, **options: Any) -> None:
        super().__init__(*columns, **options)
        self._told = self.get_time()

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Count on."""
        self.update(task_id, advance=advance)

    def update(self, task_id: TaskID, *args: Any, **changes: Any) -> None:
        """Update the bar, or print the line when its time has come."""
        super().update(task_id, *args, **changes)
        task, now = self._tasks[task_id], self.get_time()
        if not self.disable or task.total is None or now - self._told < self.told_every:
            return
        self._told = now
        left = task.time_remaining
        self.console.print(
            f'{task.description}: {task.completed:.0f} of {task.total:.0f}'
            + (f', about {_duration(left)} left' if left and not task.finished else ''),
            highlight=False, markup=False, soft_wrap=True)


def _duration(seconds: float) -> str:
    """Return a duration in the unit that suits it."""
    if seconds < 90.0:
        return f'{seconds:.0f} s'
    return f'{seconds / 60.0:.1f} min' if seconds < 5400.0 else f'{seconds / 3600.0:.1f} h'
