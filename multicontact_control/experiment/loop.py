"""One scenario in one process: plant, controller and estimator called in turn, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time

from multicontact_control.arrays import Vector
from multicontact_control.control.controller import ControlOutput, Measurement
from multicontact_control.errors import ContactGeometryError, SingularTaskError
from multicontact_control.experiment.recording import empty_run_data, RunData
from multicontact_control.experiment.scenario import Setup
from multicontact_control.force.noise import Innovation, make_noise_estimator
from multicontact_control.sensor.front_end import SensorFrontEnd, SensorReading
from multicontact_control.supervision.bumpless import BumplessController
from multicontact_control.supervision.event_log import EventLog
from multicontact_control.supervision.supervisor import Supervisor
from multicontact_control.supervision.validation import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
import numpy as np
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.pybullet_plant import PybulletPlant, Sample

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

    The controller at tick k works with the R of tick k - 1, and its command acts on the plant
    from k + actuator delay on, as in the graph.

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
    step, log = _stepper(setup, supervised)
    front_end = SensorFrontEnd(config.sensor, config.rate)
    estimator = make_noise_estimator(setup.noise_estimator)
    plant = PybulletPlant(setup.plant, rate=config.rate, seed=setup.seed)
    delay = ActuatorDelay(setup.plant.actuator_delay_ticks, plant.initial_torque)
    data = empty_run_data(
        setup.ticks, config.rate, config.contact_names, config.robot.joint_names)
    tick_us = np.zeros(setup.ticks)
    noise_variance = np.full(len(config.contact_names), config.initial_noise_variance)
    ended_early = ''
    done = setup.ticks
    start = time.perf_counter()
    try:
        sample = plant.reset()
        for k in range(setup.ticks):
            before = time.perf_counter_ns()
            reading = front_end.update(_wrench(setup, sample))
            try:
                output = step(k, sample, reading, noise_variance)
            except (SingularTaskError, ContactGeometryError, np.linalg.LinAlgError) as error:
                ended_early, done = f'tick {k}: {error}', k
                break
            noise_variance = estimator.update(output.alpha_meas, Innovation(
                output.innovation, output.prior_variance, output.variance_used)
                if estimator.uses_innovation else None)
            tick_us[k] = (time.perf_counter_ns() - before) * 1e-3
            _record(data, k, sample, output, noise_variance)
            if not np.isfinite(output.torque).all():
                ended_early, done = f'tick {k}: the commanded torque is not finite', k + 1
                break
            delay.command(k, output.torque)
            if k + 1 < setup.ticks:
                sample = plant.step(delay.torque_for(k))
            if on_progress is not None and k % PROGRESS_TICKS == 0:
                on_progress(k * config.period, output.alpha_meas)
    finally:
        plant.close()
    return LoopResult(
        data=data.truncated(done), tick_us=tick_us[:done],
        wall_time=time.perf_counter() - start, ended_early=ended_early, events=tuple(log.events))


Step = Callable[[int, Sample, SensorReading, Vector], ControlOutput]


def _stepper(setup: Setup, supervised: bool) -> tuple[Step, EventLog]:
    """Return what answers a sample, and the log of what a supervisor does."""
    config, log = setup.controller, EventLog()
    h = config.period
    if not supervised:
        controller = BumplessController.from_config(config, setup.reference(), setup.urdf_dir)
        return lambda k, sample, reading, variance: controller.step(
            Measurement(k * h, sample.q, sample.qd, reading.wrench_sensor, sample.effort),
            variance), log
    supervisor = Supervisor.from_config(config, setup.reference(), setup.urdf_dir)

    def step(
        k: int, sample: Sample, reading: SensorReading, variance: Vector,
    ) -> ControlOutput:
        result = supervisor.step(inputs_of(
            setup, k, sample, reading.wrench_sensor, variance, reading.health.fault))
        log.note(k * h, result.status)
        return result.output

    return step, log


def inputs_of(
    setup: Setup, k: int, sample: Sample, wrench: Vector, variance: Vector,
    sensor_fault: str = '',
) -> TickInputs:
    """Return what is known at tick k if all is well: its sample, and the R of the tick before."""
    h = setup.controller.period
    return TickInputs(
        time=k * h, joints=JointInput(k * h, sample.q, sample.qd, effort=sample.effort),
        wrench=WrenchInput(k * h, wrench),
        variance=VarianceInput((k - 1) * h, variance) if k else None, sensor_fault=sensor_fault)


def _wrench(setup: Setup, sample: Sample) -> Vector:
    return sample.wrench if setup.controller.wrench_input == 'raw' else sample.wrench_filtered


def _record(
    data: RunData, k: int, sample: Sample, output: ControlOutput, noise_variance: Vector,
) -> None:
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
    data.noise_variance[k] = noise_variance
    data.innovation[k] = output.innovation
    data.position[k] = output.pose.position_world
    data.quaternion[k] = output.pose.quaternion_xyzw
    data.position_des[k] = output.pose_des.position_world
    data.quaternion_des[k] = output.pose_des.quaternion_xyzw
