"""Where the arm comes from, what hangs on it, and its wrist sensor."""

from __future__ import annotations

from collections.abc import Iterator
import math

from multicontact_control.config.base import Config, parameter, Vector, Vector3
from multicontact_control.errors import ConfigError, format_count


class RobotConfig(Config):
    """
    The robot's model, and the names of its joints and frames.

    Joint vectors have the order of `joint_names`; the model is that of the URDF, with rotors.
    """

    urdf: str = parameter(
        ...,
        'URDF of the arm with its tool: a path, or a path relative to the parameter file '
        'that it stands in.',
    )
    joint_names: tuple[str, ...] = parameter(
        ..., 'Joints in the order of every joint vector.', min_length=1
    )
    locked_joints: tuple[str, ...] = parameter(
        (), 'Joints of the URDF that do not move, e.g. the fingers of a gripper.'
    )
    locked_positions: Vector = parameter(
        (), 'Position of each of them; empty for 0.', unit='rad or m'
    )
    armature: Vector = parameter(
        (), 'Rotor inertia seen at each joint; empty for none.', unit='kg m^2'
    )
    operational_frame: str = parameter(
        ..., 'URDF link that carries the operational point and its axes.'
    )
    sensor_frame: str = parameter(
        ...,
        'URDF link in whose frame the wrist sensor reads, carried by the same joint as '
        'operational_frame; empty for an arm without one.',
    )
    gravity_world: Vector3 = parameter((0.0, 0.0, -9.81), 'Gravity.', unit='m/s^2')
    adds_gravity: bool = parameter(
        False,
        'Whether the drives add the torque that holds the arm against gravity: commands '
        'and measured efforts are then without it.',
    )
    adds_tool_gravity: bool = parameter(
        True,
        "Whether that torque carries `tool`, too, as the arm's own controller knows of it.",
    )
    measures_torque: bool = parameter(
        True, 'Whether the effort in joint_states is a torque, and not a motor current.'
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        count = len(self.locked_joints)
        positions = len(self.locked_positions)
        if positions not in (0, count):
            yield ConfigError(
                'robot.locked_positions',
                format_count(count, 'values') + ', one per locked joint, or none',
                positions,
            )

    @property
    def locked(self) -> dict[str, float]:
        """Return the positions of the locked joints by name, 0 where none is given [rad or m]."""
        positions = self.locked_positions or (0.0,) * len(self.locked_joints)
        return dict(zip(self.locked_joints, positions))


class ToolConfig(Config):
    """
    The load of the wrist sensor, whose weight is subtracted from the readings.

    It hangs beyond the sensor; the URDF of the arm has it, too. `multicontact calibrate` finds it.
    """

    mass: float = parameter(
        0.0, 'Mass beyond the sensor.', unit='kg', live=True, ge=0.0
    )
    com_sensor: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Its centre, in the sensor frame.', unit='m', live=True
    )
    bias_sensor: Vector = parameter(
        (0.0,) * 6,
        'Reading without load, force first, subtracted from every reading.',
        unit='N, N m',
        live=True,
        min_length=6,
        max_length=6,
    )


class SensorFrontEndConfig(Config):
    """
    The wrist sensor: its low-pass, its noise, and what counts as a fault of it.

    The noise weighs a reading where friction is allowed for.
    """

    filter_order: int = parameter(
        0,
        'Order of the low-pass on the readings: 0 for none, 1, or 2 (Butterworth).',
        ge=0,
        le=2,
    )
    filter_cutoff: float = parameter(
        125.0,
        'Its cut-off; its delay is added to force.input_delay.',
        unit='Hz',
        gt=0.0,
    )
    full_scale: Vector = parameter(
        (),
        'Largest reading of each axis, force first, saturated from 99 % on; empty if unknown.',
        unit='N, N m',
    )
    force_noise_std: float = parameter(
        0.05,
        'Noise of a force axis: the weight of a reading with contacts.*.friction_std, and '
        'what contacts that lie close together are lost in.',
        unit='N',
        gt=0.0,
    )
    torque_noise_std: float = parameter(
        0.004, 'The same of a torque axis.', unit='N m', gt=0.0
    )
    frozen_ticks: int = parameter(
        3,
        'Identical readings in a row that mean a frozen sensor; 0 for a sensor that repeats '
        'itself: its steps are above its noise, or it is slower than the controller.',
        ge=0,
    )
    require_push_test: bool = parameter(
        True,
        'Whether force control stays disabled until a push test has proved sign, frame '
        'and scale of the sensor; false in a simulation.',
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        scales = list(self.full_scale)
        if len(scales) not in (0, 6) or min(scales, default=1.0) <= 0.0:
            yield ConfigError('sensor.full_scale', '6 values above 0, or none', scales)

    def filter_delay(self, rate: float) -> float:
        """
        Return the group delay of the low-pass at 0 Hz [s], for a rate f_s [Hz].

        With K = tan(pi f_c / f_s): 1 / (2 K) samples for order 1, 1 / (sqrt(2) K) for order 2.
        """
        if self.filter_order == 0:
            return 0.0
        samples = 1.0 / math.tan(math.pi * self.filter_cutoff / rate)
        if self.filter_order == 1:
            return samples / (2.0 * rate)
        return samples / (math.sqrt(2.0) * rate)

    def noise_share(self, rate: float) -> float:
        """
        Return the share of the deviation of white noise that the low-pass leaves, of f_s [Hz].

        With K = tan(pi f_c / f_s), the variance falls to K / (1 + K) by order 1, and to
        (K^4 + (K - K^3) / sqrt(2)) / (1 + K^4) by order 2.
        """
        if self.filter_order == 0:
            return 1.0
        K = math.tan(math.pi * self.filter_cutoff / rate)
        if self.filter_order == 1:
            return math.sqrt(K / (1.0 + K))
        return math.sqrt((K**4 + (K - K**3) / math.sqrt(2.0)) / (1.0 + K**4))
