"""What keeps a process regular: its threads, its garbage collector, its place on the machine."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import ctypes
import gc
import os
import sys

# Read by numpy's libraries when they are loaded. Threads only delay products of 6 x 6 matrices.
THREAD_VARIABLES = (
    'OPENBLAS_NUM_THREADS',
    'OMP_NUM_THREADS',
    'MKL_NUM_THREADS',
    'NUMBA_NUM_THREADS',
)
PR_SET_TIMERSLACK = 29
# s, in which a thread that computes lets another one go on: a sample does not wait for it longer.
SWITCH_INTERVAL = 5e-5
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
    sys.setswitchinterval(SWITCH_INTERVAL)
    with contextlib.suppress(
        AttributeError, OSError
    ):  # Linux: waits are 50 us too long else
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def claim_processor(
    *,
    fifo_priority: int = 0,
    cpus: tuple[int, ...] = (),
    lock_memory: bool = False,
) -> list[str]:
    """
    Request SCHED_FIFO (0 for none), processors for all threads, and memory that stays.

    Returns one line for each request that failed, with a remedy.
    """
    problems: list[str] = []

    @contextlib.contextmanager
    def asking(what: str, need: str) -> Iterator[None]:
        try:
            yield
        except (AttributeError, OSError, ValueError) as error:
            problems.append(f'{what}: not possible here ({error}); needs {need}')

    if cpus:
        with asking(f'processors {list(cpus)}', 'existing processors'):
            for thread in map(int, os.listdir('/proc/self/task')):
                with contextlib.suppress(ProcessLookupError):  # it has ended
                    os.sched_setaffinity(thread, cpus)
    if fifo_priority:
        with asking(
            f'SCHED_FIFO {fifo_priority}',
            'CAP_SYS_NICE or an rtprio limit (ulimit -r) of that size',
        ):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(fifo_priority))
    if lock_memory:
        with asking(
            'locked memory',
            'CAP_IPC_LOCK or a memlock limit (ulimit -l) of the size of the process',
        ):
            if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE):
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return problems
