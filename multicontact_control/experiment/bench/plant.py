"""The plant against PyBullet's step alone, whole runs in process, and starting from cold."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
from time import perf_counter
from typing import Any

from multicontact_control.experiment.bench.timing import (
    median,
    race,
    rounded_percentiles,
    spread,
)
from multicontact_control.experiment.closed_loop import run_in_process
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pybullet as bullet
from sim_bridge.bullet_arm import BulletArm
from sim_bridge.plant import Plant

RESTART = 250  # periods after which an arm that falls is put back
READY = (
    'import time; start = time.perf_counter()\n'
    'from multicontact_control.experiment.scenario import resolve\n'
    'from multicontact_control.control.controller import Controller\n'
    'imported = time.perf_counter()\n'
    "setup = resolve('quick', plant='rigid', seed=0, duration=None)\n"
    'Controller.from_config(setup.controller, setup.reference(), setup.urdf_dir)\n'
    'print(imported - start, time.perf_counter() - imported)')


def bench_plant(ticks: int) -> dict[str, Any]:
    """
    Return times of the plant and of `stepSimulation`, and their ratio per period.

    The floor is the plain step of an arm in the same world, as often as the plant takes substeps.
    """
    config = resolve('quick', plant='rigid', seed=0, duration=None).plant
    plant = Plant(config, rate=500.0, seed=0)
    bare, home = BulletArm(plant.description, config.gravity_world, config.substep), config.home
    substeps = config.substeps(500.0)
    client = bare.client

    def reset() -> None:
        plant.reset()
        bare.reset(np.array(home))

    def floor(_: int) -> None:
        for _ in range(substeps):
            bullet.stepSimulation(physicsClientId=client)

    times, floors = race(
        lambda _: plant.step(plant.initial_torque), floor, ticks, restart=reset, lap=RESTART)
    plant.close()
    bare.close()
    return {
        'plant_us': rounded_percentiles(times), 'pybullet_us': rounded_percentiles(floors),
        'substeps': substeps, 'ratio': median([float(np.median(times) / np.median(floors))])}


def bench_in_process(
    duration: float | None, repeats: int, *, supervised: bool,
) -> dict[str, Any]:
    """Return simulated seconds per wall second of whole runs with the plant `rigid`."""
    setup = resolve('quick', plant='rigid', seed=0, duration=duration)
    factors = []
    for _ in range(repeats):
        result = run_in_process(setup, supervised=supervised)
        factors.append(result.data.ticks / result.data.rate / result.wall_time)
    return {'realtime_factor': median(factors), 'spread': spread(factors)}


def bench_cold_start() -> dict[str, float]:
    """Return how long a new process takes until its controller could answer [s]."""
    root = Path(__file__).resolve().parents[3]
    path = os.pathsep.join(filter(None, [str(root), os.environ.get('PYTHONPATH')]))
    start = perf_counter()
    done = subprocess.run(
        [sys.executable, '-c', READY], capture_output=True, text=True, check=True,
        env={**os.environ, 'PYTHONPATH': path})
    total = perf_counter() - start
    imports, construction = map(float, done.stdout.split()[-2:])
    return {'import_s': round(imports, 3), 'construct_s': round(construction, 3),
            'process_s': round(total, 3)}
