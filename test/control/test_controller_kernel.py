"""The compiled control law against plain numpy: states, contact sets, options, whole runs."""

from pathlib import Path

from arms import controller_config, HOME
from multicontact_control.control.arm_state import see_arm
from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.law import control_law
from multicontact_control.control.reference import CommandedReference, Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import (
    ConfigError,
    ContactGeometryError,
    ShapeError,
    SingularTaskError,
)
from multicontact_control.experiment.closed_loop import run_in_process
from multicontact_control.experiment.scenario import resolve
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from reference_controller import ReferenceController
from synthetic_arm import synthetic_setup

SERIES = ('torque', 'alpha_meas', 'alpha_est', 'alpha_rate_est', 'alpha_des', 'innovation',
          'prior_variance', 'variance_used')


class RandomTask:
    """Asks for something else at every tick, contacts coming and going."""

    def __init__(self, seed, contacts):
        self._generator = np.random.default_rng(seed)
        self._contacts = contacts

    def start(self, pose, normals_world):
        self._pose = pose

    def update(self, time, alpha_meas):
        random = self._generator
        turn = random.normal(size=4) * [0.2, 0.2, 0.2, 0.0] + [0.0, 0.0, 0.0, 1.0]
        offset = Pose.from_quaternion(0.05 * random.normal(size=3), turn)
        active = random.random(self._contacts) < 0.8
        return Reference(
            pose_des=Pose(self._pose.position_world + offset.position_world,
                          offset.rotation_world @ self._pose.rotation_world),
            twist_des=0.1 * random.normal(size=6), acceleration_des=random.normal(size=6),
            active=active, alpha_des=np.where(active, 20.0 * random.random(self._contacts), 0.0))


def assert_equal(output, expected):
    """Check to 1e-12 of the largest of each kind."""
    for name in SERIES:
        found, wanted = getattr(output, name), getattr(expected, name)
        scale = max(1.0, np.abs(wanted).max())
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12 * scale, err_msg=name)
    np.testing.assert_array_equal(output.active, expected.active)
    for pose, wanted in ((output.pose, expected.pose), (output.pose_des, expected.pose_des)):
        np.testing.assert_allclose(pose.position_world, wanted.position_world, atol=1e-14)
        np.testing.assert_allclose(pose.rotation_world, wanted.rotation_world, atol=1e-14)


def pair(config, base_dir, seed=0):
    """Return the compiled and the plain controller with the same task."""
    contacts = len(config.contact_names)
    return [kind(config, RobotModel(config.robot, base_dir), RandomTask(seed, contacts))
            for kind in (Controller, ReferenceController)]


def random_samples(home, count, contacts, seed=0):
    random = np.random.default_rng(seed)
    for k in range(count):
        yield (Measurement(0.002 * k, home + 0.1 * random.normal(size=home.shape),
                           random.normal(size=home.shape), 10.0 * random.normal(size=6)),
               np.exp(random.normal(size=contacts)))


@pytest.mark.parametrize('order', [0, 1, 2, 3])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
def test_law_equals_numpy_for_every_option(order, allocation, projection):
    config = controller_config(force={
        'active_state_order': order, 'allocation': allocation, 'projection': projection})
    compiled, plain = pair(config, config_dir())
    for measurement, variance in random_samples(HOME, 100, 2):
        assert_equal(compiled.step(measurement, variance), plain.step(measurement, variance))


@pytest.mark.parametrize('fed_forward', ['estimate', 'desired', 'mixed', 'measured'])
@pytest.mark.parametrize('stiffness', [6000.0, 60_000.0])
def test_law_equals_numpy_whatever_is_fed_forward(fed_forward, stiffness):
    config = controller_config(force={'fed_forward': fed_forward})
    contacts = {name: contact.model_copy(update={'stiffness': stiffness})
                for name, contact in config.contacts.items()}
    compiled, plain = pair(config.model_copy(update={'contacts': contacts}), config_dir())
    for measurement, variance in random_samples(HOME, 50, 2):
        assert_equal(compiled.step(measurement, variance), plain.step(measurement, variance))


@pytest.mark.parametrize('delay', [0.0, 0.0031, 0.02])
def test_law_equals_numpy_for_other_delays(delay):
    config = controller_config(force={'input_delay': delay}, friction={
        'coulomb': [1.0] * 6, 'viscous': [0.5] * 6}, torque_limit=[])
    compiled, plain = pair(config, config_dir())
    for measurement, variance in random_samples(HOME, 100, 2):
        assert_equal(compiled.step(measurement, variance), plain.step(measurement, variance))


@pytest.mark.parametrize(('joints', 'contacts'), [
    (6, 1), (6, 3), (6, 6), (7, 2), (14, 1), (14, 6)])
@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
def test_law_equals_numpy_for_other_arms(tmp_path, joints, contacts, projection):
    setup = synthetic_setup(tmp_path, joints=joints, contacts=contacts)
    config = setup.config.model_copy(update={
        'force': setup.config.force.model_copy(update={'projection': projection})})
    compiled, plain = pair(config, tmp_path)
    for measurement, variance in random_samples(setup.home, 50, contacts):
        assert_equal(compiled.step(measurement, variance), plain.step(measurement, variance))


@pytest.mark.slow
def test_run_equals_numpy_tick_by_tick():
    """Both see the samples of a closed loop, contacts, steps, motion there and back included."""
    setup = resolve('quick', plant='rigid', seed=0, duration=5.0, scenario_overrides={
        'reference': {
            'force_steps': [{'time': time, 'forces': {'table': force, 'board': force}}
                            for time, force in ((1.2, 10.0), (1.7, 15.0))],
            'motion': {'start_time': 2.2, 'period': 2.0, 'amplitude': 0.04, 'blend_time': 0.5}}})
    data = run_in_process(setup, supervised=False).data
    assert (data.alpha_true[-1] > 5.0).all() and np.ptp(data.position[:, 0]) > 0.07
    config = setup.controller
    plain = ReferenceController(
        config, RobotModel(config.robot, setup.urdf_dir), setup.reference())
    variance = np.full(2, config.initial_noise_variance)
    for k in range(data.ticks):
        output = plain.step(
            Measurement(k * config.period, data.q[k], data.qd[k], data.wrench[k]), variance)
        variance = data.noise_variance[k]
        for name in ('torque', 'alpha_meas', 'alpha_est', 'alpha_rate_est', 'alpha_des'):
            found, wanted = getattr(data, name)[k], getattr(output, name)
            scale = max(1.0, np.abs(wanted).max())
            np.testing.assert_allclose(
                found, wanted, rtol=0.0, atol=1e-11 * scale, err_msg=f'{name} at tick {k}')


def home_sample(q=HOME):
    return Measurement(0.0, np.array(q), np.zeros(6), np.zeros(6))


UNDAMPED = {'singular_mobility': 0.0}


def puma(**changes):
    config = controller_config(**changes)
    return Controller.from_config(config, CommandedReference(config.contact_names), config_dir())


def test_outputs_stay_as_they_are_when_the_next_sample_comes():
    controller = puma()
    first = controller.step(home_sample(), np.ones(2))
    copies = {name: getattr(first, name).copy() for name in SERIES}
    position = first.pose.position_world.copy()
    controller.step(home_sample(HOME + 0.1), np.ones(2))
    for name, copy in copies.items():
        np.testing.assert_array_equal(getattr(first, name), copy)
    np.testing.assert_array_equal(first.pose.position_world, position)


def test_strange_arrays_do_not_make_numba_compile_again():
    controller = puma()
    compiled = len(control_law.signatures), len(see_arm.signatures)
    strided = np.repeat(HOME, 2)[::2]
    frozen = np.zeros(6)
    frozen.flags.writeable = False
    controller.step(Measurement(0.0, strided, frozen, frozen.astype(np.float32)), np.ones(2))
    assert compiled == (len(control_law.signatures), len(see_arm.signatures))


def test_no_step_compiles_anything(tmp_path):
    setup = synthetic_setup(tmp_path, joints=7, contacts=2)
    controller = Controller.from_config(
        setup.config, CommandedReference(setup.config.contact_names), tmp_path)
    before = len(control_law.signatures)
    controller.step(Measurement(0.0, setup.home, np.zeros(7), np.zeros(6)), np.ones(2))
    assert len(control_law.signatures) == before


def test_singular_posture_is_named():
    with pytest.raises(SingularTaskError, match='condition number'):
        puma(limits=UNDAMPED).step(home_sample(np.zeros(6)), np.ones(2))


@pytest.mark.parametrize('close', [1e-3, 1e-4])
def test_condition_is_judged_as_before(close):
    """The quick bound must not refuse what the eigenvalues allow, nor allow what they refuse."""
    q = HOME.copy()
    q[4] = close  # joints 4 and 6 in one line
    robot = RobotModel(controller_config().robot, config_dir())
    from multicontact_control.dynamics.operational_space import task_inertia
    state = robot.update(q, np.zeros(6))
    try:
        task_inertia(state.mass_matrix, state.jacobian)
    except SingularTaskError:
        with pytest.raises(SingularTaskError):
            puma(limits=UNDAMPED).step(home_sample(q), np.ones(2))
    else:
        assert np.isfinite(
            puma(limits=UNDAMPED).step(home_sample(q), np.ones(2)).torque).all()


def test_numbers_that_are_none_are_refused():
    with pytest.raises(SingularTaskError, match='finite'):
        puma().step(home_sample(np.full(6, np.nan)), np.ones(2))


def test_sensor_that_fails_gives_no_torque_that_looks_right():
    config = controller_config()
    reference = CommandedReference(config.contact_names)
    controller = Controller.from_config(config, reference, config_dir())
    sample = Measurement(0.0, HOME, np.zeros(6), np.full(6, np.nan))
    controller.step(sample, np.ones(2))
    reference.set_forces({'table': 5.0})
    assert np.isnan(controller.step(sample, np.ones(2)).torque).any()


def test_dependent_contacts_are_named():
    same = {'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.24]}
    with pytest.raises(ConfigError, match='table, board'):
        puma(contacts={'board': same})
    above = {**same, 'point_operational': [0.0, 0.0, 0.3]}  # with the tool upright, as it is here
    with pytest.raises(ContactGeometryError, match='table, board'):
        puma(contacts={'board': above}).step(home_sample(), np.ones(2))


def test_seventh_contact_is_refused(tmp_path):
    config = synthetic_setup(tmp_path, joints=7, contacts=6).config
    names = (*config.contact_names, 'seventh')
    contacts = {**config.contacts, 'seventh': config.contacts[config.contact_names[0]]}
    config = config.model_copy(update={'contact_names': names, 'contacts': contacts})
    with pytest.raises(ConfigError, match='which depend on each other'):
        Controller.from_config(config, CommandedReference(names), Path(tmp_path))


@pytest.mark.parametrize(('q', 'wrench', 'variance'), [
    (5, 6, 2), (6, 5, 2), (6, 6, 3)])
def test_wrong_sizes_are_named(q, wrench, variance):
    with pytest.raises(ShapeError):
        puma().step(Measurement(0.0, np.zeros(q), np.zeros(6), np.zeros(wrench)),
                    np.ones(variance))
