"""The gymnasium environment: its contracts, its determinism, and that no action is unsafe."""

import subprocess
import sys
import warnings

import gymnasium
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from multicontact_control.errors import ConfigError, ShapeError
from multicontact_control.learning import registration
from multicontact_control.learning.rewards import (
    act_smoothly,
    EpisodeStep,
    follow_path,
    keep_contact,
    REWARDS,
    rub,
    track_force,
)
from multicontact_control.learning.worlds import tilt_normal
import numpy as np
import pytest
from ros_graph import ROOT

ARMS = {
    'rigid': {'plant': 'rigid'},
    'puma': {'plant': 'puma'},
    'panda': {'robot': 'panda', 'plant': 'rigid'},
    'iiwa': {'robot': 'iiwa', 'plant': 'rigid'},
}
RANDOM_WORLD = {
    'plant': 'rigid',
    'randomise': {
        'plant.surfaces.*.stiffness': (3000.0, 12000.0),
        'plant.surfaces.table.friction': (0.05, 0.5),
        'plant.sensor.bias': (
            [-0.5] * 3 + [-0.02] * 3,
            [0.5] * 3 + [0.02] * 3,
        ),
        'plant.actuation.scale_range': ([0.97, 1.0], [1.0, 1.03]),
    },
    'tilt': 0.1,
}


@pytest.fixture(name='make_env')
def fixture_make_env():
    """Return what makes an environment, which is closed after the test."""
    made = []

    def make(**options):
        made.append(gymnasium.make(registration.ENVIRONMENT_NAME, **options))
        return made[-1].unwrapped

    yield make
    for env in made:
        env.close()


def act(env, value=0.0):
    return np.full(env.action_space.shape, value, dtype=np.float32)


def press_action(env, force, ceiling=30.0):
    """Return the action that presses every contact with a force [N], at rest."""
    action = act(env)
    for index, name in enumerate(env.action_names):
        if name.startswith('force'):
            action[index] = 2.0 * force / ceiling - 1.0
    return action


def episode(env, seed, steps=6):
    """Return everything that an environment of a seed says in a few random steps."""
    random = np.random.default_rng(7)
    observation, _ = env.reset(seed=seed)
    said = [observation]
    for _ in range(steps):
        action = random.uniform(-1.0, 1.0, env.action_space.shape)
        observation, reward, *_ = env.step(action.astype(np.float32))
        said.append({**observation, 'reward': np.array(reward)})
    return said


def assert_equal_bits(said, others):
    assert len(said) == len(others)
    for here, there in zip(said, others):
        assert here.keys() == there.keys()
        for name in here:
            np.testing.assert_array_equal(here[name], there[name], err_msg=name)


def test_name_is_registered_by_importing_the_package_after_gymnasium():
    program = (
        'import gymnasium; from gymnasium.envs.registration import registry; '
        'import multicontact_control, sys; '
        "print('MultiContact-v0' in registry, 'pinocchio' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, '-c', program], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout.split() == ['True', 'False'], done.stderr


def test_package_loads_no_gymnasium():
    program = "import multicontact_control, sys; print('gymnasium' in sys.modules)"
    done = subprocess.run(
        [sys.executable, '-c', program], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout.split() == ['False'], done.stderr


@pytest.mark.slow
@pytest.mark.parametrize('actions', [['force', 'motion'], ['stiffness'], ['force']])
def test_environment_passes_the_checker_without_a_warning(make_env, actions):
    env = make_env(plant='rigid', actions=actions, render_mode='rgb_array')
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        check_env(env)


@pytest.mark.parametrize('arm', ['rigid', 'iiwa'])
def test_same_seed_gives_the_same_episode_bit_for_bit(make_env, arm):
    options = {**RANDOM_WORLD, **ARMS[arm]}
    first = episode(make_env(**options), 3)
    env = make_env(**options)
    episode(env, 4)  # what was before leaves no trace
    assert_equal_bits(first, episode(env, 3))
    other = episode(env, 5)
    assert (first[0]['force_measured'] != other[0]['force_measured']).all()


@pytest.mark.slow
@pytest.mark.parametrize('vector', [SyncVectorEnv, AsyncVectorEnv])
def test_vector_environment_gives_the_same_episodes_bit_for_bit(make_env, vector):
    seeds = [3, 4]
    make = [lambda: make_env(**RANDOM_WORLD)] * len(seeds)
    random = np.random.default_rng(7)
    envs = vector(make)
    try:
        observations, _ = envs.reset(seed=seeds)
        said = [
            [{name: observations[name][k] for name in observations}] for k in (0, 1)
        ]
        for _ in range(6):
            one = random.uniform(-1.0, 1.0, envs.single_action_space.shape)
            actions = np.tile(one.astype(np.float32), (len(seeds), 1))
            observations, rewards, *_ = envs.step(actions)
            for k, of_env in enumerate(said):
                row = {name: observations[name][k] for name in observations}
                of_env.append({**row, 'reward': rewards[k]})
    finally:
        envs.close()
    env = make_env(**RANDOM_WORLD)
    for seed, of_env in zip(seeds, said):
        assert_equal_bits(of_env, episode(env, seed))


def test_episode_begins_in_contact_or_at_home(make_env):
    env = make_env(plant='rigid')
    observation, info = env.reset(seed=0)
    assert info['contact_states'] == ('holding', 'holding')
    assert observation in env.observation_space
    env = make_env(plant='rigid', initial_force=0.0)
    observation, info = env.reset(seed=0)
    assert info['contact_states'] == ('free', 'free')
    np.testing.assert_array_equal(observation['force_desired'], 0.0)


def test_forces_follow_the_action_and_let_go_below_the_smallest(make_env):
    env = make_env(plant='rigid')
    env.reset(seed=0)
    for _ in range(50):
        observation, _, _, _, info = env.step(press_action(env, 12.0))
    np.testing.assert_allclose(observation['force_desired'], 12.0, atol=1e-5)
    np.testing.assert_allclose(info['force_true'], 12.0, atol=0.7)
    window = observation['force_window'].reshape(-1, 2)
    np.testing.assert_array_equal(window[-1], observation['force_measured'])
    for _ in range(50):
        observation, _, _, _, info = env.step(press_action(env, 1.0))
    assert info['contact_states'] == ('free', 'free')
    np.testing.assert_array_equal(info['force_true'], 0.0)


def test_twist_moves_the_arm_at_its_speed(make_env):
    env = make_env(plant='rigid', initial_force=0.0, speed=0.05)
    start = env.reset(seed=0)[0]['position']
    action = act(env)
    action[env.action_names.index('motion x')] = 1.0
    action[: len(env.loop.setup.controller.columns)] = -1.0  # no contact
    for _ in range(50):
        observation, *_ = env.step(action)
    moved = observation['position'] - start
    # Of 1 s, 0.1 s are the ramp to that speed.
    np.testing.assert_allclose(moved, [0.0475, 0.0, 0.0], atol=3e-3)
    assert observation['twist'][0] == pytest.approx(0.05, abs=5e-3)


def test_without_motion_as_an_action_the_scenario_moves(make_env):
    env = make_env(
        plant='rigid', actions=['force'], begin=6.5, rewards={'follow_path': 1}
    )
    start = env.reset(seed=0)[0]['position']
    for _ in range(100):
        observation, reward, *_ = env.step(press_action(env, 10.0))
    assert np.linalg.norm(observation['position'] - start) > 0.05
    assert np.linalg.norm(observation['path_error'][0]) < 3e-3
    assert -0.5 < reward < 0.0


def test_softer_motion_gives_way_to_a_push(make_env):
    deviations = []
    for stiffness in (1.0, -1.0):
        actions = ['force', 'stiffness']
        env = make_env(plant='rigid', actions=actions, initial_force=0.0)
        env.reset(seed=0)
        action = act(env, -1.0)  # no contact
        action[-1] = stiffness
        for _ in range(50):
            before, *_ = env.step(action)
        env.loop.plant.push(np.array([3.0, 0.0, 0.0]), 1.0, tool=True)
        for _ in range(20):
            after, *_, info = env.step(action)
        assert info['reaction'] == 'none'
        deviations.append(np.linalg.norm(after['position'] - before['position']))
    assert deviations[1] > 4.0 * deviations[0] > 0.0


def test_bad_actions_are_refused_or_clipped_with_a_cause(make_env):
    env = make_env(plant='rigid')
    env.reset(seed=0)
    good = press_action(env, 10.0)
    env.step(good)
    for bad in (np.nan, np.inf):
        observation, _, _, _, info = env.step(act(env, bad))
        assert 'finite' in info['refused']
        np.testing.assert_array_equal(observation['action'], good)
    observation, _, _, _, info = env.step(act(env, 1e30))
    assert info['clipped'] and not info['refused']
    np.testing.assert_array_equal(observation['action'], 1.0)
    with pytest.raises(ShapeError, match='action'):
        env.step(np.zeros(3, dtype=np.float32))


def test_motion_out_of_the_workspace_is_refused_with_its_limit(make_env):
    env = make_env(plant='rigid', initial_force=0.0, speed=0.45)
    env.reset(seed=0)
    action = act(env, 0.0)
    action[:2] = -1.0
    action[env.action_names.index('motion x')] = 1.0
    upper = env.loop.setup.controller.limits.workspace_upper
    for _ in range(200):
        observation, _, terminated, _, info = env.step(action)
        if info['refused'] or terminated:
            break
    assert info['refused']
    assert observation['position'][0] < upper[0] + 0.02


def test_episode_ends_with_its_cause_and_wants_a_reset(make_env):
    env = make_env(plant='rigid', duration=0.1)
    env.reset(seed=0)
    for _ in range(5):
        *_, terminated, truncated, info = env.step(press_action(env, 5.0))
    assert (terminated, truncated, info['ended']) == (False, True, 'duration')
    with pytest.raises(ResetNeeded, match='duration'):
        env.step(act(env))
    env.reset(seed=0)
    env.loop.plant.push(np.array([0.0, 0.0, 150.0]), 1.0)
    *_, terminated, truncated, info = env.step(press_action(env, 5.0))
    assert (terminated, truncated) == (True, False)
    assert info['ended'].startswith('hold: collision')


def test_worlds_are_drawn_within_their_bounds(make_env):
    env = make_env(**RANDOM_WORLD)
    drawn = []
    for seed in range(4):
        _, info = env.reset(seed=seed)
        plant = env.loop.setup.plant
        for name, (lower, upper) in RANDOM_WORLD['randomise'].items():
            value = np.array(info['drawn'][name])
            assert (value >= lower).all() and (value <= upper).all()
        stiffness = info['drawn']['plant.surfaces.*.stiffness']
        assert {s.stiffness for s in map(plant.surfaces.get, plant.touched)} == {
            stiffness
        }
        table = env.loop.setup.controller.contacts['table'].normal_world
        assert np.cos(0.1) <= np.dot(plant.surfaces['table'].normal_world, table) < 1.0
        drawn.append((stiffness, plant.actuation.seed, env.loop.setup.seed))
    assert len(set(drawn)) == 4


def test_tilted_normal_has_unit_length_and_at_most_its_angle():
    random = np.random.default_rng(0)
    normal = np.array([0.0, 0.0, -1.0])
    for _ in range(100):
        tilted = tilt_normal(normal, 0.2, random)
        assert np.linalg.norm(tilted) == pytest.approx(1.0)
        assert normal @ tilted >= np.cos(0.2) - 1e-12


@pytest.mark.parametrize(
    ('options', 'field'),
    [
        ({'rate': 30.0}, 'rate'),
        ({'actions': ['force', 'force']}, 'actions'),
        ({'rewards': {'unknown': 1.0}}, 'rewards'),
        ({'settings': {'plant.unknown': 1.0}}, 'plant.unknown'),
        ({'randomise': {'plant.surfaces.*.friction': (0.1, 9.0)}}, 'friction'),
        ({'render_mode': 'human'}, 'render_mode'),
        ({'anything': 1}, 'anything'),
    ],
)
def test_options_that_are_not_acceptable_are_named(options, field):
    from multicontact_control.learning.environment import MultiContactEnv

    with pytest.raises(ConfigError, match=field):
        MultiContactEnv(**{'plant': 'rigid', **options})


@pytest.mark.parametrize('engine', ['pybullet', 'mujoco'])
def test_picture_shows_the_arm_move(make_env, engine, monkeypatch):
    if engine == 'mujoco':
        monkeypatch.setenv('MUJOCO_GL', 'egl')
        program = 'import mujoco; mujoco.GLContext(8, 8)'
        if subprocess.run([sys.executable, '-c', program]).returncode:
            pytest.skip('needs a MuJoCo that draws without a screen')
    env = make_env(
        settings={'plant.engine': engine}, plant='rigid', render_mode='rgb_array'
    )
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (360, 480, 3) and before.dtype == np.uint8
    action = press_action(env, 5.0)
    action[env.action_names.index('motion x')] = 1.0
    for _ in range(50):
        env.step(action)
    assert (env.render() != before).any(axis=2).mean() > 0.01


def step_with(**fields):
    still = {
        'forces': np.full((4, 2), 10.0),
        'forces_target': np.array([10.0, 10.0]),
        'sideways_load': np.zeros(4),
        'path_error': np.zeros(3),
        'action': np.zeros(3),
        'action_before': np.zeros(3),
    }
    return EpisodeStep(**{**still, **fields})


def test_reward_of_force_counts_the_mean_error():
    assert track_force(step_with()) == 0.0
    assert track_force(step_with(forces_target=np.array([10.0, 5.0]))) == -0.25


def test_reward_of_path_counts_the_distance():
    assert follow_path(step_with()) == 0.0
    error = np.array([3e-3, 0.0, 4e-3])
    assert follow_path(step_with(path_error=error)) == pytest.approx(-0.5)


def test_reward_of_rubbing_is_largest_at_the_rated_load():
    loads = np.linspace(0.0, 8.0, 81)
    rewards = [rub(step_with(sideways_load=np.full(4, load))) for load in loads]
    assert loads[np.argmax(rewards)] == pytest.approx(4.0)
    assert max(rewards) == pytest.approx(1.0)
    assert rewards[0] == 0.0
    assert rewards[-1] == pytest.approx(-3.0)


def test_reward_of_contact_is_the_share_of_pressed_samples():
    forces = np.array([[10.0, 10.0], [0.0, 10.0], [10.0, 0.0], [10.0, 10.0]])
    assert keep_contact(step_with(forces=forces)) == 0.5
    one = step_with(forces=forces, forces_target=np.array([10.0, 0.0]))
    assert keep_contact(one) == 0.75


def test_reward_of_smoothness_counts_the_change():
    assert act_smoothly(step_with()) == 0.0
    assert act_smoothly(step_with(action=np.array([0.0, 0.0, 0.3]))) == pytest.approx(
        -0.03
    )


def test_rewards_are_added_by_their_weights(make_env):
    weights = {name: 0.1 * (k + 1) for k, name in enumerate(REWARDS)}
    env = make_env(plant='rigid', rewards=weights)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(act(env, 0.1))
    assert info['rewards'].keys() == weights.keys()
    expected = sum(weights[name] * info['rewards'][name] for name in weights)
    assert reward == pytest.approx(expected)


def adversarial_actions(size, random):
    """Yield actions of an enemy without end: numbers that are none, huge, alternating, random."""
    while True:
        kind = random.integers(6)
        sign = random.choice([-1.0, 1.0], size)
        for step in range(int(random.integers(1, 40))):
            action = sign.copy()
            if kind == 0:
                action[random.integers(size)] = random.choice([np.nan, np.inf, -np.inf])
            elif kind == 1:
                action *= 1e30
            elif kind == 2:
                action *= (-1.0) ** step
            elif kind == 3:
                action = random.uniform(-1.0, 1.0, size)
            elif kind == 4:
                action *= random.uniform(0.0, 1.0)
            yield action.astype(np.float32)


class Watch:
    """Keeps the largest torque, speeds and force of a loop, relative to their limits."""

    def __init__(self):
        self.largest = {}

    def follow(self, loop):
        """See every tick of a loop from now on."""
        advance = loop.advance
        config = loop.setup.controller
        limits = config.limits

        def watched():
            output = advance()
            twist = output.controls['frame'][0]['twist']
            sample = loop.sample
            self.note('torque', loop.command, np.array(config.torque_limit))
            if limits.joint_speed:
                self.note('joint speed', sample.qd, np.array(limits.joint_speed))
            self.note('speed', np.linalg.norm(twist[:3]), limits.operational_speed)
            self.note('turn', np.linalg.norm(twist[3:]), limits.operational_turn)
            ceiling = config.contact_state.force_ceiling
            self.note('force', sample.contact_force, ceiling)
            return output

        loop.advance = watched

    def note(self, name, values, limit):
        share = float(np.abs(values / limit).max())
        assert np.isfinite(share), name
        self.largest[name] = max(self.largest.get(name, 0.0), share)


def attack(env, steps):
    """Give an environment the actions of an enemy; return the `Watch`, and how episodes ended."""
    random = np.random.default_rng(1)
    watch = Watch()
    ends = []
    env.reset(seed=2)
    watch.follow(env.loop)
    actions = adversarial_actions(env.action_space.shape[0], random)
    for _, action in zip(range(steps), actions):
        observation, reward, terminated, truncated, info = env.step(action)
        assert observation in env.observation_space
        assert np.isfinite(reward)
        if not np.isfinite(action).all():
            assert 'finite' in info['refused']
        if terminated or truncated:
            assert info['ended']
            ends.append(info['ended'])
            env.reset()
            watch.follow(env.loop)
    return watch, ends


def assert_safe(watch):
    for name, share in watch.largest.items():
        assert share <= 1.0 + 1e-9, (name, share)


@pytest.mark.slow
def test_no_action_of_an_enemy_is_unsafe(make_env):
    env = make_env(plant='rigid', actions=['force', 'motion', 'stiffness'])
    watch, ends = attack(env, 1000)
    assert_safe(watch)
    assert set(ends) == {'duration'}  # the supervisor has never stopped the arm
    assert watch.largest['torque'] > 0.2  # it has been moved


@pytest.mark.nightly
@pytest.mark.parametrize('arm', ARMS)
def test_no_action_of_an_enemy_is_unsafe_for_long(make_env, arm):
    env = make_env(**ARMS[arm], actions=['force', 'motion', 'stiffness'])
    watch, ends = attack(env, 10_000)
    assert_safe(watch)
    # An episode may end, as long as it ends in a hold.
    assert set(ends) <= {'duration', 'hold: wrench_pull'}
