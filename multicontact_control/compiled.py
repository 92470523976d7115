"""
How the numerical kernels are compiled: once, and again when any of their sources changes.

`compiled` is the only door to numba. What it makes is kept on disk, in one folder, and taken from
there by every later process; `multicontact compile` (`experiment/compilation.py`) fills it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from functools import cache
import hashlib
import os
from pathlib import Path
import tempfile
from typing import Any, cast, TypeVar

import numba
from numba.core import event

FunctionT = TypeVar('FunctionT', bound=Callable[..., Any])
OnCompile = Callable[[str], None]

HERE = Path(__file__).resolve().parent
SOURCES = (HERE, HERE.parent / 'sim_bridge')  # packages with kernels
kernels: list[Any] = []  # every function that went through `compiled` in this process


@cache
def sources_stamp() -> str:
    """
    Return a hash over every module with something compiled, and when it was written.

    numba compares the time of a function's own file only, although what the function calls is
    compiled into it.
    """
    digest = hashlib.sha256()
    for module in sorted(path for folder in SOURCES for path in folder.rglob('*.py')):
        text = module.read_bytes()
        if b'@compiled' in text:
            digest.update(f'{module}\0{module.stat().st_mtime_ns}\0'.encode() + text)
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """
    Return the folder that keeps what is compiled of these sources, None where none can be written.

    It lies in ``NUMBA_CACHE_DIR``, where that is set; otherwise beside the sources, and where
    these cannot be written in the user's cache folder, or at last in one of the user's own in the
    folder for temporary files.
    """
    user = os.environ.get('XDG_CACHE_HOME') or Path('~').expanduser() / '.cache'
    temporary = Path(tempfile.gettempdir()) / f'{HERE.name}-{os.getuid()}'
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    for base in [Path(chosen)] if chosen else [
            HERE / '__pycache__' / 'kernels', Path(user) / HERE.name / 'kernels', temporary]:
        folder = base / f'{HERE.name}-{sources_stamp()}'
        with contextlib.suppress(OSError, RuntimeError):  # the next one, then
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            if base != temporary or base.stat().st_uid == os.getuid():
                return folder
    return None


def compiled(function: FunctionT) -> FunctionT:
    """Compile a function with numba on its first call, or take it from the cache on disk."""
    folder, config = cache_folder(), cast(Any, numba.config)
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder or '')  # others in the process keep their own cache
    try:
        kernel: Any = numba.njit(cache=folder is not None, error_model='numpy')(function)
    finally:
        config.CACHE_DIR = before
    kernels.append(kernel)
    return cast(FunctionT, kernel)


def compile_for(kernel: Callable[..., Any], *arguments: Any) -> None:
    """Compile a kernel for arguments of these types, so that no call has to wait for it."""
    if hasattr(kernel, 'compile'):  # not where numba is told not to compile
        kernel.compile(tuple(numba.typeof(argument) for argument in arguments))


def compiled_here() -> int:
    """Return how often this process had to compile, because nothing on disk served."""
    return sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels
               if hasattr(kernel, 'stats'))


@contextlib.contextmanager
def compilations_told(tell: OnCompile) -> Iterator[None]:
    """
    Tell the name of every kernel before it is compiled; nothing of what comes from the cache.

    Parameters
    ----------
    tell
        Called with ``module.function``.

    """
    with event.install_listener('numba:compile', _Listener(tell)):
        yield


class _Listener(event.Listener):
    """Passes the names of our own kernels on; numba's helpers compile inside of them."""

    def __init__(self, tell: OnCompile) -> None:
        self._tell = tell

    def on_start(self, event: Any) -> None:
        function = event.data['dispatcher'].py_func
        if not function.__module__.startswith('numba.'):
            self._tell(f'{function.__module__}.{function.__name__}')

    def on_end(self, event: Any) -> None:
        pass
