"""The weight of the tool: found on a simulated arm, whose tool is known, as file and table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from multicontact_control.config import ToolConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.experiment.parameter_file import write_parameters
from multicontact_control.experiment.scenario import plant_source, resolve, Setup
from multicontact_control.experiment.weighing import REST_TIME, weigh
from multicontact_control.sensor.tool import Identification
import numpy as np
from rich.table import Table
from sim_bridge.drives import PositionHold
from sim_bridge.plant import Plant
from sim_bridge.robots import find_robot

TOOL_FILE = 'tool.yaml'
# What is met in simulation, where the truth is known.
MASS_TOLERANCE, COM_TOLERANCE, BIAS_TOLERANCE = 0.02, 3e-3, 0.1  # share, m, N
BIAS_RANGE = np.repeat([5.0, 0.2], 3)  # N, N m


@dataclass(frozen=True)
class Calibration:
    """The tool that was found, and the true one; None of a robot, where it is not known."""

    found: Identification
    truth: ToolConfig | None

    @property
    def errors(self) -> tuple[float, float, float] | None:
        """Relative error of the mass, distance of the coms [m], largest force bias error [N]."""
        found, truth = self.found, self.truth
        return None if truth is None else (
            abs(found.mass / truth.mass - 1.0),
            float(np.linalg.norm(found.com_sensor - np.array(truth.com_sensor))),
            float(np.abs(found.bias_sensor[:3] - np.array(truth.bias_sensor[:3])).max()))

    @property
    def good(self) -> bool:
        """Whether mass, centre of mass and force bias are within their tolerances, where known."""
        return self.errors is None or all(error <= limit for error, limit in zip(
            self.errors, (MASS_TOLERANCE, COM_TOLERANCE, BIAS_TOLERANCE)))


def sensor_setup(
    plant: str, seed: int, robot: str = '', **plant_overrides: object,
) -> Setup:
    """
    Resolve a plant in the first weighing pose of its robot, with a bias to be found.

    The bias is drawn from the seed, up to 5 N and 0.2 N m per axis, unless the plant's parameter
    file has one of its own.
    """
    # The scenario only carries the configuration; nothing of it is run.
    home = plant_source(plant, robot).robot.weighing_poses()[0]
    setup = resolve('quick', plant=plant, robot=robot, seed=seed,
                    plant_overrides={'home': home, **plant_overrides})
    sensor = setup.plant.sensor
    if not any(sensor.bias):
        bias = np.random.default_rng(seed).uniform(-1.0, 1.0, 6) * BIAS_RANGE
        sensor = sensor.model_copy(update={'bias': tuple(bias.tolist())})
    return replace(setup, plant=setup.plant.model_copy(update={'sensor': sensor}))


def calibrate(setup: Setup) -> Calibration:
    """
    Weigh the tool of a `sensor_setup`, whose drives hold the weighing poses of its robot.

    Raises CalibrationError if the readings do not tell.
    """
    from multicontact_control.experiment.compilation import ensure_compiled

    ensure_compiled()
    robot, controller = find_robot(setup.plant.robot), setup.controller
    ticks, samples = round(REST_TIME * controller.rate), []
    for number, pose in enumerate(robot.weighing_poses()):
        plant = Plant(setup.plant.model_copy(update={'home': tuple(pose)}),
                      rate=controller.rate, seed=setup.seed + number)
        hold, sample = PositionHold(plant.model), plant.reset()
        for k in range(ticks):
            sample = plant.step(hold.torque(sample.q, sample.qd))
            # A second from pose to pose, of which nothing is known.
            samples.append([number * (REST_TIME + 1.0) + k * controller.period,
                            *sample.q, *sample.wrench])
        plant.close()
    table = np.array(samples)
    found = weigh(RobotModel(controller.robot, setup.urdf_dir), controller.robot.gravity_world,
                  (table[:, 0], table[:, 1:-6]), (table[:, 0], table[:, -6:]))
    # The moving half of the sensor's face hangs on it, too.
    return Calibration(found, ToolConfig(
        mass=robot.arm.carried_mass, com_sensor=robot.arm.carried_com,
        bias_sensor=setup.plant.sensor.bias))


def write_tool(folder: Path, found: Identification) -> Path:
    """Write a tool as a parameter file to lay over the controller's, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / TOOL_FILE
    write_parameters(
        path, {'/**': {'tool': found.tool().model_dump(mode='json')}},
        f'# Identified from {found.poses} poses: residual {found.force_residual:.3g} N and '
        f'{found.torque_residual:.3g} N m rms, condition {found.condition:.3g}.\n'
        f'# Give it to the controller after its own parameter file.\n')
    return path


def calibration_table(calibration: Calibration, title: str) -> Table:
    """Return found and true values side by side, as far as there are true ones."""
    found, truth = calibration.found, calibration.truth
    table = Table(title=title)
    for name in ('', 'identified', *(('truth', 'error') if truth else ()), 'std. error'):
        table.add_column(name, justify='left' if name == '' else 'right')

    def rows(tool: ToolConfig) -> list[float]:
        return [tool.mass, *(1e3 * x for x in tool.com_sensor), *tool.bias_sensor]

    names = ['mass (kg)', *(f'centre of mass {axis} (mm)' for axis in 'xyz'),
             *(f'{what} bias {axis} ({unit})'
               for what, unit in (('force', 'N'), ('torque', 'N m')) for axis in 'xyz')]
    spread = [found.mass_std, *(1e3 * found.com_std)]
    for i, (name, value) in enumerate(zip(names, rows(found.tool()))):
        known = rows(truth)[i] if truth else 0.0
        table.add_row(name, f'{value:.4f}', *(
            (f'{known:.4f}', f'{value - known:+.4f}') if truth else ()),
            f'{spread[i]:.4f}' if i < len(spread) else '')
    return table
