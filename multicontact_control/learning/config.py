"""What can be chosen of an environment and of its episodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

from multicontact_control.config import Config, parameter
from multicontact_control.errors import ConfigError
from multicontact_control.learning.rewards import REWARDS
from multicontact_control.supervision.command_limits import CommandLimits

ActionName = Literal['force', 'motion', 'stiffness']
# Hz, at which a twist still lasts a step.
SLOWEST_RATE = 1.0 / CommandLimits().motion_timeout


class EnvironmentConfig(Config):
    """
    The arm, its task, what is an action, what is rewarded, and how worlds differ.

    What is no action is done by the scenario: its forces, or its motion. Names of parameters in
    `settings` and `randomise` are those of ``--set``, e.g. ``plant.surfaces.*.stiffness``.
    """

    scenario: str = parameter('quick', 'Name in config/scenarios, or a path.')
    robot: str = parameter('', 'Name in config/robots, or a path; empty for the PUMA.')
    plant: str = parameter('', "Plant of the robot, or a path; empty for the robot's.")
    preset: str = parameter('', 'Name in config/presets, or a path; empty for none.')
    settings: dict[str, Any] = parameter(
        {}, 'Values of parameters, by dotted name, in every episode.'
    )
    randomise: dict[str, tuple[Any, Any]] = parameter(
        {},
        'Lower and upper bound of parameters, by dotted name, drawn in each episode; lists '
        'bound a list.',
    )
    tilt: float = parameter(
        0.0,
        'Largest angle of each surface to the configured one, drawn in each episode.',
        unit='rad',
        ge=0.0,
        le=0.5,
    )
    rate: float = parameter(
        50.0, 'Actions per second.', unit='Hz', ge=SLOWEST_RATE, le=1000.0
    )
    actions: tuple[ActionName, ...] = parameter(
        ('force', 'motion'), 'What the actions are, in their order.', min_length=1
    )
    speed: float = parameter(
        0.1, 'Speed along an axis that an action of 1 is.', unit='m/s', gt=0.0
    )
    turn: float = parameter(
        0.5, 'Angular speed about an axis that an action of 1 is.', unit='rad/s', gt=0.0
    )
    largest_tilt: float = parameter(
        0.3,
        'Largest angle of the tool to its orientation at the beginning of an episode.',
        unit='rad',
        gt=0.0,
        le=1.0,
    )
    window: int = parameter(
        10, 'Newest samples of the measured forces in an observation.', ge=1, le=5000
    )
    rewards: dict[str, float] = parameter(
        {'track_force': 1.0}, 'Weight of each reward, by its name.'
    )
    begin: float = parameter(
        0.0, 'Time of the scenario at which episodes begin.', unit='s', ge=0.0
    )
    duration: float | None = parameter(
        None,
        'Length of an episode; none for what the scenario has left.',
        unit='s',
        gt=0.0,
    )
    initial_force: float = parameter(
        5.0,
        'Force with which every contact is pressed before an episode begins, 0 to begin at '
        'home without contact.',
        unit='N',
        ge=0.0,
        le=CommandLimits().force_ceiling,
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if len(set(self.actions)) < len(self.actions):
            yield ConfigError('actions', 'distinct names', list(self.actions))
        for name in self.rewards.keys() - REWARDS.keys():
            yield ConfigError('rewards', f'names among {", ".join(REWARDS)}', name)
