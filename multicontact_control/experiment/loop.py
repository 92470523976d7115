"""One scenario in one process, as fast as it goes, and what it leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time

from multicontact_control.arrays import Vector
from multicontact_control.control.controller import ControlOutput
from multicontact_control.errors import ContactGeometryError, SingularTaskError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.recording import empty_run_data, RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np

PROGRESS_TICKS = 100


@dataclass(frozen=True)
class LoopResult:
    """
    What a run in process leaves.

    Attributes
    ----------
    data
        The series.
    tick_us
        Wall time of each controller and estimator tick, shape (m,) [us].
    wall_time
        Of the whole run [s].
    ended_early
        Why the run ended before its time, empty if it did not.
    events
        What the supervisor did and when: time [s] and what changed.

    """

    data: RunData
    tick_us: Vector
    wall_time: float
    ended_early: str = ''
    events: tuple[tuple[float, str], ...] = ()


def run_in_process(
    setup: Setup, on_progress: Callable[[float, Vector], None] | None = None, *,
    supervised: bool = False,
) -> LoopResult:
    """
    Run a scenario as fast as it goes.

    Parameters
    ----------
    setup
        The run.
    on_progress
        Called every 100 ticks with the time [s] and the measured forces [N].
    supervised
        Whether contact states, watchdogs and limits are put around the control law. Without, it
        runs bare but for its start.

    Returns
    -------
    LoopResult
        The series up to the end, or up to where the arm could no longer be controlled.

    """
    config = setup.controller
    data = empty_run_data(
        setup.ticks, config.rate, config.contact_names, config.robot.joint_names)
    tick_us = np.zeros(setup.ticks)
    ended_early = ''
    done = setup.ticks
    loop = ClosedLoop(setup, supervised=supervised)
    start = time.perf_counter()
    try:
        for k in range(setup.ticks):
            before = time.perf_counter_ns()
            try:
                output = loop.answer()
            except (SingularTaskError, ContactGeometryError, np.linalg.LinAlgError) as error:
                ended_early, done = f'tick {k}: {error}', k
                break
            tick_us[k] = (time.perf_counter_ns() - before) * 1e-3
            _record(data, loop, output)
            if not np.isfinite(output.torque).all():
                ended_early, done = f'tick {k}: the commanded torque is not finite', k + 1
                break
            if k + 1 < setup.ticks:
                loop.act()
            if on_progress is not None and k % PROGRESS_TICKS == 0:
                on_progress(k * config.period, output.alpha_meas)
    finally:
        loop.close()
    return LoopResult(
        data=data.truncated(done), tick_us=tick_us[:done],
        wall_time=time.perf_counter() - start, ended_early=ended_early,
        events=tuple(loop.control.events.events))


def _record(data: RunData, loop: ClosedLoop, output: ControlOutput) -> None:
    k, sample = loop.tick, loop.sample
    data.q[k] = sample.q
    data.qd[k] = sample.qd
    data.effort[k] = sample.effort
    data.wrench[k] = sample.wrench
    data.wrench_filtered[k] = sample.wrench_filtered
    data.alpha_true[k] = sample.contact_force
    data.torque[k] = output.torque
    data.alpha_meas[k] = output.alpha_meas
    data.alpha_est[k] = output.alpha_est
    data.alpha_rate_est[k] = output.alpha_rate_est
    data.alpha_des[k] = output.alpha_des
    data.noise_variance[k] = loop.variance
    data.innovation[k] = output.innovation
    data.position[k] = output.pose.position_world
    data.quaternion[k] = output.pose.quaternion_xyzw
    data.position_des[k] = output.pose_des.position_world
    data.quaternion_des[k] = output.pose_des.quaternion_xyzw
