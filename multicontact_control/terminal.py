"""
Where commands print to: colours and moving bars, or plain text.

Nothing is coloured and nothing moves where the output is no terminal, as in a pipe or a file, on a
dumb one, or where NO_COLOR is set (https://no-color.org).
"""

from __future__ import annotations

import os
import stat
from typing import Any

from multicontact_control.wording import lasting
from rich.console import Console
from rich.progress import Progress, ProgressColumn, TaskID


def terminal(*, stderr: bool = False) -> Console:
    """Return what prints to the terminal, to the error stream if asked for."""
    if os.environ.get('NO_COLOR'):
        return Console(stderr=stderr, color_system=None)
    return Console(stderr=stderr)


def is_lively(console: Console) -> bool:
    """Return whether something may move there, and have colours."""
    return console.is_terminal and not console.is_dumb_terminal and not console.no_color


def moving_bar(
    *columns: ProgressColumn, console: Console | None = None, kind: type[Progress] = Progress,
    **options: Any,
) -> Progress:
    """Return a bar of some columns, which is not shown where nothing may move."""
    console = console or terminal()
    return kind(*columns, console=console, disable=not is_lively(console), **options)


class CountBar(Progress):
    """A bar that counts; where it is not shown, a line says now and then how far it is."""

    told_every = 60.0  # s

    def __init__(self, *columns: ProgressColumn, **options: Any) -> None:
        super().__init__(*columns, **options)
        self._told = self.get_time()

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Count on."""
        self.update(task_id, advance=advance)

    def update(self, task_id: TaskID, *args: Any, **changes: Any) -> None:
        """Take note of how far it is."""
        super().update(task_id, *args, **changes)
        task, now = self._tasks[task_id], self.get_time()
        if not self.disable or task.total is None or now - self._told < self.told_every:
            return
        self._told = now
        left = task.time_remaining
        self.console.print(
            f'{task.description}: {task.completed:.0f} of {task.total:.0f}'
            + (f', about {lasting(left)} left' if left and not task.finished else ''),
            highlight=False, markup=False, soft_wrap=True)


def leave_terminal() -> None:
    """Say nothing any more, but to a file: a terminal that has hung up would refuse it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        if not stat.S_ISREG(os.fstat(number).st_mode):
            os.dup2(nowhere, number)
    os.close(nowhere)
