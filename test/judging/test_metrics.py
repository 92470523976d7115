"""Metrics on series that are made to have known ones."""

from dataclasses import replace

from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from synthetic_run import delayed, perfect_run

PUSH, LASTING = 5.0, 6.5  # s, the pushes of the scenario `disturbance`


@pytest.fixture(scope='module')
def setup():
    return resolve('quick', plant='rigid', duration=12.0)


@pytest.fixture
def data(setup):
    return perfect_run(setup)


def test_windows_are_those_of_the_definition(setup, data):
    judged = RunMetrics(data, setup).windows
    rest, moving = data.time[judged.rest], data.time[judged.moving]
    assert (rest[0], rest[-1]) == pytest.approx((5.0, 6.498))
    assert (moving[0], moving[-1]) == pytest.approx((8.5, 11.998))
    assert data.time[judged.loaded][0] == pytest.approx(2.5)


def test_losses_are_counted_under_load(setup, data):
    for start, samples in ((1000, 50), (3000, 20), (4000, 2), (5000, 1)):
        data.alpha_true[start : start + samples, 1] = 0.0
    assert RunMetrics(data, setup).contacts[1].losses == [(3000, 3020), (4000, 4002)]
    data.alpha_true[3010, 1] = np.nan
    lost = RunMetrics(data, setup).contacts[1].losses
    assert [begin for begin, _ in lost] == [3000, 4000]


def test_contact_errors_are_root_mean_squares_in_their_window(setup, data):
    judged = RunMetrics(data, setup).windows
    data.alpha_true[judged.rest, 0] += 0.5 * np.where(
        np.arange(judged.rest.sum()) % 2, 1, -1
    )
    data.alpha_true[~judged.rest & (data.time > 4.5) & (data.time < 5.0), 0] += 3.0
    rest = RunMetrics(data, setup).contacts[0].summarise()['rest']
    assert rest['true_error_rms_n'] == pytest.approx(0.5)
    assert rest['estimate_error_rms_n'] == pytest.approx(0.5)
    assert (
        RunMetrics(data, setup).contacts[1].summarise()['rest']['true_error_rms_n']
        == 0.0
    )


@pytest.mark.parametrize(
    ('commanded', 'start', 'steps'), [(False, 2.5, 2), (True, 3.0, 1)]
)
def test_step_response_of_a_known_lag(setup, data, commanded, start, steps):
    """Of the scenario, and of a topic: from the force that was pressed before."""
    t = data.time - start
    response = np.where(t < 0.0, 0.0, 1.0 - np.exp(-t / 0.05))
    response[(t > 0.5) & (t < 0.6)] = 1.1
    data.alpha_true[:, 0] = np.where((t < 1.5) | commanded, 2.0 + 8.0 * response, 15.0)
    if commanded:
        setup = replace(setup, commanded_by_topic=True)
        for series, before in ((data.alpha_des, 2.0), (data.command, 0.0)):
            series[:] = np.where(t < 0.0, before, 10.0)[:, None]
    first, *others = RunMetrics(data, setup).contacts[0].step_responses
    assert (first.time_s, first.size_n, len(others)) == (start, 8.0, steps - 1)
    assert first.rise_63_s == pytest.approx(0.05, abs=0.003)
    assert first.overshoot_percent == pytest.approx(10.0)
    assert first.settling_s == pytest.approx(-0.05 * np.log(0.05), abs=0.003)
    assert first.steady_error_n == pytest.approx(0.0, abs=1e-6)
    assert (
        RunMetrics(data, setup).contacts[0].summarise()['step_rise_63_s']
        == first.rise_63_s
    )


@pytest.mark.parametrize(('error', 'settling'), [(0.3, 0.0), (0.5, None)])
def test_step_that_stays_off_its_command_has_a_steady_error(
    setup, data, error, settling
):
    """Within 5 % of the step of 8 N, and beyond."""
    data.alpha_true[data.time > 2.5, 0] += error
    first = RunMetrics(data, setup).contacts[0].step_responses[0]
    assert first.settling_s == settling
    assert first.steady_error_n == pytest.approx(error)


def test_measured_force_settles_within_the_noise_of_its_sensor(setup, data):
    """Also after a touch, which is no noise: 0.3 N, in a band of 0.9 N and not of 0.4 N."""
    noise = 0.3 * np.random.default_rng(0).standard_normal(data.ticks)
    data.alpha_meas[:, 0] += noise
    data.alpha_meas[(data.time > 1.9) & (data.time < 1.95), 0] += 20.0
    data.alpha_true[:] = np.nan
    assert RunMetrics(data, setup).contacts[0].step_responses[0].settling_s < 0.1
    data.alpha_true[:] = data.alpha_meas
    assert RunMetrics(data, setup).contacts[0].step_responses[0].settling_s is None


def test_rise_over_the_design_is_known_of_the_law_that_is_designed(setup, data):
    data.alpha_true[:] = delayed(data, 0.05)
    contact = RunMetrics(data, setup).contacts[0]
    assert contact.rise_over_design(contact.largest_step) == pytest.approx(
        1.02, abs=0.01
    )
    other = setup.controller.model_copy(
        update={'force': setup.controller.force.model_copy(update={'law': 'pi'})}
    )
    contact = RunMetrics(data, replace(setup, controller=other)).contacts[0]
    assert contact.rise_over_design(contact.largest_step) is None


def test_couple_has_no_loss_and_its_steps_begin_at_zero():
    """Those of `edge` go from 0 to 3 N, which is the preload, and back."""
    edge = resolve('edge', plant='rigid')
    data = perfect_run(edge)
    data.alpha_true[:] = edge.commanded(data.time)
    assert [
        (step.time_s, step.size_n)
        for step in RunMetrics(data, edge).contacts[1].step_responses
    ] == [(6.0, 3.0), (7.5, -3.0)]
    data.alpha_true[::2, 1] = -1.0
    force, couple = (
        RunMetrics(data, edge).contacts[i].summarise()['moving'] for i in (0, 1)
    )
    assert (force['contact_loss_fraction'], couple['contact_loss_fraction']) == (
        0.0,
        None,
    )
    assert couple['true_error_rms_n'] == pytest.approx(0.5**0.5, rel=1e-3)


def test_motion_error_counts_in_free_directions_and_in_its_window(setup, data):
    data.position[:, 1:] += [0.01, -0.01]
    assert RunMetrics(data, setup).summarise_motion()['moving_position_rms_m'] < 1e-12
    data.position[data.time < 8.5, 0] += 0.1
    data.position[data.time >= 8.5, 0] += 0.002
    turned = data.quaternion.copy()
    turned[5000] = -np.sin(0.01), 0.0, 0.0, -np.cos(0.01)
    motion = RunMetrics(replace(data, quaternion=turned), setup).summarise_motion()
    assert motion['moving_position_rms_m'] == pytest.approx(0.002)
    assert motion['position_rms_m'] > motion['moving_position_rms_m']
    assert motion['orientation_max_rad'] == pytest.approx(0.02)
    tilted = resolve('tilt', plant='rigid')
    data = perfect_run(tilted)
    data.position[:] += 0.03 * np.array(tilted.plant.surfaces['table'].normal_world)
    assert RunMetrics(data, tilted).summarise_motion()['moving_position_rms_m'] < 1e-12


@pytest.fixture(scope='module')
def pushed():
    return resolve('disturbance', plant='rigid')


def with_error(data, start, end, error, contact=0):
    true = data.alpha_true.copy()
    true[(data.time >= start - 1e-9) & (data.time < end - 1e-9), contact] += error
    return replace(data, alpha_true=true)


@pytest.mark.parametrize(
    ('push', 'errors', 'recovery'),
    [
        (0, [(PUSH, PUSH + 0.35, 2.0)], 0.25),  # from the end of a short push
        (1, [(LASTING, LASTING + 0.4, 2.0)], 0.4),  # from the start of a lasting one
        (0, [(PUSH, PUSH + 0.5, 0.7)], 0.0),  # within the band
        (
            0,
            [(PUSH, PUSH + 0.2, 2.0), (PUSH + 0.25, PUSH + 0.3, -2.0)],
            0.2,
        ),  # out of it again
        (0, [(PUSH, LASTING, 2.0)], None),
    ],
)  # not before the next event
def test_recovery_is_the_time_until_the_error_stays_in_the_band(
    pushed, push, errors, recovery
):
    data = perfect_run(pushed)
    for error in errors:
        data = with_error(data, *error)
    answer = RunMetrics(data, pushed).contacts[0].measure_recoveries(None)[push]
    assert answer['recovery'] == (
        recovery if recovery is None else pytest.approx(recovery, abs=0.003)
    )
    assert answer['peak'] == pytest.approx(max(abs(size) for *_, size in errors))
    # Of a run that is unstable by then.
    early = RunMetrics(data, pushed).contacts[0].measure_recoveries(4.0)
    assert early and all(answer['recovery'] is None for answer in early)
