"""The controller as it is commanded to an arm: no jump of the torque whatever begins or ends."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import Controller
from multicontact_control.control.reference import ReferenceSource
from multicontact_control.control.reference.holdable import HeldSource
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CommandError
from multicontact_control.supervision.fallback import SafeBehaviour
from multicontact_control.supervision.inputs import (
    Inputs,
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
from multicontact_control.supervision.status import no_answer, TickOutput
from multicontact_control.supervision.transition import TorqueTransition
import numpy as np

ControllerT = TypeVar('ControllerT', bound='BumplessController')

LAW = None  # to the blends all is one law: only what is asked for goes over


class OwnWeight:
    """
    The gravity torque that an arm adds itself: what acts is the command and this.

    The control law, the reactions and the gate reckon with the torque that acts. It is taken off
    a torque that leaves for the arm, and put on a measured effort that comes in. Before the joints
    are known it is 0: an arm that carries itself needs nothing then.

    Parameters
    ----------
    config
        Whether `tool` is in it.
    robot
        The arm.

    Attributes
    ----------
    torque
        Where the arm was seen last, shape (n,) [N m].

    """

    def __init__(self, config: ControllerConfig, robot: RobotModel) -> None:
        self._robot, self._tool = robot, config.tool
        self._with_tool = config.robot.adds_tool_gravity
        self.reset()

    def reset(self) -> None:
        """Forget where the arm was."""
        self.torque: Vector = np.zeros(self._robot.joint_count)

    def update(self) -> Vector:
        """Work it out where the robot's model was computed last; return its change, shape (n,)."""
        torque = self._robot.terms.gravity.copy()
        if not self._with_tool:
            torque -= self._robot.load_torque(self._tool.mass, np.array(self._tool.com_sensor))
        change: Vector = torque - self.torque
        self.torque = torque
        return change


class BumplessController:
    """
    A controller whose torque starts where the arm is held and changes laws smoothly.

    The first command is the measured effort, or gravity compensation where there is none (or only
    zeros, which robots report that do not measure any); from there, and from one configuration
    to the next, the torque goes over as `transition` says.

    Parameters
    ----------
    config
        Everything tunable.
    robot
        The arm.
    reference
        What to do.

    Attributes
    ----------
    config
        The configuration in force.
    controller
        The control law.
    inputs
        What comes in.
    own_weight
        What the drives add to a command, None if nothing; it is in every torque here.

    """

    def __init__(
        self, config: ControllerConfig, robot: RobotModel, reference: ReferenceSource,
    ) -> None:
        self.controller = Controller(config, robot, reference)
        self.inputs = Inputs(config, self.controller.measured)
        self._transition = TorqueTransition(config)
        self.own_weight = OwnWeight(config, robot) if config.robot.adds_gravity else None
        self._safe = SafeBehaviour(config.safe_behaviour, robot)
        self._safe_running = False
        self._idle = no_answer(robot.joint_count, len(config.columns))
        self._initial_variance = np.full(
            len(config.columns), config.initial_noise_variance)
        self._adopt(config)

    @classmethod
    def from_config(
        cls: type[ControllerT], config: ControllerConfig, reference: HeldSource, base_dir: Path,
    ) -> ControllerT:
        """
        Build a controller with the arm its configuration names.

        Raises
        ------
        ConfigError
            If the URDF cannot be read or does not match the names.

        """
        return cls(config, RobotModel(config.robot, base_dir), reference)

    def _adopt(self, config: ControllerConfig) -> None:
        """Set what follows from the values that may change while the arm is controlled."""
        self.config = config
        self._transition.adopt(config)
        self._safe.kind = config.safe_behaviour
        self._limit = np.broadcast_to(
            config.torque_limit or np.inf, (self.controller.robot.joint_count,))

    def reset(self) -> None:
        """Forget everything measured and commanded; the next sample starts anew."""
        if self.own_weight is not None:
            self.own_weight.reset()
            self.controller.arm.joints['added'] = 0.0
        self.controller.reset()
        self.inputs.reset()
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
        self.controller.redesign(config)

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with another configuration from the next sample on.

        Raises
        ------
        ConfigError
            If that cannot be done; everything is as it was then.

        """
        self.check(config)
        self.controller.reconfigure(config)
        self._adopt(config)
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

    def step(self, inputs: TickInputs) -> TickOutput:
        """
        Answer one tick.

        Parameters
        ----------
        inputs
            Joints and wrench of one sample, and the newest R if there is one.

        Raises
        ------
        MulticontactError
            If a reading is missing, or the control law has no torque for this posture.

        """
        joints, _, variance = require_complete(inputs)
        law = self.controller
        self.inputs.validate(inputs)
        law.see(joints.q, joints.qd, self.inputs.filtered)
        self._carry()
        output = law.answer(
            inputs.time, self._initial_variance if variance is None else variance.variance)
        if self._safe_running or not self._transition.begun:
            self._transition.begin(lambda: self._held(joints.effort, joints.q))
        self._safe_running = False
        torque = self._transition.apply(LAW, output.torque)
        if torque is not output.torque or self.own_weight is not None:
            torque = self._limited(torque)
            output = output._replace(torque=torque)
        self._transition.commanded(torque)
        return TickOutput(output, None)

    def safe_step(self, inputs: TickInputs) -> TickOutput:
        """
        Answer one tick by the declared safe behaviour, reached without a jump; see `step`.

        The control law is forgotten: a later `step` starts it anew, from the torque that acts
        then.
        """
        joints, _, _ = require_complete(inputs)
        self.inputs.validate(inputs)
        if self.own_weight is not None:
            self.controller.arm.update(joints.q, joints.qd)
            self._carry()
        if not self._safe_running:
            self._safe_running = True
            self._safe.start()
            self.controller.reset()
            self._transition.begin(lambda: self._held(joints.effort, joints.q))
        torque = self._limited(
            self._transition.apply(LAW, self._safe.torque(joints.q, joints.qd, self._added)))
        self._transition.commanded(torque)
        return TickOutput(self._idle._replace(torque=torque), None)

    def _carry(self) -> Vector | None:
        """Take note of what the drives add where the arm is seen now; return the change of it."""
        if self.own_weight is None:
            return None
        change = self.own_weight.update()
        self.controller.arm.joints['added'] = self.own_weight.torque
        self._transition.allow_for(change)
        return change

    @property
    def _added(self) -> Vector | float:
        return 0.0 if self.own_weight is None else self.own_weight.torque

    def _limited(self, torque: Vector) -> Vector:
        added = self._added
        limited: Vector = np.clip(torque, added - self._limit, added + self._limit)
        return limited

    def _held(self, effort: Vector | None, q: Vector | None) -> Vector:
        """Return the torque that acts before any command, shape (n,) [N m]."""
        if effort is not None and np.isfinite(effort).all() and effort.any():
            return effort if self.own_weight is None else effort + self.own_weight.torque
        if q is None:
            return np.zeros_like(self._limit)
        return self.controller.robot.update(q, np.zeros_like(q)).gravity


def require_complete(
    inputs: TickInputs,
) -> tuple[JointInput, WrenchInput, VarianceInput | None]:
    """
    Return the readings of a tick.

    Raises
    ------
    CommandError
        If there is no joint state or no wrench.

    """
    if inputs.joints is None or inputs.wrench is None:
        raise not_supervised()
    return inputs.joints, inputs.wrench, inputs.variance


def not_supervised() -> CommandError:
    """Return the error of a tick that only a supervisor can answer."""
    return CommandError('supervised', 'true, to go on without a sample', 'false')
