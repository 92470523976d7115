"""
Errors of actuation: what acts on the joints differs from the torques that are commanded.

Drives of real arms scale and shift a torque, add noise, answer late and lose some of it to
friction. A torque loop inside the drives may correct a part of that.
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np
from sim_bridge.config import MAX_DELAY_SUBSTEPS, PlantConfig
from sim_bridge.drives import Drive


class Actuator(Record, Protocol):
    """One joint's errors of actuation, joint side, and where its torque is on the way."""

    scale: float  # a, drawn
    bias: float  # b, drawn [N m]
    noise_std: float  # [N m]
    coulomb_friction: float  # at high speed [N m]
    viscous_friction: float  # [N m s/rad]
    wanted: float  # torque that is commanded [N m]
    motor: float  # u, which the torque loop asks of the motor [N m]
    driven: float  # drive torque of the newest substep, before friction [N m]
    error: float  # e of the torque loop at its newest step [N m]
    error_sum: float  # of e over the steps of the torque loop [N m]

    # Drive torques from the one that acts to the newest, at the substep they belong to modulo
    # the delay and one [N m].
    pending: Annotated[Vector, 1 + MAX_DELAY_SUBSTEPS]


ACTUATOR = record_dtype(Actuator)


class ActuationModel(Record, Protocol):
    """What all joints have in common; one."""

    substep: int  # substeps taken since the start
    delay: int  # substeps from a drive torque to its action
    friction_speed_gain: float  # [s/rad]
    torque_loop: bool  # whether there is one
    loop_substeps: int  # substeps in a period of the torque loop
    loop_period: float  # [s]
    loop_proportional: float
    loop_integral: float  # for each step of the loop
    loop_derivative: float  # [s]


ACTUATION_MODEL = record_dtype(ActuationModel)


class ActuationErrors:
    """
    The errors of all joints from a commanded torque to the one that acts, substep by substep.

    Parameters
    ----------
    config
        The plant's, whose `actuation` says how large the errors are.

    Attributes
    ----------
    actuators
        Records of `ACTUATOR`, shape (n,).
    torque_sum
        For the plant to add up the torques that act in a control period, shape (n,) [N m].

    Raises
    ------
    ConfigError
        If the period of the torque loop is not a whole number of substeps.

    """

    def __init__(self, config: PlantConfig) -> None:
        actuation = config.actuation
        joint_count = len(config.home)
        self.torque_sum: Vector = np.zeros(joint_count)
        self._noise = np.zeros(joint_count)
        self.actuators: Records[Actuator] = np.zeros(joint_count, dtype=ACTUATOR)
        # The generator of numpy's global functions: published draws are repeated.
        generator = np.random.RandomState(actuation.seed)
        lower, upper = actuation.scale_range
        self.actuators['scale'] = generator.uniform(lower, upper, joint_count)
        lower, upper = actuation.bias_range
        self.actuators['bias'] = generator.uniform(lower, upper, joint_count)
        for name in ('noise_std', 'coulomb_friction', 'viscous_friction'):
            values = getattr(actuation, name)
            if values:  # one per joint, or one for all
                self.actuators[name] = values
        self._models: Records[ActuationModel] = np.zeros(1, dtype=ACTUATION_MODEL)
        model = self._models[0]
        model['delay'] = actuation.delay_substeps
        model['friction_speed_gain'] = actuation.friction_speed_gain
        model['torque_loop'] = actuation.torque_loop
        if actuation.torque_loop:
            rate = actuation.torque_loop_rate
            model['loop_substeps'] = config.substeps(rate, 'period of the torque loop')
            model['loop_period'] = 1.0 / rate
            model['loop_proportional'] = actuation.torque_loop_proportional
            model['loop_integral'] = actuation.torque_loop_integral
            model['loop_derivative'] = actuation.torque_loop_derivative

    def reset(self, torque: Vector, generator: np.random.Generator) -> None:
        """
        Start afresh with drives that give a torque without error until the first substep.

        The torque has shape (n,) [N m]; the generator draws the noise from now on.
        """
        self._generator = generator
        self._models['substep'] = 0
        for name in ('motor', 'driven'):
            self.actuators[name] = torque
        self.actuators['pending'] = torque[:, np.newaxis]
        for name in ('error', 'error_sum'):
            self.actuators[name] = 0.0

    def begin_period(self, wanted: Vector) -> None:
        """Take the torque commanded for a control period, shape (n,) [N m]."""
        self.actuators['wanted'] = wanted
        self.torque_sum[:] = 0.0

    def find_acting_torque(
        self, qd: Vector, drives: Records[Drive], torque: Vector
    ) -> None:
        """
        Fill `torque` with what acts in the next substep, shape (n,) [N m].

        The friction is that of the rotors' speeds in records of `DRIVE`, or with none of these
        of the links' speeds `qd`, shape (n,) [rad/s].
        """
        self._generator.standard_normal(out=self._noise)
        actuate_joints(qd, drives, self._noise, self._models, self.actuators, torque)


@compiled
def actuate_joints(
    qd: Vector,
    drives: Records[Drive],
    noise: Vector,
    models: Records[ActuationModel],
    actuators: Records[Actuator],
    torque: Vector,
) -> None:
    """
    Advance the actuation by one substep and find the torques that act on the joints.

    A drive makes a u + b + noise of the motor torque u. That acts after the delay, less the
    friction F tanh(c v) + d v. A torque loop has u = wanted - k_p e - k_i sum(e) - k_d de/dt,
    where e is the drive torque of the substep before, which a sensor between drive and friction
    measures, less the wanted torque.

    Parameters
    ----------
    qd
        Speeds v of the links at the start of the substep, shape (n,) [rad/s].
    drives
        Records of `DRIVE`, shape (n,), whose speeds count instead, or none.
    noise
        White noise of deviation 1, shape (n,).
    models
        One record of `ACTUATION_MODEL`; its substeps are counted.
    actuators
        Records of `ACTUATOR`, shape (n,), advanced.
    torque
        Filled with the torques that act, shape (n,) [N m].

    """
    model = models[0]
    newest = model.substep % (model.delay + 1)
    oldest = (model.substep + 1) % (model.delay + 1)
    for joint in range(actuators.shape[0]):
        actuator = actuators[joint]
        if not model.torque_loop:
            actuator.motor = actuator.wanted
        elif model.substep % model.loop_substeps == 0:
            error = actuator.driven - actuator.wanted
            error_rate = (error - actuator.error) / model.loop_period
            actuator.error = error
            actuator.error_sum += error
            actuator.motor = (
                actuator.wanted
                - model.loop_proportional * error
                - model.loop_integral * actuator.error_sum
                - model.loop_derivative * error_rate
            )
        actuator.pending[newest] = (
            actuator.scale * actuator.motor
            + actuator.bias
            + actuator.noise_std * noise[joint]
        )
        actuator.driven = actuator.pending[oldest]
        speed = qd[joint]
        if drives.shape[0] > 0:
            speed = drives[joint].qd
        smoothed_sign = np.tanh(model.friction_speed_gain * speed)
        torque[joint] = (
            actuator.driven
            - actuator.coulomb_friction * smoothed_sign
            - actuator.viscous_friction * speed
        )
    model.substep += 1
