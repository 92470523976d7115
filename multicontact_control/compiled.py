"""
How the numerical kernels are compiled: once, and again when any of their sources changes.

`compiled` is the only door to numba. What it makes is kept on disk, in one folder, which
`multicontact compile` (`runs/compilation.py`) fills.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from functools import cache
import hashlib
import os
from pathlib import Path
import tempfile
from typing import Any, cast, TypeVar

import numba

FunctionT = TypeVar('FunctionT', bound=Callable[..., Any])

HERE = Path(__file__).resolve().parent
SOURCES = (HERE, HERE.parent / 'sim_bridge')  # packages with kernels
_kernels: list[Any] = []


@cache
def find_cache_folder() -> Path | None:
    """
    Return the folder of what is compiled of these sources, None where none can be written.

    It lies in ``NUMBA_CACHE_DIR``, or else beside the sources or in the user's cache folder.
    """
    # Its name is a hash over all kernels: numba compares a function's own file alone.
    digest = hashlib.sha256()
    for module in sorted(path for folder in SOURCES for path in folder.rglob('*.py')):
        text = module.read_bytes()
        if b'@compiled' in text:
            digest.update(f'{module}\0{module.stat().st_mtime_ns}\0'.encode() + text)
    user = os.environ.get('XDG_CACHE_HOME') or '~/.cache'
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    for base in (
        [chosen] if chosen else [f'{HERE}/__pycache__/kernels', f'{user}/{HERE.name}']
    ):
        with contextlib.suppress(
            OSError, RuntimeError
        ):  # not writable, or there is no home
            folder = Path(base).expanduser() / f'{HERE.name}-{digest.hexdigest()[:16]}'
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


def compiled(function: FunctionT) -> FunctionT:
    """Compile a function with numba on its first call, or take it from the cache on disk."""
    folder, config = find_cache_folder(), cast(Any, numba.config)
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder or '')
    kernel: Any = numba.njit(cache=folder is not None, error_model='numpy')(function)
    config.CACHE_DIR = before  # others in the process keep their own cache
    _kernels.append(kernel)
    return cast(FunctionT, kernel)


def count_compilations() -> int:
    """Return how often this process had to compile, because nothing on disk served."""
    return sum(
        sum(kernel.stats.cache_misses.values())
        for kernel in _kernels
        if hasattr(kernel, 'stats')
    )
