"""Files that a reader finds whole, or as they were before."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """
    Yield the path to write to; what is there at the end takes the place of `path`.

    Parameters
    ----------
    path
        The file that is to be there, or to be replaced, in one step.

    """
    partial = path.with_suffix('.partial')
    yield partial
    partial.replace(path)


def write_text(path: Path, text: str) -> None:
    """Write text in UTF-8; a reader sees the old file or the new one."""
    with replacing(path) as partial:
        partial.write_text(text, encoding='utf-8')


def json_text(content: Any) -> str:
    """Return JSON values as a file has them; ValueError for a number that is not finite."""
    return json.dumps(content, indent=2, allow_nan=False) + '\n'


def write_json(path: Path, content: Any) -> None:
    """Write JSON values as `json_text`; a reader sees the old file or the new one."""
    write_text(path, json_text(content))
