"""What faults and soaks happen to: a scenario with something in the way, for later."""

from __future__ import annotations

from multicontact_control.experiment.faults.vocabulary import FAR
from multicontact_control.experiment.scenario import plant_source, resolve, Setup
import numpy as np


def with_obstacles(scenario: str, plant: str, seed: int) -> Setup:
    """Resolve a scenario with walls far away that the first contact's tip, or the elbow, meets."""
    setup = resolve(scenario, plant=plant, seed=seed)
    tip = setup.plant.surfaces[setup.plant.contact_names[0]].tip_link
    elbow, normal = plant_source(plant).robot.elbow()
    walls = {name: {
        'tip_link': link, 'point_world': (FAR * into).tolist(), 'normal_world': into.tolist(),
        'stiffness': stiffness, 'roughness_std': 0.0}
        for name, link, into, stiffness in (
            ('side_wall', tip, np.array([1.0, 0.0, 0.0]), 3000.0),
            ('elbow_wall', elbow, normal, 6000.0))}
    return resolve(scenario, plant=plant, seed=seed, plant_overrides={
        'obstacle_names': list(walls), 'surfaces': walls})
