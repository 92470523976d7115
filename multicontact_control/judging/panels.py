"""What a figure is made of, whether it is drawn in a file or on a page: curves over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from multicontact_control.arrays import Vector

# Colours of Okabe and Ito, which differ for colour-blind readers, too.
CURVE_COLOURS = (
    '#0072b2',
    '#e69f00',
    '#009e73',
    '#d55e00',
    '#cc79a7',
    '#56b4e9',
    '#777777',
)
MEASURED_COLOUR = '#56b4e9'
TRUE_COLOUR = '#d55e00'
ESTIMATED_COLOUR = '#0072b2'
COMMANDED_COLOUR = '#222222'
WINDOW_COLOURS = {'rest': '#eef1f4', 'start': '#f9e2d6', 'moving': '#faf3e0'}


class ShadedSpan(NamedTuple):
    """
    A stretch of a run that is shaded: the name is one of `WINDOW_COLOURS`.

    Shaded are the windows that the numbers of the summary are of, so that a reader sees what was
    judged.
    """

    name: str
    start: float  # s
    end: float  # s


class Trace(NamedTuple):
    """
    A series as a line over the time of the run.

    NaN is a gap in it. A faint or broad line lies below the others, so that what it is compared
    with can be seen.
    """

    label: str
    values: Vector  # shape (m,)
    colour: str = MEASURED_COLOUR
    dashed: bool = False
    faint: bool = False
    broad: bool = False  # a band, below what lies upon it


class Panel(NamedTuple):
    """
    Lines over time on common axes.

    Its label has the unit in brackets; figures whose panels share it are drawn with the same
    vertical axis, so that heights can be compared.
    """

    label: str  # of the vertical axis
    traces: Sequence[Trace]
    logarithmic: bool = False
    least_span: float = 0.0  # of the vertical axis, so that small noise looks small


class RunFigure(NamedTuple):
    """
    One figure of a run: panels over time, below each other.

    The file's name tells which figure of the paper (P04 Figs 3 to 6) it stands beside, if any.
    """

    file: str  # name without an ending
    title: str
    panels: Sequence[Panel]


def choose_colour(index: int) -> str:
    """
    Return the colour of the curve of a contact; there are seven before they come again.

    `index` is the contact's column, so that a contact has one colour in every figure of a run.
    """
    return CURVE_COLOURS[index % len(CURVE_COLOURS)]
