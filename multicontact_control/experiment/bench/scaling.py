"""How the tick's time grows with contacts, joints and the order of the active state."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter_ns
from typing import Any

from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.reference import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.experiment.synthetic import synthetic_setup, SyntheticSetup
import numpy as np

CONTACTS = (1, 2, 3, 4, 5, 6)
JOINTS = (6, 7, 14)
ORDERS = (0, 1, 2, 3)


class _AllContacts:
    """A reference that holds the pose and presses on every contact."""

    def __init__(self, contacts: int) -> None:
        self._active = np.ones(contacts, dtype=bool)
        self._forces = np.full(contacts, 5.0)
        self._still = np.zeros(6)

    def start(self, pose: Pose, normals_world: Any) -> None:
        self._pose = pose

    def update(self, time: float, alpha_meas: Any) -> Reference:
        return Reference(self._pose, self._still, self._still, self._active, self._forces)


def tick_time(setup: SyntheticSetup, folder: Path, ticks: int) -> float:
    """Return the median time of a tick of the controller [us]."""
    contacts = len(setup.config.contact_names)
    controller = Controller.from_config(setup.config, _AllContacts(contacts), folder)
    random = np.random.default_rng(0)
    moves = random.standard_normal((100, 2, setup.home.shape[0]))
    wrenches = random.standard_normal((100, 6))
    samples = [
        Measurement(0.002 * k, setup.home + 0.02 * move[0], 0.1 * move[1], wrench)
        for k, (move, wrench) in enumerate(zip(moves, wrenches))]
    variance = np.full(contacts, 0.6)
    times = np.zeros(ticks)
    for k in range(ticks):
        sample = samples[k % len(samples)]
        start = perf_counter_ns()
        controller.step(sample, variance)
        times[k] = perf_counter_ns() - start
    return round(1e-3 * float(np.median(times)), 3)


def bench_scaling(ticks: int) -> dict[str, dict[str, float]]:
    """Return median times [us] by number of contacts, of joints (two contacts), and order."""
    with TemporaryDirectory() as name:
        folder = Path(name)

        def at(joints: int = 6, contacts: int = 2, order: int = 1) -> float:
            setup = synthetic_setup(folder, joints=joints, contacts=contacts, order=order)
            return tick_time(setup, folder, ticks)

        return {
            'contacts_us': {str(contacts): at(contacts=contacts) for contacts in CONTACTS},
            'joints_us': {str(joints): at(joints=joints) for joints in JOINTS},
            'order_us': {str(order): at(order=order) for order in ORDERS}}
