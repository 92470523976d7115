import json

from arms import plant_config
from multicontact_control.cli.application import app
from multicontact_control.errors import ConfigError
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from robots import ENGINES
from sim_bridge.actuation import ActuationErrors
from sim_bridge.drives import DRIVE
from typer.testing import CliRunner

SUBSTEP = 5e-4  # s
SUBSTEP_RATE = 2000.0  # Hz, of a control period of one substep
FREE = {'contact_names': (), 'joint_friction_scale': 0.0, 'substep': SUBSTEP}
# The published benchmark's errors of a robot of six joints.
BENCHMARK = {
    'seed': 19,
    'scale_range': [0.8, 1.2],
    'bias_range': [2.0, 2.0],
    'noise_std': [0.03, 0.03, 0.02, 0.02, 0.01, 0.01],
    'delay_substeps': 1,
    'coulomb_friction': [1.0],
    'viscous_friction': [0.5],
}
WITHOUT_NOISE = {**BENCHMARK, 'noise_std': []}
WITHOUT_FRICTION = {
    **WITHOUT_NOISE,
    'coulomb_friction': [],
    'viscous_friction': [],
}
STILL = np.zeros(6)  # rad/s


def make_errors(**actuation):
    """Return the errors of actuation of the PUMA, from no torque on."""
    errors = ActuationErrors(
        plant_config('rigid', substep=SUBSTEP, actuation=actuation)
    )
    errors.reset(np.zeros(6), np.random.default_rng(0))
    return errors


def act(errors, commands):
    """Return the torques on joints at rest in each substep, of commands of one substep each."""
    acting = np.zeros((len(commands), 6))
    no_rotors = np.zeros(0, dtype=DRIVE)
    for command, torque in zip(commands, acting):
        errors.begin_period(command)
        errors.find_acting_torque(STILL, no_rotors, torque)
    return acting


def record_samples(plant):
    """Let a free arm swing; return every number of every sample."""
    samples = [plant.reset()]
    swing = np.array([6.0, 4.0, 3.0, 0.4, 0.3, 0.2])
    for tick in range(100):
        torque = plant.initial_torque + np.sin(0.05 * tick) * swing
        samples.append(plant.step(torque))
    return b''.join(part.tobytes() for sample in samples for part in sample)


def test_draws_are_those_of_numpys_global_generator():
    """Scales of all joints come first, then the biases."""
    state = np.random.get_state()
    np.random.seed(19)
    scale = np.random.uniform(0.8, 1.2, 6)
    bias = np.random.uniform(-1.0, 3.0, 6)
    np.random.set_state(state)
    errors = make_errors(seed=19, scale_range=[0.8, 1.2], bias_range=[-1.0, 3.0])
    assert_array_equal(errors.actuators['scale'], scale)
    assert_array_equal(errors.actuators['bias'], bias)


@pytest.mark.parametrize('engine', ENGINES)
@pytest.mark.parametrize('preset', ['rigid', 'puma'])
@pytest.mark.parametrize('delay', [0, 3])
def test_constant_command_acts_scaled_shifted_and_less_friction_after_the_delay(
    make_plant, engine, preset, delay
):
    """The friction is that of the joint speed, which the sample before shows."""
    actuation = {**WITHOUT_NOISE, 'delay_substeps': delay}
    plant = make_plant(
        preset, rate=SUBSTEP_RATE, engine=engine, actuation=actuation, **FREE
    )
    generator = np.random.RandomState(19)
    scale = generator.uniform(0.8, 1.2, 6)
    command = plant.initial_torque + [5.0, 3.0, -4.0, 0.5, 0.4, 0.3]
    qd = plant.reset().qd
    for tick in range(30):
        driven = scale * command + 2.0
        if tick < delay:
            driven = plant.initial_torque
        friction = np.tanh(10.0 * qd) + 0.5 * qd
        sample = plant.step(command)
        assert_allclose(sample.effort, driven - friction, rtol=0.0, atol=1e-12)
        qd = sample.qd
    assert np.abs(qd).max() > 0.1


def test_effort_is_the_mean_of_the_torques_that_acted_in_the_period(make_plant):
    """With a delay of one substep, the first of four still has the torque before."""
    plant = make_plant(actuation={'delay_substeps': 1}, rate=SUBSTEP_RATE / 4.0, **FREE)
    step = np.array([8.0, 4.0, 2.0, 1.0, 0.5, 0.25])
    effort = plant.step(plant.initial_torque + step).effort
    assert_allclose(effort, plant.initial_torque + 0.75 * step, atol=1e-12)


def test_acting_torque_stays_within_the_limit(make_plant, puma):
    plant = make_plant(actuation={'scale_range': [1.2, 1.2]}, **FREE)
    sample = plant.step(np.array(puma.torque_limit))
    assert_array_equal(sample.effort, puma.torque_limit)


def test_torque_loop_leaves_its_static_error_without_integral():
    """From driven = a u + b and u = wanted - k_p e: e = ((a - 1) wanted + b) / (1 + k_p a)."""
    errors = make_errors(**WITHOUT_FRICTION, torque_loop=True, torque_loop_integral=0.0)
    wanted = np.array([60.0, -40.0, 20.0, 5.0, -3.0, 0.0])
    acting = act(errors, [wanted] * 1000)
    scale = errors.actuators['scale']
    expected = ((scale - 1.0) * wanted + 2.0) / (1.0 + 0.7 * scale)
    assert_allclose(acting[-1] - wanted, expected, atol=1e-9)


def test_integral_of_the_torque_loop_takes_the_static_error_off():
    """Its time constant is (1 + k_p a) / (k_i a) steps, at most 0.2 s for a above 0.8."""
    errors = make_errors(**WITHOUT_FRICTION, torque_loop=True)
    wanted = np.array([60.0, -40.0, 20.0, 5.0, -3.0, 0.0])
    acting = act(errors, [wanted] * 8000)
    assert_allclose(acting[-1], wanted, atol=1e-6)


def test_torque_loop_steps_at_its_rate_by_its_formula(rng):
    """The motor has wanted - 0.7 e - 0.01 sum(e) - 1e-5 de/dt from every second substep on."""
    errors = make_errors(**WITHOUT_FRICTION, torque_loop=True)
    scale = errors.actuators['scale']
    commands = rng.uniform(-20.0, 20.0, (200, 6))
    driven = [STILL]  # in the substep before
    motor = STILL
    error_before = STILL
    error_sum = np.zeros(6)
    on_its_way = STILL
    for number, wanted in enumerate(commands):
        if number % 2 == 0:
            error = driven[-1] - wanted
            error_sum = error_sum + error
            rate = (error - error_before) / 1e-3
            motor = wanted - 0.7 * error - 0.01 * error_sum - 1e-5 * rate
            error_before = error
        driven.append(on_its_way)
        on_its_way = scale * motor + 2.0
    assert_allclose(act(errors, commands), driven[1:], atol=1e-9)


def test_noise_has_the_standard_deviation_of_each_joint_and_is_white():
    errors = make_errors(noise_std=BENCHMARK['noise_std'])
    noise = act(errors, [STILL] * 20000)
    assert_allclose(noise.std(axis=0), BENCHMARK['noise_std'], rtol=0.03)
    assert np.abs(noise.mean(axis=0) / noise.std(axis=0)).max() < 0.03
    correlation = np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0)
    assert np.abs(correlation).max() < 0.03


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_reset_and_seed_repeat_the_samples_bit_for_bit(make_plant, preset):
    """A robot of another seed differs, and so does the noise of another run."""
    actuation = {**BENCHMARK, 'torque_loop': True}
    plant = make_plant(preset, seed=3, actuation=actuation, **FREE)
    first = record_samples(plant)
    assert record_samples(plant) == first
    other_robot = make_plant(
        preset, seed=3, actuation={**actuation, 'seed': 20}, **FREE
    )
    assert record_samples(other_robot) != first
    other_run = make_plant(preset, seed=4, actuation=actuation, **FREE)
    assert record_samples(other_run) != first


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_errors_of_no_size_change_no_bit(make_plant, preset):
    without = record_samples(make_plant(preset, **FREE))
    none = make_plant(preset, actuation={'seed': 5}, **FREE)
    assert record_samples(none) == without


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (
            {'actuation': {'noise_std': [0.1] * 5}},
            'actuation.noise_std: expected 6 values, one per joint, or one for all, got 5',
        ),
        (
            {'actuation': {'coulomb_friction': [1.0, 1.0]}},
            'actuation.coulomb_friction: expected 6 values, one per joint, or one for all, got 2',
        ),
        (
            {'actuation': {'viscous_friction': [-0.5]}},
            'actuation.viscous_friction.0: expected greater than or equal to 0, got -0.5',
        ),
        (
            {'actuation': {'torque_loop': True}, 'substep': 4e-4},
            'substep: expected a whole fraction of the period of the torque loop 0.001 s, '
            'got 0.0004 s',
        ),
        (
            {'actuation': {'torque_loop': True}, 'substep': 2e-3},
            'substep: expected a whole fraction of the period of the torque loop 0.001 s, '
            'got 0.002 s',
        ),
    ],
)
def test_actuation_that_does_not_fit_is_refused(make_plant, change, message):
    with pytest.raises(ConfigError) as caught:
        make_plant('rigid', **change)
    assert str(caught.value) == message


@pytest.mark.slow
def test_scenario_with_errors_of_actuation_is_judged(tmp_path, monkeypatch):
    """Those of the benchmark with its torque loop, on a robot of seven joints."""
    monkeypatch.chdir(tmp_path)
    actuation = {**BENCHMARK, 'noise_std': [0.03], 'torque_loop': True}
    arguments = ['simulate', '--robot', 'iiwa', '--scenario', 'one_contact']
    for name, value in actuation.items():
        arguments += ['--set', f'plant.actuation.{name}={json.dumps(value)}']
    done = CliRunner().invoke(app, [*arguments, '--out', 'run'])
    assert done.exit_code == 0, done.stderr
    summary = json.loads((tmp_path / 'run/summary.json').read_text())
    assert summary['verdict'] == 'stable'
