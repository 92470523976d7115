"""What faults and soaks happen to: a scenario with something in the way, for later."""

from __future__ import annotations

from multicontact_control.experiment.faults.vocabulary import FAR
from multicontact_control.experiment.scenario import resolve, Setup


def with_side_wall(scenario: str, plant: str, seed: int) -> Setup:
    """Resolve a scenario with a wall far away, that the first contact's tip may meet."""
    setup = resolve(scenario, plant=plant, seed=seed)
    tip = setup.plant.surfaces[setup.plant.contact_names[0]].tip_link
    wall = {'tip_link': tip, 'point_world': [FAR, 0.0, 0.0], 'normal_world': [1.0, 0.0, 0.0],
            'stiffness': 3000.0, 'roughness_std': 0.0}
    return resolve(scenario, plant=plant, seed=seed, plant_overrides={
        'obstacle_names': ['side_wall'], 'surfaces': {'side_wall': wall}})
