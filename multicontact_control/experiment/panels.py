"""What a figure shows, whatever draws it: lines over time on common axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from multicontact_control.arrays import Vector

MEASURED = '#4c78a8'
ESTIMATED = '#54a24b'
COMMANDED = '#222222'
TRUE = '#e45756'
WINDOW = '#f2f2f2'
# Of lines that have none of their own.
COLOURS = ('#1f3b73', '#c26a00', '#18794e', '#c0262d', '#6b4fa0', '#777777', '#0b8a9e', '#8a6d00')
FILLED, OPEN = 'filled', 'open'


class Trace(NamedTuple):
    """A series as a line, or as points; a page has one width of lines."""

    label: str
    values: Vector  # shape (m,)
    colour: str | None = MEASURED
    width: float = 0.5
    dashed: bool = False
    faint: bool = False
    marker: str = ''  # of points, FILLED or OPEN, on a page


class Panel(NamedTuple):
    """Lines over time on common axes; logarithmic if levels are named, too."""

    label: str  # of the vertical axis
    traces: Sequence[Trace]
    limits: tuple[float, float] | None = None  # those of the data if not given
    levels: Sequence[tuple[float, str]] = ()  # horizontal lines and what they stand for
    height: float = 1.0  # relative to the other panels
    logarithmic: bool = False

    @property
    def on_log_axis(self) -> bool:
        """Return whether the vertical axis is logarithmic."""
        return self.logarithmic or bool(self.levels)


class Span(NamedTuple):
    """A stretch of a run that is shaded."""

    name: str
    start: float  # s
    end: float
