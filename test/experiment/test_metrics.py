"""Metrics on series that are made to have known ones."""

from dataclasses import replace

from multicontact_control.control.reference.scenario import sine_motion
from multicontact_control.experiment.metrics import (
    contact_summary,
    losses,
    motion_summary,
    orientation_error,
    percentiles,
    step_responses,
    torque_summary,
    windows,
)
from multicontact_control.experiment.recording import empty_run_data
from multicontact_control.experiment.scenario import NO_PLANT, resolve
import numpy as np
import pytest


@pytest.fixture(scope='module')
def setup():
    return resolve('quick', plant='rigid', duration=12.0)


@pytest.fixture
def data(setup):
    """Return a perfect run of `quick`: every force at its command, 1 N of noise variance."""
    data = empty_run_data(setup.ticks, setup.controller)
    for series, value in ((data.q, 0.0), (data.qd, 0.0), (data.torque, 5.0),
                          (data.position, 0.1), (data.position_des, 0.1),
                          (data.noise_variance, 1.0), (data.alpha_rate_est, 0.0)):
        series[:] = value
    data.quaternion[:] = data.quaternion_des[:] = [0.0, 0.0, 0.0, 1.0]
    desired = np.select([data.time < 0.5, data.time < 2.5, data.time < 4.0],
                        [0.0, 2.0, 10.0], 15.0)
    for series in (data.alpha_des, data.alpha_true, data.alpha_meas, data.alpha_est):
        series[:] = desired[:, None]
    return data


def test_windows_are_those_of_the_definition(setup, data):
    """Rest from 1 s after the last step to the motion, moving from 2 s after its start."""
    judged = windows(setup.scenario.reference, data.time)
    rest, moving = data.time[judged.rest], data.time[judged.moving]
    assert (rest[0], rest[-1]) == pytest.approx((5.0, 6.498))
    assert (moving[0], moving[-1]) == pytest.approx((8.5, 11.998))
    assert data.time[judged.loaded][0] == pytest.approx(2.5)


@pytest.mark.parametrize('scenario', ['quick', 'paper'])
def test_moving_window_holds_a_reversal(scenario):
    """Friction turns there: `quick` took 12 s and was judged between two of them."""
    setup = resolve(scenario)
    time = np.arange(setup.ticks) * setup.controller.period
    judged = windows(setup.scenario.reference, time)
    # The window begins at a reversal, which it does not hold.
    speeds = [sine_motion(setup.scenario.reference.motion, t)[1] for t in time[judged.moving][5:]]
    assert np.count_nonzero(np.diff(np.sign(speeds))) >= 1


def test_perfect_run_is_without_error(setup, data):
    """Nothing is found where there is nothing."""
    for i in range(2):
        contact = contact_summary(data, setup, i)
        for window in ('rest', 'moving'):
            assert contact[window]['true_error_rms_n'] == 0.0
            assert contact[window]['contact_loss_fraction'] == 0.0
        assert (contact['loss_rate_hz'], contact['longest_loss_s']) == (0.0, 0.0)
        assert contact['oscillation_hz'] is contact['oscillation_s'] is None
    torque = torque_summary(data, setup)
    assert torque['max_fraction_of_limit'] == pytest.approx(5.0 / 20.1)


def test_losses_are_counted_under_load(setup, data):
    """One of 40 ms and one of 4 ms in 9.5 s; not one sample, nor one before the first step."""
    for start, samples in ((1000, 50), (3000, 20), (4000, 2), (5000, 1)):
        data.alpha_true[start:start + samples, 1] = 0.0
    contact = contact_summary(data, setup, 1)
    assert contact['loss_rate_hz'] == pytest.approx(2.0 / 9.5, rel=1e-3)
    assert contact['longest_loss_s'] == pytest.approx(0.04)
    data.alpha_true[3010, 1] = np.nan
    assert losses(data, setup, 1, data.time >= 0.0)[0] == [0, 1000, 3000, 4000]


def test_longest_oscillation_is_in_the_summary(setup, data):
    late = data.time >= 8.0
    data.alpha_true[late, 0] += 2.0 * np.sin(2.0 * np.pi * 42.0 * data.time[late])
    contact = contact_summary(data, setup, 0)
    assert contact['oscillation_hz'] == pytest.approx(42.0, abs=1.0)
    assert contact['oscillation_rms_n'] == pytest.approx(2.0 ** 0.5, rel=0.1)
    assert contact['oscillation_s'] == pytest.approx(4.0, abs=0.5)


def test_contact_errors_are_root_mean_squares_in_their_window(setup, data):
    """An error outside the window does not count, one inside does."""
    judged = windows(setup.scenario.reference, data.time)
    data.alpha_true[judged.rest, 0] += 0.5 * np.where(np.arange(judged.rest.sum()) % 2, 1, -1)
    data.alpha_true[~judged.rest & (data.time > 4.5) & (data.time < 5.0), 0] += 3.0
    rest = contact_summary(data, setup, 0)['rest']
    assert rest['true_error_rms_n'] == pytest.approx(0.5)
    assert rest['estimate_error_rms_n'] == pytest.approx(0.5)
    assert contact_summary(data, setup, 1)['rest']['true_error_rms_n'] == 0.0


def test_couple_of_any_sign_is_no_lost_contact():
    edge = resolve('edge', plant='rigid')
    data = empty_run_data(edge.ticks, edge.controller)
    data = replace(data, alpha_true=edge.commanded(data.time))
    data.alpha_true[::2, 1] = -1.0
    force, couple = (contact_summary(data, edge, i)['moving'] for i in (0, 1))
    assert (force['contact_loss_fraction'], couple['contact_loss_fraction']) == (0.0, None)
    assert couple['true_error_rms_n'] == pytest.approx(0.5 ** 0.5, rel=1e-3)


def test_step_response_of_a_known_lag(setup, data):
    """A first-order lag of 50 ms with 10 % of overshoot is read off as such."""
    after = data.time >= 2.5
    t = data.time[after] - 2.5
    response = 1.0 - np.exp(-t / 0.05)
    response[(t > 0.5) & (t < 0.6)] = 1.1
    data.alpha_true[after, 0] = np.where(t < 1.5, 2.0 + 8.0 * response, 15.0)
    first = step_responses(data, setup, 0)[0]
    assert (first.time, first.size) == (2.5, 8.0)
    assert first.rise_63 == pytest.approx(0.05, abs=0.003)
    assert first.overshoot_percent == pytest.approx(10.0)
    assert contact_summary(data, setup, 0)['step_rise_63_s'] == first.rise_63


@pytest.mark.parametrize('pushed', ['push', 'tool_push'])
def test_answer_to_a_push_is_no_overshoot_of_the_step_before(setup, data, pushed):
    pushes = replace(setup, plant=setup.plant.model_copy(update={
        f'{pushed}_start': (5.0,), f'{pushed}_duration': (0.1,),
        f'{pushed}_force_world': (0.0, 0.0, -5.0)}))
    data.alpha_true[(data.time >= 4.2) & (data.time < 4.3), 0] += 0.2
    data.alpha_true[(data.time >= 5.0) & (data.time < 5.2), 0] += 2.0
    assert step_responses(data, pushes, 0)[1].overshoot_percent == pytest.approx(4.0)
    assert step_responses(data, setup, 0)[1].overshoot_percent == pytest.approx(40.0)


def test_force_step_on_the_other_contact_is_no_overshoot_either():
    setup = resolve('disturbance', plant='rigid')
    data = empty_run_data(setup.ticks, setup.controller)
    data = replace(data, alpha_true=setup.commanded(data.time))
    data.alpha_true[(data.time >= 3.5) & (data.time < 3.6), 1] += 1.0
    (step,) = step_responses(data, setup, 1)
    assert (step.time, step.overshoot_percent) == (2.0, 0.0)


def commanded_run(setup, data, *, ramp=0):
    """Return a run in which 10 N are commanded while 2 N are pressed, at once or by and by."""
    desired = np.where(data.time < 3.0, 2.0, 10.0)
    begin = round(3.0 * data.rate) - ramp
    desired[begin:begin + ramp] = np.linspace(2.0, 10.0, ramp, endpoint=False)
    command = np.where(data.time < 3.0, 0.0, 10.0)
    lagging = np.where(data.time < 3.0, 2.0, 10.0 - 8.0 * np.exp(-(data.time - 3.0) / 0.05))
    lagging[(data.time > 4.0) & (data.time < 4.1)] = 10.8
    wide = [np.tile(series[:, None], (1, 2)) for series in (desired, command, lagging)]
    return replace(setup, commanded_by_topic=True), replace(
        data, alpha_des=wide[0], command=wide[1], alpha_true=wide[2])


def test_commanded_step_begins_at_what_was_pressed_before(setup, data):
    """At the preload, and not at nothing, which is what a contact counts as until it is made."""
    setup, data = commanded_run(setup, data)
    (step,) = step_responses(data, setup, 0)
    assert (step.time, step.size) == (3.0, 8.0)
    assert step.rise_63 == pytest.approx(0.05, abs=0.003)
    assert step.overshoot_percent == pytest.approx(10.0)


def test_command_that_the_desired_force_goes_to_by_and_by_is_no_step(setup, data):
    setup, data = commanded_run(setup, data, ramp=40)
    assert step_responses(data, setup, 0) == []


def test_a_step_that_is_never_reached_has_no_rise(setup, data):
    """None, not a number."""
    data.alpha_true[data.time >= 2.5, 1] = 2.0
    assert contact_summary(data, setup, 1)['step_rise_63_s'] is None


def test_motion_error_counts_in_free_directions_only(setup, data):
    """The depth of the contacts is not a motion error, the way along x is."""
    data.position[:, 1] += 0.01
    data.position[:, 2] -= 0.01
    assert motion_summary(data, setup)['position_rms_m'] == pytest.approx(0.0, abs=1e-12)
    data.position[:, 0] += 0.002
    assert motion_summary(data, setup)['position_rms_m'] == pytest.approx(0.002)


def test_rest_does_not_make_a_motion_error_smaller(setup, data):
    """Of 9.5 s under load the last 3.5 s are `moving`."""
    data.position[data.time >= 8.5, 0] += 0.002
    found = motion_summary(data, setup)
    assert found['moving_position_rms_m'] == pytest.approx(0.002)
    assert found['position_rms_m'] == pytest.approx(0.002 * np.sqrt(3.5 / 9.5), rel=1e-3)
    resting = motion_summary(data.truncated(3000), setup)
    assert resting['moving_position_rms_m'] is None and resting['position_rms_m'] == 0.0


def test_orientation_error_is_the_angle(data):
    """Of a rotation by 0.02 rad about x, whatever the quaternion's sign."""
    turned = np.tile([np.sin(0.01), 0.0, 0.0, np.cos(0.01)], (data.ticks, 1))
    for sign in (1.0, -1.0):
        turned_data = replace(data, quaternion=sign * turned)
        np.testing.assert_allclose(orientation_error(turned_data), 0.02, atol=1e-7)


def test_torque_summary_finds_the_joint_nearest_to_its_limit(setup, data):
    """As a fraction of that joint's limit."""
    data.torque[17, 2] = -44.7
    summary = torque_summary(data, setup)
    assert summary['max_fraction_of_limit'] == pytest.approx(0.5)
    assert summary['saturated_fraction'] == 0.0


def test_torque_without_a_limit_is_no_share_of_it(setup, data):
    unlimited = replace(setup, plant=NO_PLANT, controller=setup.controller.model_copy(
        update={'torque_limit': ()}))
    assert torque_summary(data, unlimited) == {
        'max_fraction_of_limit': None, 'saturated_fraction': 0.0}
    simulated = replace(unlimited, plant=setup.plant)  # whose drives have limits all the same
    assert torque_summary(data, simulated) == torque_summary(data, setup)


def test_percentiles_of_known_values():
    """And of none."""
    assert percentiles(np.arange(1001.0))['p50'] == 500.0
    assert percentiles(np.zeros(0))['max'] == 0.0


def test_trajectory_hash_is_that_of_little_endian_torques(data):
    """Independent of memory layout, and sensitive to the last bit."""
    import hashlib
    expected = hashlib.sha256(data.torque.astype('<f8').tobytes()).hexdigest()
    assert data.trajectory_sha256() == expected
    fortran = replace(data, torque=np.asfortranarray(data.torque))
    assert fortran.trajectory_sha256() == expected
    data.torque[0, 0] = np.nextafter(data.torque[0, 0], 9.0)
    assert data.trajectory_sha256() != expected


def test_steps_of_a_couple_begin_at_nothing_and_not_at_the_preload():
    """Those of `edge` go from 0 to 3 N, which is the preload, and back."""
    edge = resolve('edge', plant='rigid')
    data = empty_run_data(edge.ticks, edge.controller)
    data = replace(data, alpha_true=edge.commanded(data.time))
    assert [(step.time, step.size) for step in step_responses(data, edge, 1)] == [
        (6.0, 3.0), (7.5, -3.0)]
