"""The linear force loops of an arm as it is configured, at its home."""

from __future__ import annotations

import math

from multicontact_control.arrays import Matrix
from multicontact_control.commissioning.law_report import closed_loop_matrix
from multicontact_control.config import ToolConfig
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel, RobotState
from multicontact_control.errors import ConfigError
from multicontact_control.force import margins
from multicontact_control.force.force_law import design_law, make_loop_model
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.laws.design import LoopModel
from multicontact_control.force.loop_family import ForceLoopModel
from multicontact_control.force.observer import ObserverDesign, solve_steady_gain
from multicontact_control.runs.scenario import Setup
import numpy as np

# Where boundaries are looked for, upwards.
RATIOS = tuple(np.geomspace(0.1, 100.0, 73).tolist())


class ArmLoop:
    """
    The linear force loops of a setup's arm at its plant's home, with its tool and surfaces.

    Its plant is the mobility N^T J M^-1 J^T N [1/kg] with springs and dampers at the contacts, and
    the mass that hangs beyond the sensor. Friction, limits and the motion are not in it.

    Raises
    ------
    ConfigError
        If the force law is another than the active observer.

    """

    def __init__(self, setup: Setup) -> None:
        config = setup.controller
        names = config.contact_names
        robot = RobotModel(config.robot, setup.urdf_dir)
        state = robot.update(np.array(setup.plant.home), np.zeros(robot.joint_count))
        N = normal_space(Controller(config, robot).contacts, state.pose.rotation_world)
        first = names[0]
        model = make_loop_model(config, config.contacts[first].stiffness)
        observer = design_law(config.force_law_of(first), config.force, model)
        if not isinstance(observer, ObserverDesign):
            raise ConfigError(
                'force.law', 'aob, for the linear loops', config.force.law
            )
        self.observer = observer
        self.config = config
        pushed = state.jacobian.T @ N
        self.mobility = pushed.T @ np.linalg.solve(state.mass_matrix, pushed)
        inertia = _tool_inertia(config.tool, state)
        self.tool_inertia = np.linalg.pinv(N) @ inertia @ N @ np.linalg.inv(N.T @ N)
        self.stiffness = np.array([config.contacts[name].stiffness for name in names])
        self.damping = np.array([setup.plant.surfaces[name].damping for name in names])
        # What the loop really has: of actuators and sensor's low-pass [s].
        self.delay = (
            setup.plant.actuator_delay_ticks * config.period
            + config.sensor.filter_delay(config.rate)
        )

    def model_of(self, contact: int) -> ForceLoopModel:
        """Return what is known exactly of the loop of one contact, for its certificate."""
        return ForceLoopModel(
            self.observer,
            self.config.period,
            self.config.force.damping_rate,
            self._find_fed_share(),
            float(self.damping[contact]),
        )

    def _find_fed_share(self) -> float:
        """Return the share of the desired force in what is fed forward, of the first contact."""
        force = self.config.force
        if force.fed_forward == 'desired':
            return 1.0
        if force.fed_forward == 'mixed':
            stiffest = 2.0 * self.stiffness[0] * self.mobility[0, 0]
            return float(min(force.damping_rate**2 / stiffest, 1.0))
        return 0.0

    def largest_stable_ratio(
        self, noise_variance: float, *, of_paper: bool = False
    ) -> float:
        """
        Return the largest stable ratio of true and modelled stiffness, 0 for none or infinity.

        With R held at `noise_variance` [N^2], on the arm, or on the plant of P04 eq. 32 if
        `of_paper`.
        """
        gain = solve_steady_gain(self.observer, noise_variance)
        law = make_steady_law(self.observer, gain)
        period = self.config.period
        K_2 = self.config.force.damping_rate
        model = LoopModel(float(self.stiffness[0]), K_2, self.delay, period)
        whole_delay = round(self.delay / period) * period

        def is_stable(ratio: float) -> bool:
            """Return whether all eigenvalues of the closed loop lie within the unit circle."""
            if of_paper:
                loop = closed_loop_matrix(law, model, ratio)
            else:
                arm = margins.LinearArmPlant(
                    self.mobility,
                    ratio * self.stiffness,
                    self.damping,
                    self.tool_inertia,
                    whole_delay,
                )
                loop = margins.closed_loop(
                    arm, law, K_2, period, fed_share=self._find_fed_share()
                )
            return margins.spectral_radius(loop) < 1.0

        low, high = margins.find_last_stable(is_stable, RATIOS, 1e-7)
        return math.sqrt(low * high)


def _tool_inertia(tool: ToolConfig, state: RobotState) -> Matrix:
    """Return the inertia of the tool, a point mass at its centre, about the point, (6, 6)."""
    sensor = state.sensor_pose
    centre = sensor.rotation_world @ np.array(tool.com_sensor) + sensor.position_world
    x, y, z = centre - state.pose.position_world
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return tool.mass * np.block([[np.eye(3), -cross], [cross, -cross @ cross]])
