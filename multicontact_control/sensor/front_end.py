"""The one way of a reading from the sensor into the loop: watched, then low-passed."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Vector
from multicontact_control.config import SensorFrontEndConfig
from multicontact_control.sensor.low_pass import LowPass
from multicontact_control.sensor.monitor import SensorHealth, SensorMonitor


@dataclass(frozen=True, slots=True)
class SensorReading:
    """
    One reading, ready for the controller.

    Attributes
    ----------
    wrench_sensor
        Low-passed, bias and weight still in it, sensor axes, shape (6,) [N, N m].
    health
        Of the raw reading.

    """

    wrench_sensor: Vector
    health: SensorHealth


class SensorFrontEnd:
    """
    Watch and filter the readings of a wrist sensor.

    Parameters
    ----------
    config
        What to do.
    rate
        Rate of the readings [Hz].

    Raises
    ------
    ConfigError
        If the low-pass does not fit the rate.

    """

    def __init__(self, config: SensorFrontEndConfig, rate: float) -> None:
        self._monitor = SensorMonitor(config)
        self._low_pass = LowPass(config, rate)

    def reset(self) -> None:
        """Forget the readings so far."""
        self._monitor.reset()
        self._low_pass.reset()

    def update(self, wrench_sensor: Vector) -> SensorReading:
        """
        Take the next raw reading.

        Parameters
        ----------
        wrench_sensor
            Shape (6,) [N, N m].

        Raises
        ------
        ShapeError
            If it is not of that shape.

        """
        health = self._monitor.update(wrench_sensor)
        return SensorReading(self._low_pass.update(wrench_sensor), health)
