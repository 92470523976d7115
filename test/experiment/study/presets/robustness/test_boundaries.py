
from multicontact_control.experiment.closed_loop import run_in_process
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.measure import final_error_share
from multicontact_control.experiment.study.presets.compare.matrix import (
    controller_values,
)
from multicontact_control.experiment.study.presets.robustness.boundaries import (
    arm_loop,
    map_job,
    SETTLED,
    verdict,
)
from multicontact_control.experiment.study.presets.robustness.study import (
    stable_range,
)
import pytest


def test_stable_range_is_what_is_connected_with_the_model():
    def points(*stable):
        return {'points': [{'plant': 'rigid', 'estimator': 'fixed', 'delay_ticks': 1,
                            'ratio': ratio, 'stable': here}
                           for ratio, here in zip((0.1, 0.5, 1.0, 2.0, 5.0), stable)]}

    for stable, found in (((1, 0, 1, 1, 0), (1.0, 2.0)), ((1, 1, 0, 1, 1), None),
                          ((1, 1, 1, 1, 1), (0.1, 5.0))):
        assert stable_range(points(*map(bool, stable)), 'rigid', 'fixed', 1) == found


def test_map_job_changes_only_the_plant():
    setup = map_job(5.0, 2, 'fixed').setup()
    assert {surface.stiffness for surface in setup.plant.surfaces.values()} == {30000.0}
    assert {contact.stiffness for contact in setup.controller.contacts.values()} == {6000.0}
    assert setup.plant.actuator_delay_ticks == 2
    assert setup.controller.force.input_delay == 0.006


def test_arm_loop_boundary_is_where_the_radius_is_one_and_lower_with_more_delay():
    quick, late = (arm_loop(map_job(1.0, delay, 'fixed').setup()) for delay in (1, 3))
    boundary = quick.boundary(0.6)
    assert quick.radius(0.6)(boundary) == pytest.approx(1.0, abs=1e-5)
    assert boundary > late.boundary(0.6)


LOW_PASS = {'sensor': {'filter_order': 2, 'filter_cutoff': 60.0}}


def setup_of(ratio, damping_rate=60.0, controller=None, **plant):
    """Return a run on surfaces of another stiffness, without noise, friction and roughness."""
    surface = {'stiffness': 6000.0 * ratio, 'roughness_std': 0.0, 'friction': 0.0}
    return resolve(
        'step', plant='rigid', duration=3.5,
        noise_estimator={'estimator': 'fixed', 'fixed_variance': 0.6},
        controller={**(controller or {}), 'force': {
            'damping_rate': damping_rate, 'input_delay': 0.002}},
        plant_overrides={
            **plant, 'actuator_delay_ticks': 1, 'joint_friction_scale': 0.0,
            'sensor': {'noise': False, 'quantise': False},
            'surfaces': {'table': surface, 'board': surface}})


def settles(setup):
    result = run_in_process(setup)
    return not result.ended_early and final_error_share(result.data, setup) <= SETTLED


@pytest.mark.slow
def test_linear_boundary_with_a_low_pass_is_the_simulated_one_within_a_quarter():
    loop = arm_loop(setup_of(1.0, controller=LOW_PASS))
    linear = loop.boundary(0.6)
    assert settles(setup_of(0.75 * linear, controller=LOW_PASS))
    assert settles(setup_of(loop.paper_boundary(0.6), controller=LOW_PASS))
    assert not settles(setup_of(1.25 * linear, controller=LOW_PASS))
    assert linear < 0.8 * arm_loop(setup_of(1.0)).boundary(0.6)


def test_verdict_of_a_run_that_did_not_settle_is_unstable():
    metrics = {'final_error_share': 0.05, 'summary': {'ended_early': None, 'contacts': {
        'table': {'step_overshoot_percent': 12.0}, 'board': {'step_overshoot_percent': None}}}}
    assert verdict(metrics) == {'stable': True, 'overshoot_percent': 12.0}
    for share in (0.2, None):
        assert not verdict({**metrics, 'final_error_share': share})['stable']
    metrics['summary']['ended_early'] = 'tick 100: singular'
    assert not verdict(metrics)['stable']


@pytest.mark.slow
@pytest.mark.parametrize('damping_rate', [20.0, 60.0, 100.0])
def test_linear_boundary_is_the_simulated_one_within_a_tenth(damping_rate):
    """With R fixed, the model's T_d that of the actuator, no friction, roughness or noise."""
    def setup(ratio):
        return setup_of(ratio, damping_rate, controller_values('rigid'), substep=2.5e-4)

    loop = arm_loop(setup(1.0))
    linear = loop.boundary(0.6)
    assert settles(setup(0.9 * linear))
    assert not settles(setup(1.1 * linear))
    # What eq. 32 leaves out makes it more robust.
    assert loop.paper_boundary(0.6) < 0.9 * linear
