"""The simulated arm under a gravity-compensated joint servo: it goes where told and stays."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.control.tasks import quintic
from multicontact_control.dynamics.robot import RobotModel, RobotState
from multicontact_control.experiment.scenario import Setup
import numpy as np
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.plant import Plant, Sample

NATURAL_FREQUENCY = 30.0  # rad/s, as the controller's motion loop


class ServoedPlant:
    """
    Plant, actuator delay and servo: tau = M (qdd_des + 2 w e' + w^2 e) + c + g.

    `sample` is the last sample, `state` what the model makes of it.
    """

    def __init__(self, setup: Setup) -> None:
        self._robot = RobotModel(setup.controller.robot, setup.urdf_dir)
        self._plant = Plant(setup.plant, rate=setup.controller.rate, seed=setup.seed)
        self._delay = ActuatorDelay(setup.plant.actuator_delay_ticks, self._plant.initial_torque)
        self._period = setup.controller.period
        self._tick = 0
        self._take(self._plant.reset())
        self._q_des = self.sample.q.copy()

    def hold(self, duration: float) -> list[tuple[Sample, RobotState]]:
        """Stay for a time [s], and return every sample with its state."""
        return [self._advance(self._q_des, np.zeros_like(self._q_des))
                for _ in range(round(duration / self._period))]

    def move(self, q_des: Vector, duration: float) -> None:
        """Go to joint angles [rad] within a time [s], along a quintic."""
        start, way = self._q_des, q_des - self._q_des
        ticks = max(1, round(duration / self._period))
        for i in range(1, ticks + 1):
            place, speed, _ = quintic(i / ticks * duration, duration)
            self._advance(start + place * way, speed * way)
        self._q_des = q_des.copy()

    def close(self) -> None:
        """Give the simulator's memory back."""
        self._plant.close()

    def _advance(self, q_des: Vector, qd_des: Vector) -> tuple[Sample, RobotState]:
        w, state = NATURAL_FREQUENCY, self.state
        acceleration = (2.0 * w * (qd_des - self.sample.qd) + w * w * (q_des - self.sample.q))
        torque = state.mass_matrix @ acceleration + state.coriolis + state.gravity
        self._delay.command(self._tick, torque)
        self._take(self._plant.step(self._delay.torque_for(self._tick)))
        self._tick += 1
        return self.sample, self.state

    def _take(self, sample: Sample) -> None:
        self.sample: Sample = sample
        self.state: RobotState = self._robot.update(sample.q, sample.qd)
