"""Files that are replaced as a whole: a reader sees the old content or the new one."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError


def replace_text_file(path: Path, text: str) -> None:
    """
    Replace a file by text in UTF-8.

    A program that ends meanwhile leaves the old file.
    """
    replace_binary_file(path, text.encode('utf-8'))


def replace_binary_file(path: Path, content: bytes) -> None:
    """
    Replace a file by bytes.

    They are written beside it first, so that a program that ends meanwhile leaves the old file.
    """
    partial = path.with_suffix('.partial')
    partial.write_bytes(content)
    partial.replace(path)


def replace_json_file(path: Path, content: Any) -> None:
    """Replace a file by indented JSON values; ValueError for a number that is not finite."""
    replace_text_file(path, json.dumps(content, indent=2, allow_nan=False) + '\n')


def read_json_file(path: Path) -> Any:
    """Read JSON; ConfigError if the file cannot be read or is not JSON."""
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise ConfigError(
            str(path), 'a readable file of JSON', hint=str(error)
        ) from None


def replace_nonfinite_numbers(value: Any) -> Any:
    """
    Return nested JSON values with None for every number that is not finite.

    JSON knows neither NaN nor infinity.
    """
    if isinstance(value, dict):
        return {name: replace_nonfinite_numbers(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_nonfinite_numbers(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
