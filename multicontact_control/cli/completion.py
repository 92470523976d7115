"""
What a shell completes on the command line: names of config/, and what parameters may be.

A shell waits for it at every press of the key, so nothing heavy is loaded: no numerics, no ROS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, get_args

from multicontact_control.paths import config_dir
import typer

Names = Callable[[typer.Context], Iterable[str]]
Completer = Callable[[typer.Context, str], list[str]]


def one_of(names: Names) -> Completer:
    """Return what completes one of some names."""
    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        return [name for name in names(ctx) if name.startswith(incomplete)]

    return complete


def some_of(names: Names) -> Completer:
    """Return what completes the last of some names with commas between."""
    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(',')
        return [f'{before}{comma}{name}' for name in names(ctx) if name.startswith(last)]

    return complete


def files_in(folder: str) -> Names:
    """Return the names of the YAML files in a folder of config/, and of the folders in it."""
    def names(_: typer.Context) -> Iterator[str]:
        there = config_dir() / folder
        return (path.relative_to(there).with_suffix('').as_posix()
                for path in sorted(there.rglob('*.yaml')))

    return names


scenarios, presets, robots = files_in('scenarios'), files_in('presets'), files_in('robots')
studies = files_in('studies')


def plants(ctx: typer.Context) -> Iterator[str]:
    """Yield the plants of --robot; of all robots, alone and as ROBOT/PLANT, without it."""
    chosen = ctx.params.get('robot')
    found = {name: _plants_of(name) for name in robots(ctx) if chosen in (None, '', name)}
    yield from dict.fromkeys(plant for known in found.values() for plant in known)
    if not chosen:
        yield from (f'{name}/{plant}' for name, known in found.items() for plant in known)


def _plants_of(robot: str) -> list[str]:
    from multicontact_control.config import read_yaml

    values = read_yaml(config_dir() / 'robots' / f'{robot}.yaml')
    return [*values.get('plants', ()), *values.get('plant_aliases', ())]


def engines(_: typer.Context) -> tuple[str, ...]:
    """Return what may simulate a plant."""
    from sim_bridge.config import PlantConfig

    return _choices(PlantConfig, 'engine')


def native_engines(ctx: typer.Context) -> tuple[str, ...]:
    """Return the engines, and those with contacts of their own."""
    return (*engines(ctx), 'mujoco-native')


def laws(_: typer.Context) -> tuple[str, ...]:
    """Return the force laws."""
    from multicontact_control.config.force import LawName

    return get_args(LawName)


def estimators(_: typer.Context) -> tuple[str, ...]:
    """Return the estimators of the noise."""
    from multicontact_control.config import NoiseEstimatorConfig

    return _choices(NoiseEstimatorConfig, 'estimator')


def sensor_faults(_: typer.Context) -> tuple[str, ...]:
    """Return what may be wrong with the sensor in a push test."""
    from multicontact_control.sensor.push_config import SENSOR_FAULTS

    return SENSOR_FAULTS


def _choices(config: Any, field: str) -> tuple[str, ...]:
    return get_args(config.model_fields[field].annotation)
