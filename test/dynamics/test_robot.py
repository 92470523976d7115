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
    q, qd, qdd = (np.array(sample[name]) for name in ('q', 'qd', 'qdd'))
    state = puma.update(q, qd)
    torque = state.mass_matrix @ qdd + state.coriolis + state.gravity
    np.testing.assert_allclose(torque, sample['tau'], atol=1e-9)
    np.testing.assert_allclose(state.mass_matrix, sample['M'], atol=1e-9)
    np.testing.assert_allclose(state.gravity, sample['g'], atol=1e-9)
    pose = np.array(sample['T'])
    np.testing.assert_allclose(state.pose.position_world, pose[:3, 3], atol=1e-9)
    np.testing.assert_allclose(state.pose.rotation_world, pose[:3, :3], atol=1e-9)


def test_jacobian_and_drift_agree_with_finite_differences(tmp_path):
    model = RobotModel(seven_joint_config(seven_joint_urdf(tmp_path)), tmp_path)
    rng = np.random.default_rng(0)
    h = 1e-6
    for _ in range(5):
        q, v = rng.standard_normal((2, 7))
        state, ahead, behind = (
            model.update(each, v) for each in (q, q + h * v, q - h * v)
        )
        linear, turn = (
            (getattr(ahead.pose, name) - getattr(behind.pose, name)) / (2 * h)
            for name in ('position_world', 'rotation_world')
        )
        skew = turn @ state.pose.rotation_world.T
        np.testing.assert_allclose(state.twist_world, state.jacobian @ v, atol=1e-13)
        np.testing.assert_allclose(
            state.twist_world, [*linear, skew[2, 1], skew[0, 2], skew[1, 0]], atol=1e-7
        )
        rate = (ahead.jacobian - behind.jacobian) @ v
        np.testing.assert_allclose(state.jacobian_drift, rate / (2 * h), atol=1e-6)


def test_model_carries_another_load_than_its_urdf_has():
    config = controller_config()
    load = ToolConfig(mass=1.7, com_sensor=(0.05, -0.03, 0.11))
    models = [load_model(find_config_folder() / config.robot.urdf) for _ in range(3)]
    for model, tool in zip(models, (load, config.tool)):
        frame = model.frames[model.getFrameId(config.robot.sensor_frame)]
        model.appendBodyToJoint(
            frame.parentJoint,
            pin.Inertia(tool.mass, np.array(tool.com_sensor), np.zeros((3, 3))),
            frame.placement,
        )
    robot = RobotModel(config.robot, find_config_folder())
    robot.carry_load(load, config.tool)
    for q, v, a in np.random.default_rng(1).uniform(-1.5, 1.5, (5, 3, 6)):
        state = robot.update(q, v)
        torque = (state.mass_matrix - np.diag(config.robot.armature)) @ a
        more, less, bare = (pin.rnea(x, x.createData(), q, v, a) for x in models)
        np.testing.assert_allclose(
            torque + state.coriolis + state.gravity, bare + more - less, atol=1e-9
        )


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.8))
def test_rotation_error_is_scipys_rotation_vector(seed, size):
    a, b = size * np.random.default_rng(seed).uniform(-1.0, 1.0, (2, 3))
    R_des = Rotation.from_rotvec(a).as_matrix()
    R = Rotation.from_rotvec(b).as_matrix()
    error = rotation_vector_between(R_des, R)
    np.testing.assert_allclose(
        Rotation.from_rotvec(error).as_matrix() @ R, R_des, atol=1e-7
    )
    assert np.linalg.norm(error) <= np.pi + 1e-9
    pose = Pose(a, R)
    again = Pose.from_quaternion(a, 2.0 * pose.quaternion_xyzw)
    np.testing.assert_allclose(again.rotation_world, R, atol=1e-12)


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


def test_model_of_a_vendors_urdf_locks_fingers_and_takes_endless_joints(tmp_path):
    """It is that of an arm whose fingers are welded where they are locked."""
    arm = seven_joint_urdf(tmp_path).read_text()

    def with_fingers(kind, places):
        fingers = ''.join(
            f'<link name="{name}"><inertial><origin xyz="0 0 0.02"/><mass value="0.3"/><inertia '
            'ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}_joint" type="{kind}"><parent link="wrist"/><child link="{name}"'
            f'/><origin xyz="0 {place} 0.05"/><axis xyz="0 1 0"/>'
            '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>'
            for name, place in zip(('left', 'right'), places)
        )
        return arm.replace('</robot>', fingers + '</robot>')

    limit = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'
    vendor = tmp_path / 'vendor.urdf'
    welded = tmp_path / 'welded.urdf'
    vendor.write_text(
        with_fingers('prismatic', (0, 0))
        .replace('type="revolute"', 'type="continuous"')
        .replace(limit, '')
    )
    welded.write_text(with_fingers('fixed', (0.03, 0.01)))
    config = seven_joint_config(vendor)
    with pytest.raises(
        ConfigError,
        match=r"robot.joint_names: .*'left_joint', 'right_joint'\] in "
        'robot.locked_joints, got',
    ):
        RobotModel(config, tmp_path)
    locked = config.model_copy(
        update={
            'locked_joints': ('left_joint', 'right_joint'),
            'locked_positions': (0.03, 0.01),
        }
    )
    q = np.linspace(-4.0, 4.0, 7)
    v = np.linspace(0.3, -0.5, 7)
    state, expected = (
        RobotModel(each, tmp_path).update(q, v)
        for each in (locked, seven_joint_config(welded))
    )
    for name in ('mass_matrix', 'gravity', 'coriolis', 'jacobian'):
        np.testing.assert_allclose(
            getattr(state, name), getattr(expected, name), rtol=0.0, atol=1e-12
        )
    assert (load_model(vendor, locked.locked).upperPositionLimit == np.inf).all()
    with pytest.raises(ConfigError, match="robot.locked_joints: .*got \\['thumb'\\]"):
        load_model(vendor.read_text(), {'thumb': 0.0})


def test_model_refuses_a_joint_that_mimics_another_unless_it_is_locked(tmp_path):
    """Whatever pinocchio makes of the element, a locked one is where the configuration says."""
    urdf = seven_joint_urdf(tmp_path)
    plain = urdf.read_text()
    urdf.write_text(
        plain.replace(
            '<child link="l3"/>',
            '<child link="l3"/><mimic joint="j2" multiplier="-1"/>',
        )
    )
    config = seven_joint_config(urdf)
    with pytest.raises(
        ConfigError,
        match=r'robot.urdf.j3.mimic: .*, got j3 follows j2, no motor '
        r'of its own; list it in robot.locked_joints',
    ):
        RobotModel(config, tmp_path)
    others = tuple(name for name in config.joint_names if name != 'j3')
    locked = config.model_copy(
        update={
            'joint_names': others,
            'locked_joints': ('j3',),
            'locked_positions': (0.4,),
        }
    )
    urdf_of_six = tmp_path / 'plain.urdf'
    urdf_of_six.write_text(plain)
    expected = RobotModel(locked.model_copy(update={'urdf': 'plain.urdf'}), tmp_path)
    q = np.linspace(-1.0, 1.0, 6)
    v = np.linspace(0.3, -0.5, 6)
    np.testing.assert_array_equal(
        RobotModel(locked, tmp_path).update(q, v).mass_matrix,
        expected.update(q, v).mass_matrix,
    )
    urdf.write_text(urdf.read_text().replace('multiplier="-1"', 'multiplier="half"'))
    with pytest.raises(
        ConfigError, match="j3.mimic.multiplier: expected a number, got 'half'"
    ):
        RobotModel(config, tmp_path)


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
    law = controls['law']
    terms = model.terms
    contacts = np.zeros(0, dtype=CONTACT)
    arm = ArmState(model, controls, contacts)
    arm.joints['config']['torque_limit'] = np.inf
    controls['task']['acceleration'] = acceleration
    for name, value in nullspace.items():
        (law if name in LAW.names else arm.joints['config'])[name] = value
    arm.motion[:] = q, v
    arm.take_motion()
    assert (
        control_law(
            controls[0],
            arm.joints,
            terms.mass_matrix,
            terms.jacobian,
            terms.jacobian_rate,
            contacts,
            np.zeros(0, dtype=FORCE_LAW),
            np.zeros(1, dtype=LAW_SPACE)[0],
        )
        == 0
    )
    return arm.joints['answer']['torque'].copy()


def test_operational_force_gives_the_commanded_acceleration():
    """F = Lambda a + mu + p makes the operational point accelerate by a (P04 eqs 24-25)."""
    puma = RobotModel(controller_config().robot, find_config_folder())
    rng = np.random.default_rng(1)
    for _ in range(10):
        q, v, a = HOME + 0.3 * rng.standard_normal(6), *rng.standard_normal((2, 6))
        torque = torque_for(puma, q, v, a)
        state = puma.update(q, v)
        np.testing.assert_allclose(_acceleration(state, torque), a, atol=1e-9)
        space = equations.operational_space(state)
        np.testing.assert_allclose(
            torque,
            state.jacobian.T @ (space.Lambda @ a + space.mu + space.p),
            atol=1e-9,
        )


def test_redundant_arm_gives_the_commanded_acceleration_in_any_null_space_motion(
    tmp_path,
):
    """J M^-1 of what damping, posture and stops add is 0, to rounding."""
    model = RobotModel(seven_joint_config(seven_joint_urdf(tmp_path)), tmp_path)
    rng = np.random.default_rng(4)
    for _ in range(10):
        q, v, a, posture = (
            *rng.standard_normal((2, 7)),
            rng.standard_normal(6),
            np.ones(7),
        )
        lower = q - 0.05
        upper = q + np.array([0.03] * 3 + [np.inf] * 4)
        free, damped, pulled = (
            torque_for(model, q, v, a, **each)
            for each in (
                {},
                {'nullspace_damping': 10.0},
                {
                    'nullspace_damping': 10.0,
                    'posture_stiffness': 25.0,
                    'stop_stiffness': 400.0,
                    'posture': posture,
                    'lower': lower,
                    'upper': upper,
                },
            )
        )
        state = model.update(q, v)
        for torque in (free, damped, pulled):
            np.testing.assert_allclose(_acceleration(state, torque), a, atol=1e-8)
        assert (damped - free) @ v < 0.0
        assert np.abs(np.linalg.solve(state.mass_matrix, pulled - damped)).max() > 0.1
        space = equations.operational_space(state)
        np.testing.assert_allclose(
            pulled,
            equations.joint_torque(
                space.Lambda @ a + space.mu + space.p,
                state,
                space,
                10.0,
                equations.posture_pull(q, posture, lower, upper, 5.0, 0.1),
            ),
            atol=1e-8,
        )


MOMENTS = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
MASS, INERTIA = ('inertial/mass', 'value'), ('inertial/inertia', *MOMENTS)
COM, STOPS = ('inertial/origin', 'xyz'), ('limit', 'lower', 'upper')


def spoil(element, path, *names, factor=None):
    """Multiply all numbers of some attributes, or remove them, or the element without names."""
    if not names:
        element.remove(element.find(path))
    for name in names:
        attributes = element.find(path).attrib
        numbers = [float(number) for number in attributes.pop(name).split()]
        if factor is not None:
            attributes[name] = ' '.join(str(factor * number) for number in numbers)


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


def make_seven(folder):
    """Return an arm of seven joints: its URDF and the configuration of its loop."""
    urdf = seven_joint_urdf(folder)
    return urdf, controller_config().model_copy(
        update={'robot': seven_joint_config(urdf)}
    )


def test_model_check_names_each_damage_or_it_does_no_harm(tmp_path):
    """
    No harm: the torque that carries the true arm is right to 3 % of the limits.

    And no direction has an inertia that is wrong by more than a factor of 2.
    """
    urdf, config = make_seven(tmp_path)
    whole = urdf.read_text()
    random = np.random.default_rng(7)
    true = RobotModel(config.robot, tmp_path)
    assert true.warnings() == ()
    zero = np.zeros(true.joint_count)
    limit = true.torque_limit
    postures = random.uniform(-1.5, 1.5, (10, true.joint_count))
    harmless = 0
    for which, (kind, path, factor) in product(
        range(true.joint_count),
        [*(('link', *x) for x in LINK_FAULTS), *(('joint', *x) for x in JOINT_FAULTS)],
    ):
        root = ElementTree.fromstring(whole)
        joint = [x for x in root.findall('joint') if x.get('type') == 'revolute'][which]
        child = joint.find('child').get('link')
        (link,) = (x for x in root.findall('link') if x.get('name') == child)
        spoil(link if kind == 'link' else joint, *path, factor=factor)
        urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
        try:
            lines = RobotModel(config.robot, tmp_path).warnings()
        except ConfigError as error:
            lines = tuple(str(each) for each in error.errors)
        if any(name in line for line in lines for name in (child, joint.get('name'))):
            continue
        harmless += 1
        model = RobotModel(config.robot, tmp_path)
        for q in postures:
            right = true.update(q, zero)
            wrong = model.update(q, zero)
            assert (np.abs(wrong.gravity - right.gravity) < 0.03 * limit).all()
            shares = np.linalg.eigvals(
                np.linalg.solve(right.mass_matrix, wrong.mass_matrix)
            ).real
            assert 0.5 < shares.min() and shares.max() < 2.0
            assert (np.abs(right.gravity) <= model.torque_limit).all()
    assert harmless < 24


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
    tmp_path, fault, factor, words
):
    urdf, config = make_seven(tmp_path)
    root = ElementTree.fromstring(urdf.read_text())
    for link in root.findall('link'):
        if link.find('inertial') is not None:
            spoil(link, *fault, factor=factor)
    urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
    with pytest.raises(ConfigError) as caught:
        ControlLoop(config, None, CommandLimits(), tmp_path)
    assert all(word in str(caught.value) for word in words)
