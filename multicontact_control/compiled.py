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
import sys
import tempfile
from typing import Any, TypeVar

import numba
from numba.core import event

FunctionT = TypeVar('FunctionT', bound=Callable[..., Any])
OnCompile = Callable[[str], None]

HERE = Path(__file__).resolve().parent
NAME = HERE.name
_kernels: list[Any] = []


def sources_stamp(path: Path) -> str:
    """Return a hash over every module of a package, or the one file, with something compiled."""
    digest = hashlib.sha256()
    for module in sorted(path.rglob('*.py')) if path.is_dir() else [path]:
        text = module.read_bytes()
        if b'@compiled' in text:
            digest.update(module.relative_to(path).as_posix().encode())
            digest.update(text)
    return digest.hexdigest()


_stamp = cache(sources_stamp)


@cache
def cache_folder() -> Path | None:
    """
    Return the folder that keeps what is compiled, None where no folder can be written.

    ``NUMBA_CACHE_DIR``, where it is set; otherwise beside the sources, and where these cannot be
    written in the user's cache folder, or at last in one of the user's own in the folder for
    temporary files.
    """
    user = os.environ.get('XDG_CACHE_HOME') or Path('~').expanduser() / '.cache'
    temporary = Path(tempfile.gettempdir()) / f'{NAME}-{os.getuid()}'
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    for folder in [Path(chosen)] if chosen else [
            HERE / '__pycache__' / 'kernels', Path(user) / NAME / 'kernels', temporary]:
        with contextlib.suppress(OSError, RuntimeError):  # the next one, then
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            if folder != temporary or folder.stat().st_uid == os.getuid():
                return folder
    return None


def compiled(function: FunctionT) -> FunctionT:
    """
    Compile a function with numba on its first call, or take it from the cache on disk.

    numba looks for changes in the function's own file only, although what the function calls is
    compiled into it; so the stamp that it compares is replaced by one over all compiled sources
    of this package and of the function's own.
    """
    config: Any = numba.config
    folder = cache_folder()
    before = config.CACHE_DIR
    try:
        # For this function only: others in the process keep their own cache.
        config.CACHE_DIR = str(folder or '')
        kernel: Any = numba.njit(cache=folder is not None, error_model='numpy')(function)
    finally:
        config.CACHE_DIR = before
    cache_file = getattr(getattr(kernel, '_cache', None), '_cache_file', None)
    if cache_file is not None:  # None when numba is told not to compile, or there is no folder
        cache_file._source_stamp = _stamp(HERE) + _stamp(_sources(function))
    _kernels.append(kernel)
    result: FunctionT = kernel
    return result


def bound(kernel: FunctionT, *arguments: Any) -> FunctionT:
    """
    Return a kernel for arguments like these, compiled, that does not look at their types.

    To find out the types of ten arrays takes numba longer than many a kernel its work. Only for
    arrays that are the caller's own: in place of a contiguous one any other would be misread.

    Parameters
    ----------
    kernel
        What `compiled` has made.
    arguments
        Of the types, dimensions and layouts of all that it will be called with.

    """
    compile_for = getattr(kernel, 'compile', None)  # None when numba is told not to compile
    if compile_for is None:
        return kernel
    entry: FunctionT = compile_for(tuple(numba.typeof(argument) for argument in arguments))
    return entry


def _sources(function: Callable[..., Any]) -> Path:
    """Return the folder of the top-level package of a function, or the file of a script."""
    package = sys.modules.get(function.__module__.partition('.')[0])
    folders = list(getattr(package, '__path__', []))
    return Path(folders[0] if folders else function.__code__.co_filename).resolve()


def kernels() -> tuple[Any, ...]:
    """Return every function that went through `compiled` in this process."""
    return tuple(_kernels)


def load_stored() -> Iterator[str]:
    """
    Take all that was compiled from the cache on disk, before its first call.

    Yields
    ------
    str
        The name of each kernel that has just been taken, as often as it is kept for other types.

    """
    for kernel in _kernels:
        cache: Any = getattr(kernel, '_cache', None)
        stored = getattr(cache, '_cache_file', None)
        if stored is None:
            continue
        codegen = kernel.targetctx.codegen()
        for key, name in stored._load_index().items():
            # Not of another processor, nor one that a process that compiles is yet to write.
            kept = Path(stored._data_path(name)).is_file()
            if kept and key == cache._index_key(key[0], codegen):
                kernel.compile(key[0])
                yield kernel.__name__


def stamps() -> dict[Path, str]:
    """Return, by the index that numba keeps of a kernel on disk, the stamp of its sources."""
    files = [getattr(getattr(kernel, '_cache', None), '_cache_file', None) for kernel in _kernels]
    return {Path(file._index_path): file._source_stamp for file in files if file is not None}


def compiled_here() -> int:
    """Return how often this process had to compile, because nothing on disk served."""
    return sum(sum(kernel.stats.cache_misses.values()) for kernel in _kernels
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
    listener = _Listener(tell)
    event.register('numba:compile', listener)
    try:
        yield
    finally:
        event.unregister('numba:compile', listener)


class _Listener(event.Listener):
    """Passes the names of our own kernels on; numba's helpers compile inside of them."""

    def __init__(self, tell: OnCompile) -> None:
        self._tell = tell

    def on_start(self, event: Any) -> None:
        """Take note of a compilation that begins."""
        dispatcher = event.data['dispatcher']
        if any(dispatcher is kernel for kernel in _kernels):
            function = dispatcher.py_func
            self._tell(f'{function.__module__}.{function.__name__}')

    def on_end(self, event: Any) -> None:
        """Take note of one that has ended."""
