"""The controller between activation and deactivation: samples and commands in, torques out."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.bumpless import BumplessController
from multicontact_control.control.command_limits import CommandLimits
from multicontact_control.control.controller import ControlOutput, Measurement
from multicontact_control.control.holdable_reference import HoldableReference
from multicontact_control.control.reference import CommandedReference, ReferenceSource
from multicontact_control.control.sensor.front_end import SensorFrontEnd
from multicontact_control.control.sensor.tare import tare_bias, TareConfig
from multicontact_control.errors import CommandError
from multicontact_control.nodes.messages import MotionReading
from multicontact_control.nodes.pairing import PairedSample
import numpy as np

TARE_READINGS = 100


class ControlSession:
    """
    One controller and all that it remembers of its samples.

    Parameters
    ----------
    config
        The controller's.
    scenario
        What to do; None to obey commands.
    limits
        Of those commands.
    base_dir
        Folder that relative paths start from.

    Attributes
    ----------
    output
        The answer to the newest sample, None before the first.
    first_stamp, last_stamp
        Of the first and the newest sample [ns], -1 before the first.
    variance, variance_stamp
        R [N^2] and its stamp [ns], -1 before the first.
    tick
        Number of the newest sample.
    skipped
        Samples that never came, or were overtaken.

    """

    def __init__(
        self, config: ControllerConfig, scenario: ReferenceSource | None,
        limits: CommandLimits, base_dir: Path,
    ) -> None:
        self.limits = limits
        self._commanded = CommandedReference(config.contact_names) if scenario is None else None
        self._reference = HoldableReference(scenario or self._commanded)  # type: ignore[arg-type]
        self.controller = BumplessController.from_config(config, self._reference, base_dir)
        self._front_end = SensorFrontEnd(config.sensor, config.rate)
        self.restart()

    @property
    def config(self) -> ControllerConfig:
        """Return the configuration in force."""
        return self.controller.config

    @property
    def held(self) -> bool:
        """Whether pose and forces are held."""
        return self._reference.held

    def restart(self) -> None:
        """Forget the past: the next sample is the first."""
        self.controller.reset()
        self._front_end.reset()
        self.output: ControlOutput | None = None
        self.first_stamp = self.last_stamp = self.variance_stamp = -1
        self.skipped = 0
        self.tick = 0
        self._newest: Measurement | None = None
        self._readings: deque[Vector] = deque(maxlen=TARE_READINGS)
        self.variance: Vector = np.full(
            len(self.config.contact_names), self.config.initial_noise_variance)

    def step(self, sample: PairedSample) -> ControlOutput:
        """
        Answer a sample.

        Raises
        ------
        MulticontactError
            If that is not possible in this posture; the sample counts as seen.

        """
        measurement = self._take(sample)
        self.output = self.controller.step(measurement, self.variance)
        return self.output

    def safe_step(self, sample: PairedSample) -> Vector:
        """Answer a sample by the declared safe behaviour; return the torque [N m]."""
        self.output = None
        return self.controller.safe_step(self._take(sample))

    def _take(self, sample: PairedSample) -> Measurement:
        if self.first_stamp < 0:
            self.first_stamp = sample.stamp
        tick = round((sample.stamp - self.first_stamp) * 1e-9 * self.config.rate)
        self.skipped += max(0, tick - self.tick - 1)
        self.tick, self.last_stamp = tick, sample.stamp
        self._readings.append(sample.wrench_sensor)
        wrench = self._front_end.update(sample.wrench_sensor).wrench_sensor
        self._newest = Measurement(
            tick * self.config.period, sample.q, sample.qd, wrench, sample.effort)
        return self._newest

    def set_forces(self, forces: dict[str, float]) -> None:
        """
        Obey commanded forces.

        Raises
        ------
        CommandError
            If they are out of limits or nothing can be commanded now.

        """
        reference = self._commandable()
        self.limits.check_forces(forces)
        reference.set_forces(forces)

    def set_motion(self, motion: MotionReading) -> None:
        """
        Obey a commanded motion.

        Raises
        ------
        CommandError
            If it is out of limits or nothing can be commanded now.

        """
        reference = self._commandable()
        self.limits.check_position(motion.position_world)
        reference.set_motion(motion.position_world, motion.quaternion_xyzw, motion.twist_world,
                             motion.acceleration_world)

    def _commandable(self) -> CommandedReference:
        if self._commanded is None:
            raise CommandError('reference_file', 'none, to obey commands', 'a scenario')
        self._running()
        if self.held:
            raise CommandError('~/hold', 'released, to obey commands', 'held')
        return self._commanded

    def _running(self) -> ControlOutput:
        if self.output is None:
            raise CommandError('controller', 'active, with samples coming', 'not so')
        return self.output

    def hold(self, wanted: bool) -> None:
        """
        Hold the present pose and the desired forces, or go on.

        Raises
        ------
        CommandError
            If nothing is controlled now.

        """
        output = self._running()
        if wanted:
            self._reference.hold(output.pose)
        else:
            self._reference.release()
        self.controller.smooth()

    def tare(self, config: TareConfig) -> Vector:
        """
        Return the sensor's bias, by which the compensated wrench would read zero now.

        Returns
        -------
        Vector
            Sensor axes, force first, shape (6,) [N, N m].

        Raises
        ------
        CommandError
            If forces are being controlled: what presses would be taken for bias.
        CalibrationError
            If there are too few readings, or they are restless.

        """
        if self.output is not None and self.output.active.any():
            raise CommandError('contacts', 'none under force control for a tare', 'some')
        newest = self._newest
        readings = np.array(self._readings).reshape(-1, 6)
        if newest is None:
            raise CommandError('samples', 'some, for a tare', 'none')
        model = self.config
        pose = self.controller.controller.robot.update(newest.q, newest.qd).sensor_pose
        return tare_bias(readings, pose.rotation_world, model.tool,
                         np.array(model.robot.gravity_world), config)
