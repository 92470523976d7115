"""What a job is, the key by which its result is kept, and how jobs run: here or on a cluster."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Generator, Iterator, Mapping
import concurrent.futures
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
import hashlib
from importlib.metadata import PackageNotFoundError, version
import json
from pathlib import Path
import signal
import socket
import threading
import time
from typing import Any, ClassVar, Protocol

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.files import finite, write_json
from rich.console import Console
from sim_bridge.robots import find_robot

LIBRARIES = ('mujoco', 'numba', 'numpy', 'pin', 'pybullet', 'scipy')
CELLS = 'cells'
WORKER_DIED = 'a worker died; the same command goes on with what is missing'
CONNECT_TIMEOUT = 10.0  # s, until an address counts as one that does not answer
LOST_CONNECTION = (asyncio.CancelledError, concurrent.futures.CancelledError, OSError)

# The simulator and the compiled kernels are not for several threads of one process.
_ONE_AT_A_TIME = threading.Lock()
Outcome = tuple[str, dict[str, Any], float]  # key, what was measured, wall time [s]


class Job(Protocol):
    """One piece of work: a frozen dataclass that describes it in full and can be pickled."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def key(self) -> str:
        """Return the hash of all that decides the outcome; ConfigError if it is not acceptable."""
        ...

    def run(self) -> dict[str, Any]:
        """Do the work in this process; return what was measured as JSON values."""
        ...


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
    text = json.dumps({'kind': kind, 'code': code_stamp(), **content}, sort_keys=True,
                      separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def setup_content(setup: Setup) -> dict[str, Any]:
    """Return what decides the outcome of a run, as JSON values."""
    urdf = (setup.urdf_dir / setup.controller.robot.urdf).read_bytes()
    configurations = {
        name: getattr(setup, name).model_dump(mode='json')
        for name in ('scenario', 'controller', 'noise_estimator', 'plant')}
    return {'seed': setup.seed, 'urdf': hashlib.sha256(urdf).hexdigest(),
            'arm': repr(find_robot(setup.plant.robot).arm), **configurations}


@dataclass(frozen=True, slots=True)
class RunJob:
    """One run of a scenario; made by `job_of`."""

    scenario: str
    plant: str
    seed: int
    overrides: str = '{}'  # canonical JSON of the other arguments of `resolve`
    supervised: bool = False
    surface_gone: tuple[float, float] | None = None  # from when to when the last one is away [s]

    def setup(self) -> Setup:
        """Return everything the run needs, checked."""
        return replace(_resolved(replace(self, seed=0)), seed=self.seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        content = _content(replace(self, seed=0))
        return content_key('run', {**content, 'seed': self.seed, 'supervised': self.supervised,
                                   'surface_gone': self.surface_gone})

    def run(self) -> dict[str, Any]:
        """Run it and measure it; see `measure_run`."""
        # Only here: what gives out the work to others needs neither kernels nor simulator.
        from multicontact_control.experiment.study.measure import measure_run

        return measure_run(self.setup(), self.supervised, self.surface_gone)


# Jobs that differ in their seed only follow each other: one is remembered.
@lru_cache(maxsize=1)
def _resolved(job: RunJob) -> Setup:
    return resolve(job.scenario, plant=job.plant, **json.loads(job.overrides))


@lru_cache(maxsize=1)
def _content(job: RunJob) -> dict[str, Any]:
    return setup_content(_resolved(job))


def job_of(
    scenario: str, plant: str, seed: int, *, supervised: bool = False,
    surface_gone: tuple[float, float] | None = None, **overrides: Any,
) -> RunJob:
    """Return a job; `overrides` are arguments of `resolve`."""
    kept = {name: value for name, value in overrides.items() if value}
    return RunJob(scenario, plant, seed, json.dumps(
        kept, sort_keys=True, separators=(',', ':')), supervised, surface_gone)


def read_cell(folder: Path, key: str) -> dict[str, Any] | None:
    """Return what was measured in a finished job of a folder, None if it is not there or whole."""
    try:
        metrics = json.loads((folder / CELLS / f'{key}.json').read_text('utf-8'))['metrics']
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return metrics if isinstance(metrics, dict) else None


def prepare_folder(folder: Path, *, overwrite: bool, results: Collection[str] = ()) -> None:
    """
    Make the folder of a study, keeping its finished jobs unless they shall go.

    ConfigError if it cannot be made, or holds other files than `results` without any ``cells/``.
    """
    cells = folder / CELLS
    if folder.is_dir() and not cells.is_dir() and any(
            path.name not in results for path in folder.iterdir()):
        raise ConfigError('out', 'a new or empty folder, or one with cells/',
                          f'{folder}, which holds other files')
    try:
        cells.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{folder} ({error.strerror})') from None
    if overwrite:
        for path in cells.glob('*.json'):
            path.unlink()


def run_jobs(
    jobs: Mapping[str, Job], folder: Path, *, workers: int = 0, client: Any = None,
    console: Console | None = None, title: str = 'runs',
) -> dict[str, dict[str, Any]]:
    """
    Run every job without a result in a folder, and return what was measured in all, by key.

    Results are in ``cells/<key>.json``. One worker is this process, 0 stands for a process on
    every core; the client of a Dask cluster runs them there. RunError if a worker or the cluster
    dies; what was finished before is kept.
    """
    found = {key: read_cell(folder, key) for key in jobs}
    todo = {key: job for key, job in jobs.items() if found[key] is None}
    if todo:
        ensure_compiled(console)  # here once, not in every worker at once
    with count_bar(console) as progress:
        bar = progress.add_task(title, total=len(jobs), completed=len(jobs) - len(todo))
        if client is not None:
            work = _on_cluster(todo, client)
        elif len(todo) < 2 or workers == 1:
            work = (_timed(key, job) for key, job in todo.items())
        else:
            work = _in_processes(todo, workers)
        with closing(work) as outcomes:
            for key, metrics, wall_time in outcomes:
                write_json(folder / CELLS / f'{key}.json', {
                    'key': key, 'job': asdict(todo[key]), 'wall_s': wall_time,
                    'metrics': metrics})
                found[key] = metrics
                progress.advance(bar)
    return {key: metrics for key, metrics in found.items() if metrics is not None}


def _timed(key: str, job: Job) -> Outcome:
    start = time.perf_counter()
    return key, finite(job.run()), time.perf_counter() - start


def _in_processes(todo: Mapping[str, Job], workers: int) -> Generator[Outcome, None, None]:
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    with joblib.parallel_config(backend='loky', inner_max_num_threads=1):
        # One job at a time: it takes far longer than handing it over, and is kept once done.
        parallel = joblib.Parallel(n_jobs=workers or -1, return_as='generator_unordered',
                                   batch_size=1, pre_dispatch='2*n_jobs')
        try:
            yield from parallel(
                joblib.delayed(_in_worker)(key, job) for key, job in todo.items())
        except TerminatedWorkerError:
            raise RunError(WORKER_DIED) from None


def _in_worker(key: str, job: Job) -> Outcome:
    # Ctrl-C reaches every process of the terminal; the one that gave out the work ends the rest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _timed(key, job)


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """
    Connect to the Dask scheduler at an address; yield None without one.

    ConfigError if nothing answers there, RunError if `distributed` is not installed.
    """
    if not address:
        yield None
        return
    try:
        import distributed
        from distributed.comm import get_address_host_port
    except ImportError:
        raise RunError('a Dask cluster needs `distributed`, which is not installed here: '
                       "pip install 'multicontact_control[dask]'") from None
    try:
        # A client that is refused leaves threads that complain at the end of the program.
        socket.create_connection(get_address_host_port(address), CONNECT_TIMEOUT).close()
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise ConfigError('dask', 'the address of a Dask scheduler that answers, e.g. '
                          'tcp://127.0.0.1:8786', f'{address} ({reason})') from None
    with client:
        yield client


def _on_cluster(todo: Mapping[str, Job], client: Any) -> Generator[Outcome, None, None]:
    # Not joblib's Dask backend: it waits for ever for a job whose workers died (joblib 1.6).
    from distributed import as_completed, KilledWorker

    futures = client.map(_on_dask_worker, todo.keys(), todo.values(), pure=False, batch_size=500)
    try:
        for future in as_completed(futures, loop=client.loop):
            yield future.result()
            future.release()
    except KilledWorker:
        raise RunError(WORKER_DIED) from None
    except LOST_CONNECTION as error:
        raise RunError(f'the Dask cluster gives no results any more ({type(error).__name__}); '
                       'the same command goes on with what is missing') from None
    finally:
        with suppress(*LOST_CONNECTION):
            client.cancel(futures)


def _on_dask_worker(key: str, job: Job) -> Outcome:
    """Run a job where its key is the same, which stands for equal code and configuration."""
    with _ONE_AT_A_TIME:
        if job.key() != key:
            raise RunError('a Dask worker has other code, libraries or configuration files')
        return _timed(key, job)
