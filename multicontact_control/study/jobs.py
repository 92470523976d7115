"""What a job is, the key by which its result is kept, and how jobs run: here or on a cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import as_completed, BrokenExecutor, CancelledError
from contextlib import AbstractContextManager, closing, ExitStack, nullcontext, suppress
from dataclasses import asdict, dataclass
from functools import cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
import inspect
from itertools import starmap
import json
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from pathlib import Path
import signal
import threading
import time
from typing import Any, ClassVar, NamedTuple, Protocol

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.files import (
    read_json_file,
    replace_json_file,
    replace_nonfinite_numbers,
)
from multicontact_control.force.laws.design import find_law
from multicontact_control.force.noise import find_noise_estimator
from multicontact_control.judging.display import make_count_bar
from multicontact_control.paths import PACKAGE_DIR
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


class Outcome(NamedTuple):
    """
    What a finished job has to say, as it comes from a worker, perhaps on another machine.

    Numbers that JSON cannot write are replaced before it is sent, so that a table is the same
    whether a job was run now or read back.
    """

    key: str  # of the job
    metrics: dict[str, Any]  # what was measured, as JSON values
    wall_time: float  # [s]


class Job(Protocol):
    """
    One piece of work: a frozen dataclass that describes it in full and can be pickled.

    It carries all that a worker on another machine needs beside this package and its files.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def setup(self) -> Setup:
        """
        Return the setup that is run, resolved from the files of the machine that asks.

        Raises
        ------
        ConfigError
            If it is not acceptable; planning calls this for every job before any is run.

        """

    def key(self) -> str:
        """
        Return the hash of all that decides the outcome; see `outcome_key`.

        Under this key the result is kept. A worker compares it with its own: another key there
        means other code, libraries or files.
        """

    def run(self) -> dict[str, Any]:
        """
        Do the work in this process; return what was measured as JSON values.

        A run that goes wrong is a result and not an exception: one that is raised ends the whole
        study.
        """


@cache
def hash_code() -> str:
    """
    Return a hash over all sources and the versions of the numerical libraries.

    Any change of a source or a library makes every earlier result one of another key, since
    trajectories are compared bit by bit. Computed once in a process.
    """
    digest = hashlib.sha256()
    for folder in (PACKAGE_DIR, PACKAGE_DIR.parent / 'sim_bridge'):
        for path in sorted(folder.rglob('*.py')):
            digest.update(f'{path.relative_to(folder.parent).as_posix()}\0'.encode())
            digest.update(path.read_bytes())
    for library in LIBRARIES:
        with suppress(PackageNotFoundError):  # an extra, or not from a wheel
            digest.update(f'{library} {version(library)}\0'.encode())
    return digest.hexdigest()


def hash_registered(setup: Setup) -> str:
    """
    Return a hash over the files of a setup's force laws and noise estimator.

    Those of another package, or of the program, are not among the sources of `hash_code`.
    """
    controller = setup.controller
    parts: list[Any] = [find_noise_estimator(setup.noise_estimator.estimator)]
    for name in controller.contact_names:
        parts.append(find_law(controller.force_law_of(name)).design)
    digest = hashlib.sha256()
    for part in parts:
        with suppress(OSError, TypeError):  # of a session it has no file
            digest.update(Path(inspect.getfile(part)).read_bytes())
    return digest.hexdigest()


def outcome_key(kind: str, setup: Setup, **content: Any) -> str:
    """
    Return the key of a job: a hash of all that decides its outcome, 24 hexadecimal digits.

    Parameters
    ----------
    kind
        Of the work; different work on the same setup has another kind.
    setup
        What is run: its configurations, seed, URDF and, of a known robot, the arm.
    content
        What else decides the outcome, as JSON values.

    """
    urdf = (setup.urdf_dir / setup.controller.robot.urdf).read_bytes()
    whole: dict[str, Any] = {
        'kind': kind,
        'code': hash_code(),
        'seed': setup.seed,
        'urdf': hashlib.sha256(urdf).hexdigest(),
        'arm': repr(find_robot(setup.plant.robot).arm),
        'registered': hash_registered(setup),
    }
    for name in ('scenario', 'controller', 'noise_estimator', 'plant'):
        whole[name] = getattr(setup, name).model_dump(mode='json')
    whole |= content
    text = json.dumps(whole, sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


@dataclass(frozen=True)
class RunJob:
    """
    One run of a scenario, in process, of which the usual figures are measured.

    The arguments are kept instead of the setup that they resolve to: they are small, can be
    written into the result's file, and lead a worker to its own files.
    """

    arguments: Mapping[str, Any]  # of `resolve`
    supervised: bool = False
    # From when to when the last surface is away [s].
    surface_gone: tuple[float, float] | None = None

    def setup(self) -> Setup:
        """
        Return everything the run needs; see `Job.setup`.

        The arguments name files, presets and overrides as on the command line; they are resolved
        anew on each call.
        """
        return resolve(**self.arguments)

    def key(self) -> str:
        """
        Return the hash of all that decides the outcome; see `outcome_key`.

        Beside the setup these are whether a supervisor is around the law, and when the last
        surface is away.
        """
        return outcome_key(
            'run',
            self.setup(),
            supervised=self.supervised,
            surface_gone=self.surface_gone,
        )

    def run(self) -> dict[str, Any]:
        """
        Run it and measure it; see `measure_run`.

        An exception of the run is the `error` of its metrics: an unstable corner of a grid ends no
        study.
        """
        return measure_run(self.setup(), self.supervised, self.surface_gone)


def read_finished(folder: Path, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """
    Return what was measured in those jobs that are finished in a study's folder, by key.

    Keys without a file are left out: the caller runs those. The files are written at once or not
    at all, so that one that is there is whole.
    """
    finished = {}
    for key in keys:
        path = _find_cell_file(folder, key)
        if path.exists():
            finished[key] = read_json_file(path)['metrics']
    return finished


def _find_cell_file(folder: Path, key: str) -> Path:
    return folder / CELLS / f'{key}.json'


def prepare_folder(folder: Path, *, overwrite: bool) -> None:
    """
    Make the folder of a study, or keep the finished jobs that it has, unless `overwrite`.

    Raises
    ------
    ConfigError
        If the folder has files that are no study's.

    """
    cells = folder / CELLS
    if folder.is_dir() and not cells.is_dir() and any(folder.iterdir()):
        raise ConfigError('out', 'a new or empty folder, or that of a study', folder)
    cells.mkdir(parents=True, exist_ok=True)
    if overwrite:
        for path in cells.glob('*.json'):
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

    Parameters
    ----------
    jobs
        Jobs by their keys.
    folder
        Of the study, prepared; every result is written there as soon as it is known.
    workers
        How many processes run jobs: 1 is this process, 0 stands for one on every core.
    client
        Of a Dask cluster, which runs them instead (`dask_client`).
    console
        Where a bar shows how many are finished.
    title
        What the bar is called.

    Raises
    ------
    RunError
        If a worker or the cluster dies; what is finished is kept.

    """
    finished = read_finished(folder, jobs)
    missing = {key: job for key, job in jobs.items() if key not in finished}
    if missing:
        ensure_compiled()  # here once, not in every worker at once
    with (
        make_count_bar(console) as progress,
        closing(_run_missing(missing, workers, client)) as outcomes,
    ):
        bar = progress.add_task(title, total=len(jobs), completed=len(finished))
        for key, metrics, wall_time in outcomes:
            content = {
                'key': key,
                'job': asdict(missing[key]),
                'wall_s': wall_time,
                'metrics': metrics,
            }
            replace_json_file(_find_cell_file(folder, key), content)
            finished[key] = metrics
            progress.advance(bar)
            is_next_tenth = 10 * len(finished) % len(jobs) < 10
            if progress.disable and is_next_tenth:
                progress.console.print(
                    f'{title}: {len(finished)} of {len(jobs)}', highlight=False
                )
    return finished


def _run_missing(
    jobs: Mapping[str, Job], workers: int, client: Any
) -> Generator[Outcome, None, None]:
    """Yield the outcomes of jobs as they end: in this process, in others, or on a cluster."""
    if client is None and (len(jobs) < 2 or workers == 1):
        yield from starmap(_run_job, jobs.items())
        return
    deaths: tuple[type[BaseException], ...]
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
            deaths = (BrokenExecutor,)
            stack.callback(executor.shutdown)
            stack.callback(_end_workers, others=active_children())
        else:
            # Not joblib's Dask backend: it waits for ever for a job whose workers died.
            from distributed import KilledWorker

            executor = client.get_executor(pure=False)
            deaths = (KilledWorker, CancelledError, OSError)
        try:
            futures = [executor.submit(_run_job, *item) for item in jobs.items()]
            for future in as_completed(futures):
                yield future.result()
        except deaths:
            raise RunError(WORKER_DIED) from None


def _end_workers(others: Sequence[BaseProcess]) -> None:
    """End all workers; `shutdown` with `kill_workers` looks for a job that it has removed."""
    for process in active_children():
        if process not in others:
            process.terminate()


def _run_job(key: str, job: Job) -> Outcome:
    """Run a job where its key is the same, which stands for equal code and configuration."""
    with _ONE_AT_A_TIME:
        if job.key() != key:
            raise RunError('a worker has other code, libraries or configuration files')
        start = time.perf_counter()
        metrics = replace_nonfinite_numbers(job.run())
        return Outcome(key, metrics, time.perf_counter() - start)


def dask_client(address: str) -> AbstractContextManager[Any]:
    """
    Connect to the Dask scheduler at an address; without an address the context is None.

    Raises
    ------
    ConfigError
        If no scheduler answers there.
    RunError
        If `distributed` is not installed.

    """
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
