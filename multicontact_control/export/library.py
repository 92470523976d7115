"""A folder with the tick of one configuration as a C library: `multicontact export`."""

from __future__ import annotations

from pathlib import Path
import shutil
import struct
import subprocess
from tempfile import TemporaryDirectory
from typing import Any

from multicontact_control.config import ControllerConfig
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.export.entries import ENTRIES
from multicontact_control.export.header import FILES, write_header
from multicontact_control.export.memory import (
    copy_memory,
    hash_layout,
    make_memory_record,
)
from multicontact_control.export.objects import compile_entries
from multicontact_control.loop import ControlLoop
from multicontact_control.records import record_dtype, Records
import numpy as np

NAME = 'multicontact_tick'
HEADER = f'{NAME}.h'
RECORDS = 'multicontact_records.bin'
MODEL = 'model.txt'
MAGIC = b'MCTICK01'
EXAMPLES = ('CMakeLists.txt', 'control_loop.cpp', 'arm_model.hpp')
LIBRARIES = (f'lib{NAME}.a', f'lib{NAME}.so')
LEFT_BY_EXPORTS = {HEADER, RECORDS, MODEL, *EXAMPLES, *LIBRARIES, 'build'}


def export_library(loop: ControlLoop, folder: Path, *, target: str = '') -> list[Path]:
    """
    Write the tick of a controller as a C library; return its files.

    The folder appears as a whole: what fails leaves none, or the export that was there.

    Parameters
    ----------
    loop
        The controller, before its first sample.
    folder
        Where the files go.
    target
        Triple of the machine that is to run it, as LLVM names it; empty for this one. Without
        `TARGET-gcc` there is no shared library.

    Raises
    ------
    ConfigError
        If LLVM does not know the target, or the folder holds what no export has left.
    RunError
        If `ar` or `cc` is missing, or fails.

    """
    if folder.exists():
        foreign = {path.name for path in folder.iterdir()} - LEFT_BY_EXPORTS
        if foreign:
            raise ConfigError(
                'DIR',
                'a new folder, or that of an export',
                f'{folder}, which holds {min(foreign)}',
            )
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f'.{folder.name}-') as beside:
        partial = Path(beside) / 'new'
        partial.mkdir()
        _write_files(loop, partial, target)
        if folder.exists():
            folder.rename(Path(beside) / 'old')
        partial.rename(folder)
    return sorted(folder.iterdir())


def _write_files(loop: ControlLoop, folder: Path, target: str) -> None:
    """Write all files of an export into a folder."""
    record = make_memory_record(loop)
    dtype = record_dtype(record)
    layout = hash_layout(dtype)
    header = write_header(
        record, layout, _list_values(loop.config), loop.config.column_names
    )
    (folder / HEADER).write_text(header, encoding='utf-8')
    (folder / RECORDS).write_bytes(pack_records(loop))
    (folder / MODEL).write_text(loop.supervisor.controller.robot.save_model())
    for name in EXAMPLES:
        shutil.copyfile(FILES / name, folder / name)
    code = compile_entries(ENTRIES, dtype, layout, target)
    _link(code, folder, target)


def pack_records(loop: ControlLoop) -> bytes:
    """Return the content of a file of records: what a controller works on now."""
    dtype = record_dtype(make_memory_record(loop))
    memory: Records[Any] = np.zeros(1, dtype=dtype)
    copy_memory(loop, memory)
    head = struct.pack('<8sQQ', MAGIC, hash_layout(dtype), dtype.itemsize)
    return head + np.asarray(memory).tobytes()


def _list_values(config: ControllerConfig) -> dict[str, object]:
    """Return the constants of a configuration, by their names in C."""
    robot = config.robot
    return {
        'JOINTS': len(robot.joint_names),
        'COLUMNS': len(config.column_names),
        'PERIOD': config.period,
        'OPERATIONAL_FRAME': robot.operational_frame,
        'SENSOR_FRAME': robot.sensor_frame or robot.operational_frame,
        'ADDS_GRAVITY': int(robot.adds_gravity),
        'ADDS_TOOL_GRAVITY': int(robot.adds_tool_gravity),
        'TOOL_MASS': config.tool.mass,
        'TOOL_COM': tuple(config.tool.com_sensor),
        'COMMAND_DELAY': config.collision.command_delay,
        'WRENCH_BY_MOMENTUM': int(config.wrench_input == 'momentum'),
    }


def _link(code: bytes, folder: Path, target: str) -> None:
    """Make the static library of an object file, and the shared one where it can be linked."""
    archive, shared = (folder / name for name in LIBRARIES)
    linker = 'cc'
    if target:
        linker = f'{target}-gcc'
    with TemporaryDirectory() as place:
        compiled = Path(place) / f'{NAME}.o'
        compiled.write_bytes(code)
        _call('ar', 'rcs', archive, compiled)
        if not target or shutil.which(linker):
            _call(linker, '-shared', '-o', shared, compiled, '-lm')


def _call(program: str, *arguments: object) -> None:
    """Call a program; RunError in one line if it is missing or fails."""
    try:
        done = subprocess.run(
            [program, *map(str, arguments)], capture_output=True, text=True
        )
    except FileNotFoundError:
        raise RunError(
            f'export: expected {program} (Debian: gcc, binutils), got none on PATH'
        ) from None
    if done.returncode:
        reasons = done.stderr.strip().splitlines() or ['no reason']
        raise RunError(f'export: {program} failed: {reasons[-1]}')
