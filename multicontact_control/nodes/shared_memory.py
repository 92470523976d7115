"""
The shared memory through which Fast DDS 2.14 reaches a process, where one was killed.

A port is a segment with a name and a number; a lock beside it is held by the process that reads
from it, as long as it lives.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path
import struct
import sys
import time
from typing import BinaryIO

SHARED_MEMORY = Path('/dev/shm')
PORT_NAME = 'fastrtps_port'
DELETED = ' (deleted)'
PORT_WATCH_PERIOD = 2.0  # s
PORT_READY = 2  # first word of a shared memory segment that has been made (Boost.Interprocess)
# What Fast DDS calls the layout of a port, where in it the port's number is, five words, and a
# word whose lowest bit says that the port is good.
PORT_LAYOUT, PORT_NODE_AT, PORT_NODE, PORT_OK = b'port_node_abi5\0', 276, struct.Struct('=7I'), 1
HALF_MADE_AGE = 1.0  # s, from which nobody is still at it


class OutOfReachError(Exception):
    """Other processes cannot find this one; only another start helps."""


def remove_half_made_ports(folder: Path = SHARED_MEMORY) -> None:
    """
    Remove shared memory that Fast DDS would wait for in vain.

    A process that is killed in the moment in which it makes a port of the shared memory transport
    leaves one that never says it is ready. Fast DDS 2.14 waits for that for ever, in every
    process of this machine that comes to the same port. Its maker takes microseconds.
    """
    for path in folder.glob(f'{PORT_NAME}*[0-9]'):
        # Of others, or removed by another process meanwhile: not for this one to mend.
        with contextlib.suppress(OSError):
            with path.open('rb') as file:
                state = int.from_bytes(file.read(4), sys.byteorder)
            if state < PORT_READY and time.time() - path.stat().st_mtime > HALF_MADE_AGE:
                path.unlink()


def remove_dead_ports(folder: Path = SHARED_MEMORY) -> None:
    """
    Remove shared memory through which a process was reached that has been killed.

    Who starts in its place gets the same port of the shared memory transport. Fast DDS 2.14
    makes it anew for that, by name, while others still send to the old one, until they notice or
    for ever, and one of them may remove the new one in place of the old one (its issue 5053).
    So those are told here that the old one is no good, before there is a new one.
    """
    for lock in folder.glob(f'{PORT_NAME}*_el'):
        port = lock.with_name(lock.name.removesuffix('_el'))
        # Of others, or removed by another process meanwhile: not for this one to mend.
        with contextlib.suppress(OSError), lock.open('rb') as file:
            if time.time() - lock.stat().st_mtime < HALF_MADE_AGE:
                continue
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # as its reader does while it lives
            with contextlib.suppress(FileNotFoundError), port.open('r+b') as segment:
                mark_port(segment)
            port.unlink(missing_ok=True)
            lock.unlink()


def mark_port(segment: BinaryIO) -> None:
    """Mark a port as no good, if it is laid out as Fast DDS 2.14 does it."""
    content = segment.read()
    if PORT_LAYOUT not in content:
        return
    number, *_, flags = PORT_NODE.unpack_from(content, PORT_NODE_AT)
    if Path(segment.name).name == f'{PORT_NAME}{number}':
        segment.seek(PORT_NODE_AT + PORT_NODE.size - 4)
        segment.write((flags & ~PORT_OK).to_bytes(4, sys.byteorder))


def find_lost_ports() -> list[str]:
    """
    Return the ports of shared memory that this process reads from and nobody can write to.

    They are told by their locks, which this process has open. None are found but on Linux.
    """
    process = Path('/proc/self')
    if not process.exists():
        return []
    locks, lost = set(), set()
    for link in (process / 'fd').iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile
            locks.add(Path(os.readlink(link).split(' ')[0]).name)
    for line in (process / 'maps').read_text(encoding='utf-8').splitlines():
        if PORT_NAME in line and line.endswith(DELETED):
            name = Path(line.removesuffix(DELETED)).name
            lost |= {name} if f'{name}_el' in locks else set()
    return sorted(lost)


class PortWatch:
    """Looks for lost ports, now and then: a matter of milliseconds."""

    def __init__(self) -> None:
        self._next_look = time.monotonic() + PORT_WATCH_PERIOD

    def look(self) -> None:
        """
        Look if it is time to.

        Raises
        ------
        OutOfReachError
            If a port is lost.

        """
        if time.monotonic() < self._next_look:
            return
        lost = find_lost_ports()
        self._next_look = time.monotonic() + PORT_WATCH_PERIOD
        if lost:
            raise OutOfReachError(f'{", ".join(lost)}: removed by another process, so that '
                                  'nobody can find this one: starting again')
