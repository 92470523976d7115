"""The stiffness found on-line: the regression, its standard error, and the model that follows."""

from force_loop import design_force_loop, H
from multicontact_control.config import ForceConfig
from multicontact_control.force.force_law import FORCE_LAW
from multicontact_control.force.observer import design_observer, make_observers
from multicontact_control.force.stiffness import (
    add_fit_sample,
    estimate_stiffness,
    filter_signal,
    FIT_SPACE,
    follow_stiffness,
    friction_of_others,
    interpolate_ratio_limit,
    set_up_stiffness,
    STIFFNESS,
    take_over_stiffness,
    use_model_stiffness,
)
from multicontact_control.records import CONTACT, CONTROL, FRAME
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.integrate import trapezoid

SPACE = np.zeros(1, dtype=FIT_SPACE)[0]


def stiffness_of(k=6000.0, delay=0.006, mass=0.5, **values):
    """Return the record of an adaptive stiffness, and its observer."""
    config = ForceConfig(damping_rate=100.0, **values)
    loop = design_force_loop(k, 100.0, delay)
    observer = make_observers([design_observer(loop)])[0]
    record = np.zeros(1, dtype=STIFFNESS)[0]
    set_up_stiffness(record, loop.plant, k, config, period=H, tool_mass=mass)
    record['config']['ratio_limit'] = np.linspace(5.0, 1.0, 8)
    return record, observer


@pytest.mark.parametrize('delay', [0.0, 0.001, 0.002, 0.0037, 0.006, 0.0071])
def test_feedback_of_another_stiffness_is_that_of_ackermann(delay):
    """Of another stiffness, and with other poles; P04 eq. 36 is the reference."""
    record, observer = stiffness_of(delay=delay, mass=0.0)
    for k in (300.0, 20_000.0, 6000.0):
        use_model_stiffness(observer, record, k, 0.0)
        loop = design_force_loop(k, 100.0, delay)
        expected = make_observers([design_observer(loop)])[0]['design']
        for name in ('Phi_n', 'Gamma', 'feedback'):
            tolerance = 1e-9 * np.abs(expected[name]).max()
            found = observer['design'][name]
            assert_allclose(found, expected[name], rtol=1e-6, atol=tolerance)


def test_poles_are_limited_by_tool_and_surface():
    record, observer = stiffness_of()
    use_model_stiffness(observer, record, 300.0, 20.0)
    design = observer['design']
    Gamma = design['Gamma'][:5]
    loop = design['Phi_n'][:5, :5] - np.outer(Gamma, design['feedback'][:5])
    slowest_moduli = np.sort(np.abs(np.linalg.eigvals(loop)))[-2:]
    poles = np.sort(-np.log(slowest_moduli) / H)
    limits = [300.0 / 20.0, np.sqrt(0.8 * 300.0 / 0.5)]
    assert_allclose(poles, limits, rtol=1e-4)


def press_surface(k, c=0.0, mu=0.0, seed=1, count=150, noise=0.0):
    """
    Return samples of a surface that is pressed and let go, by a tool of 0.5 kg.

    Shape (count, 4): z, v, w and what is measured.
    """
    random = np.random.default_rng(seed)
    t = H * np.arange(count)
    slow = 2e-3 * (1.0 - np.cos(2.0 * np.pi * 5.0 * t))
    fast = 3e-4 * np.sin(2.0 * np.pi * 9.0 * t)
    depth = slow + fast
    speed = np.gradient(depth, H)
    others = 10.0 * speed / np.sqrt(speed**2 + 0.003**2)
    inertial = 0.5 * np.gradient(speed, H)
    error = noise * random.standard_normal(count)
    alpha = k * depth + c * speed + mu * others + inertial + error
    return np.column_stack([depth, speed, others, alpha])


def fit_to(samples):
    """Return the slow fit to samples that are all accepted."""
    record, _ = stiffness_of()
    fit = record['slow']
    for record['depth'], record['speed'], friction, alpha in samples:
        add_fit_sample(record, fit, friction, alpha, True, SPACE)
    return fit


@pytest.mark.parametrize(
    ('k', 'c', 'mu'), [(300.0, 30.0, 0.1), (6000.0, 0.0, 0.0), (60_000.0, 50.0, 0.3)]
)
def test_fit_recovers_stiffness_damping_and_friction(k, c, mu):
    fit = fit_to(press_surface(k, c, mu))
    assert fit['k'] == pytest.approx(k, rel=0.03)
    assert fit['mu'] == pytest.approx(mu, abs=0.03)
    assert fit['c'] == pytest.approx(c, abs=max(0.1 * c, 0.002 * k))
    assert fit['share'] > 0.99


def test_fit_error_is_that_of_repeated_fits():
    values = []
    errors = []
    for seed in range(60):
        fit = fit_to(press_surface(6000.0, 30.0, 0.1, seed=seed, noise=0.3))
        values.append(float(fit['k']))
        errors.append(float(fit['k_std']))
    assert 0.5 < np.std(values) / np.median(errors) < 2.0


def test_fit_takes_samples_after_a_touch_or_a_step_alone():
    record, _ = stiffness_of()
    weights = []
    desired = np.full(600, 10.0)
    desired[401:] = 15.0
    samples = press_surface(6000.0, count=600)
    for alpha_des, (_, speed, _, alpha) in zip(desired, samples):
        estimate_stiffness(record, 5.0 + alpha, alpha_des, speed, 0.0, SPACE)
        weights.append(float(record['slow']['weight']))
    assert weights[149] > 10.0
    assert weights[160] == weights[400]
    assert weights[420] != weights[400]


def test_model_follows_at_its_rates_within_its_range():
    record, observer = stiffness_of(adaptive={'lowest': 1000.0, 'highest': 50_000.0})
    laws = np.zeros(1, dtype=FORCE_LAW)
    laws['observer'] = observer
    laws['stiffness'] = record
    contacts = np.zeros(1, dtype=CONTACT)
    control = np.zeros(1, dtype=CONTROL)[0]
    control['measured'] = True
    fit = laws['stiffness']['slow']
    fit['share'] = 1.0
    used = []
    for target, ticks in ((300.0, 200), (200_000.0, 60)):
        fit['k'] = target
        for _ in range(ticks):
            follow_stiffness(laws, contacts, 0, control, 0.0, SPACE)
            used.append(float(laws['stiffness']['k'][0]))
    steps = np.diff(np.log(used))
    assert steps.min() == pytest.approx(-H / 0.02)
    assert steps.max() == pytest.approx(H / 0.004)
    assert min(used) == pytest.approx(1000.0)
    assert max(used) == pytest.approx(50_000.0)


def test_force_does_not_jump_when_the_model_changes():
    record, observer = stiffness_of()
    observer['x_est'][:2] = (10.0, 40.0)
    observer['P'][0, 1] = 2.0
    observer['P'][1, 1] = 3.0
    use_model_stiffness(observer, record, 12_000.0, 24.0)
    assert observer['x_est'][:2].tolist() == [10.0, 80.0]
    assert observer['P'][0, 1] == 4.0
    assert observer['P'][1, 1] == 12.0
    assert observer['design']['damping_time'] == pytest.approx(24.0 / 12_000.0)


def gain_of_band(fit, frequency):
    """Return the amplitude that is left of a settled sine of amplitude 1."""
    sine = np.sin(2.0 * np.pi * frequency * H * np.arange(2000))
    passed = [filter_signal(fit, fit['way'], value) for value in sine]
    return np.abs(passed[1000:]).max()


@pytest.mark.parametrize(('band', 'centre'), [('slow', 8.0), ('fast', 14.0)])
def test_band_passes_its_frequencies_alone(band, centre):
    """Neither what drifts below 0.3 Hz nor the noise above 100 Hz."""
    record, _ = stiffness_of()
    assert gain_of_band(record[band], centre) > 0.6
    assert gain_of_band(record[band], 0.3) < 0.12
    assert gain_of_band(record[band], 100.0) < 0.1


def test_depth_is_the_way_since_the_touch():
    record, _ = stiffness_of()
    speeds = 0.01 * (1.0 + np.sin(np.arange(50)))
    estimate_stiffness(record, 0.5, 10.0, 1.0, 0.0, SPACE)  # not felt yet
    for speed in speeds:
        estimate_stiffness(record, 5.0, 10.0, speed, 0.0, SPACE)
    assert record['depth'] == pytest.approx(trapezoid(speeds, dx=H))


def test_friction_of_others_is_along_their_sliding():
    frame = np.zeros(1, dtype=FRAME)[0]
    frame['rotation'] = np.eye(3)
    frame['twist'] = 0.02, -0.01, 0.03, 0.1, 0.2, -0.3
    contacts = np.zeros(3, dtype=CONTACT)
    normals = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    contacts['normal'] = normals
    contacts['alpha_meas'] = 5.0, 8.0, -2.0  # what pulls rubs on nothing
    point = np.array([0.1, -0.05, 0.2])
    contacts['config']['point'] = point
    velocity = frame['twist'][:3] + np.cross(frame['twist'][3:], point)
    pressing = normals[1]
    sliding = velocity - (velocity @ pressing) * pressing
    direction = sliding / np.sqrt(sliding @ sliding + 0.003**2)
    friction = friction_of_others(frame, contacts, 0)
    assert friction == pytest.approx(8.0 * direction @ normals[0])


@pytest.mark.parametrize('k', [500.0, 1000.0, 1900.0, 12_000.0, 50_000.0, 60_000.0])
def test_stable_ratio_is_interpolated_over_the_logarithm_of_the_stiffness(k):
    record, _ = stiffness_of(adaptive={'lowest': 1000.0, 'highest': 50_000.0})
    record['k'] = k
    grid = np.linspace(np.log(1000.0), np.log(50_000.0), 8)
    limits = record['config']['ratio_limit']
    limits[:] = np.linspace(3.0, 1.0, 8) ** 2
    expected = np.interp(np.log(k), grid, limits)
    assert interpolate_ratio_limit(record) == pytest.approx(expected)


def test_design_that_takes_over_knows_the_surface():
    old, new = np.zeros(2, dtype=FORCE_LAW)
    old['stiffness'], old['observer'] = stiffness_of(6000.0)
    new['stiffness'], new['observer'] = stiffness_of(3000.0)
    known = old['stiffness']
    for _, speed, _, alpha in press_surface(6000.0, 20.0):
        estimate_stiffness(known, 5.0 + alpha, 10.0, speed, 0.0, SPACE)
    use_model_stiffness(old['observer'], known, 9000.0, 18.0)
    take_over_stiffness(new, old)
    assert known['k_est'] > 0.0
    assert new['stiffness'] == known
    design = new['observer']['design']
    assert_allclose(design['feedback'], old['observer']['design']['feedback'])
    assert design['damping_time'] == pytest.approx(0.002)
