"""The controller as it is commanded to an arm: no jump of the torque whatever begins or ends."""

from __future__ import annotations

from pathlib import Path

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import Controller, ControlOutput, Measurement
from multicontact_control.control.reference import ReferenceSource
from multicontact_control.dynamics.pose import Pose
from multicontact_control.supervision.safe_behaviour import SafeBehaviour
from multicontact_control.supervision.transition import TorqueTransition
import numpy as np

LAW = None  # to the blends all is one law: only what is asked for goes over


class BumplessController:
    """
    A controller whose torque starts where the arm is held and changes laws smoothly.

    Parameters
    ----------
    controller
        The control law.

    """

    def __init__(self, controller: Controller) -> None:
        config = controller.config
        self._controller = controller
        self._transition = TorqueTransition(config)
        self._safe = SafeBehaviour(config.safe_behaviour, controller.robot)
        self._limit = _torque_limit(config)
        self.reset()

    @classmethod
    def from_config(
        cls, config: ControllerConfig, reference: ReferenceSource, base_dir: Path,
    ) -> BumplessController:
        """
        Build a controller with the arm its configuration names.

        Raises
        ------
        ConfigError
            If the URDF cannot be read or does not match the names.

        """
        return cls(Controller.from_config(config, reference, base_dir))

    @property
    def config(self) -> ControllerConfig:
        """Return the configuration in force."""
        return self._controller.config

    @property
    def controller(self) -> Controller:
        """Return the control law."""
        return self._controller

    def reset(self) -> None:
        """Forget everything measured and commanded; the next sample starts anew."""
        self._controller.reset()
        self._transition.reset()
        self._safe_running = False

    def check(self, config: ControllerConfig) -> None:
        """
        Find out whether `reconfigure` would take a configuration.

        Raises
        ------
        ConfigError
            If not.

        """
        self._controller.redesign(config)

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with another configuration from the next sample on.

        Raises
        ------
        ConfigError
            If that cannot be done; everything is as it was then.

        """
        self._controller.reconfigure(config)
        self._transition.adopt(config)
        self._safe.config = config.safe_behaviour
        self._limit = _torque_limit(config)
        self.restart_from_last()

    def restart_from_last(self) -> None:
        """Let the next command be the last one again: what is asked for is about to jump."""
        self._transition.restart_from_last()

    def stand_still(self, pose: Pose) -> Pose:
        """Return the pose of a reference that leaves the arm at a pose: the same."""
        self.restart_from_last()
        return pose

    def go_on(self) -> None:
        """Go on with the reference after `stand_still`."""
        self.restart_from_last()

    def step(self, measurement: Measurement, noise_variance: Vector) -> ControlOutput:
        """
        Answer one sample; see `Controller.step`.

        The first command is the measured effort, or gravity compensation where there is none.
        """
        output = self._controller.step(measurement, noise_variance)
        if self._safe_running or not self._transition.begun:
            self._transition.begin(lambda: self._held(measurement))
        self._safe_running = False
        torque = self._transition.apply(LAW, output.torque)
        if torque is not output.torque:
            torque = np.clip(torque, -self._limit, self._limit)
            output = output._replace(torque=torque)
        self._transition.commanded(torque)
        return output

    def safe_step(self, measurement: Measurement) -> Vector:
        """
        Answer one sample by the declared safe behaviour, reached without a jump.

        The control law is forgotten: a later `step` starts it anew, from the torque that acts
        then.

        Returns
        -------
        Vector
            Joint torque, shape (n,) [N m].

        """
        if not self._safe_running:
            self._safe_running = True
            self._safe.start()
            self._controller.reset()
            self._transition.begin(lambda: self._held(measurement))
        torque: Vector = np.clip(
            self._transition.apply(LAW, self._safe.torque(measurement.q, measurement.qd)),
            -self._limit, self._limit)
        self._transition.commanded(torque)
        return torque

    def _held(self, measurement: Measurement) -> Vector:
        """Return the torque that acts before any command, shape (n,) [N m]."""
        effort = measurement.effort
        if effort is not None and np.isfinite(effort).all():
            return effort
        return self._controller.robot.update(
            measurement.q, np.zeros_like(measurement.qd)).gravity


def _torque_limit(config: ControllerConfig) -> Vector:
    return np.array(config.torque_limit) if config.torque_limit else np.full(
        len(config.robot.joint_names), np.inf)
