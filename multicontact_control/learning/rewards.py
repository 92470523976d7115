"""
What a step of an episode is worth, in ways that are added up by their weights.

`REWARDS` has them by name; a program that adds its own there has it in every environment.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config.supervision import RELEASE_FORCE
import numpy as np

FORCE_ERROR = 10.0  # N, a mean error that costs 1
PATH_ERROR = 0.01  # m, the same of the path
RATED_LOAD = 4.0  # N along the surface, at which a wiper rubs best and wears little
OVERLOAD_COST = 4.0  # what a load of twice that costs


class EpisodeStep(NamedTuple):
    """What has happened in a step of n control periods, as it truly was."""

    forces: Matrix  # of robot on surface, and couples, shape (n, r) [N]
    forces_target: Vector  # those of the scenario, shape (r,) [N]
    sideways_load: Vector  # sum of the friction forces on the surfaces, shape (n,) [N]
    path_error: Vector  # from the operational point to the scenario's path, (3,) [m]
    action: Vector  # as it was obeyed, in [-1, 1]
    action_before: Vector  # the same of the step before


Reward = Callable[[EpisodeStep], float]


def track_force(step: EpisodeStep) -> float:
    """Return minus the mean error of the forces to the scenario's, 1 for 10 N."""
    return -float(np.abs(step.forces - step.forces_target).mean()) / FORCE_ERROR


def follow_path(step: EpisodeStep) -> float:
    """Return minus the distance of the operational point to the scenario's path, 1 for 10 mm."""
    return -float(np.linalg.norm(step.path_error)) / PATH_ERROR


def rub(step: EpisodeStep) -> float:
    """
    Return how well a wiper rubs: the load along the surface over the rated one, up to 1.

    What is beyond it is taken off four times: the surface is scratched.
    """
    load = step.sideways_load / RATED_LOAD
    excess = np.maximum(load - 1.0, 0.0)
    return float((np.minimum(load, 1.0) - OVERLOAD_COST * excess).mean())


def keep_contact(step: EpisodeStep) -> float:
    """Return the share of the samples in which every contact with a target is pressed."""
    pressed = (step.forces > RELEASE_FORCE) | (step.forces_target <= 0.0)
    return float(pressed.all(axis=1).mean())


def act_smoothly(step: EpisodeStep) -> float:
    """Return minus the mean square of the change of the action."""
    return -float(np.square(step.action - step.action_before).mean())


REWARDS: dict[str, Reward] = {
    'track_force': track_force,
    'follow_path': follow_path,
    'rub': rub,
    'keep_contact': keep_contact,
    'act_smoothly': act_smoothly,
}
