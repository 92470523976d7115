"""The world of each episode: a setup whose parameters are drawn at random."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.learning.config import EnvironmentConfig
from multicontact_control.runs.overrides import lay_values_over
from multicontact_control.runs.scenario import resolve, Setup
import numpy as np
from sim_bridge.config import ActuationConfig

LARGEST_SEED = 10**9
UNBLENDED = 1e6  # N m/s, at which every change of a torque is over within a period
ACTUATION_SEED = 'plant.actuation.seed'


class Worlds:
    """
    Draws the worlds of an environment: the same generator draws the same ones.

    Parameters
    ----------
    config
        Of the environment.

    Attributes
    ----------
    mean
        The setup in which nothing is drawn.

    Raises
    ------
    ConfigError
        If a parameter or a value is not acceptable, also a bound of what is drawn.

    """

    def __init__(self, config: EnvironmentConfig) -> None:
        self._config = config
        self._settings = dict(config.settings)
        if 'stiffness' in config.actions:
            # Each change would blend anew, and the torque hardly follow the law any more. What
            # changes is limited by itself (`limiting`).
            self._settings.setdefault('controller.transition.blend_time', 0.0)
            self._settings.setdefault('controller.transition.torque_rate', UNBLENDED)
        self._arguments: dict[str, Any] = {
            'scenario': config.scenario,
            'robot': config.robot,
            'plant': config.plant,
            'preset': config.preset,
        }
        self._named: Setup = resolve(**self._arguments)
        self.mean = self._resolve(self._settings, 'settings.')
        self._drives_err = self.mean.plant.actuation != ActuationConfig()
        for place in (0, 1):  # a bound that no world can have is found now
            bounds = {name: both[place] for name, both in config.randomise.items()}
            bound = self._resolve({**self._settings, **bounds}, 'randomise.')
            if bound.plant.actuation != ActuationConfig():
                self._drives_err = True

    def _resolve(self, values: dict[str, Any], field: str, seed: int = 0) -> Setup:
        arguments = {**self._arguments, 'seed': seed}
        return lay_values_over(resolve, arguments, values, self._named, field)

    def draw(self, random: np.random.Generator) -> tuple[Setup, dict[str, Any]]:
        """
        Return the setup of the next episode, and the values that were drawn, by dotted name.

        Also drawn are the seeds of noise, roughness and errors of the drives.
        """
        seed, actuation_seed = random.integers(LARGEST_SEED, size=2).tolist()
        drawn: dict[str, Any] = {}
        if self._drives_err:
            drawn[ACTUATION_SEED] = actuation_seed
        for name, (lower, upper) in self._config.randomise.items():
            drawn[name] = np.asarray(random.uniform(lower, upper)).tolist()
        if self._config.tilt:
            for name in self.mean.plant.touched:
                normal = np.array(self.mean.plant.surfaces[name].normal_world)
                tilted = tilt_normal(normal, self._config.tilt, random)
                drawn[f'plant.surfaces.{name}.normal_world'] = tilted.tolist()
        setup = self._resolve({**self._settings, **drawn}, 'randomise.', seed)
        return setup, drawn


def tilt_normal(
    normal: Vector, largest_angle: float, random: np.random.Generator
) -> Vector:
    """Return a unit normal, shape (3,), turned by a random angle about a random axis across it."""
    angle = random.uniform(0.0, largest_angle)
    direction = random.standard_normal(3)
    across = direction - normal * (normal @ direction)
    across /= np.linalg.norm(across)
    tilted: Vector = np.cos(angle) * normal + np.sin(angle) * across
    return tilted
