"""Arms from their vendors' URDFs, and what is derived from them."""

from dataclasses import replace

from arms import seven_joint_urdf
from multicontact_control.config import ControllerConfig, merge, read_yaml, validate
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.external import read_controller_files
from multicontact_control.paths import config_dir
import numpy as np
import pinocchio as pin
import pytest
from robots import OTHERS, robot_parameters, ROBOTS
from sim_bridge.arm import OPERATIONAL_FRAME, Placement
from sim_bridge.config import PlantConfig
from sim_bridge.contacts import act_on_arm, Contacts
from sim_bridge.drives import DRIVE
from sim_bridge.kinematics import chain_of
from sim_bridge.new_robot import new_robot, write_controller
from sim_bridge.posture import condition, frame_pose
from sim_bridge.pushes import HAND
from sim_bridge.robots import find_robot, urdf_path
from sim_bridge.urdf_arm import arm_of_urdf, read_urdf
import yaml


def vendor(name):
    """Return the vendor's own model of a robot."""
    file = find_robot(name).file
    path = urdf_path(file.urdf, config_dir())
    model = load_model(path)
    return load_model(path, {joint: 0.0 for joint in list(model.names)[1:]
                             if joint not in file.joint_names})


@pytest.mark.parametrize('name', ROBOTS)
def test_urdf_that_is_written_gives_the_same_arm_back(name):
    """But for what no URDF has: rotor inertia and friction."""
    arm = find_robot(name).arm
    again = arm_of_urdf(arm.urdf)
    bare = tuple(replace(link, armature=0.0, viscous=0.0, coulomb_positive=0.0,
                         coulomb_negative=0.0) for link in arm.links)
    assert replace(again, text='') == replace(arm, links=bare, text='')


@pytest.mark.parametrize('name', OTHERS)
def test_joints_turned_to_z_move_the_mount_as_the_vendor_does(name, rng):
    arm, own = find_robot(name).arm, vendor(name)
    model, mount = arm.model(), find_robot(name).file.mount_link
    turn = pin.rpy.rpyToMatrix(*find_robot(name).file.mount_rpy)
    for _ in range(5):
        q = rng.uniform(-1.0, 1.0, model.nv)
        expected = frame_pose(own, q, mount)
        found = frame_pose(model, q)
        np.testing.assert_allclose(found.translation, expected.translation, atol=1e-12)
        np.testing.assert_allclose(found.rotation, expected.rotation @ turn, atol=1e-12)
    for placement in list(model.jointPlacements)[1:]:
        np.testing.assert_allclose(
            Placement.of(placement).se3.homogeneous, placement.homogeneous, atol=1e-14)


@pytest.mark.parametrize('name', robot_parameters(['iiwa', 'kinova', 'ur5']))
def test_inertia_is_that_of_the_vendor_with_the_tool(name, rng):
    """M = M_vendor + J^T I_tool J, and gravity likewise; these have nothing beyond it."""
    arm, own = find_robot(name).arm, vendor(name)
    model = arm.model()
    com = arm.tool.com.se3
    tool = pin.Inertia(arm.tool.mass, com.translation,
                       com.rotation @ np.diag(arm.tool.inertia) @ com.rotation.T)
    tool += pin.Inertia(arm.face_mass, np.zeros(3), 1e-6 * np.eye(3))
    own.armature = np.zeros(own.nv)
    data, other = model.createData(), own.createData()
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, model.nv)
        jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId('ft_face'), pin.LOCAL)
        expected = np.triu(pin.crba(own, other, q) + jacobian.T @ tool.matrix() @ jacobian)
        np.testing.assert_allclose(np.triu(pin.crba(model, data, q)), expected, atol=1e-9)


@pytest.mark.parametrize('name', ROBOTS)
def test_controller_and_plant_have_the_same_arm_at_home_before_its_surfaces(name):
    robot = find_robot(name)
    controller = validate(ControllerConfig, robot.controller_base())
    plant = validate(PlantConfig, robot.plant_values('rigid'))
    assert controller.contact_names == plant.contact_names
    assert plant.robot == name
    model = RobotModel(controller.robot, robot.urdf_dir())
    home, limits = np.array(plant.home), controller.limits
    state = model.update(home, np.zeros(len(home)))
    place = state.pose.position_world
    assert (place > limits.workspace_lower).all() and (place < limits.workspace_upper).all()
    assert (home > limits.joint_lower).all() and (home < limits.joint_upper).all()
    np.testing.assert_allclose(
        state.pose.rotation_world, np.diag([-1.0, 1.0, -1.0]), atol=1e-8)  # tool down
    assert condition(robot.arm.model(), home) < 20.0
    if name == 'puma':  # k_s = k_env (1 + |l x n|^2), P04 eq. 17
        np.testing.assert_allclose([6000.0 * (1.0 + np.sum(np.cross(
            contact.point_operational, contact.normal_world) ** 2))
            for contact in controller.contacts.values()], [6000.0, 6216.6])
    for contact in controller.contact_names:
        surface, told = plant.surfaces[contact], controller.contacts[contact]
        tip = place + state.pose.rotation_world @ told.point_operational
        gap = (np.array(surface.point_world) - tip) @ surface.normal_world
        assert 5e-3 <= gap <= 10e-3
        assert told.normal_world == surface.normal_world
    assert controller.tool.mass == pytest.approx(robot.arm.carried_mass)
    poses = robot.weighing_poses()
    assert len(poses) >= 4 and {len(pose) for pose in poses} == {len(plant.home)}


# Links whose inertia is a placeholder, or has lost a decimal point, in the file of their vendor.
WRONG = {'panda': 'link6', 'ur5': 'link5'}


@pytest.mark.parametrize('name', ROBOTS)
def test_published_arms_are_accepted_and_their_wrong_inertias_named(name):
    robot = find_robot(name)
    config = validate(ControllerConfig, robot.controller_base())
    found = RobotModel(config.robot, robot.urdf_dir()).warnings(config.torque_limit)
    assert [f'robot.urdf.{WRONG.get(name)}.inertia' in text for text in found] == (
        [True] * (name in WRONG))


def test_several_tips_meet_one_plane_each_with_its_own_friction(rng):
    """The force on each is k depth along the normal and friction against its own sliding."""
    feet = [f'face_{i}' for i in (1, 2, 3, 4)]
    robot = find_robot('panda')
    config = validate(PlantConfig, merge(robot.plant_values('', ('face',)), {
        'contact_names': feet, 'surfaces': {name: {
            'contact': '', 'roughness_std': 0.0, 'stiffness': 6000.0, 'damping': 30.0}
            for name in feet}}))
    model = robot.arm.model()
    data, home = model.createData(), np.array(config.home)
    contacts = Contacts(config, robot.arm, model, [rng] * len(feet))
    for contact in range(4):
        contacts.shift(contact, -8e-3)  # 1 mm into the tips
    qd = rng.uniform(-0.01, 0.01, model.nv)
    torques, pushes = np.zeros((4, model.nv)), np.zeros((6, 7))
    assert act_on_arm(
        np.array([home, qd]), torques, np.ones(model.nv), chain_of(model), np.zeros(0, DRIVE),
        contacts.surfaces, contacts.profiles, np.zeros(2, HAND), pushes, 1e-3) == 4
    pin.computeJointJacobians(model, data, home)
    pin.updateFramePlacements(model, data)
    load = np.zeros(model.nv)
    for i, name in enumerate(feet):
        jacobian = pin.getFrameJacobian(
            model, data, model.getFrameId(name), pin.LOCAL_WORLD_ALIGNED)[:3]
        speed = jacobian @ qd
        alpha = 6000.0 * 1e-3 - 30.0 * speed[2]
        slide = np.array([speed[0], speed[1], 0.0])
        expected = alpha * np.array([0.0, 0.0, -1.0]) + 0.1 * alpha * slide / np.sqrt(
            slide @ slide + 0.01 ** 2)
        np.testing.assert_allclose(pushes[i, :3], -expected, atol=1e-4)
        load += jacobian.T @ pushes[i, :3]
    np.testing.assert_allclose(torques[1], load, atol=1e-9)


@pytest.mark.parametrize(('changes', 'field'), [
    ({'home': [0.0]}, 'home'),
    ({'mount_link': 'hand'}, 'mount_link'),
    ({'mount_link': 'panda_link5'}, 'joint_names'),
    ({'mount_link': ''}, 'mount_link'),
    ({'urdf': 'package://nowhere/a.urdf'}, 'urdf'),
    ({'urdf': 'package://example-robot-data/none.urdf'}, 'urdf'),
    ({'contacts': {'table': {'tip': 'nose', 'normal_world': [0, 0, -1]}}}, 'contacts.table.tip')])
def test_robot_file_names_the_bad_field(tmp_path, changes, field):
    values = {**read_yaml(config_dir() / 'robots' / 'panda.yaml'), **changes}
    path = tmp_path / 'mine.yaml'
    path.write_text(yaml.safe_dump(values), encoding='utf-8')
    with pytest.raises(ConfigError) as caught:
        assert find_robot(str(path)).arm
    assert caught.value.field == field


WELDED = """<link name="sensor"/><joint name="sensor_joint" type="fixed"><parent link="l6"/>
<child link="sensor"/><origin xyz="0 0 0.05"/></joint>
<link name="stick"><inertial><origin xyz="0 0 0.1"/><mass value="0.4"/>
<inertia ixx="0.002" iyy="0.002" izz="0.0002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="stick_joint" type="fixed"><parent link="sensor"/><child link="stick"/></joint>
<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="stick"/>
<child link="tip"/><origin xyz="0 0 0.2"/></joint></robot>"""


@pytest.mark.parametrize('encode', [
    lambda text: text.encode('utf-8-sig'), lambda text: text.encode('utf-16'),
    lambda text: text.replace('><', '>\r\n\t<!-- > -->\r\n<').encode(),
    lambda text: f'<?xml version="1.0" encoding="latin-1"?><!-- ö -->{text}'.encode('latin-1')])
def test_urdf_is_read_in_any_encoding_and_layout(tmp_path, encode):
    urdf = seven_joint_urdf(tmp_path)
    wanted = load_model(urdf)
    urdf.write_bytes(encode(urdf.read_text()))
    assert load_model(urdf) == load_model(read_urdf(urdf)) == wanted


@pytest.mark.parametrize('welded', [True, False])
def test_new_robot_writes_a_file_that_works_and_says_what_is_missing(tmp_path, welded):
    """With the tool in the URDF, and without."""
    urdf = seven_joint_urdf(tmp_path)
    if welded:
        urdf.write_text(urdf.read_text().replace('</robot>', WELDED))
    made = new_robot(urdf, 'sensor' if welded else 'wrist', 'tip' if welded else 'wrist',
                     tmp_path / 'mine.yaml')
    assert any('armature' in text for text in made.missing)
    assert any('tool' in text for text in made.missing) != welded
    robot = find_robot(str(made.path))
    assert 'PLACEHOLDER' in made.path.read_text()
    model, home = robot.arm.model(), np.array(robot.file.home)
    assert robot.arm.carried_mass == pytest.approx(0.401 if welded else 0.501)
    pose = frame_pose(model, home, OPERATIONAL_FRAME)
    np.testing.assert_allclose(pose.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-6)
    tip = frame_pose(model, home, 'tip' if welded else 'wrist_tip').translation
    np.testing.assert_allclose(
        pose.translation - tip, [0.0, 0.0, 0.2 if welded else 0.15], atol=1e-6)
    assert not any('limit' in text for text in made.missing)
    validate(ControllerConfig, robot.controller_base())
    validate(PlantConfig, robot.plant_values('rigid'))
    write_controller(made, tmp_path / 'controller.yaml')
    found = read_controller_files([tmp_path / 'controller.yaml'])
    config = found.config()
    assert config.sensor.require_push_test and config.contact_names == ('table',)
    assert config.tool.mass == pytest.approx(robot.arm.carried_mass)
    there = RobotModel(config.robot, found.urdf_dir).update(home, np.zeros(len(home))).pose
    np.testing.assert_allclose(there.position_world, pose.translation, atol=1e-9)


def test_new_robot_asks_for_the_limits_of_the_joint_that_has_none_and_keeps_the_others(tmp_path):
    urdf = seven_joint_urdf(tmp_path)
    limit = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'
    urdf.write_text(urdf.read_text().replace('</robot>', WELDED).replace(
        limit, '<limit lower="-3" upper="3"/>', 1))
    made = new_robot(urdf, 'sensor', 'tip', tmp_path / 'mine.yaml')
    for name in ('torque_limit', 'speed_limit'):
        assert sum(name in text and 'j0' in text for text in made.missing) == 1
    links = find_robot(str(made.path)).arm.links
    assert [link.torque_limit for link in links[1:]] == [100.0] * 6
    assert [link.speed_limit for link in links[1:]] == [3.0] * 6
    made.path.write_text(made.path.read_text().replace('\ntorque_limit', '\n# torque_limit'))
    with pytest.raises(ConfigError, match='torque_limit: .* for j0, found nothing'):
        assert find_robot(str(made.path)).arm
