"""The loop in one process presses as the paper does."""

from canonical_runs import run_of
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.verdict import judge_run
from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_allclose
import pytest


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_quick_is_stable_and_holds_its_forces(plant):
    """The paper's experiment in short."""
    setup = resolve('quick', plant=plant)
    result = run_of(setup)
    metrics = RunMetrics(result.data, setup)
    assert judge_run(metrics, ended_early=result.ended_early).reasons == ()
    for contact in metrics.contacts:
        summary = contact.summarise()
        assert summary['rest']['true_error_rms_n'] < 1.0
        assert summary['moving']['true_error_rms_n'] < 3.0
        assert summary['moving']['contact_loss_fraction'] == 0.0
        assert 0.3 < summary['rest']['noise_variance_median_n2'] < 1.2
        assert 0.02 <= summary['step_rise_63_s'] <= 0.06


def test_first_touch_stays_below_three_preloads_and_its_switches_do_not_step_the_torque():
    """At a switch the torque moves by no more than from tick to tick without one."""
    setup = resolve('quick', plant='rigid')
    data = run_of(setup).data.part(0, 700)
    assert data.alpha_true.max() < 3 * 2.0
    assert_allclose(data.alpha_true[-50:].mean(axis=0), 2.0, atol=0.1)
    shares = np.diff(data.torque, axis=0) / setup.controller.torque_limit
    steps = np.abs(shares).max(axis=1)
    switched = np.diff(data.alpha_des > 0.0, axis=0).any(axis=1)
    assert switched.sum() == 2
    later = np.arange(len(steps)) >= 100
    assert steps[switched].max() <= steps[later & ~switched].max()


def test_limited_slew_of_the_variance_leaves_a_force_step_its_speed():
    """A step lifts R, which slows the board's steps on flexible drives."""

    def rises_of_steps(slew_time):
        setup = resolve(
            'quick',
            plant='puma',
            duration=6.5,
            preset='paper',
            noise_estimator={'slew_time': slew_time},
        )
        board = RunMetrics(run_of(setup).data, setup).contacts[1]
        return [step['rise_63_s'] for step in board.summarise()['steps']]

    assert min(rises_of_steps(0.0)) > 0.08
    assert max(rises_of_steps(0.03)) < 0.08


# Files are laid over those of config/, as a user's own would be.
WALL = {
    'normal_world': [1.0, 0.0, 0.0],
    'point_operational': [0.0, 0.0, 0.24],
    'stiffness': 6000.0,
}
NAMES = ['table', 'board', 'wall']


def test_contact_is_added_without_code():
    """A third surface, to the side of the first tip; the controller reads a filtered wrench."""
    steps = [{'time': 2.5, 'forces': dict.fromkeys(NAMES, 10.0)}]
    surface = {
        'tip_link': 'tip_table',
        'point_world': [0.006, 0.55, 0.41],
        'normal_world': [1.0, 0.0, 0.0],
        'friction': 0.1,
    }
    setup = resolve(
        'quick',
        plant='rigid',
        duration=6.0,
        controller={
            'contact_names': NAMES,
            'contacts': {'wall': WALL},
            'wrench_input': 'filtered',
        },
        noise_estimator={'contact_names': NAMES},
        plant_overrides={'contact_names': NAMES, 'surfaces': {'wall': surface}},
        scenario_overrides={'reference': {'force_steps': steps, 'motion': None}},
    )
    result = run_of(setup)
    assert not result.ended_early
    late = result.data.alpha_true[result.data.time > 5.0]
    assert_allclose(late.mean(axis=0), 10.0, atol=0.3)
