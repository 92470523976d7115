"""Files that are replaced as a whole: a reader sees the old content or the new one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import math
from pathlib import Path
import shutil
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


@contextmanager
def make_whole_folder(folder: Path) -> Iterator[Path]:
    """
    Yield a folder to be filled, which gets its name when it is complete.

    Until then it is beside it, as ``<name>.partial``; an exception removes it. A process that is
    killed leaves it there, where the next one replaces it. Raises ConfigError of `out` if there is
    something of that name, or the folder cannot be made.
    """
    if folder.exists() or folder.is_symlink():
        raise ConfigError('out', 'a folder that is not there yet', folder)
    partial = folder.with_name(f'{folder.name}.partial')
    try:
        if partial.exists():
            shutil.rmtree(partial)
        partial.mkdir(parents=True)
    except OSError as error:
        raise ConfigError(
            'out', 'a folder that can be made', f'{folder} ({error.strerror})'
        ) from None
    try:
        yield partial
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


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
