"""
PyBullet, without the line in which it tells when it was built.

It writes that line from C, to the standard error stream of the process, before anything else is
said; neither Python's `sys.stderr` nor a logger knows of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
import platform

BANNER = b'pybullet build time:'


@contextmanager
def without_line(start: bytes) -> Iterator[None]:
    """
    Keep lines with some beginning out of what C writes to its standard error stream.

    C's stream alone is led into memory, by its pointer: file descriptor 2, Python's own output,
    that of other threads and of processes they start stay as they are. What else was written
    appears at the end, also where an exception is raised. Without glibc nothing is done.

    Parameters
    ----------
    start
        How such a line begins.

    """
    if platform.libc_ver()[0] != 'glibc':
        yield
        return
    libc = ctypes.CDLL(None)
    libc.open_memstream.restype = ctypes.c_void_p
    text, size = ctypes.c_void_p(), ctypes.c_size_t()
    # Never closed: a thread that has just looked the pointer up may still write to it.
    memory = libc.open_memstream(ctypes.byref(text), ctypes.byref(size))
    stream = ctypes.c_void_p.in_dll(libc, 'stderr')
    usual = stream.value
    if not memory:
        yield
        return
    stream.value = memory
    try:
        yield
    finally:
        stream.value = usual
        libc.fflush(ctypes.c_void_p(memory))
        lines = ctypes.string_at(text.value or 0, size.value).splitlines(keepends=True)
        others = b''.join(line for line in lines if not line.startswith(start))
        if others:
            libc.fputs(others, ctypes.c_void_p(usual))


with without_line(BANNER):
    import pybullet as bullet

__all__ = ['bullet']
