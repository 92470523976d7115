"""What faults and soaks happen to: a scenario with something in the way, for later."""

from __future__ import annotations

from multicontact_control.experiment.faults.vocabulary import FAR
from multicontact_control.experiment.scenario import resolve, Setup

ELBOW = 'link3'  # of the simulated arm: its origin is on the axis of the elbow


def with_obstacles(scenario: str, plant: str, seed: int) -> Setup:
    """Resolve a scenario with walls far away that the first contact's tip, or the elbow, meets."""
    setup = resolve(scenario, plant=plant, seed=seed)
    tip = setup.plant.surfaces[setup.plant.contact_names[0]].tip_link
    walls = {name: {
        'tip_link': link, 'point_world': [along * FAR, 0.0, 0.0],
        'normal_world': [along, 0.0, 0.0], 'stiffness': stiffness, 'roughness_std': 0.0}
        for name, link, along, stiffness in (
            ('side_wall', tip, 1.0, 3000.0), ('elbow_wall', ELBOW, -1.0, 6000.0))}
    return resolve(scenario, plant=plant, seed=seed, plant_overrides={
        'obstacle_names': list(walls), 'surfaces': walls})
