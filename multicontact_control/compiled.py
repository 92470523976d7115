"""
How the numerical kernels are compiled: once, and again when any of their sources changes.

`compiled` is the only door to numba. What it makes is kept on disk, in one folder, which
`multicontact compile` (`runs/compilation.py`) fills.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
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

    It lies in ``NUMBA_CACHE_DIR``, or else beside the sources or in the user's cache folder. Its
    name is a hash over all kernels and what their modules import: numba compares a function's
    own file alone, and compiles the functions and constants of others into it.
    """
    name = f'{HERE.name}-{_hash_kernels()[:16]}'
    user = os.environ.get('XDG_CACHE_HOME') or '~/.cache'
    places = [f'{HERE}/__pycache__/kernels', f'{user}/{HERE.name}']
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    if chosen:
        places = [chosen]
    for place in places:
        # A place that is not writable, or in a home that does not exist, is passed over.
        with contextlib.suppress(OSError, RuntimeError):
            folder = Path(place).expanduser() / name
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


def _hash_kernels() -> str:
    """Return a hash over the paths, times and texts of all that kernels are compiled from."""
    digest = hashlib.sha256()
    for module in sorted(_find_kernel_sources()):
        digest.update(f'{module}\0{module.stat().st_mtime_ns}\0'.encode())
        digest.update(module.read_bytes())
    return digest.hexdigest()


def _find_kernel_sources() -> set[Path]:
    """Return the modules with kernels and those that they import, directly or through others."""
    remaining: list[Path] = []
    for folder in SOURCES:
        for module in folder.rglob('*.py'):
            if b'@compiled' in module.read_bytes():
                remaining.append(module)
    sources = set(remaining)
    while remaining:
        for imported in _find_imported_modules(remaining.pop()):
            if imported not in sources:
                sources.add(imported)
                remaining.append(imported)
    return sources


def _find_imported_modules(module: Path) -> Iterator[Path]:
    """Yield the modules of `SOURCES` that a module imports before its functions can be called."""
    packages = [folder.name for folder in SOURCES]
    for statement in ast.parse(module.read_bytes()).body:
        if not isinstance(statement, ast.ImportFrom) or statement.module is None:
            continue
        names = statement.module.split('.')
        if names[0] not in packages:
            continue
        imported = HERE.parent.joinpath(*names)
        places = [imported.with_suffix('.py'), imported / '__init__.py']
        places += [imported / f'{alias.name}.py' for alias in statement.names]
        yield from filter(Path.is_file, places)


def compiled(function: FunctionT) -> FunctionT:
    """
    Compile a function with numba on its first call, or take it from the cache on disk.

    Divisions by zero give infinity or NaN, as those of numpy do.
    """
    folder = find_cache_folder()
    config = cast(Any, numba.config)
    folder_of_others = config.CACHE_DIR  # in this process, which they keep
    config.CACHE_DIR = str(folder or '')
    kernel: Any = numba.njit(cache=folder is not None, error_model='numpy')(function)
    config.CACHE_DIR = folder_of_others
    _kernels.append(kernel)
    return cast(FunctionT, kernel)


def count_compilations() -> int:
    """Return how often this process had to compile, because nothing on disk served."""
    compilations = 0
    for kernel in _kernels:
        if hasattr(kernel, 'stats'):
            compilations += sum(kernel.stats.cache_misses.values())
    return compilations
