"""The controller's tick against pinocchio's dynamics calls alone, and where its time goes."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.control.arm_state import ArmState
from multicontact_control.control.controller import Controller
from multicontact_control.control.reference.holdable import HoldableReference
from multicontact_control.control_loop import ControlLoop
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.experiment.bench.timing import (
    median,
    noise_notes,
    race,
    rounded_percentiles,
    spread,
    stopwatch,
)
from multicontact_control.experiment.closed_loop import estimate_variance, run_in_process
from multicontact_control.experiment.scenario import law_presets, resolve, Setup
from multicontact_control.force.noise import make_noise_estimator, NoiseEstimator
from multicontact_control.sampling import PairedSample
from multicontact_control.sensor.front_end import SensorFrontEnd
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.reference import ContactReference
from multicontact_control.supervision.supervised_law import SupervisedLaw
from multicontact_control.supervision.validation import Watchdog
import numpy as np

LAW_DURATION = 4.0  # s of the scenario, with both contacts held from 1 s on
# What a tick consists of, in its order: where it is, its name, the stage it counts for.
BARE = (
    (SensorFrontEnd, 'take', 'sensor'), (RobotModel, 'compute', 'dynamics'),
    (ArmState, 'look', 'contacts'), (HoldableReference, 'update', 'reference'),
    (Controller, 'decide', 'law'), (NoiseEstimator, 'update', 'estimators'))
SUPERVISED = (
    BARE[0], (Watchdog, 'validate', 'watchdog'), *BARE[1:3],
    (ContactReference, 'ask', 'reference'), (SupervisedLaw, 'answer', 'law'), BARE[5])


class Replay:
    """A scenario that has been run, ready to be computed again."""

    def __init__(self, setup: Setup, *, supervised: bool) -> None:
        self._places = SUPERVISED if supervised else BARE
        data = run_in_process(setup, supervised=supervised).data
        config = setup.controller
        wrench = getattr(data, config.wrench_series)
        self.samples = [
            PairedSample(round(k * config.period * 1e9), data.q[k].copy(), data.qd[k].copy(),
                         wrench[k].copy(), data.effort[k].copy())
            for k in range(data.ticks)]
        self._loop = ControlLoop(
            config, setup.reference(), CommandLimits(), setup.urdf_dir, supervised=supervised)
        self._estimator = make_noise_estimator(setup.noise_estimator)
        self._robot = RobotModel(config.robot, setup.urdf_dir)

    def time(self, ticks: int) -> tuple[Vector, Vector]:
        """Time loop and estimator, and as their floor pinocchio's dynamics calls alone [us]."""
        return race(self._step, self._floor, ticks, restart=self._restart, lap=len(self.samples))

    def time_law(self) -> tuple[Vector, Vector]:
        """Time the loop alone, under a constant R, on each sample, and its floor [us]."""
        def step(place: int) -> None:
            self._loop.step(self.samples[place])

        count = len(self.samples)
        return race(step, self._floor, count, restart=self._restart, lap=count)

    def shares(self) -> dict[str, float]:
        """Return which part of a tick goes where; the stopwatch's own time counts with each."""
        with stopwatch(self._places) as spent:
            total = float(np.median(self.time(len(self.samples))[0]))
        shares: dict[str, float] = {}
        for (stage, _), times in spent.items():
            shares[stage] = shares.get(stage, 0.0) + float(np.median(times)) / total
        shares['other'] = max(0.0, 1.0 - sum(shares.values()))
        return {stage: round(share, 3) for stage, share in shares.items()}

    def _restart(self) -> None:
        self._loop.restart()
        self._estimator.reset()

    def _step(self, place: int) -> None:
        """Answer a sample, and estimate the R of the next one."""
        loop, sample = self._loop, self.samples[place]
        loop.step(sample)
        if loop.output is not None:
            loop.take_variance(sample.stamp, estimate_variance(self._estimator, loop.output))

    def _floor(self, place: int) -> None:
        sample = self.samples[place]
        self._robot.bare_dynamics(sample.q, sample.qd)


def bench_laws(ticks: int) -> dict[str, Any]:
    """Return for every preset the control law's tick [us], bare, and its ratio to the floor."""
    found = {}
    for preset in law_presets():
        replay = Replay(resolve('quick', plant='rigid', duration=LAW_DURATION, preset=preset),
                        supervised=False)
        replay.time_law()
        laps = max(1, round(ticks / len(replay.samples)))
        times = [replay.time_law() for _ in range(laps)]
        law, floor = (float(np.median(np.concatenate(each))) for each in zip(*times))
        found[preset] = {'law_us': round(law, 2), 'ratio': law / floor}
    return found


def bench_tick(ticks: int, repeats: int, *, supervised: bool) -> dict[str, Any]:
    """
    Return times, ratio to the floor with its spread, shares, and doubts.

    Front end and noise estimators of all contacts count; watchdog, contact states, limits and
    gate do if it is `supervised`.
    """
    replay = Replay(
        resolve('quick', plant='rigid', seed=0, duration=None), supervised=supervised)
    replay.time(min(ticks, 2000))
    runs = [replay.time(ticks) for _ in range(repeats)]
    ratios = [float(np.median(tick) / np.median(floor)) for tick, floor in runs]
    return {
        'ticks': ticks, 'repeats': repeats,
        'tick_us': rounded_percentiles(np.concatenate([tick for tick, _ in runs])),
        'dynamics_us': rounded_percentiles(np.concatenate([floor for _, floor in runs])),
        'ratio': median(ratios), 'ratio_spread': spread(ratios),
        'shares': replay.shares(),
        'notes': noise_notes([floor for _, floor in runs])}
