"""The composed control law on a simple arm model: decoupling, seeding, limits."""

from arms import controller_config, HOME
from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.reference import CommandedReference
from multicontact_control.errors import ShapeError
from multicontact_control.paths import config_dir
import numpy as np
import pytest

REST = np.zeros(6)
NOTHING = np.zeros(3)
NO_FRICTION = {'coulomb': [], 'viscous': []}


def _controller(reference=None, **changes):
    config = controller_config(friction=NO_FRICTION, **changes)
    reference = reference or CommandedReference(config.contact_names)
    return Controller.from_config(config, reference, config_dir()), reference


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
    """At the start pose, without contact, the torque is that of gravity."""
    controller, _ = _controller()
    output = controller.step(_sample(controller), np.full(2, 0.6))
    state = controller.robot.update(HOME, np.zeros(6))
    np.testing.assert_allclose(output.torque, state.gravity, atol=1e-9)
    np.testing.assert_allclose(output.alpha_meas, 0.0, atol=1e-9)


def test_what_friction_is_read_as_is_worked_out_once():
    """At the first sample, and when the contacts change, and with no report of it."""
    lever = {'table': {'type': 'edge', 'point_operational': [0.0, 0.0, 0.24]}}
    controller, _ = _controller(
        contact_names=['table'], contacts=lever, reference=CommandedReference(['t', 't/along']))
    assert controller.misread_friction == []
    controller.step(_sample(controller), np.full(2, 0.6))
    found = controller.misread_friction
    assert [(where, what) for where, what, _ in found] == [('table', 'table/along')]
    assert found[0][2] > 1.05 and controller.misread_friction is found
    table = controller.config.contacts['table'].model_copy(update={'friction_coefficient': 0.1})
    controller.reconfigure(controller.config.model_copy(update={
        'contacts': {**controller.config.contacts, 'table': table}}))
    assert controller.misread_friction == []


def test_controller_measures_each_contact_force():
    """10 N at the table's tip along its normal is alpha = [10, 0]."""
    controller, _ = _controller()
    table = np.array(controller.config.contacts['table'].point_operational)
    output = controller.step(
        _sample(controller, force_world=np.array([0, 0, -10.0]), point_operational=table),
        np.full(2, 0.6))
    np.testing.assert_allclose(output.alpha_meas, [10.0, 0.0], atol=1e-9)


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
    reference.set_motion(pose.position_world + [0.01, 0.004, -0.003], pose.quaternion_xyzw,
                         np.zeros(6), np.array([0.5, 0, 0, 0, 0, 0.2]))
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


def test_controller_seeds_the_observer_with_the_measured_force():
    """A contact that becomes force controlled starts from what is measured."""
    controller, reference = _controller()
    table = np.array(controller.config.contacts['table'].point_operational)
    controller.step(_sample(controller), np.full(2, 0.6))
    reference.set_forces({'table': 7.0})
    output = controller.step(
        _sample(controller, 0.002, force_world=np.array([0, 0, -7.0]),
                point_operational=table), np.full(2, 0.6))
    np.testing.assert_allclose(output.alpha_est, [7.0, 0.0], atol=1e-9)
    np.testing.assert_array_equal(output.active, [True, False])


def test_controller_tells_the_innovation_of_every_active_contact():
    """Report alpha - C x_1 with its variances; zeros without force control and when it starts."""
    controller, reference = _controller()
    table = np.array(controller.config.contacts['table'].point_operational)

    def step(tick, force):
        return controller.step(
            _sample(controller, 0.002 * tick, force_world=np.array([0, 0, -force]),
                    point_operational=table), np.array([0.4, 0.5]))

    free = step(0, 7.0)
    reference.set_forces({'table': 7.0})
    first, second = step(1, 7.0), step(2, 7.25)
    for output in (free, first):
        for values in (output.innovation, output.prior_variance, output.variance_used):
            np.testing.assert_array_equal(values, np.zeros(2))
    np.testing.assert_allclose(second.innovation, [0.25, 0.0], atol=1e-9)
    np.testing.assert_array_equal(second.variance_used, [0.4, 0.0])
    share = second.prior_variance[0] / (second.prior_variance[0] + 0.4)
    assert second.prior_variance[1] == 0.0
    assert second.alpha_est[0] == pytest.approx(7.0 + share * 0.25, rel=1e-9)


def test_controller_clips_torque_at_its_limit():
    """No command beyond the limit, whatever the error."""
    controller, reference = _controller()
    controller.step(_sample(controller), np.full(2, 0.6))
    reference.set_motion(np.array([0.5, 0.5, 0.9]), np.array([0, 0, 0, 1.0]), np.zeros(6),
                         np.zeros(6))
    output = controller.step(_sample(controller, 0.002), np.full(2, 0.6))
    limit = np.array(controller.config.torque_limit)
    assert (np.abs(output.torque) <= limit).all()
    assert (np.abs(output.torque) == limit).any()


def test_controller_compensates_friction_in_the_direction_of_motion():
    """Coulomb through tanh, viscous in proportion."""
    qd = np.array([0.1, -0.1, 0.0, 0.001, 0.0, 0.0])
    plain, _ = _controller()
    config = controller_config(friction={'coulomb': [2.0] * 6, 'viscous': [0.5] * 6,
                                         'speed': 0.01})
    compensated = Controller.from_config(
        config, CommandedReference(config.contact_names), config_dir())
    sample = _sample(plain, qd=qd)
    difference = (compensated.step(sample, np.full(2, 0.6)).torque
                  - plain.step(sample, np.full(2, 0.6)).torque)
    np.testing.assert_allclose(difference, 2.0 * np.tanh(qd / 0.01) + 0.5 * qd, atol=1e-12)


def test_controller_reset_forgets_everything():
    """The same samples give the same torques after a reset."""
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


def test_controller_refuses_arrays_of_another_size():
    """Shapes are checked before anything changes."""
    controller, _ = _controller()
    with pytest.raises(ShapeError, match=r'noise_variance: expected shape \(2,\)'):
        controller.step(_sample(controller), np.ones(3))
