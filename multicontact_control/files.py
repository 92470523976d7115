"""Files that a reader finds whole, or as they were before."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import math
from pathlib import Path
import re
from typing import Any

from multicontact_control.errors import ConfigError


def file_name(text: str) -> str:
    """Return text as part of a file's name, with what not every system has in one replaced."""
    return re.sub(r'[^\w.-]', '_', text)


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


def read_json(path: Path) -> Any:
    """Read JSON; ConfigError if the file cannot be read or is not JSON."""
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(str(path), 'a readable file', error.strerror or error) from None
    except ValueError as error:
        raise ConfigError(str(path), 'valid JSON', error) from None


def finite(value: Any) -> Any:
    """Return JSON values with None for every number that is not finite."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
