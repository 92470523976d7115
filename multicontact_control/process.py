"""What keeps a process regular: its threads, its garbage collector, its place on the machine."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os

# Every library that may do numpy's linear algebra looks at one of these when it is loaded.
THREAD_VARIABLES = (
    'OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS')
PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE = 1, 2


def limit_threads() -> None:
    """
    Let linear algebra use one thread, unless the user has said otherwise.

    Matrices here are 6 x 6: other threads do nothing but wake up, a millisecond late. Of use
    only before numpy is imported.
    """
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, '1')


def settle_process() -> None:
    """
    Prepare this process for short, regular work; call it when everything is set up.

    A full garbage collection takes several periods, and the default timer slack makes every
    wait 50 us too long. The one here takes as long: not while another node of the process works.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    with contextlib.suppress(AttributeError, OSError):  # Linux only
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def claim_processor(
    *, fifo_priority: int = 0, cpus: tuple[int, ...] = (), lock_memory: bool = False,
) -> list[str]:
    """
    Run this process ahead of others, on some processors only, and keep it in memory.

    Parameters
    ----------
    fifo_priority
        Priority of SCHED_FIFO, 1 to 99; 0 leaves the scheduler as it is.
    cpus
        Processors it may run on; empty for all.
    lock_memory
        Whether none of its memory may be paged out.

    Returns
    -------
    list of str
        One line for everything that could not be done, with what would help.

    """
    problems = []
    if cpus:
        try:
            for thread in _threads():
                with contextlib.suppress(ProcessLookupError):  # it has ended
                    os.sched_setaffinity(thread, cpus)
        except (AttributeError, OSError, ValueError) as error:
            problems.append(f'CPU affinity {list(cpus)} is not possible here: {error}')
    if fifo_priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(fifo_priority))
        except PermissionError:
            problems.append(
                f'SCHED_FIFO {fifo_priority} is not permitted: running at normal priority; '
                'needs CAP_SYS_NICE or an rtprio limit (ulimit -r) of that size')
        except (AttributeError, OSError, ValueError) as error:
            problems.append(f'SCHED_FIFO {fifo_priority} is not possible here: {error}')
    if lock_memory:
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        except (AttributeError, OSError) as error:
            problems.append(f'memory cannot be locked: {error}; needs CAP_IPC_LOCK or a memlock '
                            'limit (ulimit -l) of the size of the process')
    return problems


def _threads() -> list[int]:
    """Return the threads of this process; those that follow are bound as who starts them is."""
    try:
        return [int(name) for name in os.listdir('/proc/self/task')]
    except OSError:
        return [0]  # this one


def describe_claim() -> str:
    """Return how this thread is scheduled and where, and whether its memory is locked."""
    if not hasattr(os, 'sched_getscheduler'):
        return 'normal priority'
    fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
    priority = f'SCHED_FIFO {os.sched_getparam(0).sched_priority}' if fifo else 'normal priority'
    cpus = ','.join(str(cpu) for cpu in sorted(os.sched_getaffinity(0)))
    return f'{priority}, processors {cpus}, memory {"" if _locked_memory() else "not "}locked'


def _locked_memory() -> bool:
    with contextlib.suppress(OSError), open('/proc/self/status', encoding='utf-8') as file:
        return any(line.startswith('VmLck:') and int(line.split()[1]) > 0 for line in file)
    return False
