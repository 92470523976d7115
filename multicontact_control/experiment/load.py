"""Reading a run's folder back: its configuration, its series, its summary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from multicontact_control.config import (
    ControllerConfig,
    NoiseEstimatorConfig,
    read_parameters,
    read_yaml,
    validate,
)
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.bag import read_bag
from multicontact_control.experiment.recording import RunData, SERIES_FILE
from multicontact_control.experiment.results import CONFIG_FOLDER, read_json, SUMMARY_FILE
from multicontact_control.experiment.scenario import ScenarioConfig, Setup
from multicontact_control.experiment.summary import summarise_again
from sim_bridge.config import PlantConfig

BAG_FOLDER = 'bag'


@dataclass(frozen=True)
class LoadedRun:
    """
    A run read back.

    Attributes
    ----------
    folder
        Where it is.
    setup, data, summary
        Configuration, series, and the content of ``summary.json``.

    """

    folder: Path
    setup: Setup
    data: RunData
    summary: dict[str, Any]


def load_setup(folder: Path) -> Setup:
    """
    Rebuild what a run was made with.

    Parameters
    ----------
    folder
        Of `multicontact run` or `simulate`.

    Raises
    ------
    ConfigError
        If a file is missing or not acceptable.

    """
    if not (folder / CONFIG_FOLDER).is_dir():
        raise ConfigError('run', 'a folder of `multicontact run` or `simulate`', folder)
    config = folder / CONFIG_FOLDER
    summary = read_json(folder / SUMMARY_FILE)
    try:
        plant, seed = str(summary['plant']), int(summary['seed'])
    except (KeyError, TypeError, ValueError):
        raise ConfigError(str(folder / SUMMARY_FILE), 'the summary of a run',
                          'no plant and seed') from None

    def parameters(name: str) -> dict[str, Any]:
        return read_parameters(config / name)

    path = config / 'scenario.yaml'
    return Setup(
        scenario=validate(ScenarioConfig, read_yaml(path), str(path)),
        controller=validate(
            ControllerConfig, parameters('controller.yaml'), str(config / 'controller.yaml')),
        noise_estimator=validate(
            NoiseEstimatorConfig, parameters('noise_estimator.yaml'),
            str(config / 'noise_estimator.yaml')),
        plant=validate(PlantConfig, parameters('plant.yaml'), str(config / 'plant.yaml')),
        plant_name=plant, seed=seed, urdf_dir=config)


def load_run(folder: Path) -> LoadedRun:
    """
    Read a run, from its bag if it has one, from ``samples.npz`` otherwise.

    Parameters
    ----------
    folder
        Of `multicontact run` or `simulate`.

    Raises
    ------
    ConfigError
        If it is not such a folder.
    RunError
        If the recording cannot be read.

    """
    setup = load_setup(folder)
    if (folder / BAG_FOLDER).is_dir():
        data = read_bag(
            folder / BAG_FOLDER, rate=setup.controller.rate,
            contact_names=setup.controller.contact_names,
            joint_names=setup.controller.robot.joint_names).data
    elif (folder / SERIES_FILE).is_file():
        data = RunData.load(folder)
    else:
        raise RunError(f'{folder}: expected {BAG_FOLDER}/ or {SERIES_FILE}, found neither')
    # By today's definitions: the summary may be of older code, and a verdict is to be trusted.
    summary = summarise_again(data, setup, read_json(folder / SUMMARY_FILE))
    return LoadedRun(folder, setup, data, summary)
