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
import equations
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
import pytest
from reference_controller import ReferenceController

REST = np.zeros(6)
NO_FRICTION = {'coulomb': [], 'viscous': []}


def make_law(reference=None, **changes):
    """Return a law without joint friction, and its reference: commands by themselves."""
    config = controller_config(friction=NO_FRICTION, **changes)
    reference = reference or CommandedTask(config.column_names, config.leading_columns)
    return Law(config, reference), reference


def sample(law, time=0.0, qd=REST, **forces):
    """Return a sample at home, with forces on contacts."""
    state = law.robot.update(HOME, qd)
    config = law.config
    weight = predict_weight_reading(
        state.sensor_pose.rotation_world,
        config.tool,
        np.array(config.robot.gravity_world),
    )
    return Measurement(
        time,
        HOME.copy(),
        np.array(qd),
        weight + pressed_wrench(config, state, **forces),
    )


@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
def test_motion_error_accelerates_no_contact(projection, allocation):
    """With both forces at their command, a motion error leaves N^T theta_dot at 0."""
    law, reference = make_law(
        force={'projection': projection, 'allocation': allocation}
    )
    law.step(sample(law), np.full(2, 0.6))
    reference.set_forces({'table': 10.0, 'board': 5.0})
    state = law.robot.update(HOME, REST)
    reference.set_motion(
        MotionReading(
            state.pose.position_world + [0.01, 0.004, -0.003],
            state.pose.quaternion_xyzw,
            REST,
            np.array([0.5, 0, 0, 0, 0, 0.2]),
        ),
        np.zeros((0, 3)),
    )
    output = law.step(sample(law, 0.002, table=10.0, board=5.0), np.full(2, 0.6))
    np.testing.assert_allclose(output.contacts['alpha_meas'], [10.0, 5.0], atol=1e-9)
    contacts = [law.config.contacts[name] for name in ('table', 'board')]
    N = equations.contact_normals(
        np.array([each.normal_world for each in contacts]),
        -np.array(
            [state.pose.rotation_world @ each.point_operational for each in contacts]
        ),
    )
    qdd = np.linalg.solve(
        state.mass_matrix,
        output.torque
        - state.coriolis
        - state.gravity
        - state.jacobian.T @ N @ [10.0, 5.0],
    )
    acceleration = state.jacobian @ qdd + state.jacobian_drift
    np.testing.assert_allclose(N.T @ acceleration, 0.0, atol=1e-8)
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

    contact_state, seeks = {}, False

    def __init__(self, contacts):
        self._generator = np.random.default_rng(0)
        self._contacts = contacts

    def start(self, pose, normals_world):
        self._pose = pose

    def task_at(self, time, alpha_meas=None):
        random = self._generator
        turn = random.normal(size=4) * [0.2, 0.2, 0.2, 0.0] + [0.0, 0.0, 0.0, 1.0]
        offset = Pose.from_quaternion(0.05 * random.normal(size=3), turn)
        active = random.random(self._contacts) < 0.8
        return WantedTask(
            pose_des=Pose(
                self._pose.position_world + offset.position_world,
                offset.rotation_world @ self._pose.rotation_world,
            ),
            twist_des=0.1 * random.normal(size=6),
            acceleration_des=random.normal(size=6),
            active=active,
            alpha_des=np.where(active, 20.0 * random.random(self._contacts), 0.0),
        )


def assert_law_is_numpy(config, base_dir=None, home=HOME, tolerance=1e-12):
    """Compare both laws on random states and contacts, to a tolerance of the largest."""
    count = len(config.contact_names)
    random = np.random.default_rng(0)
    compiled = Law(config, RandomTask(count), base_dir)
    plain = ReferenceController(
        config,
        RobotModel(config.robot, base_dir or find_config_folder()),
        RandomTask(count),
    )
    for k in range(50):
        sample = Measurement(
            0.002 * k,
            home + 0.1 * random.normal(size=home.shape),
            random.normal(size=home.shape),
            10.0 * random.normal(size=6),
        )
        variance = np.exp(random.normal(size=count))
        output, expected = (law.step(sample, variance) for law in (compiled, plain))
        results = {'torque': output.torque, 'alpha_meas': output.contacts['alpha_meas']}
        for name, values in (
            results | {name: output.answer[name] for name in SERIES}
        ).items():
            wanted = getattr(expected, name)
            np.testing.assert_allclose(
                values,
                wanted,
                rtol=0.0,
                err_msg=name,
                atol=tolerance * max(1.0, np.abs(wanted).max()),
            )


@pytest.mark.parametrize('order', [0, 1, 3])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
@pytest.mark.parametrize('projection', ['euclidean', 'inertia'])
def test_law_equals_numpy_for_every_option(order, allocation, projection):
    assert_law_is_numpy(
        controller_config(
            force={
                'active_state_order': order,
                'allocation': allocation,
                'projection': projection,
            }
        )
    )


def test_law_equals_numpy_where_lambda_is_damped():
    """Around all joints at 0, which is singular."""
    assert_law_is_numpy(controller_config(), home=np.zeros(6), tolerance=1e-9)


def test_paper_allocation_equals_the_decoupled_one_where_normals_are_orthogonal():
    """N^T N is diagonal at home, with k_s of 1 and 1.036 k_env: eqs 17, 30 and 31 hold."""
    decoupled, paper = (
        make_law(force={'allocation': allocation, 'fed_forward': 'mixed'})
        for allocation in ('decoupled', 'paper')
    )
    for law, reference in (decoupled, paper):
        law.step(sample(law), np.full(2, 0.6))
        reference.set_forces({'table': 10.0, 'board': 5.0})
    N = decoupled[0].controller.contacts['N']
    np.testing.assert_allclose(N @ N.T, np.diag([1.0, 1.0361]), atol=1e-12)
    random = np.random.default_rng(1)
    for k in range(1, 500):
        forces = {'table': 8.0 + random.normal(), 'board': 4.0 + random.normal()}
        qd = 0.05 * random.normal(size=6)
        one, other = (
            law.step(sample(law, 0.002 * k, qd, **forces), np.array([0.6, 60.0]))
            for law, _ in (decoupled, paper)
        )
        np.testing.assert_allclose(other.torque, one.torque, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('fed_forward', ['estimate', 'desired', 'mixed', 'measured'])
@pytest.mark.parametrize('allocation', ['decoupled', 'paper'])
@pytest.mark.parametrize('stiffness', [6000.0, 60_000.0])
def test_law_equals_numpy_for_every_feed_forward(fed_forward, allocation, stiffness):
    contacts = {name: {'stiffness': stiffness} for name in ('table', 'board')}
    assert_law_is_numpy(
        controller_config(
            force={
                'fed_forward': fed_forward,
                'allocation': allocation,
                'input_delay': 0.0031,
            },
            contacts=contacts,
            friction={'coulomb': [1.0] * 6, 'viscous': [0.5] * 6},
            torque_limit=[],
        )
    )


@pytest.mark.parametrize('count', [1, 2, 6])
@pytest.mark.parametrize(
    ('allocation', 'projection'),
    [('decoupled', 'euclidean'), ('decoupled', 'inertia'), ('paper', 'euclidean')],
)
def test_law_equals_numpy_with_seven_joints_and_up_to_six_oblique_contacts(
    tmp_path, count, allocation, projection
):
    random = np.random.default_rng(count)
    names = [f'contact{i}' for i in range(count)]
    normals = random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    config = controller_config(
        robot=seven_joint_config(seven_joint_urdf(tmp_path)).model_dump(),
        friction=NO_FRICTION,
        torque_limit=[100.0] * 7,
        limits={
            'joint_lower': [-3.0] * 7,
            'joint_upper': [3.0] * 7,
            'joint_speed': [],
            'torque_rate': [],
        },
        collision={'threshold': [1.0] * 7},
        contact_names=names,
        contacts={
            name: {'normal_world': normal.tolist(), 'point_operational': point.tolist()}
            for name, normal, point in zip(
                names, normals, random.normal(size=(count, 3))
            )
        },
        force={'allocation': allocation, 'projection': projection},
    )
    assert_law_is_numpy(
        config, tmp_path, np.array([0.3, 0.7, -0.4, 0.9, 0.5, -0.8, 2.95]), 1e-9
    )


def test_controller_refuses_impossible_samples(monkeypatch):
    def step(q=HOME, **changes):
        make_law(**changes)[0].step(Measurement(0.0, q, REST, REST), np.ones(2))

    above = {'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.3]}
    for error, match, arguments in (
        (SingularTaskError, 'finite', {'q': np.full(6, np.nan)}),
        # The tool is upright: the board's point lies straight above the table's.
        (ContactGeometryError, 'table, board', {'contacts': {'board': above}}),
    ):
        with pytest.raises(error, match=match):
            step(**arguments)
    monkeypatch.setattr(
        'multicontact_control.control.controller.SINGULAR_MOBILITY', 0.0
    )
    with pytest.raises(SingularTaskError, match='condition number'):
        step(np.zeros(6))


class Follow:
    """Asks for the pose the arm is in, a little beside it, and for the speed it has."""

    contact_state, seeks = {}, False

    def __init__(self, offset):
        self.offset = np.array(offset)

    def start(self, pose, normals_world):
        pass

    def task_at(self, time, alpha_meas=None):
        state = self.state
        beside = Pose(
            state.pose.position_world + self.offset, state.pose.rotation_world
        )
        return WantedTask(
            beside, state.twist_world, REST, np.zeros(2, dtype=bool), np.zeros(2)
        )


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
    torques = []
    gravity = []
    for k in range(501):
        q = HOME.copy()
        q[joint] = start + (end - start) * k / 500
        follow.state = law.robot.update(q, qd)
        torques.append(
            law.step(Measurement(0.002 * k, q, qd, REST), np.full(2, 0.6)).torque
        )
        gravity.append(follow.state.gravity + follow.state.coriolis)
    shares = np.array(torques) / limit
    assert np.isfinite(shares).all()
    assert np.abs(shares - np.array(gravity) / limit).max() < 0.4
    assert np.abs(np.diff(shares, axis=0)).max() < 0.02


def limited(torque, priority, limit, least_share=0.0, drive_gravity_torque=0.0):
    joints = np.zeros(len(torque), dtype=JOINT)
    joints['answer']['torque'], joints['answer']['priority'] = torque, priority
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
        np.testing.assert_array_equal(command, torque)
        return
    assert (np.abs(command) <= limit).all()
    share = (command - priority) / (torque - priority)
    np.testing.assert_allclose(share, share[0], atol=1e-9)
    assert 0.0 <= share[0] < 1.0
    assert (np.abs(command) / limit).max() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ('torque', 'priority', 'limit', 'options', 'expected'),
    [
        (
            [12.0, 3.0],
            [11.0, 1.0],
            [10.0, 10.0],
            {},
            [10.0, 3.0],
        ),  # more than can be carried
        ([9.0, 20.0], [1.0, 0.0], [10.0, 4.0], {'least_share': 0.5}, [5.0, 4.0]),
        ([np.nan, 30.0], [0.0, 0.0], [10.0, 10.0], {}, [np.nan, 10.0]),
        # Limits are those of command and torque that the drives add.
        (
            [20.0, 3.0],
            [11.0, 1.0],
            [10.0, 10.0],
            {'drive_gravity_torque': [5.0, 0.0]},
            [15.0, 1.0 + 8.0 / 9.0],
        ),
        (
            [14.0, -6.0],
            [0.0, 0.0],
            [10.0, 10.0],
            {'drive_gravity_torque': [5.0, 4.0]},
            [14.0, -6.0],
        ),
    ],
)
def test_torque_beyond_its_share_is_cut_joint_by_joint(
    torque, priority, limit, options, expected
):
    np.testing.assert_allclose(limited(torque, priority, limit, **options)[0], expected)
