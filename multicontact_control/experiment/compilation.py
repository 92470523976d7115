"""
Compiling is a step of its own: every kernel a command or node may need, before any of them runs.

What is to be compiled is found by doing it once, in short: every estimator, both kinds of drives,
with the supervisor and without. A file in the cache says that all of it is there, for these
sources, libraries and processor; a command that finds none compiles first, and says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
import fcntl
import hashlib
from importlib.metadata import version
import json
import os
from pathlib import Path
import shutil
import sys
import time

from llvmlite import binding as llvm
from multicontact_control.compiled import cache_folder, compiled_here
from multicontact_control.experiment.terminal import moving_bar, terminal
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

NO_FOLDER = ('no folder can be written for what is compiled, so every process compiles for itself '
             '(half a minute each): set NUMBA_CACHE_DIR to one that can')
LOCK_FILE = 'compiling.lock'
TICKS = 3
KEPT = 5  # folders, each for one state of the sources
LOCK_POLL = 0.2  # s


def ensure_compiled(console: Console | None = None) -> int:
    """
    Compile every kernel that the cache on disk lacks; where it lacks none, look and return.

    A second process that wants the same waits for the first and finds everything done.

    Parameters
    ----------
    console
        Where it is said, and where the bar is shown.

    Returns
    -------
    int
        How many kernels this process compiled.

    """
    folder = cache_folder()
    if folder is not None and is_complete(folder):
        return 0
    console = console or terminal(stderr=True)
    if folder is None:
        console.print(f'warning: {NO_FOLDER}', style='yellow', highlight=False, soft_wrap=True)
        return 0
    with _alone(folder, console):
        if is_complete(folder):  # by the one that was waited for
            return 0
        console.print(f'compiling the numerical kernels, once, into {folder}',
                      highlight=False, soft_wrap=True)
        return _compile_all(folder, console)


def is_complete(folder: Path) -> bool:
    """Return whether everything has been compiled into a folder and is still there."""
    try:
        names = json.loads(_complete_file(folder).read_text(encoding='utf-8'))
        return all((folder / name).is_file() for name in names)
    except (OSError, TypeError, ValueError):
        return False


def _complete_file(folder: Path) -> Path:
    """Return what says that a folder is complete, for these libraries and this processor."""
    parts = [version('numba'), version('llvmlite'), sys.version, llvm.get_host_cpu_name(),
             llvm.get_host_cpu_features().flatten()]
    return folder / f'complete-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}.json'


def _compile_all(folder: Path, console: Console) -> int:
    """Do everything once, then note which files that took or made."""
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
               TimeElapsedColumn())
    before = compiled_here()
    with moving_bar(*columns, console=console, refresh_per_second=5) as progress:
        bar = progress.add_task('loading', total=None)
        exercises = _exercises()
        for done, (title, exercise) in enumerate(exercises.items()):
            progress.update(bar, total=len(exercises), completed=done,
                            description=f'compiling: {title}')
            exercise()
        progress.update(bar, completed=len(exercises), description='compiled')
    found = [path.relative_to(folder).as_posix() for path in sorted(folder.rglob('*.nb[ic]'))]
    complete = _complete_file(folder)
    unfinished = complete.with_suffix(f'.{os.getpid()}')
    unfinished.write_text(json.dumps(found), encoding='utf-8')
    unfinished.replace(complete)
    alike = folder.parent.glob(f'{folder.name.rpartition("-")[0]}-*')
    for outdated in sorted(alike, key=os.path.getmtime)[:-KEPT]:
        shutil.rmtree(outdated, ignore_errors=True)
    return compiled_here() - before


def _exercises() -> Mapping[str, Callable[[], object]]:
    """Return what makes numba compile all that there is, by what it is."""
    from multicontact_control.experiment.closed_loop import run_in_process
    from multicontact_control.experiment.position_controlled_plant import ServoedPlant
    from multicontact_control.experiment.scenario import resolve, Setup
    from multicontact_control.force.force_law import continue_laws, make_force_laws
    from multicontact_control.force.noise import ESTIMATORS, make_noise_estimator
    from multicontact_control.force.stiffness import find_stiffness, friction_of_others
    from multicontact_control.records import CONTACT, FRAME

    def setup(plant: str, preset: str = '', **options: object) -> Setup:
        quick = resolve('quick', plant=plant)
        return resolve('quick', plant=plant, duration=TICKS * quick.controller.period,
                       preset=preset, plant_overrides=options)

    def force_laws() -> None:
        configs = [setup('rigid', preset).controller for preset in ('adaptive', 'laws/dob')]
        laws = [make_force_laws(config, np.full(len(config.columns), 6000.0))
                for config in (configs[0], *configs)]
        laws[0]['observer']['running'] = True
        for new, old in zip(laws[1:], laws):
            continue_laws(new, old)
        find_stiffness(laws[1][0]['stiffness'], 0.0, 0.0, 0.0, 0.0)
        friction_of_others(np.zeros(1, dtype=FRAME)[0], np.zeros(2, dtype=CONTACT), 0)

    def estimators() -> None:
        config = setup('flexible').noise_estimator
        for name in ESTIMATORS:
            make_noise_estimator(config.model_copy(update={'estimator': name}))

    def calibration() -> None:
        flexible = setup('flexible')
        arm = ServoedPlant(flexible)
        arm.hold(flexible.controller.period)
        arm.close()

    return {
        'noise estimators': estimators, 'force laws': force_laws,
        'control law and flexible drives': lambda: run_in_process(setup('flexible')),
        'supervisor': lambda: run_in_process(setup('flexible'), supervised=True),
        'rigid drives': lambda: run_in_process(setup('rigid')),
        'rigid drives with friction': lambda: run_in_process(
            setup('rigid', joint_friction_scale=0.25)),
        'calibration': calibration}


@contextlib.contextmanager
def _alone(folder: Path, console: Console) -> Iterator[None]:
    """Hold the right to compile into a folder; the system frees it when this process ends."""
    with (folder / LOCK_FILE).open('w') as lock:
        waiting = False
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError:
                if not waiting:
                    console.print('another process compiles the numerical kernels: waiting for '
                                  'it', highlight=False)
                waiting = True
                time.sleep(LOCK_POLL)
        yield
