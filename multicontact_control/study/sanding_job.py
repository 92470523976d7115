"""One run of the sanding benchmark as a job, measured as its published results are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.control.motions import CircleConfig, SineConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.judging.run_series import (
    find_long_stretches,
    statistic_within,
)
from multicontact_control.judging.supervisor_events import read_event
from multicontact_control.runs.closed_loop import LoopResult, run_in_process
from multicontact_control.runs.recording import RunData
from multicontact_control.runs.scenario import resolve, Setup
from multicontact_control.study.jobs import outcome_key
from multicontact_control.supervision.contacts import LOSS_TIME
import numpy as np
import pandas as pd

MEASURED_FROM = 3.0  # s
AVERAGING_TIME = 0.01  # s: 20 samples of the published simulation


@dataclass(frozen=True)
class SandingJob:
    """
    One run of a sanding scenario, in process and with the supervisor.

    As in a `RunJob`, the arguments are kept instead of the setup that they resolve to.
    """

    arguments: Mapping[str, Any]  # of `resolve`

    def setup(self) -> Setup:
        """Return everything the run needs; see `Job.setup`."""
        return resolve(**self.arguments)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `outcome_key`."""
        return outcome_key('sanding', self.setup())

    def run(self) -> dict[str, Any]:
        """
        Run it and measure it; see `measure_sanding`.

        An exception of the run is the `error` of its metrics, and ends no study.
        """
        setup = self.setup()
        try:
            return measure_sanding(run_in_process(setup, supervised=True), setup)
        except Exception as problem:
            return {'holds': False, 'error': f'{type(problem).__name__}: {problem}'}


def measure_sanding(result: LoopResult, setup: Setup) -> dict[str, Any]:
    """
    Return the errors of a run from 3 s on, and what went wrong in it since the first touch.

    Parameters
    ----------
    result
        What the run left.
    setup
        What was run: a circle or a sine on one surface or several.

    Returns
    -------
    dict
        `normal_n`: mean error of the true normal force, of the worst contact [N]. `vertical_n`:
        that of the force along the normal that the controller is told, None with several
        contacts. `force_n`: that of these two which the controller is asked for. `position_m`:
        mean error of the first contact's tip. `without_contact`: share of the samples without a
        contact. `losses`: of `LOSS_TIME` or more. `reactions`: of the supervisor. `holds`: whether
        there is neither, and the run has its whole length. `error`: why it ended early, or None.
        Errors are None if the run ended before 3 s.

    """
    data = result.data
    config = setup.controller
    names = config.contact_names
    forces = data.alpha_true[:, : len(names)]
    command = setup.commanded(data.time)[:, : len(names)]
    measured = data.time >= MEASURED_FROM
    normal_errors = []
    for force, wanted in zip(forces.T, command.T):
        normal_errors.append(_mean_error(force, wanted, data.rate, measured))
    normal_error = max(normal_errors, key=lambda error: error or 0.0)
    told_forces, tips = find_told_forces_and_tips(data, setup)
    vertical_error = None
    if len(names) == 1:
        vertical_error = _mean_error(told_forces, command[:, 0], data.rate, measured)
    force_error = vertical_error
    if config.contacts[names[0]].normal_turn_rate > 0.0:
        force_error = normal_error
    deviation = find_deviation(tips, data.time, setup)
    off = forces <= 0.0
    off_since_touch = off & np.logical_or.accumulate(~off, axis=0)
    losses = 0
    for column in off_since_touch.T:
        losses += len(find_long_stretches(column, LOSS_TIME * data.rate - 1e-9))
    reactions = sum(read_event(*line).replaces_law for line in result.events)
    is_whole = not result.ended_early
    return {
        'holds': is_whole and not losses and not reactions,
        'force_n': force_error,
        'normal_n': normal_error,
        'vertical_n': vertical_error,
        'position_m': statistic_within(measured, deviation),
        'without_contact': statistic_within(measured, off.any(axis=1).astype(float)),
        'losses': losses,
        'reactions': reactions,
        'error': result.ended_early or None,
    }


def _mean_error(
    force: Vector, wanted: Vector, rate: float, measured: Mask
) -> float | None:
    """Return the mean distance of a force's moving average from the command [N]."""
    count = round(AVERAGING_TIME * rate)
    average = pd.Series(force).rolling(count, min_periods=1).mean().to_numpy()
    return statistic_within(measured, np.abs(average - wanted))


def find_told_forces_and_tips(data: RunData, setup: Setup) -> tuple[Vector, Matrix]:
    """
    Return what the wrist sensor shows of the first contact, and where its tip is.

    The force is the reading without the weight of the tool, along the normal that the controller
    is told, shape (m,) [N]; the tip follows from the joint angles, world axes, shape (m, 3) [m].
    """
    config = setup.controller
    contact = config.contacts[config.contact_names[0]]
    robot = RobotModel(config.robot, setup.urdf_dir)
    gravity = np.array(config.robot.gravity_world)
    at_rest = np.zeros(data.q.shape[1])
    forces = np.zeros(data.ticks)
    tips = np.zeros((data.ticks, 3))
    for k in range(data.ticks):
        state = robot.update(data.q[k], at_rest)
        pose = state.pose
        sensor = (state.sensor_pose.position_world, state.sensor_pose.rotation_world)
        wrench = contact_wrench(
            data.wrench[k], sensor, pose.position_world, config.tool, gravity
        )
        forces[k] = wrench[:3] @ contact.normal_world
        tips[k] = pose.position_world + pose.rotation_world @ contact.point_operational
    return forces, tips


def find_deviation(tips: Matrix, time: Vector, setup: Setup) -> Vector:
    """
    Return how far a tip is from the motion that is asked for, at full speed from its start on.

    Parameters
    ----------
    tips
        Positions from the start of the run on, world axes, shape (m, 3) [m].
    time
        Their times, shape (m,) [s].
    setup
        Of the run; the motion begins from the first position.

    Returns
    -------
    Vector
        The mean of |x - x_ref| and |y - y_ref| for a circle, the distance along its direction for
        a sine, shape (m,) [m].

    Raises
    ------
    ConfigError
        If the motion is another.

    """
    motion = setup.scenario.reference.motion
    if isinstance(motion, CircleConfig):
        # With half of the blend the tool is where one begun at full speed is.
        since_start = time - motion.start_time - 0.5 * motion.blend_time
        angle: Vector = motion.speed / motion.radius * since_start
        axes = np.array([motion.centre_direction_world, motion.direction_world])
        wanted = motion.radius * np.column_stack([1.0 - np.cos(angle), np.sin(angle)])
    elif isinstance(motion, SineConfig):
        angle = 2.0 * np.pi / motion.period * (time - motion.start_time)
        axes = np.array([motion.direction_world])
        wanted = motion.amplitude * np.sin(angle)[:, np.newaxis]
    else:
        raise ConfigError('reference.motion', 'a circle or a sine', motion)
    errors = (tips - tips[0]) @ axes.T - wanted
    deviation: Vector = np.abs(errors).mean(axis=1)
    return deviation
