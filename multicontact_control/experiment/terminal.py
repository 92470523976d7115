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


def moving_bar(
    *columns: ProgressColumn, console: Console | None = None, kind: type[Progress] = Progress,
    **options: Any,
) -> Progress:
    """Return a bar of some columns, shown where text can move."""
    console = console or terminal()
    lively = console.is_terminal and not console.is_dumb_terminal and not console.no_color
    return kind(*columns, console=console, disable=not lively, **options)


class CountBar(Progress):
    """A bar that counts; where it is not shown, a line has the state once a minute."""

    interval = 60.0  # s
    _printed = 0.0

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Count on, and print the line when its time has come."""
        self.update(task_id, advance=advance)
        task, now = self._tasks[task_id], self.get_time()
        if self.disable and now - (self._printed or task.start_time or now) >= self.interval:
            self._printed = now
            self.console.print(f'{task.description}: {task.completed:.0f} of {task.total:.0f}',
                               highlight=False, markup=False, soft_wrap=True)
