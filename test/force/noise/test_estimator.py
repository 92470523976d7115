"""Noise estimators: properties of all, and the formulas of each (P04 eqs 42-44)."""

from dataclasses import astuple

from force_loop import estimator_of, observer_of, run_force_loop
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.force.noise import Innovation
from multicontact_control.force.noise.innovation import corrected_square
from multicontact_control.force.noise.window import design_lead_filter
from multicontact_control.registry import NOISE_ESTIMATORS
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.signal import freqz, lfilter, lfilter_zi

NAMES = sorted(NOISE_ESTIMATORS)
FLOOR, CEILING = 0.1, 50.0


def make_sample(rng, contacts=2, size=1.0):
    """Return forces and an innovation as large."""
    alpha = size * rng.standard_normal(contacts)
    innovation = size * rng.standard_normal(contacts)
    prior_variance = size**2 * rng.uniform(0.1, 1.0, contacts)
    variance_used = rng.uniform(FLOOR, CEILING, contacts)
    return alpha, Innovation(innovation, prior_variance, variance_used)


BROKEN = (np.nan, np.inf, -np.inf, 1e200)


@pytest.mark.parametrize(
    'place', ['alpha', 'innovation', 'prior_variance', 'variance_used']
)
@pytest.mark.parametrize('name', NAMES)
def test_estimators_drop_and_count_samples_that_are_not_finite(name, place):
    estimator = estimator_of(name, contacts=2)
    untouched = estimator_of(name, contacts=2)
    if place != 'alpha' and not estimator.uses_innovation:
        return
    rng = np.random.default_rng(6)
    for k in range(20):
        for _ in range(10):
            sample = make_sample(rng)
            R = estimator.update(*sample)
            assert_array_equal(R, untouched.update(*sample))
        alpha, innovation = make_sample(rng)
        values = alpha
        if place != 'alpha':
            values = getattr(innovation, place)
        values[k % 2] = BROKEN[k // 2 % 4]
        assert_array_equal(estimator.update(alpha, innovation), R)
    assert estimator.dropped == 20
    assert untouched.dropped == 0


@pytest.mark.parametrize('name', NAMES)
@settings(max_examples=8, deadline=None)
@given(
    sizes=st.lists(
        st.sampled_from([0.0, 1e-120, 1e-3, 1.0, 1e3, 1e40]), min_size=1, max_size=5
    ),
    seed=st.integers(0, 1000),
)
def test_estimators_keep_within_floor_and_ceiling(name, sizes, seed):
    estimator = estimator_of(name, contacts=2)
    rng = np.random.default_rng(seed)
    for size in sizes:
        for _ in range(60):
            R = estimator.update(*make_sample(rng, size=size))
            assert (R >= 0.1).all()
            assert (R <= 1000.0).all()
    for _ in range(600):
        R = estimator.update(*make_sample(rng, size=0.0))
    assert estimator.dropped == 0
    if name != 'fixed':
        assert_array_equal(R, 0.1)
        assert estimator.bounded.min() > 0


@pytest.mark.parametrize('name', NAMES)
def test_estimators_repeat_r_while_forces_only_repeat_the_last_reading(name):
    estimator = estimator_of(name, contacts=2)
    untouched = estimator_of(name, contacts=2)
    rng = np.random.default_rng(9)
    for _ in range(120):
        sample = make_sample(rng)
        R = estimator.update(*sample)
        assert_array_equal(R, untouched.update(*sample))
    for _ in range(estimator.config.window):
        assert_array_equal(estimator.update(*sample, measured=False), R)
    sample = make_sample(rng)
    assert_array_equal(estimator.update(*sample), untouched.update(*sample))


@pytest.mark.parametrize('name', NAMES)
def test_estimators_do_not_take_another_force_after_an_outage_for_noise(name):
    estimator = estimator_of(name, contacts=2)
    rng = np.random.default_rng(9)
    for _ in range(120):
        alpha, innovation = make_sample(rng)
        estimator.update(10.0 + alpha, innovation)
    for _ in range(estimator.config.window + 1):
        estimator.update(10.0 + alpha, innovation, measured=False)
    anew = estimator_of(name, contacts=2)
    for _ in range(120):
        sample = make_sample(rng)
        assert_array_equal(estimator.update(*sample), anew.update(*sample))


def estimate_variances(estimator, samples):
    return [estimator.update(*sample) for sample in samples]


@pytest.mark.parametrize('name', NAMES)
def test_estimators_scale_what_they_estimate(name):
    plain = estimator_of(name)
    scaled = estimator_of(name, variance_scale=3.0)
    expected = 3.0
    if name == 'fixed':
        expected = 1.0
    rng = np.random.default_rng(25)
    for _ in range(1500):
        sample = make_sample(rng, contacts=1)
        R = plain.update(*sample)
        R_scaled = scaled.update(*sample)
    assert_allclose(R_scaled, expected * R, rtol=1e-4)


@pytest.mark.parametrize('name', NAMES)
def test_reset_forgets_all_samples(name):
    estimator = estimator_of(name)
    rng = np.random.default_rng(25)
    samples = [make_sample(rng, contacts=1) for _ in range(200)]
    values = estimate_variances(estimator, samples)
    estimator.reset()
    assert_array_equal(estimate_variances(estimator, samples), values)


@pytest.mark.parametrize('name', NAMES)
def test_slew_time_bounds_how_fast_every_estimate_changes(name):
    """By a factor e in 0.03 s, which is 15 samples."""
    estimator = estimator_of(name, 2, slew_time=0.03)
    plain = estimator_of(name, 2, slew_time=0.0)
    noise = np.random.default_rng(0).standard_normal((600, 2))
    noise[450:] *= 5.0
    noise[301:] += 10.0
    before = np.full(2, 0.6)
    one = np.ones(2)
    for alpha in noise:
        innovation = Innovation(alpha, one, one)
        R = estimator.update(alpha, innovation)
        free = plain.update(alpha, innovation)
        assert (np.abs(np.log(R / before)) <= 1.0 / 15.0 + 1e-12).all()
        assert (R >= np.minimum(free, before)).all()
        assert (R <= np.maximum(free, before)).all()
        before = R


RATE = 500.0


def coefficients_of(lead_filter):
    """Return numerator and denominator, in powers of z^-1."""
    gain = lead_filter.gain
    return [gain, -gain * lead_filter.zero], [1.0, -lead_filter.pole]


@pytest.mark.parametrize(
    ('normalisation', 'at_dc', 'at_nyquist', 'factor'),
    [('dc', 1.0, 19.1, 269.0), ('hf', 1.0 / 19.1, 1.0, 269.0 / 366.0)],
)
def test_lead_filter_has_the_papers_gains(normalisation, at_dc, at_nyquist, factor):
    """Zero and pole at 3 and 60 Hz, and what is left of white noise."""
    f = design_lead_filter(3.0, 60.0, RATE, normalisation)
    frequencies = -np.log([f.zero, f.pole]) * RATE / (2 * np.pi)
    assert_allclose(frequencies, [3.0, 60.0], rtol=1e-12)
    numerator, denominator = coefficients_of(f)
    _, response = freqz(numerator, denominator, worN=[0.0, np.pi])
    assert_allclose(np.abs(response), [at_dc, at_nyquist], rtol=0.01)
    impulse = lfilter(numerator, denominator, np.eye(400)[0])
    assert impulse @ impulse == pytest.approx(factor, rel=0.01)


@pytest.mark.parametrize(
    ('name', 'normalisation'),
    [('window', None), ('lead_window', 'dc'), ('hf_window', 'hf')],
)
def test_window_is_the_variance_of_what_scipy_filters(name, normalisation):
    """From its steady state at the first sample, over 50 samples, known once there are 50."""
    estimator = estimator_of(name, contacts=2)
    noise = np.random.default_rng(15).standard_normal((120, 2))
    forces = np.linspace(0.0, 30.0, 120)[:, None] + noise
    filtered = forces
    if normalisation:
        f = design_lead_filter(3.0, 60.0, RATE, normalisation)
        numerator, denominator = coefficients_of(f)
        zi = lfilter_zi(numerator, denominator)[:, None] * forces[0]
        filtered, _ = lfilter(numerator, denominator, forces, axis=0, zi=zi)
    values = np.array([estimator.update(force) for force in forces])
    assert (values[:49] == 0.6).all()
    windows = sliding_window_view(filtered, 50, axis=0)
    assert_allclose(values[49:], windows.var(axis=-1), rtol=1e-9)


ADAPTIVE = ['innovation', 'sage_husa', 'variational_bayes']
FORCE = np.array([10.0])


def make_innovations(seed, count=60):
    rng = np.random.default_rng(seed)
    return [make_sample(rng, contacts=1)[1] for _ in range(count)]


def test_corrected_square_is_that_of_the_observers_residual_and_posterior_variance():
    """Test e = y - C x and C P C^T, from r, C P_1 C^T and R alone; 0 where there is none."""
    observer = observer_of()
    rng = np.random.default_rng(17)
    for _ in range(20):
        force = rng.standard_normal()
        variance = 10.0 ** rng.uniform(-3, 3)
        observer.update(force, variance)
        observer.command(1.0)
    observed = observer.innovation
    innovation = Innovation(
        np.append(observed.innovation, 0.0),
        np.append(observed.prior_variance, 0.0),
        np.append(observed.variance_used, 0.0),
    )
    assert_array_equal(innovation.valid, [True, False])
    square = corrected_square(innovation, innovation.variance_used)
    expected = (force - observer.x_est[0]) ** 2 + observer.P[0, 0]
    assert_allclose(square, [expected, 0.0], rtol=1e-9)


def test_innovation_is_the_mean_over_the_window_within_its_floor():
    """(1/N) sum [r r^T - C P_1 C^T], once there are N."""
    estimator = estimator_of('innovation')
    innovations = make_innovations(18, count=80)
    values = [estimator.update(FORCE, innovation)[0] for innovation in innovations]
    assert values[:49] == [0.6] * 49
    squares = [each.innovation[0] ** 2 for each in innovations]
    prior_variances = [each.prior_variance[0] for each in innovations]
    excess = np.subtract(squares, prior_variances)
    means = sliding_window_view(excess, 50).mean(axis=1)
    assert_allclose(values[49:], np.maximum(means, 0.1), rtol=1e-10)
    small = Innovation(np.array([0.1]), np.array([6.4]), np.array([0.6]))
    for _ in range(50):
        R = estimator.update(FORCE, small)
    assert R == 0.1


def test_sage_husa_is_its_recursion():
    """R_k = (1 - d_k) R_k-1 + d_k (e e^T + C P C^T), d_k = (1 - b) / (1 - b^k)."""
    estimator = estimator_of('sage_husa', window=10)
    R = 123.0  # forgotten with d_1 = 1
    for k, innovation in enumerate(make_innovations(19), start=1):
        d = (1.0 - 0.9) / (1.0 - 0.9**k)
        (r,) = innovation.innovation
        (p,) = innovation.prior_variance
        (R_used,) = innovation.variance_used
        unexplained = R_used / (p + R_used)
        e = r * unexplained
        CPC = p * unexplained
        R = (1.0 - d) * R + d * (e * e + CPC)
        assert estimator.update(FORCE, innovation)[0] == pytest.approx(R, rel=1e-12)


def test_variational_bayes_is_its_fixed_point_iteration():
    """Check alpha + 1/2 and beta + e^2/2 + C P C^T/2, written out for one contact."""
    estimator = estimator_of('variational_bayes', window=20)
    alpha = 0.5 / 0.05
    beta = alpha * 0.6
    for innovation in make_innovations(20):
        (r,) = innovation.innovation
        (p,) = innovation.prior_variance
        alpha = 0.95 * alpha + 0.5
        beta_prior = 0.95 * beta
        for _ in range(3):
            gain = p / (p + beta / alpha)
            e = (1.0 - gain) * r
            CPC = (1.0 - gain) * p
            beta = beta_prior + 0.5 * e**2 + 0.5 * CPC
        (R,) = estimator.update(FORCE, innovation)
        assert R == pytest.approx(beta / alpha, rel=1e-12)


@pytest.mark.parametrize('name', ADAPTIVE)
def test_estimators_find_the_variance_of_white_noise_and_follow_its_rise(name):
    """In their own loop: from 0.6 at rest to 100 in motion, as in the paper's Fig. 6."""
    noise = np.random.default_rng(21).standard_normal(6000)
    noise[:3000] *= np.sqrt(0.6)
    noise[3000:] *= 10.0
    variance = run_force_loop(estimator_of(name), noise)
    assert variance[500:3000].mean() == pytest.approx(0.6, rel=0.15)
    assert 50.0 < np.median(variance[3250:3500]) < 200.0  # a few windows later
    assert variance[3500:].mean() == pytest.approx(100.0, rel=0.15)


@pytest.mark.parametrize('name', ADAPTIVE)
def test_estimators_leave_out_an_inactive_contact(name):
    rng = np.random.default_rng(24)
    both = estimator_of(name, contacts=2)
    alone = estimator_of(name)
    for _ in range(200):
        forces, innovation = make_sample(rng)
        acts = rng.random() < 0.5
        values = np.array(astuple(innovation))
        before = both.update(forces)
        R = both.update(forces, Innovation(*(values * [1.0, acts])))
        expected = before[1]
        if acts:
            expected = alone.update(forces[1:], Innovation(*values[:, 1:]))[0]
        assert R[1] == pytest.approx(expected, rel=1e-12)


def test_innovation_is_too_sensitive_to_a_force_on_another_contact():
    """A noise-free step of 5 N lifts R five times higher than with the filter (P04 sec. 4.2)."""
    step = 5.0 * (np.arange(600) >= 300)
    of_innovation = run_force_loop(estimator_of('innovation'), leak=step)
    of_filter = run_force_loop(estimator_of('hf_window'), leak=step)
    assert of_innovation[300:].max() > 5.0 * of_filter[300:].max()
