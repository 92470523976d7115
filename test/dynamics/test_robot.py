"""The model of an arm against roboticstoolbox, differences, scipy, and damaged URDFs."""

from itertools import product
import json
from pathlib import Path
from xml.etree import ElementTree

from arms import controller_config, HOME, seven_joint_config, seven_joint_urdf
import equations
from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.config import ToolConfig
from multicontact_control.control.arm import ArmState
from multicontact_control.control.law import control_law, LAW_SPACE
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.dynamics.rotations import Pose, rotation_vector_between
from multicontact_control.errors import ConfigError
from multicontact_control.force.force_law import FORCE_LAW
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import find_config_folder
from multicontact_control.records import CONTACT, CONTROL, LAW
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from sim_bridge.robots import find_robot

REFERENCE = json.loads(
    (Path(__file__).parents[1] / 'data' / 'puma560_reference.json').read_text()
)


@pytest.fixture
def puma(tmp_path):
    """Return the arm of the reference values: without tool, armature to the last digit."""
    urdf = ElementTree.parse(find_config_folder() / 'puma560.urdf').getroot()
    for link in urdf.findall('link'):
        if link.get('name') in ('ft_face', 'tool'):
            link.remove(link.find('inertial'))
    (tmp_path / 'puma.urdf').write_text(ElementTree.tostring(urdf, encoding='unicode'))
    config = controller_config().robot.model_copy(
        update={'urdf': 'puma.urdf', 'armature': find_robot('puma').arm.armature}
    )
    return RobotModel(config, tmp_path)


@pytest.mark.parametrize('sample', REFERENCE['samples'][:8])
def test_dynamics_agree_with_roboticstoolbox(puma, sample):
    state = puma.update(np.array(sample['q']), np.array(sample['qd']))
    torque = state.mass_matrix @ sample['qdd'] + state.coriolis + state.gravity
    assert_allclose(torque, sample['tau'], atol=1e-9)
    assert_allclose(state.mass_matrix, sample['M'], atol=1e-9)
    assert_allclose(state.gravity, sample['g'], atol=1e-9)
    pose = np.array(sample['T'])
    assert_allclose(state.pose.position_world, pose[:3, 3], atol=1e-9)
    assert_allclose(state.pose.rotation_world, pose[:3, :3], atol=1e-9)


def test_jacobian_and_drift_agree_with_finite_differences(tmp_path):
    model = RobotModel(seven_joint_config(seven_joint_urdf(tmp_path)), tmp_path)
    rng = np.random.default_rng(0)
    h = 1e-6
    for _ in range(5):
        q, v = rng.standard_normal((2, 7))
        state = model.update(q, v)
        ahead = model.update(q + h * v, v)
        behind = model.update(q - h * v, v)
        way = ahead.pose.position_world - behind.pose.position_world
        rotation_change = ahead.pose.rotation_world - behind.pose.rotation_world
        skew = rotation_change @ state.pose.rotation_world.T
        change = [*way, skew[2, 1], skew[0, 2], skew[1, 0]]
        assert_allclose(state.twist_world, state.jacobian @ v, atol=1e-13)
        assert_allclose(state.twist_world, np.array(change) / (2 * h), atol=1e-7)
        drift = (ahead.jacobian - behind.jacobian) @ v / (2 * h)
        assert_allclose(state.jacobian_drift, drift, atol=1e-6)


def test_model_carries_another_load_than_its_urdf_has():
    """The torque of a load is that of a model with it less that of a model without."""
    config = controller_config()
    load = ToolConfig(mass=1.7, com_sensor=(0.05, -0.03, 0.11))
    bare = load_model(find_config_folder() / config.robot.urdf)
    frame = bare.frames[bare.getFrameId(config.robot.sensor_frame)]

    def model_with(tool):
        model = bare.copy()
        com = np.array(tool.com_sensor)
        inertia = pin.Inertia(tool.mass, com, np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
        return model

    loaded = model_with(load)
    tooled = model_with(config.tool)
    robot = RobotModel(config.robot, find_config_folder())
    robot.carry_load(load, config.tool)
    for q, v, a in np.random.default_rng(1).uniform(-1.5, 1.5, (5, 3, 6)):
        state = robot.update(q, v)
        mass_matrix = state.mass_matrix - np.diag(config.robot.armature)
        torque = mass_matrix @ a + state.coriolis + state.gravity
        expected = pin.rnea(bare, bare.createData(), q, v, a)
        expected += pin.rnea(loaded, loaded.createData(), q, v, a)
        expected -= pin.rnea(tooled, tooled.createData(), q, v, a)
        assert_allclose(torque, expected, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.8))
def test_rotation_error_is_scipys_rotation_vector(seed, size):
    a, b = size * np.random.default_rng(seed).uniform(-1.0, 1.0, (2, 3))
    R_des = Rotation.from_rotvec(a).as_matrix()
    R = Rotation.from_rotvec(b).as_matrix()
    error = rotation_vector_between(R_des, R)
    turned = Rotation.from_rotvec(error).as_matrix() @ R
    assert_allclose(turned, R_des, atol=1e-7)
    assert np.linalg.norm(error) <= np.pi + 1e-9


def test_pose_is_that_of_its_quaternion_whatever_the_length():
    R = Rotation.from_rotvec([0.7, -1.2, 0.4]).as_matrix()
    quaternion = Pose(np.zeros(3), R).quaternion_xyzw
    pose = Pose.from_quaternion(np.zeros(3), 2.0 * quaternion)
    assert_allclose(pose.rotation_world, R, atol=1e-12)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (
            {'joint_names': ('a', 'b')},
            r"robot.joint_names: expected the robot's joints .*joint1",
        ),
        (
            {'operational_frame': 'hand'},
            r'robot.operational_frame: expected a link .*wrist_point',
        ),
        (
            {'sensor_frame': 'hand'},
            r"robot.sensor_frame: expected a link .*, got 'hand'",
        ),
        (
            {'operational_frame': 'link3'},
            r'robot.operational_frame: expected a link that is carried '
            r"by joint6, as the wrist sensor on 'ft_face' is, .*, got 'link3', carried by joint3",
        ),
        (
            {'urdf': 'nowhere.urdf'},
            r'robot.urdf: expected a readable URDF file, got .*nowhere',
        ),
    ],
)
def test_model_refuses_names_that_do_not_match(change, message):
    config = controller_config().robot.model_copy(update=change)
    with pytest.raises(ConfigError, match=message):
        RobotModel(config, find_config_folder())


FINGER = (
    '<link name="{name}"><inertial><origin xyz="0 0 0.02"/><mass value="0.3"/><inertia '
    'ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="{name}_joint" type="{kind}"><parent link="wrist"/><child link="{name}"'
    '/><origin xyz="0 {place} 0.05"/><axis xyz="0 1 0"/>'
    '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>'
)
FINGERS = ('left_joint', 'right_joint')


def add_fingers(urdf, kind, left_place, right_place):
    """Return a URDF whose wrist has two fingers more."""
    left = FINGER.format(name='left', kind=kind, place=left_place)
    right = FINGER.format(name='right', kind=kind, place=right_place)
    return urdf.replace('</robot>', f'{left}{right}</robot>')


@pytest.fixture
def vendor(tmp_path):
    """Return the configuration of an arm with fingers and endless joints."""
    urdf = seven_joint_urdf(tmp_path)
    text = add_fingers(urdf.read_text(), 'prismatic', 0, 0)
    text = text.replace('type="revolute"', 'type="continuous"')
    limit = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'
    urdf.write_text(text.replace(limit, ''))
    return seven_joint_config(urdf)


def lock(config, names, positions):
    """Return a configuration whose other joints are those of the arm."""
    moving = tuple(name for name in config.joint_names if name not in names)
    return config.model_copy(
        update={
            'joint_names': moving,
            'locked_joints': names,
            'locked_positions': positions,
        }
    )


def test_model_is_that_of_an_arm_whose_locked_fingers_are_welded(vendor, tmp_path):
    locked = RobotModel(lock(vendor, FINGERS, (0.03, 0.01)), tmp_path)
    (tmp_path / 'arm').mkdir()
    urdf = seven_joint_urdf(tmp_path / 'arm')
    urdf.write_text(add_fingers(urdf.read_text(), 'fixed', 0.03, 0.01))
    welded = RobotModel(seven_joint_config(urdf), tmp_path / 'arm')
    q = np.linspace(-4.0, 4.0, 7)
    v = np.linspace(0.3, -0.5, 7)
    state = locked.update(q, v)
    expected = welded.update(q, v)
    for name in ('mass_matrix', 'gravity', 'coriolis', 'jacobian'):
        value = getattr(state, name)
        assert_allclose(value, getattr(expected, name), rtol=0.0, atol=1e-12)


def test_endless_joints_have_no_stops(vendor, tmp_path):
    locked = lock(vendor, FINGERS, (0.03, 0.01)).locked
    model = load_model(tmp_path / vendor.urdf, locked)
    assert (model.upperPositionLimit == np.inf).all()


def test_joints_that_are_neither_the_arms_nor_locked_are_refused(vendor, tmp_path):
    expected = (
        r"joint_names: .*'left_joint', 'right_joint'\] in robot.locked_joints, got"
    )
    with pytest.raises(ConfigError, match=expected):
        RobotModel(vendor, tmp_path)


def test_locked_joint_that_the_urdf_does_not_have_is_refused(vendor, tmp_path):
    text = (tmp_path / vendor.urdf).read_text()
    with pytest.raises(ConfigError, match=r"robot.locked_joints: .*got \['thumb'\]"):
        load_model(text, {'thumb': 0.0})


def mimic(folder, multiplier):
    """Return the configuration of an arm whose third joint follows the second."""
    urdf = seven_joint_urdf(folder)
    child = '<child link="l3"/>'
    following = f'{child}<mimic joint="j2" multiplier="{multiplier}"/>'
    urdf.write_text(urdf.read_text().replace(child, following))
    return seven_joint_config(urdf)


@pytest.mark.parametrize(
    ('multiplier', 'message'),
    [
        (
            '-1',
            r'j3.mimic: .*, got j3 follows j2, no motor of its own; list it in '
            'robot.locked_joints',
        ),
        ('half', "j3.mimic.multiplier: expected a number, got 'half'"),
    ],
)
def test_model_refuses_a_joint_that_mimics_another(tmp_path, multiplier, message):
    with pytest.raises(ConfigError, match=message):
        RobotModel(mimic(tmp_path, multiplier), tmp_path)


def test_locked_joint_is_where_the_configuration_says_whatever_it_mimics(tmp_path):
    """Whatever pinocchio makes of the element."""
    following = RobotModel(lock(mimic(tmp_path, '-1'), ('j3',), (0.4,)), tmp_path)
    config = seven_joint_config(seven_joint_urdf(tmp_path))
    expected = RobotModel(lock(config, ('j3',), (0.4,)), tmp_path)
    q = np.linspace(-1.0, 1.0, 6)
    v = np.zeros(6)
    mass_matrix = following.update(q, v).mass_matrix
    assert_array_equal(mass_matrix, expected.update(q, v).mass_matrix)


def _acceleration(state, torque):
    """Joint acceleration of the free arm, and that of its operational point."""
    qdd = np.linalg.solve(state.mass_matrix, torque - state.coriolis - state.gravity)
    return state.jacobian @ qdd + state.jacobian_drift


def test_arm_of_more_joints_than_a_tick_has_room_for_is_refused(tmp_path):
    urdf = seven_joint_urdf(tmp_path, joints=13)
    names = tuple(f'j{i}' for i in range(13))
    config = seven_joint_config(urdf).model_copy(
        update={'joint_names': names, 'armature': (0.1,) * 13}
    )
    with pytest.raises(ConfigError, match='at most 12 joints.*got 13'):
        RobotModel(config, tmp_path)


def torque_for(model, q, v, acceleration, **nullspace):
    """Return J^T Lambda (a + bias), with the null space as records of `LAW` and `JOINT` say it."""
    controls = np.zeros(1, dtype=CONTROL)
    contacts = np.zeros(0, dtype=CONTACT)
    arm = ArmState(model, controls, contacts)
    arm.joints['config']['torque_limit'] = np.inf
    controls['task']['acceleration'] = acceleration
    for name, value in nullspace.items():
        owner = arm.joints['config']
        if name in LAW.names:
            owner = controls['law']
        owner[name] = value
    arm.motion[:] = q, v
    arm.take_motion()
    refused = control_law(
        controls[0],
        arm.joints,
        model.terms,
        contacts,
        np.zeros(0, dtype=FORCE_LAW),
        np.zeros(1, dtype=LAW_SPACE)[0],
    )
    assert refused == 0
    return arm.joints['answer']['torque'].copy()


def test_operational_force_gives_the_commanded_acceleration():
    """F = Lambda a + mu + p makes the operational point accelerate by a (P04 eqs 24-25)."""
    puma = RobotModel(controller_config().robot, find_config_folder())
    rng = np.random.default_rng(1)
    for _ in range(10):
        q = HOME + 0.3 * rng.standard_normal(6)
        v, a = rng.standard_normal((2, 6))
        torque = torque_for(puma, q, v, a)
        state = puma.update(q, v)
        assert_allclose(_acceleration(state, torque), a, atol=1e-9)
        space = equations.operational_space(state)
        force = space.Lambda @ a + space.mu + space.p
        assert_allclose(torque, state.jacobian.T @ force, atol=1e-9)


def test_redundant_arm_gives_the_commanded_acceleration_in_any_null_space_motion(
    tmp_path,
):
    """J M^-1 of what damping, posture and stops add is 0, to rounding."""
    model = RobotModel(seven_joint_config(seven_joint_urdf(tmp_path)), tmp_path)
    rng = np.random.default_rng(4)
    for _ in range(10):
        q, v = rng.standard_normal((2, 7))
        a = rng.standard_normal(6)
        posture = np.ones(7)
        lower = q - 0.05
        upper = q + np.array([0.03] * 3 + [np.inf] * 4)
        free = torque_for(model, q, v, a)
        damped = torque_for(model, q, v, a, nullspace_damping=10.0)
        pulled = torque_for(
            model,
            q,
            v,
            a,
            nullspace_damping=10.0,
            posture_stiffness=25.0,
            stop_stiffness=400.0,
            posture=posture,
            lower=lower,
            upper=upper,
        )
        state = model.update(q, v)
        for torque in (free, damped, pulled):
            assert_allclose(_acceleration(state, torque), a, atol=1e-8)
        assert (damped - free) @ v < 0.0
        change = np.linalg.solve(state.mass_matrix, pulled - damped)
        assert np.abs(change).max() > 0.1
        space = equations.operational_space(state)
        force = space.Lambda @ a + space.mu + space.p
        pull = equations.posture_pull(q, posture, lower, upper, 5.0, 0.1)
        expected = equations.joint_torque(force, state, space, 10.0, pull)
        assert_allclose(pulled, expected, atol=1e-8)


MOMENTS = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
MASS = ('inertial/mass', 'value')
INERTIA = ('inertial/inertia', *MOMENTS)
COM = ('inertial/origin', 'xyz')
STOPS = ('limit', 'lower', 'upper')


def spoil(element, path, *names, factor=None):
    """Multiply all numbers of some attributes, or remove them, or the element without names."""
    if not names:
        element.remove(element.find(path))
    for name in names:
        attributes = element.find(path).attrib
        text = attributes.pop(name)
        if factor is not None:
            numbers = factor * np.array(text.split(), dtype=float)
            attributes[name] = ' '.join(map(str, numbers))


# Of a link, and of a joint; the factor removes what it is None for.
LINK_FAULTS = [
    (MASS, 0.0),
    (MASS, -1.0),
    (MASS, 1e3),
    (INERTIA, -1.0),
    (INERTIA, 3.0),
    (INERTIA, 1e3),
    (INERTIA, 1e9),
    (INERTIA[::3], -1.0),
    (INERTIA[::3], 30.0),
    (COM, 1e3),
    (('inertial',), None),
]
JOINT_FAULTS = [
    (('axis', 'xyz'), 0.0),
    (('axis', 'xyz'), 2.0),
    (STOPS, 0.0),
    (STOPS, -1.0),
    (STOPS, 180.0 / np.pi),
    (('limit', 'effort'), 0.01),
    (('limit', 'effort'), None),
    (('limit', 'upper'), None),
    (('limit',), None),
]


@pytest.fixture
def seven(tmp_path):
    """Return the URDF of an arm of seven joints."""
    return seven_joint_urdf(tmp_path)


def damage(urdf, which, kind, fault, factor):
    """Spoil a joint or the link that it carries; return the names of both."""
    tree = ElementTree.parse(urdf)
    joint = tree.findall("joint[@type='revolute']")[which]
    child = joint.find('child').get('link')
    link = tree.find(f"link[@name='{child}']")
    spoil({'joint': joint, 'link': link}[kind], *fault, factor=factor)
    tree.write(urdf)
    return child, joint.get('name')


def find_complaints(config, folder):
    """Return what the model check says, refusals and warnings, as one text."""
    try:
        return ' '.join(RobotModel(config, folder).list_warnings())
    except ConfigError as error:
        return str(error)


@pytest.mark.parametrize(
    ('kind', 'faults'), [('link', LINK_FAULTS), ('joint', JOINT_FAULTS)]
)
def test_model_check_names_each_damage_or_it_does_no_harm(seven, kind, faults):
    """
    No harm: the torque that carries the true arm is right to 3 % of the limits.

    And no direction has an inertia that is wrong by more than a factor of 2.
    """
    config = seven_joint_config(seven)
    whole = seven.read_text()
    true = RobotModel(config, seven.parent)
    assert true.list_warnings() == ()
    zero = np.zeros(7)
    limit = true.torque_limit
    postures = np.random.default_rng(7).uniform(-1.5, 1.5, (10, 7))
    harmless = 0
    for which, (fault, factor) in product(range(7), faults):
        seven.write_text(whole)
        link, joint = damage(seven, which, kind, fault, factor)
        complaints = find_complaints(config, seven.parent)
        if link in complaints or joint in complaints:
            continue
        harmless += 1
        model = RobotModel(config, seven.parent)
        for q in postures:
            right = true.update(q, zero)
            wrong = model.update(q, zero)
            assert (np.abs(wrong.gravity - right.gravity) < 0.03 * limit).all()
            ratio = np.linalg.solve(right.mass_matrix, wrong.mass_matrix)
            shares = np.linalg.eigvals(ratio).real
            assert 0.5 < shares.min()
            assert shares.max() < 2.0
            assert (np.abs(right.gravity) <= model.torque_limit).all()
    assert harmless < 12


@pytest.mark.parametrize(
    ('fault', 'factor', 'words'),
    [
        (MASS, 1e3, ('masses in g',)),
        (COM, 1e3, ('l0', 'l3', 'l6', 'mm?')),
        (INERTIA, 1e9, ('l0', 'l3', 'l6', 'g mm^2')),
        (('inertial',), None, ('l0', 'l3', 'l6')),
    ],
)
def test_loop_refuses_an_impossible_arm_and_names_all_links(
    seven, fault, factor, words
):
    tree = ElementTree.parse(seven)
    for link in tree.findall('link[inertial]'):
        spoil(link, *fault, factor=factor)
    tree.write(seven)
    robot = seven_joint_config(seven)
    config = controller_config().model_copy(update={'robot': robot})
    with pytest.raises(ConfigError) as caught:
        ControlLoop(config, None, CommandLimits(), seven.parent)
    for word in words:
        assert word in str(caught.value)
