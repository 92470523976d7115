"""
Compiling is a step of its own: every kernel a command or node may need, before any of them runs.

What is to be compiled is found by doing it once, in short: every estimator, both kinds of drives,
with the supervisor and without. A file in the cache says that all of it is there, for these
sources, libraries and processor; a command that finds none compiles first, and says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import fcntl
import hashlib
from importlib.metadata import version
import os
from pathlib import Path
import shutil
import sys

from llvmlite import binding as llvm
from multicontact_control.compiled import cache_folder, compiled_here
from multicontact_control.experiment.terminal import moving_bar, terminal
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

NO_FOLDER = ('warning: no folder can be written for compiled kernels, so every process compiles '
             'its own (half a minute each): set NUMBA_CACHE_DIR to one that can')
LOCK_FILE = 'compiling.lock'
TICKS = 3
KEPT = 5  # folders, each for one state of the sources


def ensure_compiled(console: Console | None = None) -> int:
    """
    Compile every kernel that the cache on disk lacks, and return how many that were.

    A second process that wants the same waits for the first. `console` shows what is done.
    """
    folder = cache_folder()
    if folder is not None and _marker(folder).is_file():
        return 0
    console = console or terminal(stderr=True)
    if folder is None:
        console.print(NO_FOLDER, style='yellow', highlight=False, soft_wrap=True)
        return 0
    with (folder / LOCK_FILE).open('w') as lock:  # the system frees it when this process ends
        console.print(f'compiling the numerical kernels, once, into {folder}',
                      highlight=False, soft_wrap=True)
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _marker(folder).is_file():
            return 0
        before = compiled_here()
        _compile_all(console)
        _marker(folder).touch()
    alike = folder.parent.glob(f'{folder.name.rpartition("-")[0]}-*')
    for outdated in sorted(alike, key=os.path.getmtime)[:-KEPT]:
        shutil.rmtree(outdated, ignore_errors=True)
    return compiled_here() - before


def _marker(folder: Path) -> Path:
    """Return the file that says that all is compiled, for these libraries and this processor."""
    parts = [version('numba'), version('llvmlite'), sys.version, llvm.get_host_cpu_name(),
             llvm.get_host_cpu_features().flatten()]
    return folder / f'complete-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}'


def _compile_all(console: Console) -> None:
    """Do everything once."""
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
               TimeElapsedColumn())
    with moving_bar(*columns, console=console, refresh_per_second=5) as progress:
        bar = progress.add_task('loading', total=None)
        exercises = _exercises()
        progress.update(bar, total=len(exercises))
        for title, exercise in exercises.items():
            progress.update(bar, description=f'compiling: {title}')
            exercise()
            progress.advance(bar)


def _exercises() -> Mapping[str, Callable[[], object]]:
    """Return what makes numba compile all that there is, by what it is."""
    from multicontact_control.experiment.closed_loop import run_in_process
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

    return {
        'noise estimators': estimators, 'force laws': force_laws,
        'control law and flexible drives': lambda: run_in_process(setup('flexible')),
        'supervisor': lambda: run_in_process(setup('flexible'), supervised=True),
        'rigid drives': lambda: run_in_process(setup('rigid')),
        'rigid drives with friction': lambda: run_in_process(
            setup('rigid', joint_friction_scale=0.25))}
