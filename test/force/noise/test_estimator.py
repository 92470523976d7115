"""What holds for every estimator, whatever comes."""

from force_loop import estimator_of
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise import ESTIMATORS, Innovation, make_noise_estimator
from multicontact_control.force.noise.base import VARIANCE_CEILING, VARIANCE_FLOOR
import numpy as np
import pytest

NAMES = sorted(ESTIMATORS)
FLOOR, CEILING = 0.1, 50.0


def _sample(rng, contacts=2, size=1.0):
    return size * rng.standard_normal(contacts), Innovation(
        size * rng.standard_normal(contacts), size ** 2 * rng.uniform(0.1, 1.0, contacts),
        rng.uniform(FLOOR, CEILING, contacts))


@pytest.mark.parametrize('place', ['alpha', 'innovation', 'prior_variance', 'variance_used'])
@pytest.mark.parametrize('name', NAMES)
def test_estimators_drop_and_count_samples_that_are_not_finite(name, place):
    estimator, untouched = (estimator_of(name, contacts=2) for _ in range(2))
    rng = np.random.default_rng(6)
    for k in range(200):
        alpha, innovation = _sample(rng)
        R = estimator.update(alpha, innovation)
        np.testing.assert_array_equal(R, untouched.update(alpha, innovation))
        if k % 10 == 3:
            values = alpha if place == 'alpha' else getattr(innovation, place)
            values[k % 2] = (np.nan, np.inf, -np.inf, 1e200)[k // 10 % 4]
            if place == 'alpha' or estimator.uses_innovation:
                np.testing.assert_array_equal(estimator.update(alpha, innovation), R)
    assert estimator.dropped == (20 if place == 'alpha' or estimator.uses_innovation else 0)
    assert untouched.dropped == 0


@pytest.mark.parametrize('name', NAMES)
@settings(max_examples=8, deadline=None)
@given(sizes=st.lists(
    st.sampled_from([0.0, 1e-120, 1e-3, 1.0, 1e3, 1e40]), min_size=1, max_size=5),
    seed=st.integers(0, 1000))
def test_estimators_keep_within_floor_and_ceiling(name, sizes, seed):
    estimator = estimator_of(name, contacts=2)
    rng = np.random.default_rng(seed)
    for size in [*sizes, 0.0]:
        for _ in range(600 if size == 0.0 else 60):
            R = estimator.update(*_sample(rng, size=size))
            assert (R >= VARIANCE_FLOOR).all() and (R <= VARIANCE_CEILING).all()
    assert estimator.dropped == 0
    if name != 'fixed':
        np.testing.assert_array_equal(R, VARIANCE_FLOOR)


@pytest.mark.parametrize('name', NAMES)
def test_estimators_scale_what_they_estimate_and_reset_forgets_all_samples(name):
    plain, scaled = (estimator_of(name, variance_scale=scale) for scale in (1.0, 3.0))
    runs = []
    for _ in range(2):
        rng = np.random.default_rng(25)
        samples = [_sample(rng, contacts=1) for _ in range(1500)]
        runs.append([(plain.update(*each), scaled.update(*each)) for each in samples])
        plain.reset(), scaled.reset()
    np.testing.assert_array_equal(*runs)
    values = runs[0][-1]
    np.testing.assert_allclose(values[1], values[0] * (1.0 if name == 'fixed' else 3.0), rtol=1e-4)


@pytest.mark.parametrize('name', NAMES)
def test_slew_time_bounds_how_fast_every_estimate_changes(name):
    """By a factor e in 0.03 s, which is 15 samples."""
    config = NoiseEstimatorConfig(estimator=name, contact_names=('a', 'b'), slew_time=0.03)
    plain = make_noise_estimator(config.model_copy(update={'slew_time': 0.0}))
    estimator, random = make_noise_estimator(config), np.random.default_rng(0)
    before, one = np.full(2, config.fixed_variance), np.ones(2)
    for k in range(600):
        alpha = 10.0 * (k > 300) + random.standard_normal(2) * (1.0 if k < 450 else 5.0)
        innovation = Innovation(alpha, one, one)
        found, free = estimator.update(alpha, innovation), plain.update(alpha, innovation)
        assert (np.abs(np.log(found / before)) <= 1.0 / 15.0 + 1e-12).all()
        assert ((found >= np.minimum(free, before)) & (found <= np.maximum(free, before))).all()
        before = found
