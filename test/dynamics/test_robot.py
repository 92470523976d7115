"""The robot model against roboticstoolbox, finite differences and scipy's rotations."""

import json
from pathlib import Path
from xml.etree import ElementTree

from arms import controller_config, seven_joint_config, seven_joint_urdf
from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.dynamics.rotations import Pose, rotation_vector
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sim_bridge.robots import find_robot

REFERENCE = json.loads(
    (Path(__file__).parents[1] / 'data' / 'puma560_reference.json').read_text())


@pytest.fixture
def puma(tmp_path):
    """Return the arm of the reference values: without tool, armature to the last digit."""
    urdf = ElementTree.parse(config_dir() / 'puma560.urdf').getroot()
    for link in urdf.findall('link'):
        if link.get('name') in ('ft_face', 'tool'):
            link.remove(link.find('inertial'))
    (tmp_path / 'puma.urdf').write_text(ElementTree.tostring(urdf, encoding='unicode'))
    config = controller_config().robot.model_copy(update={
        'urdf': 'puma.urdf', 'armature': find_robot('puma').arm.armature})
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
    rng, h = np.random.default_rng(0), 1e-6
    for _ in range(5):
        q, v = rng.standard_normal((2, 7))
        state, ahead, behind = (model.update(each, v) for each in (q, q + h * v, q - h * v))
        linear, turn = (
            (getattr(ahead.pose, name) - getattr(behind.pose, name)) / (2 * h)
            for name in ('position_world', 'rotation_world'))
        skew = turn @ state.pose.rotation_world.T
        np.testing.assert_allclose(state.twist_world, state.jacobian @ v, atol=1e-13)
        np.testing.assert_allclose(
            state.twist_world, [*linear, skew[2, 1], skew[0, 2], skew[1, 0]], atol=1e-7)
        rate = (ahead.jacobian - behind.jacobian) @ v
        np.testing.assert_allclose(state.jacobian_drift, rate / (2 * h), atol=1e-6)


@given(st.integers(0, 2 ** 32 - 1), st.floats(0.0, 1.8))
def test_rotation_error_is_scipys_rotation_vector(seed, size):
    a, b = size * np.random.default_rng(seed).uniform(-1.0, 1.0, (2, 3))
    R_des, R = Rotation.from_rotvec(a).as_matrix(), Rotation.from_rotvec(b).as_matrix()
    error = np.empty(3)
    rotation_vector(R_des, R, error)
    np.testing.assert_allclose(Rotation.from_rotvec(error).as_matrix() @ R, R_des, atol=1e-7)
    assert np.linalg.norm(error) <= np.pi + 1e-9
    pose = Pose(a, R)
    again = Pose.from_quaternion(a, 2.0 * pose.quaternion_xyzw)
    np.testing.assert_allclose(again.rotation_world, R, atol=1e-12)


@pytest.mark.parametrize(('change', 'message'), [
    ({'joint_names': ('a', 'b')}, r"robot.joint_names: expected the robot's joints .*joint1"),
    ({'operational_frame': 'hand'}, r'robot.operational_frame: expected a link .*wrist_point'),
    ({'sensor_frame': 'hand'}, r"robot.sensor_frame: expected a link .*, found 'hand'"),
    ({'operational_frame': 'link3'}, r'robot.operational_frame: expected a link that is carried '
     r"by joint6, as the wrist sensor on 'ft_face' is, .*, found 'link3', carried by joint3"),
    ({'urdf': 'nowhere.urdf'}, r'robot.urdf: expected a readable URDF file, found .*nowhere'),
])
def test_model_refuses_names_that_do_not_match(change, message):
    config = controller_config().robot.model_copy(update=change)
    with pytest.raises(ConfigError, match=message):
        RobotModel(config, config_dir())


def test_model_of_a_vendors_urdf_locks_fingers_and_takes_endless_joints(tmp_path):
    arm = seven_joint_urdf(tmp_path).read_text()
    finger = ''.join(
        f'<link name="{name}"><inertial><origin xyz="0 0 0.02"/><mass value="0.3"/><inertia '
        'ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="{name}_joint" type="KIND"><parent link="wrist"/><child link="{name}"/>'
        f'<origin xyz="0 {place} 0.05"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>'
        for name, place in (('left', 'LEFT'), ('right', 'RIGHT')))
    limit = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'
    vendor = arm.replace('</robot>', finger + '</robot>').replace(
        'type="revolute"', 'type="continuous"').replace(limit, '')
    (tmp_path / 'vendor.urdf').write_text(vendor.replace('KIND', 'prismatic').replace(
        'LEFT', '0').replace('RIGHT', '0'))
    (tmp_path / 'welded.urdf').write_text(arm.replace('</robot>', finger + '</robot>').replace(
        'KIND', 'fixed').replace('LEFT', '0.03').replace('RIGHT', '0.01'))
    config = seven_joint_config(tmp_path / 'vendor.urdf')
    with pytest.raises(ConfigError, match=r"robot.joint_names: .*'left_joint', 'right_joint'\] in "
                       'robot.locked_joints, found'):
        RobotModel(config, tmp_path)
    locked = config.model_copy(update={
        'locked_joints': ('left_joint', 'right_joint'), 'locked_positions': (0.03, 0.01)})
    q, v = np.linspace(-4.0, 4.0, 7), np.linspace(0.3, -0.5, 7)
    found = RobotModel(locked, tmp_path).update(q, v)
    welded = RobotModel(seven_joint_config(tmp_path / 'welded.urdf'), tmp_path).update(q, v)
    for name in ('mass_matrix', 'gravity', 'coriolis', 'jacobian'):
        np.testing.assert_allclose(
            getattr(found, name), getattr(welded, name), rtol=0.0, atol=1e-12)
    model = load_model(tmp_path / 'vendor.urdf', locked.locked)
    assert model.nq == 7 and (model.upperPositionLimit == np.inf).all()
    with pytest.raises(ConfigError, match="robot.locked_joints: .*found \\['thumb'\\]"):
        load_model((tmp_path / 'vendor.urdf').read_text(), {'thumb': 0.0})
