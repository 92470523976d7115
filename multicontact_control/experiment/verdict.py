"""What a run is called; `judge` decides which."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

STABLE, HELD, NOT_STABLE = 'stable', 'held by the supervisor', 'not stable'
# Of a run that missed so many of its deadlines that the loop had another delay than its own: what
# came of that cannot be told from what the arm did. Only numbers that are not finite count.
UNJUDGED = 'not judged'
HOPELESS = 0.1  # share of the deadlines missed
UNJUDGED_TEXT = 'not judged: the machine could not keep real time'
# Of a run whose machine was too busy for it: what went wrong with the samples is not judged.
AS_FAR_AS_KNOWN = 'stable as far as it could be judged: the machine could not keep real time'


def verdict_text(summary: Mapping[str, Any]) -> str:
    """
    Return the verdict of a run and its reasons.

    Parameters
    ----------
    summary
        Of `summarise`, or what took its verdict from there; `verdict` may be missing in a file
        from before verdicts had names.

    """
    name: str = summary.get('verdict', STABLE if summary['stable'] else NOT_STABLE)
    if name == UNJUDGED:
        return '; seen: '.join([UNJUDGED_TEXT, *(
            ['; '.join(summary['instabilities'])] if summary['instabilities'] else [])])
    if name != STABLE:
        return f"{name}: {'; '.join(summary['instabilities'])}"
    return AS_FAR_AS_KNOWN if summary.get('kept_real_time') is False else STABLE
