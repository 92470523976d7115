"""What a job is, the key by which its result is kept, and how jobs run: here or on a cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import as_completed, BrokenExecutor, CancelledError
from contextlib import AbstractContextManager, closing, ExitStack, nullcontext, suppress
from dataclasses import asdict, dataclass
from functools import cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
from itertools import starmap
import json
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from pathlib import Path
import signal
import threading
import time
from typing import Any, ClassVar, Protocol

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.files import (
    read_json_file,
    replace_json_file,
    replace_nonfinite_numbers,
)
from multicontact_control.judging.display import make_count_bar
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.scenario import resolve, Setup
from multicontact_control.study.measure import measure_run
from rich.console import Console
from sim_bridge.robots import find_robot

LIBRARIES = ('mujoco', 'numba', 'numpy', 'pin', 'pybullet', 'scipy')
CELLS = 'cells'
THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
WORKER_DIED = 'a worker died; the same command goes on with what is missing'
CONNECT_TIMEOUT = 10.0  # s, until an address counts as one that does not answer

# The simulator and the compiled kernels are not for several threads of one process.
_ONE_AT_A_TIME = threading.Lock()
Outcome = tuple[str, dict[str, Any], float]  # key, what was measured, wall time [s]


class Job(Protocol):
    """One piece of work: a frozen dataclass that describes it in full and can be pickled."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def setup(self) -> Setup:
        """Return the setup that is run; ConfigError if it is not acceptable."""

    def key(self) -> str:
        """Return the hash of all that decides the outcome."""

    def run(self) -> dict[str, Any]:
        """Do the work in this process; return what was measured as JSON values."""


@cache
def code_stamp() -> str:
    """Return a hash over all sources and the versions of the numerical libraries."""
    package = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for folder in (package, package.parent / 'sim_bridge'):
        for path in sorted(folder.rglob('*.py')):
            digest.update(f'{path.relative_to(folder.parent).as_posix()}\0'.encode())
            digest.update(path.read_bytes())
    for library in LIBRARIES:
        with suppress(PackageNotFoundError):  # an extra, or not from a wheel
            digest.update(f'{library} {version(library)}\0'.encode())
    return digest.hexdigest()


def content_key(kind: str, content: Mapping[str, Any]) -> str:
    """Return the key of a kind of work on JSON values, which with the code decide the outcome."""
    text = json.dumps(
        {'kind': kind, 'code': code_stamp(), **content},
        sort_keys=True,
        separators=(',', ':'),
    )
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def setup_content(setup: Setup) -> dict[str, Any]:
    """Return what decides the outcome of a run, as JSON values."""
    urdf = (setup.urdf_dir / setup.controller.robot.urdf).read_bytes()
    configurations = {
        name: getattr(setup, name).model_dump(mode='json')
        for name in ('scenario', 'controller', 'noise_estimator', 'plant')
    }
    return {
        'seed': setup.seed,
        'urdf': hashlib.sha256(urdf).hexdigest(),
        'arm': repr(find_robot(setup.plant.robot).arm),
        **configurations,
    }


@dataclass(frozen=True)
class RunJob:
    """One run of a scenario."""

    arguments: Mapping[str, Any]  # of `resolve`
    supervised: bool = False
    surface_gone: tuple[float, float] | None = (
        None  # from when to when the last one is away [s]
    )

    def setup(self) -> Setup:
        """Return everything the run needs; see `Job.setup`."""
        return resolve(**self.arguments)

    def key(self) -> str:
        """Return the hash of all that decides the outcome."""
        return content_key(
            'run',
            {
                **setup_content(self.setup()),
                'supervised': self.supervised,
                'surface_gone': self.surface_gone,
            },
        )

    def run(self) -> dict[str, Any]:
        """Run it and measure it; see `measure_run`."""
        return measure_run(self.setup(), self.supervised, self.surface_gone)


def read_cells(folder: Path, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return what was measured in those jobs that are finished in a folder, by key."""
    paths = {key: folder / CELLS / f'{key}.json' for key in keys}
    return {
        key: read_json_file(path)['metrics']
        for key, path in paths.items()
        if path.exists()
    }


def prepare_folder(folder: Path, *, overwrite: bool) -> None:
    """Make the folder of a study, or keep what it has; ConfigError if that is no study's."""
    cells = folder / CELLS
    if folder.is_dir() and not cells.is_dir() and any(folder.iterdir()):
        raise ConfigError('out', 'a new or empty folder, or that of a study', folder)
    cells.mkdir(parents=True, exist_ok=True)
    for path in cells.glob('*.json') if overwrite else ():
        path.unlink()


def run_jobs(
    jobs: Mapping[str, Job],
    folder: Path,
    *,
    workers: int = 0,
    client: Any = None,
    console: Console | None = None,
    title: str = 'runs',
) -> dict[str, dict[str, Any]]:
    """
    Run every job without a result in a folder, and return what was measured in all, by key.

    One worker is this process, 0 stands for a process on every core; the client of a Dask cluster
    runs them there. RunError if a worker or the cluster dies; what is finished is kept.
    """
    done = read_cells(folder, jobs)
    todo = {key: job for key, job in jobs.items() if key not in done}
    if todo:
        ensure_compiled()  # here once, not in every worker at once
    with (
        make_count_bar(console) as progress,
        closing(_outcomes(todo, workers, client)) as outcomes,
    ):
        bar = progress.add_task(title, total=len(jobs), completed=len(done))
        for key, metrics, wall_time in outcomes:
            replace_json_file(
                folder / CELLS / f'{key}.json',
                {
                    'key': key,
                    'job': asdict(todo[key]),
                    'wall_s': wall_time,
                    'metrics': metrics,
                },
            )
            done[key] = metrics
            progress.advance(bar)
            if progress.disable and 10 * len(done) % len(jobs) < 10:  # at every tenth
                progress.console.print(
                    f'{title}: {len(done)} of {len(jobs)}', highlight=False
                )
    return done


def _outcomes(
    todo: Mapping[str, Job],
    workers: int,
    client: Any,
) -> Generator[Outcome, None, None]:
    """Yield the outcomes of jobs as they end: in this process, in others, or on a cluster."""
    if client is None and (len(todo) < 2 or workers == 1):
        yield from starmap(_run, todo.items())
        return
    deaths: tuple[type[BaseException], ...] = (BrokenExecutor,)
    with ExitStack() as stack:
        if client is None:
            from joblib.externals.loky import get_reusable_executor

            # Ctrl-C reaches every process of the terminal; only this one answers it.
            executor = get_reusable_executor(
                workers or None,
                env=dict.fromkeys(THREADS, '1'),
                initializer=signal.signal,
                initargs=(signal.SIGINT, signal.SIG_IGN),
            )
            stack.callback(executor.shutdown)
            stack.callback(_end_workers, others=active_children())
        else:
            # Not joblib's Dask backend: it waits for ever for a job whose workers died.
            from distributed import KilledWorker

            executor = client.get_executor(pure=False)
            deaths = (KilledWorker, CancelledError, OSError)
        try:
            for future in as_completed(
                [executor.submit(_run, *item) for item in todo.items()]
            ):
                yield future.result()
        except deaths:
            raise RunError(WORKER_DIED) from None


def _end_workers(others: Sequence[BaseProcess]) -> None:
    """End all workers; `shutdown` with `kill_workers` looks for a job that it has removed."""
    for process in active_children():
        if process not in others:
            process.terminate()


def _run(key: str, job: Job) -> Outcome:
    """Run a job where its key is the same, which stands for equal code and configuration."""
    with _ONE_AT_A_TIME:
        if job.key() != key:
            raise RunError('a worker has other code, libraries or configuration files')
        start = time.perf_counter()
        return key, replace_nonfinite_numbers(job.run()), time.perf_counter() - start


def dask_client(address: str) -> AbstractContextManager[Any]:
    """Connect to the Dask scheduler at an address, None without one; ConfigError, RunError."""
    if not address:
        return nullcontext()
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ImportError:
        raise RunError(
            'a Dask cluster needs `distributed`, which is not installed here: '
            'pip install distributed'
        ) from None
    try:
        get_address_host_port(address)  # refuses it before there is anything to close
        client: AbstractContextManager[Any] = Client(
            address, timeout=CONNECT_TIMEOUT, set_as_default=False
        )
    except (OSError, ValueError) as error:
        raise ConfigError(
            'dask',
            'the address of a Dask scheduler that answers, e.g. tcp://127.0.0.1:8786',
            f'{address} ({error})',
        ) from None
    return client
