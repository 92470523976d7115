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
# s, after which a thread that computes lets another one go on: a sample waits no longer for it.
SWITCH_INTERVAL = 5e-5
MCL_CURRENT = 1
MCL_FUTURE = 2


def limit_threads() -> None:
    """
    Limit linear algebra to one thread by default; call it before numpy is imported.

    Matrices of an arm are so small that threads cost more than they save, and take the cores of
    other nodes. What is set in the environment stays.
    """
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, '1')


def settle_process() -> None:
    """
    Prepare this process for short, regular work; call it when everything is set up.

    The garbage collector is switched off: a full collection takes several control periods.
    """
    gc.collect()  # a full collection takes several control periods
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL)
    with contextlib.suppress(AttributeError, OSError):
        # Of Linux: else each wait is 50 us too long.
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
    def noting_failure(request: str, need: str) -> Iterator[None]:
        """Note what fails within, and what it needs, instead of raising it."""
        try:
            yield
        except (AttributeError, OSError, ValueError) as error:
            problems.append(f'{request}: not possible here ({error}); needs {need}')

    if cpus:
        with noting_failure(f'processors {list(cpus)}', 'existing processors'):
            for thread in os.listdir('/proc/self/task'):
                with contextlib.suppress(ProcessLookupError):  # it has ended
                    os.sched_setaffinity(int(thread), cpus)
    if fifo_priority:
        with noting_failure(
            f'SCHED_FIFO {fifo_priority}',
            'CAP_SYS_NICE or an rtprio limit (ulimit -r) of that size',
        ):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(fifo_priority))
    if lock_memory:
        with noting_failure(
            'locked memory',
            'CAP_IPC_LOCK or a memlock limit (ulimit -l) of the size of the process',
        ):
            lock_all_memory = ctypes.CDLL(None, use_errno=True).mlockall
            if lock_all_memory(MCL_CURRENT | MCL_FUTURE):
                code = ctypes.get_errno()
                raise OSError(code, os.strerror(code))
    return problems
