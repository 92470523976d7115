"""The control law: physics, the same in plain numpy on random states, limits and refusals."""

from arms import (
    controller_config,
    HOME,
    Law,
    Measurement,
    pressed_wrench,
    seven_joint_config,
    seven_joint_urdf,
)
from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.control.law import limit_torque
from multicontact_control.control.tasks import CommandedTask, MotionReading, WantedTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import ContactGeometryError, SingularTaskError
from multicontact_control.paths import find_config_folder
from multicontact_control.records import JOINT, LAW
from multicontact_control.sensor.tool import predict_weight_reading
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from reference_controller import ReferenceController

REST = np.zeros(6)
VARIANCE = np.full(2, 0.6)
FORCES = {'table': 10.0, 'board': 5.0}
NO_FRICTION = {'coulomb': [], 'viscous': []}


def make_law(**changes):
    """Return a law without joint friction: it asks for nothing until its reference is set."""
    config = controller_config(friction=NO_FRICTION, **changes)
    return Law(config, CommandedTask(config.column_names, config.leading_columns))


def sample(law, time=0.0, qd=REST, **forces):
    """Return a sample at home, with forces on contacts."""
    state = law.robot.update(HOME, qd)
    config = law.config
    gravity = np.array(config.robot.gravity_world)
    rotation = state.sensor_pose.rotation_world
    weight = predict_weight_reading(rotation, config.tool, gravity)
    wrench = weight + pressed_wrench(config, state, **forces)
    return Measurement(time, HOME.copy(), np.array(qd), wrench)


@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
def test_motion_error_accelerates_no_contact(projection, allocation):
    """With both forces at their command, a motion error leaves N^T theta_dot at 0."""
    law = make_law(force={'projection': projection, 'allocation': allocation})
    law.step(sample(law), VARIANCE)
    law.reference.set_forces(FORCES)
    state = law.robot.update(HOME, REST)
    beside = state.pose.position_world + [0.01, 0.004, -0.003]
    acceleration_des = np.array([0.5, 0, 0, 0, 0, 0.2])
    motion = MotionReading(beside, state.pose.quaternion_xyzw, REST, acceleration_des)
    law.reference.set_motion(motion, np.zeros((0, 3)))
    output = law.step(sample(law, 0.002, **FORCES), VARIANCE)
    assert_allclose(output.contacts['alpha_meas'], [10.0, 5.0], atol=1e-9)
    N = law.contacts['N'].T
    pressing = state.jacobian.T @ N @ [10.0, 5.0]
    free_torque = output.torque - state.coriolis - state.gravity - pressing
    qdd = np.linalg.solve(state.mass_matrix, free_torque)
    acceleration = state.jacobian @ qdd + state.jacobian_drift
    assert_allclose(N.T @ acceleration, 0.0, atol=1e-8)
    assert np.abs(acceleration).max() > 1.0


SERIES = (
    'alpha_est',
    'alpha_rate_est',
    'alpha_des',
    'innovation',
    'prior_variance',
    'variance_used',
)


class RandomTask:
    """Asks for something else at every tick, contacts coming and going."""

    contact_state, seeks, follower = {}, False, None

    def __init__(self, contacts):
        self._generator = np.random.default_rng(0)
        self._contacts = contacts

    def start(self, pose, normals_world):
        self._pose = pose

    def task_at(self, time, alpha_meas=None):
        random = self._generator
        start = self._pose
        turn = random.normal(size=4) * [0.2, 0.2, 0.2, 0.0] + [0.0, 0.0, 0.0, 1.0]
        offset = Pose.from_quaternion(0.05 * random.normal(size=3), turn)
        position = start.position_world + offset.position_world
        rotation = offset.rotation_world @ start.rotation_world
        active = random.random(self._contacts) < 0.8
        forces = 20.0 * random.random(self._contacts)
        return WantedTask(
            pose_des=Pose(position, rotation),
            twist_des=0.1 * random.normal(size=6),
            acceleration_des=random.normal(size=6),
            active=active,
            alpha_des=np.where(active, forces, 0.0),
        )


def assert_near(values, wanted, tolerance):
    """Compare to a tolerance of the largest, which counts as 1 at least."""
    size = max(1.0, np.abs(wanted).max())
    assert_allclose(values, wanted, rtol=0.0, atol=tolerance * size)


def assert_law_is_numpy(config, base_dir=None, home=HOME, tolerance=1e-12):
    """Compare both laws on random states and contacts."""
    count = len(config.contact_names)
    random = np.random.default_rng(0)
    compiled = Law(config, RandomTask(count), base_dir)
    robot = RobotModel(config.robot, base_dir or find_config_folder())
    plain = ReferenceController(config, robot, RandomTask(count))
    for k in range(50):
        q = home + 0.1 * random.normal(size=home.shape)
        qd = random.normal(size=home.shape)
        wrench = 10.0 * random.normal(size=6)
        measurement = Measurement(0.002 * k, q, qd, wrench)
        variance = np.exp(random.normal(size=count))
        output = compiled.step(measurement, variance)
        expected = plain.step(measurement, variance)
        assert_near(output.torque, expected.torque, tolerance)
        assert_near(output.contacts['alpha_meas'], expected.alpha_meas, tolerance)
        for name in SERIES:
            assert_near(output.answer[name], getattr(expected, name), tolerance)


@pytest.mark.parametrize('order', [0, 1, 3])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
def test_law_equals_numpy_for_every_option(order, allocation, projection):
    force = {
        'active_state_order': order,
        'allocation': allocation,
        'projection': projection,
    }
    assert_law_is_numpy(controller_config(force=force))


def test_law_equals_numpy_where_lambda_is_damped():
    """Around all joints at 0, which is singular."""
    assert_law_is_numpy(controller_config(), home=np.zeros(6), tolerance=1e-9)


def test_paper_allocation_equals_the_decoupled_one_where_normals_are_orthogonal():
    """N^T N is diagonal at home, with k_s of 1 and 1.036 k_env: eqs 17, 30 and 31 hold."""
    decoupled = make_law(force={'allocation': 'decoupled', 'fed_forward': 'mixed'})
    paper = make_law(force={'allocation': 'paper', 'fed_forward': 'mixed'})
    for law in (decoupled, paper):
        law.step(sample(law), VARIANCE)
        law.reference.set_forces(FORCES)
    N = decoupled.contacts['N']
    assert_allclose(N @ N.T, np.diag([1.0, 1.0361]), atol=1e-12)
    random = np.random.default_rng(1)
    variance = np.array([0.6, 60.0])
    for k in range(1, 500):
        forces = {'table': 8.0 + random.normal(), 'board': 4.0 + random.normal()}
        qd = 0.05 * random.normal(size=6)
        measurement = sample(decoupled, 0.002 * k, qd, **forces)
        expected = decoupled.step(measurement, variance).torque
        torque = paper.step(measurement, variance).torque
        assert_allclose(torque, expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('fed_forward', ['estimate', 'desired', 'mixed', 'measured'])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
@pytest.mark.parametrize('stiffness', [6000.0, 60_000.0])
def test_law_equals_numpy_for_every_feed_forward(fed_forward, allocation, stiffness):
    surface = {'stiffness': stiffness}
    config = controller_config(
        force={
            'fed_forward': fed_forward,
            'allocation': allocation,
            'input_delay': 0.0031,
        },
        contacts={'table': surface, 'board': surface},
        friction={'coulomb': [1.0] * 6, 'viscous': [0.5] * 6},
        torque_limit=[],
    )
    assert_law_is_numpy(config)


@pytest.mark.parametrize('count', [1, 2, 6])
@pytest.mark.parametrize(
    ('allocation', 'projection'),
    [('decoupled', 'euclidean'), ('decoupled', 'inertia'), ('paper', 'euclidean')],
)
def test_law_equals_numpy_with_seven_joints_and_up_to_six_oblique_contacts(
    tmp_path, count, allocation, projection
):
    random = np.random.default_rng(count)
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = random.normal(size=(count, 3))
    contacts = {}
    for i in range(count):
        contacts[f'contact{i}'] = {
            'normal_world': normals[i].tolist(),
            'point_operational': points[i].tolist(),
        }
    limits = {
        'joint_lower': [-3.0] * 7,
        'joint_upper': [3.0] * 7,
        'joint_speed': [],
        'torque_rate': [],
    }
    config = controller_config(
        robot=seven_joint_config(seven_joint_urdf(tmp_path)).model_dump(),
        friction=NO_FRICTION,
        torque_limit=[100.0] * 7,
        limits=limits,
        collision={'threshold': [1.0] * 7},
        contact_names=list(contacts),
        contacts=contacts,
        force={'allocation': allocation, 'projection': projection},
    )
    home = np.array([0.3, 0.7, -0.4, 0.9, 0.5, -0.8, 2.95])
    assert_law_is_numpy(config, tmp_path, home, 1e-9)


def step_at_rest(q=HOME, **changes):
    make_law(**changes).step(Measurement(0.0, q, REST, REST), VARIANCE)


def test_joints_that_are_not_finite_are_refused():
    with pytest.raises(SingularTaskError, match='finite'):
        step_at_rest(np.full(6, np.nan))


def test_contacts_with_dependent_columns_are_refused():
    """The tool is upright: the board's point lies straight above the table's."""
    above = {'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.3]}
    with pytest.raises(ContactGeometryError, match='table, board'):
        step_at_rest(contacts={'board': above})


def test_singular_posture_is_refused_where_lambda_is_not_damped(monkeypatch):
    monkeypatch.setattr(
        'multicontact_control.control.controller.SINGULAR_MOBILITY', 0.0
    )
    with pytest.raises(SingularTaskError, match='condition number'):
        step_at_rest(np.zeros(6))


class Follow:
    """Asks for the pose the arm is in, a little beside it, and for the speed it has."""

    contact_state, seeks, follower = {}, False, None

    def __init__(self, offset):
        self.offset = np.array(offset)

    def start(self, pose, normals_world):
        pass

    def task_at(self, time, alpha_meas=None):
        pose = self.state.pose
        beside = Pose(pose.position_world + self.offset, pose.rotation_world)
        inactive = np.zeros(2, dtype=bool)
        return WantedTask(beside, self.state.twist_world, REST, inactive, np.zeros(2))


@pytest.mark.parametrize(
    'offset', [(1e-3, 0, 0), (0, 1e-3, 0), (0, 0, 1e-3), (0, 0, 0)]
)
@pytest.mark.parametrize(('joint', 'start', 'end'), [(4, -0.5, 0.5), (2, 2.2, 1.0)])
def test_torques_have_no_spike_on_the_way_through_a_singularity(
    joint, start, end, offset
):
    """Within 40 % of the limits beside gravity, and no more than 2 % of them from tick to tick."""
    follow = Follow(offset)
    limit = np.array(controller_config().torque_limit)
    law = Law(controller_config(torque_limit=[], limits={'torque_rate': []}), follow)
    qd = (end - start) * np.eye(6)[joint]
    shares = []
    shares_beside_gravity = []
    for k in range(501):
        q = HOME.copy()
        q[joint] = start + (end - start) * k / 500
        state = law.robot.update(q, qd)
        follow.state = state
        torque = law.step(Measurement(0.002 * k, q, qd, REST), VARIANCE).torque
        shares.append(torque / limit)
        shares_beside_gravity.append((torque - state.gravity - state.coriolis) / limit)
    assert np.isfinite(shares).all()
    assert np.abs(shares_beside_gravity).max() < 0.4
    assert np.abs(np.diff(shares, axis=0)).max() < 0.02


def limited(torque, priority, limit, least_share=0.0, drive_gravity_torque=0.0):
    """Return a torque within limits, and whether it was beyond them."""
    joints = np.zeros(len(torque), dtype=JOINT)
    joints['answer']['torque'] = torque
    joints['answer']['priority'] = priority
    joints['config']['torque_limit'] = limit
    joints['drive_gravity_torque'] = drive_gravity_torque
    law = np.zeros(1, dtype=LAW)
    law['least_share'] = least_share
    was_limited = limit_torque(law[0], joints)
    return joints['answer']['torque'], was_limited


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.1, 30.0))
def test_torque_beyond_its_limits_keeps_its_direction(seed, size):
    random = np.random.default_rng(seed)
    limit = random.uniform(5.0, 20.0, 6)
    priority = random.uniform(-0.9, 0.9, 6) * limit
    torque = priority + size * random.normal(size=6)
    command, was_limited = limited(torque, priority, limit)
    assert was_limited == bool((np.abs(torque) > limit).any())
    if not was_limited:
        assert_array_equal(command, torque)
        return
    assert (np.abs(command) <= limit).all()
    share = (command - priority) / (torque - priority)
    assert_allclose(share, share[0], atol=1e-9)
    assert 0.0 <= share[0] < 1.0
    assert (np.abs(command) / limit).max() == pytest.approx(1.0)


LIMIT = [10.0, 10.0]


@pytest.mark.parametrize(
    ('torque', 'priority', 'limit', 'expected'),
    [
        ([12.0, 3.0], [11.0, 1.0], LIMIT, [10.0, 3.0]),  # more than can be carried
        ([9.0, 20.0], [1.0, 0.0], [10.0, 4.0], [5.0, 4.0]),
        ([np.nan, 30.0], [0.0, 0.0], LIMIT, [np.nan, 10.0]),
    ],
)
def test_torque_beyond_its_share_is_cut_joint_by_joint(
    torque, priority, limit, expected
):
    command, _ = limited(torque, priority, limit, least_share=0.5)
    assert_allclose(command, expected)


@pytest.mark.parametrize(
    ('torque', 'priority', 'drive_gravity_torque', 'expected'),
    [
        ([20.0, 3.0], [11.0, 1.0], [5.0, 0.0], [15.0, 1.0 + 8.0 / 9.0]),
        ([14.0, -6.0], [0.0, 0.0], [5.0, 4.0], [14.0, -6.0]),
    ],
)
def test_limit_is_that_of_the_command_and_the_torque_that_the_drives_add(
    torque, priority, drive_gravity_torque, expected
):
    command, _ = limited(
        torque, priority, LIMIT, drive_gravity_torque=drive_gravity_torque
    )
    assert_allclose(command, expected)
