"""A contact, made as CONTRIBUTING's recipe says, works."""

from multicontact_control.experiment.scenario import resolve
import numpy as np
from runs import run_of

# Files are laid over those of config/, as a user's own would be.
WALL = {'normal_world': [1.0, 0.0, 0.0], 'point_operational': [0.0, 0.0, 0.24],
        'stiffness': 6000.0}
NAMES = ['table', 'board', 'wall']


def test_contact_is_added_without_code():
    """A third surface, to the side of the first tip, pressed by 10 N like the others."""
    setup = resolve(
        'quick', plant='rigid', duration=6.0,
        controller={'contact_names': NAMES, 'contacts': {'wall': WALL}},
        noise_estimator={'contact_names': NAMES},
        plant_overrides={'contact_names': NAMES, 'surfaces': {'wall': {
            'tip_link': 'tip_table', 'point_world': [0.006, 0.55, 0.41],
            'normal_world': [1.0, 0.0, 0.0], 'friction': 0.1}}},
        scenario_overrides={'reference': {'force_steps': [
            {'time': 2.5, 'forces': dict.fromkeys(NAMES, 10.0)}]}})
    result = run_of(setup)
    assert not result.ended_early
    late = result.data.time > 5.0
    np.testing.assert_allclose(
        result.data.alpha_true[late].mean(axis=0), [10.0] * 3, atol=0.3)
