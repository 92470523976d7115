"""What keeps a process regular: its threads, its garbage collector, its place on the machine."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
from pathlib import Path
import re

# Read by numpy's libraries when they are loaded. Threads only delay products of 6 x 6 matrices.
THREAD_VARIABLES = (
    'OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS')
PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE = 1, 2


def limit_threads() -> None:
    """Limit linear algebra to one thread by default; call it before numpy is imported."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, '1')


def settle_process() -> None:
    """Prepare this process for short, regular work; call it when everything is set up."""
    gc.collect()  # a full collection takes several control periods
    gc.freeze()
    gc.disable()
    with contextlib.suppress(AttributeError, OSError):  # Linux: waits are 50 us too long else
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def claim_processor(
    *, fifo_priority: int = 0, cpus: tuple[int, ...] = (), lock_memory: bool = False,
) -> list[str]:
    """
    Request SCHED_FIFO (0 for none), processors for all threads, and memory that stays.

    Returns one line for each request that failed, with a remedy.
    """
    def place() -> None:
        for thread in map(int, os.listdir('/proc/self/task')):
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.sched_setaffinity(thread, cpus)

    def lock() -> None:
        if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    problems = []
    for wish, claim, what, need in (
            (cpus, place, f'processors {list(cpus)}', 'existing processors'),
            (fifo_priority, lambda: os.sched_setscheduler(
                0, os.SCHED_FIFO, os.sched_param(fifo_priority)), f'SCHED_FIFO {fifo_priority}',
             'CAP_SYS_NICE or an rtprio limit (ulimit -r) of that size'),
            (lock_memory, lock, 'locked memory',
             'CAP_IPC_LOCK or a memlock limit (ulimit -l) of the size of the process')):
        try:
            if wish:
                claim()
        except (AttributeError, OSError, ValueError) as error:
            problems.append(f'{what}: not possible here ({error}); needs {need}')
    return problems


def describe_claim() -> str:
    """Return scheduler and processors of this thread, and whether its memory is locked."""
    fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
    priority = f'SCHED_FIFO {os.sched_getparam(0).sched_priority}' if fifo else 'normal priority'
    cpus = ','.join(map(str, sorted(os.sched_getaffinity(0))))
    status = Path('/proc/self/status').read_text(encoding='utf-8')
    locked = re.search(r'^VmLck:\s*[1-9]', status, re.MULTILINE)
    return f'{priority}, processors {cpus}, memory {"" if locked else "not "}locked'
