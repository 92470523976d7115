"""
Compiling is a step of its own: every kernel a command or node may need, before any of them runs.

All of it is called once, in short. A file in the cache says that it is there, for these sources,
libraries and processor; a command that finds none compiles first.
"""

from __future__ import annotations

from dataclasses import replace
import fcntl
import hashlib
from importlib.metadata import version
import os
from pathlib import Path
import shutil
from subprocess import DEVNULL, PIPE, Popen
import sys
from typing import Any

from llvmlite import binding as llvm
from multicontact_control.compiled import find_cache_folder, HERE
import numpy as np
from rich.console import Console

NO_FOLDER = (
    'warning: no folder can be written for compiled kernels, so every process compiles '
    'its own (a minute each): set NUMBA_CACHE_DIR to one that can'
)
LOCK_FILE = 'compiling.lock'
TICKS = 3
BESIDE = f'from {__name__} import compile_beside; compile_beside()'
KEPT = 5  # folders, each for one state of the sources


def ensure_compiled() -> int:
    """
    Compile every kernel, unless the cache has them.

    One command at a time does so, on two cores; others wait for it. Returns the number of compiled
    kernels in the cache if this call has made them, else 0. Without a folder for the cache nothing
    is compiled now, and a warning is printed.
    """
    folder = find_cache_folder()
    if folder is not None and _completion_file(folder).is_file():
        return 0
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    if folder is None:
        console.print(NO_FOLDER, style='yellow')
        return 0
    # The system frees the lock when this process ends.
    with (folder / LOCK_FILE).open('w') as lock:
        console.print(
            'compiling the numerical kernels, once (a minute on two cores), into '
            f'{folder}'
        )
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _completion_file(folder).is_file():
            return 0
        errors = _compile_on_two_cores()
        if errors:
            console.print(
                f'warning: the second compiler failed, one goes on:\n{errors}',
                style='yellow',
            )
        _call_remaining_kernels()
        _completion_file(folder).touch()
    package = folder.name.rpartition('-')[0]
    folders = sorted(folder.parent.glob(f'{package}-*'), key=os.path.getmtime)
    for outdated in folders[:-KEPT]:
        shutil.rmtree(outdated, ignore_errors=True)
    return len(list(folder.rglob('*.nbc')))  # numba's files, one for each


def _compile_on_two_cores() -> str:
    """Compile the law here and the rest beside; return what the other process failed with."""
    places = [str(HERE.parent), os.environ.get('PYTHONPATH', '')]
    with Popen(
        [sys.executable, '-c', BESIDE],
        stdout=DEVNULL,
        stderr=PIPE,
        text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(places)},
    ) as beside:
        _compile_law()
        _, errors = beside.communicate()
    return errors if beside.returncode else ''


def _completion_file(folder: Path) -> Path:
    """Return the file that says that all is compiled, for these libraries and this processor."""
    parts = [
        version('numba'),
        version('llvmlite'),
        sys.version,
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    ]
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()
    return folder / f'complete-{digest[:16]}'


def compile_beside() -> None:
    """
    Compile what works without the law: inputs, task, reactions, gate and plant.

    In a process of its own, on another core. What fails there is compiled by what follows.
    """
    from multicontact_control.dynamics.terms import ModelTerms
    from multicontact_control.force.force_law import FORCE_LAW
    from multicontact_control.records import CONTACT, CONTROL, JOINT
    from multicontact_control.runs.scenario import resolve
    from multicontact_control.supervision.checks import JUDGEMENT
    from multicontact_control.supervision.contacts import CONTACT_STATE
    from multicontact_control.supervision.decisions import react
    from multicontact_control.supervision.gate import GATE_STATE
    from multicontact_control.supervision.input_checks import check_inputs, INPUT_STAGE
    from multicontact_control.supervision.reference import TASK_LIMITS
    from multicontact_control.supervision.task_limits import limit_task
    from multicontact_control.supervision.tick_records import (
        SUPERVISION,
        TickRecords,
        WORKSPACE,
    )
    from sim_bridge.plant import Plant

    rotation = np.eye(3, order='F')
    terms = ModelTerms(  # in the order of elements in which pinocchio gives them
        mass_matrix=np.eye(6, order='F'),
        bias_torque=np.zeros(6),
        gravity=np.zeros(6),
        jacobian=np.eye(6),
        jacobian_rate=np.eye(6),
        position=np.zeros(3),
        rotation=rotation,
        sensor_position=np.zeros(3),
        sensor_rotation=rotation,
    )

    def make_records(count: int, dtype: Any) -> Any:
        return np.zeros(count, dtype=dtype)

    records = TickRecords(
        joints=make_records(6, JOINT),
        controls=make_records(1, CONTROL),
        contacts=make_records(2, CONTACT),
        laws=make_records(2, FORCE_LAW),
        fresh_laws=make_records(2, FORCE_LAW),
        states=make_records(2, CONTACT_STATE),
        stages=make_records(1, INPUT_STAGE),
        supervisions=make_records(1, SUPERVISION),
        limits=make_records(1, TASK_LIMITS),
        judgements=make_records(1, JUDGEMENT),
        gates=make_records(1, GATE_STATE),
        workspaces=make_records(1, WORKSPACE),
    )
    records.stages['settings']['commands'] = 2
    react(records, terms)
    limit_task(records.limits[0], records.controls[0], records.contacts, records.states)
    check_inputs(
        records.stages,
        np.zeros(6),
        np.zeros(6),
        records.joints,
        records.controls,
        records.contacts,
    )
    for name in ('flexible', 'rigid'):
        setup = resolve('quick', plant=name)
        plant = Plant(setup.plant, rate=setup.controller.rate, seed=0)
        plant.step(plant.initial_torque)
        plant.close()


def _compile_law() -> None:
    """Compile what sees the arm, and the law."""
    from multicontact_control.control.controller import Controller
    from multicontact_control.dynamics.robot import RobotModel
    from multicontact_control.runs.scenario import resolve

    setup = resolve('quick')
    Controller(setup.controller, RobotModel(setup.controller.robot, setup.urdf_dir))


def _call_remaining_kernels() -> None:
    """Make numba compile all that is left, above all the tick."""
    from multicontact_control.force.force_law import continue_laws, make_force_laws
    from multicontact_control.force.stiffness import (
        estimate_stiffness,
        FIT_SPACE,
        friction_of_others,
    )
    from multicontact_control.records import CONTACT, FRAME
    from multicontact_control.runs.closed_loop import run_in_process
    from multicontact_control.runs.scenario import resolve

    adaptive = resolve('quick', preset='adaptive').controller
    other_law = resolve('quick', preset='laws/dob').controller
    running = make_force_laws(adaptive)
    running['observer']['running'] = True
    for config in (adaptive, other_law):
        laws = make_force_laws(config)
        continue_laws(laws, running)
        running = laws
    stiffness = make_force_laws(adaptive)[0]['stiffness']
    space = np.zeros(1, dtype=FIT_SPACE)[0]
    estimate_stiffness(stiffness, 0.0, 0.0, 0.0, 0.0, space)
    friction_of_others(np.zeros(1, dtype=FRAME)[0], np.zeros(2, dtype=CONTACT), 0)
    for plant, friction, supervised in (
        ('flexible', 0.25, True),
        ('flexible', 0.25, False),
        ('rigid', 0.0, False),
        ('rigid', 0.25, False),
    ):
        overrides = {
            'joint_friction_scale': friction,
            'actuation': {'torque_loop': True},
        }
        setup = resolve('quick', plant=plant, plant_overrides=overrides)
        duration = TICKS * setup.controller.period  # shorter than any that is accepted
        scenario = setup.scenario.model_copy(update={'duration': duration})
        run_in_process(replace(setup, scenario=scenario), supervised=supervised)
