"""What is left of an action: forces, twists and a stiffness that end no episode."""

import gymnasium
from multicontact_control.dynamics.rotations import rotation_vector_between
from multicontact_control.learning import registration
from multicontact_control.learning.limiting import (
    FORCE_RATE,
    FREE_TIME,
    LEVER,
    nearest_within,
    WRENCH_SHARE,
)
import numpy as np
import pytest
from scipy.optimize import minimize


@pytest.fixture(name='make_env')
def fixture_make_env():
    """Return what makes an environment, which is closed after the test."""
    made = []

    def make(**options):
        env = gymnasium.make(registration.ENVIRONMENT_NAME, plant='rigid', **options)
        made.append(env)
        env.unwrapped.reset(seed=0)
        return env.unwrapped

    yield make
    for env in made:
        env.close()


def command(env, **parts):
    """Return an action: forces of all contacts [N], and the other numbers by their names."""
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for index, name in enumerate(env.action_names):
        if name.startswith('force'):
            action[index] = 2.0 * parts.get('force', 5.0) / 30.0 - 1.0
        else:
            action[index] = parts.get(name.replace(' ', '_'), 0.0)
    return action


def minimise_distance(twist, rows, bounds):
    """Return the nearest twist within bounds by sequential quadratic programming."""
    scale = np.repeat([1.0, LEVER], 3)
    return minimize(
        lambda x: np.square(scale * (x - twist)).sum(),
        np.zeros(6),
        constraints={'type': 'ineq', 'fun': lambda x: bounds - rows @ x},
        options={'ftol': 1e-14, 'maxiter': 500},
    ).x


def test_nearest_twist_is_that_of_another_optimiser():
    random = np.random.default_rng(0)
    changed = 0
    for _ in range(20):
        twist = random.standard_normal(6)
        rows = random.standard_normal((3, 6))
        bounds = random.uniform(-0.5, 1.0, 3)
        nearest, multipliers = nearest_within(twist, rows, bounds)
        reference = minimise_distance(twist, rows, bounds)
        np.testing.assert_allclose(nearest, reference, atol=1e-5)
        assert (multipliers >= 0.0).all()
        changed += (np.abs(nearest - twist) > 1e-3).any()
    assert 10 < changed


def test_force_changes_at_a_bounded_rate_and_info_says_so(make_env):
    env = make_env()
    before = 5.0
    for force in (20.0, 20.0, 20.0, 6.0, 6.0):
        observation, *_, info = env.step(command(env, force=force))
        desired = observation['force_desired']
        step = FORCE_RATE / env.config.rate
        assert (np.abs(desired - before) <= step + 1e-9).all()
        assert ('force' in info['limited']) == bool((abs(desired - force) > 1e-4).any())
        before = desired
    for _ in range(20):
        observation, *_, info = env.step(command(env, force=20.0))
    np.testing.assert_allclose(observation['force_desired'], 20.0, atol=1e-5)
    assert info['limited'] == ()


def test_contact_is_sought_anew_only_off_its_surface(make_env):
    env = make_env()
    while env.step(command(env, force=0.0))[-1]['contact_states'] != ('free', 'free'):
        pass
    pressed = env.loop.sample.contact_force.max() > 1.0
    steps = 0
    states = ('free', 'free')
    while states == ('free', 'free'):
        assert steps < 100
        before = env.loop.sample.contact_force.copy()
        *_, info = env.step(command(env, force=10.0))
        states = info['contact_states']
        steps += 1
    assert pressed
    np.testing.assert_array_equal(before, 0.0)
    assert steps >= FREE_TIME * env.config.rate
    assert 'contact being made' in info['limited']
    for _ in range(150):
        observation, *_, info = env.step(command(env, force=10.0))
    assert info['contact_states'] == ('holding', 'holding')
    np.testing.assert_allclose(info['force_true'], 10.0, atol=0.7)


def test_tip_that_is_not_pressed_is_kept_off_its_surface(make_env):
    """It goes there no faster than an approach, and back from what it feels."""
    env = make_env()
    force = 0.0
    limited = set()
    for _ in range(150):
        action = command(env, force=0.0, motion_z=-1.0)
        *_, terminated, _, info = env.step(action)
        assert not terminated
        limited.update(info['limited'])
        if info['contact_states'] == ('free', 'free'):
            force = max(force, info['force_true'].max())
    assert 'motion to a surface' in limited
    assert 0.0 < force < 15.0


def test_tool_tilts_no_farther_than_its_largest(make_env):
    env = make_env(largest_tilt=0.2)
    start = env.loop.control.supervisor.task.reference_pose().rotation_world
    tilts = []
    action = command(env, motion_about_x=1.0, motion_about_z=-1.0)
    for _ in range(60):
        *_, terminated, _, info = env.step(action)
        assert not terminated
        rotation = env.loop.control.supervisor.task.reference_pose().rotation_world
        tilts.append(np.linalg.norm(rotation_vector_between(rotation, start)))
    assert 'tilt of the tool' in info['limited']
    assert 0.19 < max(tilts) < 0.205
    for _ in range(20):
        env.step(-action)
    rotation = env.loop.control.supervisor.task.reference_pose().rotation_world
    assert np.linalg.norm(rotation_vector_between(rotation, start)) < 0.15


def test_forces_keep_to_the_range_of_the_wrist_sensor(make_env):
    env = make_env()
    scale = np.array(env.loop.setup.controller.sensor.full_scale)
    limited = set()
    for _ in range(100):
        action = command(env, force=30.0, motion_x=1.0, motion_about_x=-1.0)
        observation, *_, terminated, _, info = env.step(action)
        assert not terminated
        limited.update(info['limited'])
    assert 'range of the wrist sensor' in limited
    load = np.abs(observation['wrench'] / scale).max()
    assert 0.7 * WRENCH_SHARE < load < 1.2 * WRENCH_SHARE


def test_stiffness_changes_slowly(make_env):
    env = make_env(actions=['stiffness'])
    frequencies = []
    limited = []
    for _ in range(60):
        *_, info = env.step(command(env, stiffness_natural_frequency=-1.0))
        frequencies.append(env.loop.control.config.motion.natural_frequency)
        limited.append('stiffness' in info['limited'])
    assert (np.diff(np.log(frequencies)) > -0.0401).all()
    assert frequencies[-1] == pytest.approx(30.0 / 4.0)
    assert limited[0] and not limited[-1]
