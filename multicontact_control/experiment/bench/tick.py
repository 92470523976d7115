"""The controller's tick against pinocchio's dynamics calls alone, and where its time goes."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter_ns
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.control_loop import ControlLoop
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.experiment.bench.spread import (
    median,
    noise_notes,
    percentiles,
    spread,
)
from multicontact_control.experiment.closed_loop import estimate_variance
from multicontact_control.experiment.loop import run_in_process
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.force.noise import make_noise_estimator, NoiseEstimator
from multicontact_control.sampling import PairedSample
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np


class Replay:
    """
    A scenario that has been run, ready to be computed again.

    Parameters
    ----------
    setup
        The run.
    supervised
        Whether the control law runs within its supervision, or bare.

    Attributes
    ----------
    loop
        What answers the samples, warmed up.
    estimator, robot
        Warmed up, too; the floor has an arm of its own.
    samples
        What the sensors read in that run.

    """

    def __init__(self, setup: Setup, *, supervised: bool = False) -> None:
        data = run_in_process(setup, supervised=supervised).data
        config = setup.controller
        wrench = data.wrench if config.wrench_input == 'raw' else data.wrench_filtered
        self.samples = [
            PairedSample(round(k * config.period * 1e9), data.q[k].copy(), data.qd[k].copy(),
                         wrench[k].copy())
            for k in range(data.ticks)]
        self.loop = ControlLoop(
            config, setup.reference(), CommandLimits(), setup.urdf_dir, supervised=supervised)
        self.estimator: NoiseEstimator = make_noise_estimator(setup.noise_estimator)
        self.robot = RobotModel(config.robot, setup.urdf_dir)

    def restart(self) -> None:
        """Begin anew."""
        self.loop.restart()
        self.estimator.reset()

    def step(self, sample: PairedSample) -> None:
        """Answer a sample, and estimate the R of the next one."""
        loop = self.loop
        loop.step(sample)
        if loop.output is not None:
            loop.take_variance(
                sample.stamp, estimate_variance(self.estimator, loop.output))


def time_ticks(replay: Replay, ticks: int) -> tuple[Vector, Vector]:
    """
    Time controller and estimator, and the floor right after each, so that both see the same.

    Returns
    -------
    tuple
        Times of the ticks and of pinocchio's dynamics calls alone, shape (ticks,) [us].

    """
    tick, floor = np.zeros(ticks), np.zeros(ticks)
    samples, robot = replay.samples, replay.robot
    for k in range(ticks):
        sample = samples[k % len(samples)]
        if k % len(samples) == 0:
            replay.restart()
        start = perf_counter_ns()
        replay.step(sample)
        done = perf_counter_ns()
        robot.bare_dynamics(sample.q, sample.qd)
        end = perf_counter_ns()
        tick[k], floor[k] = done - start, end - done
    return 1e-3 * tick, 1e-3 * floor


class _Stopwatch:
    """Notes what calls of some functions take."""

    def __init__(self) -> None:
        self.spent: dict[str, list[int]] = {}

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does the same and is timed under a name."""
        def timed(*arguments: Any) -> Any:
            start = perf_counter_ns()
            result = function(*arguments)
            self.spent.setdefault(name, []).append(perf_counter_ns() - start)
            return result
        return timed


def stage_shares(replay: Replay, ticks: int) -> dict[str, float]:
    """Return which part of a tick goes where; the stopwatch's own time counts with each."""
    loop, watch = replay.loop, _Stopwatch()
    controller, supervisor = loop.controller.controller, loop.supervisor
    places: list[tuple[Any, str, str]] = [
        (loop._front_end, 'update', 'sensor'),
        (controller.robot, 'compute', 'dynamics'), (controller, '_measure', 'contacts'),
        (controller._reference, 'update', 'reference'), (controller, '_decide', 'law')]
    if supervisor is not None:
        places += [
            (supervisor._watchdog, 'validate', 'watchdog'), (supervisor, '_finish', 'gate')]
    for owner, method, stage in places:
        setattr(owner, method, watch.around(stage, getattr(owner, method)))
    try:
        total = float(np.median(time_ticks(replay, ticks)[0]))
    finally:
        for owner, method, _ in places:
            delattr(owner, method)  # the class's own is there again
    shares = {
        stage: 1e-3 * float(np.median(spent)) / total for stage, spent in watch.spent.items()}
    shares['estimators'] = _estimator_time(replay, ticks) / total
    shares['other'] = max(0.0, 1.0 - sum(shares.values()))
    return {stage: round(share, 3) for stage, share in shares.items()}


def _estimator_time(replay: Replay, ticks: int) -> float:
    """Return the median time of all noise estimators in a tick [us]."""
    watch, alpha = _Stopwatch(), np.full(len(replay.loop.variance), 10.0)
    update = watch.around('estimators', replay.estimator.update)
    for _ in range(ticks):
        update(alpha)
    return 1e-3 * float(np.median(watch.spent['estimators']))


def bench_tick(ticks: int, repeats: int, *, supervised: bool) -> dict[str, Any]:
    """
    Return times, ratio to the floor with its spread, shares, and doubts.

    Parameters
    ----------
    ticks, repeats
        How many, and how often.
    supervised
        Whether watchdog, contact states, limits and gate count, or the control law with its
        start alone; front end and noise estimators of all contacts always do.

    """
    replay = Replay(
        resolve('quick', plant='rigid', seed=0, duration=None), supervised=supervised)
    time_ticks(replay, min(ticks, 2000))
    runs = [time_ticks(replay, ticks) for _ in range(repeats)]
    ratios = [float(np.median(tick) / np.median(floor)) for tick, floor in runs]
    return {
        'ticks': ticks, 'repeats': repeats,
        'tick_us': percentiles(np.concatenate([tick for tick, _ in runs])),
        'dynamics_us': percentiles(np.concatenate([floor for _, floor in runs])),
        'ratio': median(ratios), 'ratio_spread': spread(ratios),
        'shares': stage_shares(replay, len(replay.samples)),
        'notes': noise_notes([floor for _, floor in runs])}
