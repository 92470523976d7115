"""How the numerical kernels are compiled: once, and again when any of their sources changes."""

from __future__ import annotations

from collections.abc import Callable
import hashlib
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

FunctionT = TypeVar('FunctionT', bound=Callable[..., Any])


def sources_stamp(package_dir: Path) -> str:
    """Return a hash over the text of every module of a package that has something compiled."""
    digest = hashlib.sha256()
    for path in sorted(package_dir.rglob('*.py')):
        text = path.read_bytes()
        if b'@compiled' in text or b'@njit' in text:
            digest.update(path.relative_to(package_dir).as_posix().encode())
            digest.update(text)
    return digest.hexdigest()


STAMP = sources_stamp(Path(__file__).resolve().parent)


def compiled(function: FunctionT) -> FunctionT:
    """
    Compile a function with numba on its first call, or take it from numba's cache on disk.

    numba keeps the result beside the source, or where that cannot be written in the user's
    cache folder (NUMBA_CACHE_DIR moves it). It looks for changes in the function's own file
    only, although what the function calls is compiled into it; so the stamp that it compares is
    replaced by one over all compiled sources.
    """
    dispatcher: Any = njit(cache=True, error_model='numpy')(function)
    cache_file = getattr(getattr(dispatcher, '_cache', None), '_cache_file', None)
    if cache_file is not None:  # None when numba is told not to compile
        cache_file._source_stamp = STAMP
    result: FunctionT = dispatcher
    return result
