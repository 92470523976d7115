"""Metrics on series that are made to have known ones."""

from dataclasses import replace

from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.runs.scenario import NO_PLANT, resolve
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


def between(data, start, end):
    """Return which samples are after a time and before another [s], shape (ticks,)."""
    return (data.time > start) & (data.time < end)


def test_windows_are_those_of_the_definition(setup, data):
    judged = RunMetrics(data, setup).windows
    rest = data.time[judged.rest]
    moving = data.time[judged.moving]
    assert rest[[0, -1]] == pytest.approx([5.0, 6.498])
    assert moving[[0, -1]] == pytest.approx([8.5, 11.998])
    assert data.time[judged.loaded][0] == pytest.approx(2.5)


def test_windows_begin_with_the_sample_that_has_their_time():
    """3.14 + 1 s is above 4.14 s in floating point, by less than the sample is from the next."""
    arm = resolve('quick', plant='rigid', duration=12.0)
    reference = arm.scenario.reference
    motion = reference.motion.model_copy(update={'start_time': 6.5})
    steps = [reference.force_steps[0].model_copy(update={'time': 3.14})]
    ours = {'force_steps': steps, 'motion': motion}
    scenario = {'reference': reference.model_copy(update=ours)}
    arm = replace(arm, scenario=arm.scenario.model_copy(update=scenario))
    judged = RunMetrics(perfect_run(arm), arm).windows
    assert np.argmax(judged.rest) == 2070


def test_run_of_the_users_own_robot_has_no_known_pushes(setup, data):
    metrics = RunMetrics(data, replace(setup, plant=NO_PLANT))
    assert metrics.pushes == [] and metrics.quiet_windows['moving'].any()


def test_losses_are_counted_under_load(setup, data):
    for start, samples in ((1000, 50), (3000, 20), (4000, 2), (5000, 1)):
        data.alpha_true[start : start + samples, 1] = 0.0
    assert RunMetrics(data, setup).contacts[1].losses == [(3000, 3020), (4000, 4002)]
    data.alpha_true[3010, 1] = np.nan
    lost = RunMetrics(data, setup).contacts[1].losses
    assert [begin for begin, _ in lost] == [3000, 4000]


def test_contact_errors_are_root_mean_squares_in_their_window(setup, data):
    at_rest = RunMetrics(data, setup).windows.rest
    alternating = np.full(data.ticks, 0.5)
    alternating[::2] = -0.5
    before = between(data, 4.5, 5.0) & ~at_rest
    data.alpha_true[at_rest, 0] += alternating[at_rest]
    data.alpha_true[before, 0] += 3.0
    table, board = RunMetrics(data, setup).contacts
    rest = table.summarise()['rest']
    assert rest['true_error_rms_n'] == pytest.approx(0.5)
    assert rest['estimate_error_rms_n'] == pytest.approx(0.5)
    assert board.summarise()['rest']['true_error_rms_n'] == 0.0


def lagging_step(data, start):
    """Return a step from 2 to 10 N with a lag of 0.05 s that overshoots by 10 % later."""
    t = data.time - start
    response = 1.0 - np.exp(-t / 0.05)
    response[t < 0.0] = 0.0
    response[between(data, start + 0.5, start + 0.6)] = 1.1
    return 2.0 + 8.0 * response


def first_step(data, setup):
    """Return the response of the first contact to its first step."""
    return RunMetrics(data, setup).contacts[0].step_responses[0]


def assert_known_lag(step, start):
    assert step.time_s == start
    assert step.size_n == 8.0
    assert step.rise_63_s == pytest.approx(0.05, abs=0.003)
    assert step.overshoot_percent == pytest.approx(10.0)
    assert step.settling_s == pytest.approx(-0.05 * np.log(0.05), abs=0.003)
    assert step.steady_error_n == pytest.approx(0.0, abs=1e-6)


def test_step_response_of_a_known_lag(setup, data):
    data.alpha_true[:, 0] = lagging_step(data, 2.5)
    data.alpha_true[data.time >= 4.0, 0] = 15.0
    contact = RunMetrics(data, setup).contacts[0]
    first, _ = contact.step_responses
    assert_known_lag(first, 2.5)
    assert contact.summarise()['step_rise_63_s'] == first.rise_63_s


def test_step_commanded_by_a_topic_begins_at_the_force_that_was_pressed(setup, data):
    before = data.time < 3.0
    data.alpha_true[:, 0] = lagging_step(data, 3.0)
    data.alpha_des[:] = 10.0
    data.alpha_des[before] = 2.0
    data.command[:] = 10.0
    data.command[before] = 0.0
    by_topic = replace(setup, commanded_by_topic=True)
    (step,) = RunMetrics(data, by_topic).contacts[0].step_responses
    assert_known_lag(step, 3.0)


@pytest.mark.parametrize(('error', 'settling'), [(0.3, 0.0), (0.5, None)])
def test_step_that_stays_off_its_command_has_a_steady_error(
    setup, data, error, settling
):
    """Within 5 % of the step of 8 N, and beyond."""
    data.alpha_true[data.time > 2.5, 0] += error
    first = first_step(data, setup)
    assert first.settling_s == settling
    assert first.steady_error_n == pytest.approx(error)


def test_measured_force_settles_within_the_noise_of_its_sensor(setup, data):
    """Also after a touch, which is no noise: 0.3 N, in a band of 0.9 N and not of 0.4 N."""
    noise = 0.3 * np.random.default_rng(0).standard_normal(data.ticks)
    data.alpha_meas[:, 0] += noise
    data.alpha_meas[between(data, 1.9, 1.95), 0] += 20.0
    data.alpha_true[:] = np.nan
    assert first_step(data, setup).settling_s < 0.1
    data.alpha_true[:] = data.alpha_meas
    assert first_step(data, setup).settling_s is None


@pytest.mark.parametrize(('law', 'ratio'), [('aob', 1.02), ('pi', None)])
def test_rise_over_the_design_is_known_of_the_law_that_is_designed(law, ratio):
    setup = resolve('quick', plant='rigid', controller={'force': {'law': law}})
    data = perfect_run(setup)
    data.alpha_true[:] = delayed(data, 0.05)
    contact = RunMetrics(data, setup).contacts[0]
    found = contact.rise_over_design(contact.largest_step)
    assert found == pytest.approx(ratio, abs=0.01)


def test_couple_has_no_loss_and_its_steps_begin_at_zero():
    """Those of `edge` go from 0 to 3 N, which is the preload, and back."""
    edge = resolve('edge', plant='rigid')
    data = perfect_run(edge)
    data.alpha_true[:] = edge.commanded(data.time)
    there, back = RunMetrics(data, edge).contacts[1].step_responses
    assert there.time_s == 6.0
    assert there.size_n == 3.0
    assert back.time_s == 7.5
    assert back.size_n == -3.0
    data.alpha_true[::2, 1] = -1.0
    contacts = RunMetrics(data, edge).contacts
    force, couple = (contact.summarise()['moving'] for contact in contacts)
    assert force['contact_loss_fraction'] == 0.0
    assert couple['contact_loss_fraction'] is None
    assert couple['true_error_rms_n'] == pytest.approx(np.sqrt(0.5), rel=1e-3)


@pytest.mark.parametrize(
    ('scenario', 'error'), [('quick', (0.0, 0.01, -0.01)), ('tilt', None)]
)
def test_motion_error_along_the_normals_does_not_count(scenario, error):
    """Those of table and board, and a tilted one."""
    setup = resolve(scenario, plant='rigid')
    data = perfect_run(setup)
    if error is None:
        error = 0.03 * np.array(setup.plant.surfaces['table'].normal_world)
    data.position[:] += error
    motion = RunMetrics(data, setup).summarise_motion()
    assert motion['moving_position_rms_m'] < 1e-12


def test_motion_error_counts_in_free_directions_and_in_its_window(setup, data):
    data.position[data.time < 8.5, 0] += 0.1
    data.position[data.time >= 8.5, 0] += 0.002
    motion = RunMetrics(data, setup).summarise_motion()
    assert motion['moving_position_rms_m'] == pytest.approx(0.002)
    assert motion['position_rms_m'] > motion['moving_position_rms_m']


def test_orientation_error_is_its_largest_angle(setup, data):
    turned = data.quaternion.copy()
    turned[5000] = -np.sin(0.01), 0.0, 0.0, -np.cos(0.01)
    motion = RunMetrics(replace(data, quaternion=turned), setup).summarise_motion()
    assert motion['orientation_max_rad'] == pytest.approx(0.02)


@pytest.fixture(scope='module')
def pushed():
    return resolve('disturbance', plant='rigid')


def with_error(data, start, end, error, contact=0):
    true = data.alpha_true.copy()
    true[between(data, start - 1e-9, end - 1e-9), contact] += error
    return replace(data, alpha_true=true)


@pytest.mark.parametrize(
    ('push', 'errors', 'recovery'),
    [
        # From the end of a short push, and from the start of a lasting one.
        (0, [(PUSH, PUSH + 0.35, 2.0)], 0.25),
        (1, [(LASTING, LASTING + 0.4, 2.0)], 0.4),
        # Within the band, out of it again, and not before the next event.
        (0, [(PUSH, PUSH + 0.5, 0.7)], 0.0),
        (0, [(PUSH, PUSH + 0.2, 2.0), (PUSH + 0.25, PUSH + 0.3, -2.0)], 0.2),
        (0, [(PUSH, LASTING, 2.0)], None),
    ],
)
def test_recovery_is_the_time_until_the_error_stays_in_the_band(
    pushed, push, errors, recovery
):
    data = perfect_run(pushed)
    for error in errors:
        data = with_error(data, *error)
    contact = RunMetrics(data, pushed).contacts[0]
    answer = contact.measure_recoveries(None)[push]
    assert answer['recovery'] == pytest.approx(recovery, abs=0.003)
    _, _, largest = errors[0]
    assert answer['peak'] == pytest.approx(largest)


def test_run_that_is_unstable_by_then_recovers_from_no_push(pushed):
    contact = RunMetrics(perfect_run(pushed), pushed).contacts[0]
    for answer in contact.measure_recoveries(4.0):
        assert answer['recovery'] is None
