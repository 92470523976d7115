"""Weighing the tool in simulation, where the truth is known; what was found, as file and table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from multicontact_control.arrays import Vector as Array
from multicontact_control.config import (
    Config,
    parameter,
    Real,
    ToolConfig,
    Vector,
)
from multicontact_control.errors import CalibrationError
from multicontact_control.experiment.parameter_file import write_parameters
from multicontact_control.experiment.scenario import plant_source, resolve, Setup
from multicontact_control.sensor.tool import (
    Identification,
    IdentificationConfig,
    identify_tool,
    PoseReading,
)
import numpy as np
from rich.table import Table
from sim_bridge.robots import DEFAULT, find_robot

if TYPE_CHECKING:
    from multicontact_control.experiment.position_controlled_plant import ServoedPlant

TOOL_FILE = 'tool.yaml'
# What has to be met in simulation, where the truth is known.
MASS_TOLERANCE, COM_TOLERANCE, BIAS_TOLERANCE = 0.02, 3e-3, 0.1  # share, m, N
BIAS_RANGE = np.repeat([5.0, 0.2], 3)  # N, N m


class CalibrationConfig(Config):
    """The poses in which a simulated arm weighs its tool."""

    poses: tuple[Vector, ...] = parameter(
        ..., 'Joint angles of each pose; the arm starts in the first.', unit='rad', min_length=1)
    move_time: Real = parameter(1.5, 'Time from pose to pose.', unit='s', gt=0.0)
    settle_time: Real = parameter(0.5, 'Rest before the readings.', unit='s', ge=0.0)
    average_time: Real = parameter(0.5, 'Time over which readings are averaged.', unit='s', gt=0.0)
    identification: IdentificationConfig = IdentificationConfig()


@dataclass(frozen=True)
class Calibration:
    """What a weighing found, and what there was to find; nobody knows that of a robot."""

    found: Identification
    truth: ToolConfig | None

    @property
    def errors(self) -> tuple[float, float, float]:
        """Relative error of the mass, distance of the coms [m], largest force bias error [N]."""
        found, truth = self.found, self.truth
        if truth is None:
            raise CalibrationError('errors: expected a tool that is known, found that of a robot')
        bias = found.bias_sensor[:3] - np.array(truth.bias_sensor[:3])
        return (abs(found.mass / truth.mass - 1.0),
                float(np.linalg.norm(found.com_sensor - np.array(truth.com_sensor))),
                float(np.max(np.abs(bias))))

    @property
    def good(self) -> bool:
        """Whether mass, centre of mass and force bias are within their tolerances."""
        return all(error <= limit for error, limit in zip(
            self.errors, (MASS_TOLERANCE, COM_TOLERANCE, BIAS_TOLERANCE)))


def calibration_config(robot: str = '') -> CalibrationConfig:
    """Return the poses of a robot, the default one if none is named."""
    chosen = find_robot(robot or DEFAULT)
    return CalibrationConfig(poses=chosen.weighing_poses())


def sensor_setup(
    plant: str, seed: int, robot: str = '', **plant_overrides: object,
) -> Setup:
    """
    Resolve a run of the sensor's front end: a plant in the first pose, with a bias to be found.

    The bias is drawn from the seed, up to 5 N and 0.2 N m per axis, unless the plant's parameter
    file has one of its own.
    """
    # The scenario only carries the configuration; nothing of it is run.
    source = plant_source(plant, robot)
    setup = resolve('quick', plant=plant, robot=robot, seed=seed, plant_overrides={
        'home': calibration_config(source.robot.name).poses[0], **plant_overrides})
    sensor = setup.plant.sensor
    if not any(sensor.bias):
        bias = np.random.default_rng(seed).uniform(-1.0, 1.0, 6) * BIAS_RANGE
        sensor = sensor.model_copy(update={'bias': tuple(bias.tolist())})
    return replace(setup, plant=setup.plant.model_copy(update={'sensor': sensor}))


def calibrate(setup: Setup, config: CalibrationConfig) -> Calibration:
    """Weigh the tool of a `sensor_setup`; CalibrationError if the readings do not tell."""
    # Only now: the simulator is not loaded for the sake of an error.
    from multicontact_control.experiment.compilation import ensure_compiled
    from multicontact_control.experiment.position_controlled_plant import ServoedPlant

    ensure_compiled()
    arm = ServoedPlant(setup)
    try:
        readings = [_reading(arm, np.array(pose), config) for pose in config.poses]
    finally:
        arm.close()
    gravity = np.array(setup.controller.robot.gravity_world)
    return Calibration(
        identify_tool(readings, gravity, config.identification), true_tool(setup))


def _reading(arm: ServoedPlant, pose: Array, config: CalibrationConfig) -> PoseReading:
    arm.move(pose, config.move_time)
    arm.hold(config.settle_time)
    samples = arm.hold(config.average_time)
    return PoseReading(
        rotation_world=samples[-1][1].sensor_pose.rotation_world,
        wrench_sensor=np.mean([sample.wrench for sample, _ in samples], axis=0))


def true_tool(setup: Setup) -> ToolConfig:
    """Return what really hangs on the simulated sensor, the moving half of its face included."""
    arm = find_robot(setup.plant.robot).arm
    return ToolConfig(mass=arm.carried_mass, com_sensor=arm.carried_com,
                      bias_sensor=setup.plant.sensor.bias)


def write_tool(folder: Path, calibration: Calibration) -> Path:
    """Write what was found as a parameter file to lay over the controller's, and return it."""
    found = calibration.found
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
    known = truth or found.tool()
    table = Table(title=title)
    names = ('truth', 'error') if truth is not None else ()
    for name in ('', 'identified', *names, 'std. error'):
        table.add_column(name, justify='left' if name == '' else 'right')

    rows = [
        ('mass (kg)', found.mass, known.mass, 5, found.mass_std),
        *((f'centre of mass {axis} (mm)', 1e3 * found.com_sensor[i], 1e3 * known.com_sensor[i],
           3, 1e3 * found.com_std[i]) for i, axis in enumerate('xyz')),
        *((f'{what} bias {axis} ({unit})', found.bias_sensor[start + i],
           known.bias_sensor[start + i], digits, None)
          for what, unit, start, digits in (('force', 'N', 0, 4), ('torque', 'N m', 3, 5))
          for i, axis in enumerate('xyz'))]
    for name, value, true, digits, std in rows:
        compared = (f'{true:.{digits}f}', f'{value - true:+.{digits}f}') if names else ()
        table.add_row(name, f'{value:.{digits}f}', *compared,
                      '' if std is None else f'{std:.{digits}f}')
    return table
