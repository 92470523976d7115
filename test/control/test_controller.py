"""The control law: physics, the same in plain numpy on random states, refusals."""

from arms import (
    controller_config,
    HOME,
    Law,
    Measurement,
    seven_joint_config,
    seven_joint_urdf,
)
from multicontact_control.contact.geometry import misread_friction
from multicontact_control.control.tasks import CommandedTask, MotionReading, Task
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import (
    ConfigError,
    ContactGeometryError,
    ShapeError,
    SingularTaskError,
)
from multicontact_control.experiment.scenario import resolve
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from reference_controller import ReferenceController
from runs import run_of

REST = np.zeros(6)
NOTHING = np.zeros(3)
NO_FRICTION = {'coulomb': [], 'viscous': []}


def _controller(reference=None, **changes):
    config = controller_config(friction=NO_FRICTION, **changes)
    reference = reference or CommandedTask(config.contact_names)
    return Law(config, reference), reference


def _sample(controller, time=0.0, q=HOME, qd=REST, force_world=NOTHING,
            point_operational=NOTHING):
    """Return a sample with a force on the environment at a point of the tool."""
    state = controller.robot.update(q, qd)
    tool = controller.config.tool
    R = state.sensor_pose.rotation_world
    weight = tool.mass * np.array(controller.config.robot.gravity_world)
    point = state.pose.position_world + state.pose.rotation_world @ point_operational
    moment = (np.cross(point - state.sensor_pose.position_world, force_world)
              - np.cross(R @ np.array(tool.com_sensor), weight))
    wrench = np.concatenate([R.T @ (force_world - weight), R.T @ moment])
    return Measurement(time, np.array(q), np.array(qd), wrench)


def _acceleration(controller, measurement, torque, contact_wrench):
    """Return what the operational point does under a torque and a wrench on the environment."""
    state = controller.robot.update(measurement.q, measurement.qd)
    qdd = np.linalg.solve(
        state.mass_matrix, torque - state.coriolis - state.gravity
        - state.jacobian.T @ contact_wrench)
    return state.jacobian @ qdd + state.jacobian_drift


def test_controller_at_rest_compensates_gravity():
    controller, _ = _controller()
    output = controller.step(_sample(controller), np.full(2, 0.6))
    state = controller.robot.update(HOME, np.zeros(6))
    np.testing.assert_allclose(output.torque, state.gravity, atol=1e-9)
    np.testing.assert_allclose(output.alpha_meas, 0.0, atol=1e-9)


def test_friction_at_a_lever_is_misread():
    lever = {'table': {'type': 'edge', 'point_operational': [0.0, 0.0, 0.24]}}
    controller, _ = _controller(
        contact_names=['table'], contacts=lever, reference=CommandedTask(['t', 't/along']))

    def misread():
        return misread_friction(
            controller.config, controller.contacts, controller.arm.pose.rotation_world)

    controller.step(_sample(controller), np.full(2, 0.6))
    found = misread()
    assert [(where, what) for where, what, _ in found] == [('table', 'table/along')]
    assert found[0][2] > 1.05
    table = controller.config.contacts['table'].model_copy(update={'friction_coefficient': 0.1})
    controller.reconfigure(controller.config.model_copy(update={
        'contacts': {**controller.config.contacts, 'table': table}}))
    assert misread() == []


@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
def test_motion_error_accelerates_no_contact(projection, allocation):
    """With both forces at their command, a motion error leaves N^T theta_dot at 0."""
    controller, reference = _controller(
        force={'projection': projection, 'allocation': allocation})
    table, board = (np.array(controller.config.contacts[name].point_operational)
                    for name in ('table', 'board'))
    controller.step(_sample(controller), np.full(2, 0.6))
    reference.set_forces({'table': 10.0, 'board': 5.0})
    pose = controller.robot.update(HOME, np.zeros(6)).pose
    reference.set_motion(MotionReading(
        pose.position_world + [0.01, 0.004, -0.003], pose.quaternion_xyzw, np.zeros(6),
        np.array([0.5, 0, 0, 0, 0, 0.2])), np.zeros((0, 3)))
    state = controller.robot.update(HOME, np.zeros(6))
    R = state.pose.rotation_world
    force = np.array([0.0, 5.0, -10.0])
    moment = (np.cross(R @ table, [0, 0, -10.0]) + np.cross(R @ board, [0, 5.0, 0]))
    wrench = np.concatenate([force, moment])
    sample = _sample(controller, 0.002)
    R_s = state.sensor_pose.rotation_world
    lever = state.pose.position_world - state.sensor_pose.position_world
    sample.wrench_sensor[:3] += R_s.T @ force
    sample.wrench_sensor[3:] += R_s.T @ (moment + np.cross(lever, force))
    output = controller.step(sample, np.full(2, 0.6))
    np.testing.assert_allclose(output.alpha_meas, [10.0, 5.0], atol=1e-9)
    a = _acceleration(controller, sample, output.torque, wrench)
    normals = np.array([[0, 0, -1.0], [0, 1.0, 0]])
    levers = -np.array([R @ table, R @ board])
    N = np.vstack([normals.T, np.cross(normals, levers).T])
    np.testing.assert_allclose(N.T @ a, 0.0, atol=1e-8)
    assert np.abs(a).max() > 1.0


def test_controller_reset_forgets_everything():
    controller, reference = _controller()

    def run():
        torques = []
        for k in range(20):
            if k == 5:
                reference.set_forces({'table': 3.0})
            rng = np.random.default_rng(k)
            sample = _sample(controller, 0.002 * k, qd=0.01 * rng.standard_normal(6))
            torques.append(controller.step(sample, np.full(2, 0.6)).torque)
        return np.array(torques)

    first = run()
    controller.reset()
    np.testing.assert_array_equal(run(), first)


SERIES = ('torque', 'alpha_meas', 'alpha_est', 'alpha_rate_est', 'alpha_des', 'innovation',
          'prior_variance', 'variance_used')


class RandomTask:
    """Asks for something else at every tick, contacts coming and going."""

    contact_state = {}

    def __init__(self, contacts):
        self._generator = np.random.default_rng(0)
        self._contacts = contacts

    def start(self, pose, normals_world):
        self._pose = pose

    def task(self, time, alpha_meas=None):
        random = self._generator
        turn = random.normal(size=4) * [0.2, 0.2, 0.2, 0.0] + [0.0, 0.0, 0.0, 1.0]
        offset = Pose.from_quaternion(0.05 * random.normal(size=3), turn)
        active = random.random(self._contacts) < 0.8
        return Task(
            pose_des=Pose(self._pose.position_world + offset.position_world,
                          offset.rotation_world @ self._pose.rotation_world),
            twist_des=0.1 * random.normal(size=6), acceleration_des=random.normal(size=6),
            active=active, alpha_des=np.where(active, 20.0 * random.random(self._contacts), 0.0))


def assert_close(output, expected, tolerance):
    """Check to a tolerance of the largest of each kind."""
    for name in SERIES:
        found, wanted = getattr(output, name), getattr(expected, name)
        np.testing.assert_allclose(
            found, wanted, rtol=0.0, atol=tolerance * max(1.0, np.abs(wanted).max()),
            err_msg=name)


def assert_law_is_numpy(config, base_dir=None, home=HOME, tolerance=1e-12):
    """Compare both laws on random states and random contacts that come and go."""
    count, random = len(config.contact_names), np.random.default_rng(0)
    compiled = Law(config, RandomTask(count), base_dir)
    plain = ReferenceController(
        config, RobotModel(config.robot, base_dir or config_dir()), RandomTask(count))
    for k in range(50):
        sample = Measurement(0.002 * k, home + 0.1 * random.normal(size=home.shape),
                             random.normal(size=home.shape), 10.0 * random.normal(size=6))
        variance = np.exp(random.normal(size=count))
        assert_close(compiled.step(sample, variance), plain.step(sample, variance), tolerance)


@pytest.mark.parametrize('order', [0, 1, 3])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
def test_law_equals_numpy_for_every_option(order, allocation, projection):
    assert_law_is_numpy(controller_config(force={
        'active_state_order': order, 'allocation': allocation, 'projection': projection}))


@pytest.mark.parametrize('fed_forward', ['estimate', 'desired', 'mixed', 'measured'])
@pytest.mark.parametrize('stiffness', [6000.0, 60_000.0])
def test_law_equals_numpy_whatever_is_fed_forward(fed_forward, stiffness):
    contacts = {name: {'stiffness': stiffness} for name in ('table', 'board')}
    assert_law_is_numpy(controller_config(
        force={'fed_forward': fed_forward, 'input_delay': 0.0031}, contacts=contacts,
        friction={'coulomb': [1.0] * 6, 'viscous': [0.5] * 6}, torque_limit=[]))


@pytest.mark.parametrize('count', [1, 2, 6])
@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
def test_law_equals_numpy_with_seven_joints_and_up_to_six_contacts(tmp_path, count, projection):
    random, names = np.random.default_rng(count), [f'contact{i}' for i in range(count)]
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    config = controller_config(
        robot=seven_joint_config(seven_joint_urdf(tmp_path)).model_dump(),
        friction=NO_FRICTION, torque_limit=[100.0] * 7, limits={
            'joint_lower': [-3.0] * 7, 'joint_upper': [3.0] * 7, 'joint_speed': [],
            'torque_rate': []}, collision={'threshold': [1.0] * 7}, contact_names=names,
        contacts={name: {'normal_world': normal.tolist(), 'point_operational': point.tolist()}
                  for name, normal, point in zip(names, normals, random.normal(size=(count, 3)))},
        force={'projection': projection})
    assert_law_is_numpy(
        config, tmp_path, np.array([0.3, 0.7, -0.4, 0.9, 0.5, -0.8, 2.95]), 1e-9)


@pytest.mark.slow
def test_run_equals_numpy_tick_by_tick():
    setup = resolve('quick', plant='rigid', seed=0, duration=4.0, scenario_overrides={
        'reference': {
            'force_steps': [{'time': 1.2, 'forces': {'table': 10.0, 'board': 15.0}}],
            'motion': {'start_time': 1.8, 'period': 2.0, 'amplitude': 0.04, 'blend_time': 0.5}}})
    data, config = run_of(setup, supervised=False).data, setup.controller
    assert (data.alpha_true[-1] > 5.0).all() and np.ptp(data.position[:, 0]) > 0.07
    plain = ReferenceController(
        config, RobotModel(config.robot, setup.urdf_dir), setup.reference())
    variance = np.full(2, config.initial_noise_variance)
    for k in range(data.ticks):
        output = plain.step(
            Measurement(k * config.period, data.q[k], data.qd[k], data.wrench[k]), variance)
        variance = data.noise_variance[k]
        for name in SERIES[:5]:
            wanted = getattr(output, name)
            np.testing.assert_allclose(
                getattr(data, name)[k], wanted, rtol=0.0,
                atol=1e-11 * max(1.0, np.abs(wanted).max()), err_msg=f'{name} at tick {k}')


def step(q=HOME, wrench=REST, qd=REST, **changes):
    controller, _ = _controller(**changes)
    return controller.step(Measurement(0.0, q, qd, wrench), np.ones(2))


def test_output_stays_when_the_next_sample_comes():
    controller, _ = _controller()
    first = controller.step(_sample(controller), np.ones(2))
    copies = {name: getattr(first, name).copy() for name in SERIES}
    controller.step(_sample(controller, q=HOME + 0.1), np.ones(2))
    for name, copy in copies.items():
        np.testing.assert_array_equal(getattr(first, name), copy)


def test_impossible_states_are_refused(monkeypatch):
    with pytest.raises(SingularTaskError, match='finite'):
        step(np.full(6, np.nan))
    monkeypatch.setattr('multicontact_control.control.controller.SINGULAR_MOBILITY', 0.0)
    with pytest.raises(SingularTaskError, match='condition number'):
        step(np.zeros(6))


def test_wrench_of_nan_gives_no_torque_that_looks_right():
    controller, reference = _controller()
    sample = Measurement(0.0, HOME, REST, np.full(6, np.nan))
    controller.step(sample, np.ones(2))
    reference.set_forces({'table': 5.0})
    assert np.isnan(controller.step(sample, np.ones(2)).torque).any()


def test_dependent_contacts_are_refused():
    same = {'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.24]}
    with pytest.raises(ConfigError, match='table, board'):
        step(contacts={'board': same})
    above = {**same, 'point_operational': [0.0, 0.0, 0.3]}  # with the tool upright, as it is here
    with pytest.raises(ContactGeometryError, match='table, board'):
        step(contacts={'board': above})


@pytest.mark.parametrize('sizes', [(5, 6), (6, 5)])
def test_arrays_of_wrong_size_are_refused(sizes):
    with pytest.raises(ShapeError):
        step(np.zeros(sizes[0]), qd=np.zeros(sizes[1]))
