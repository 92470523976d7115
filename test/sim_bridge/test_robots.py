"""Arms from their vendors' URDFs, and what is derived from them."""

from dataclasses import replace
from pathlib import Path
import re
from xml.etree import ElementTree

from arms import seven_joint_urdf
from multicontact_control.cli.robot import new_robot as command
from multicontact_control.config import ControllerConfig, read_yaml, validate
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.scenario import read_controller_files
import numpy as np
from numpy.testing import assert_allclose
import pinocchio as pin
import pybullet as bullet
import pytest
from robots import carried, OTHERS, ROBOTS
from sim_bridge.config import PlantConfig
from sim_bridge.new_robot import new_robot
from sim_bridge.posture import frame_pose, jacobian_condition
from sim_bridge.robots import find_robot, find_urdf
from sim_bridge.urdf_arm import arm_of_urdf
import yaml

DATA = Path(__file__).parents[1] / 'data'
PUMA_TABLE = read_yaml(DATA / 'puma560.yaml')
# Links whose inertia is a placeholder, or has lost a decimal point, in the file of their vendor.
PLACEHOLDERS = {'panda': ['link6'], 'ur5': ['link5']}


def find_vendor_urdf(name):
    """Return the path of the vendor's own URDF of a robot."""
    return find_urdf(find_robot(name).file.urdf, find_config_folder())


def load_vendor_model(name):
    """Return the vendor's own model of a robot; joints that are not the arm's stay at zero."""
    path = find_vendor_urdf(name)
    arm_joints = find_robot(name).file.joint_names
    other_joints = {}
    for joint in ElementTree.parse(path).iterfind('joint'):
        joint_name = joint.get('name')
        if joint.get('type') != 'fixed' and joint_name not in arm_joints:
            other_joints[joint_name] = 0.0
    return load_model(path, other_joints)


def test_motors_and_limits_of_the_puma_are_the_published_ones_at_the_joint(puma):
    """Jm G^2, b G^2 and F |G|; the armature is published rounded, too."""
    assert len(puma.links) == len(PUMA_TABLE['motors'])
    for number, link in enumerate(puma.links):
        motor = PUMA_TABLE['motors'][number]
        gear = abs(motor['gear'])
        positive, negative = motor['coulomb']
        at_joint = [
            motor['rotor_inertia'] * gear**2,
            motor['viscous'] * gear**2,
            positive * gear,
            -negative * gear,
        ]
        friction = [link.viscous, link.coulomb_positive, link.coulomb_negative]
        assert_allclose([link.armature, *friction], at_joint, rtol=1e-12)
        assert link.armature == pytest.approx(PUMA_TABLE['armature'][number], abs=6e-4)
        assert link.torque_limit == PUMA_TABLE['torque_limit'][number]
        assert link.speed_limit == PUMA_TABLE['speed_limit'][number]
        positions = np.degrees([link.lower, link.upper])
        assert_allclose(positions, PUMA_TABLE['position_limit_deg'][number])


@pytest.mark.parametrize('name', ROBOTS)
def test_urdf_that_is_written_gives_the_same_arm_back(name):
    """But for rotor inertia and friction, which no URDF has."""
    arm = find_robot(name).arm
    read_back = replace(arm_of_urdf(arm.urdf), visuals=arm.visuals, source_urdf='')
    no_motor = dict.fromkeys(
        ('armature', 'viscous', 'coulomb_positive', 'coulomb_negative'), 0.0
    )
    bare_links = tuple(replace(link, **no_motor) for link in arm.links)
    assert read_back == replace(arm, links=bare_links, source_urdf='')


@pytest.mark.parametrize('name', ROBOTS)
def test_pybullet_adds_no_mass_to_the_urdf_that_is_written(tmp_path, name):
    arm = find_robot(name).arm
    path = tmp_path / 'arm.urdf'
    path.write_text(arm.urdf)
    client = bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    mass = 0.0
    for link in range(bullet.getNumJoints(body, client)):
        mass += bullet.getDynamicsInfo(body, link, client)[0]
    bullet.disconnect(client)
    assert mass == pytest.approx(sum(part.mass for part in arm.bodies))


@pytest.mark.parametrize('name', OTHERS)
def test_arm_moves_its_mount_and_its_masses_as_the_vendor_does(name, rng):
    """M = M_vendor + J^T I_tool J, but for the Panda, whose file has a hand there."""
    robot = find_robot(name)
    vendor = load_vendor_model(name)
    vendor.armature = np.zeros(vendor.nv)
    vendor_data = vendor.createData()
    model = robot.arm.model()
    data = model.createData()
    face = model.getFrameId('ft_face')
    turn = pin.rpy.rpyToMatrix(*robot.file.mount_rpy)
    tool = carried(robot.arm).matrix()
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, model.nv)
        mount = frame_pose(vendor, q, robot.file.mount_link)
        pose = frame_pose(model, q)
        assert_allclose(pose.translation, mount.translation, atol=1e-12)
        assert_allclose(pose.rotation, mount.rotation @ turn, atol=1e-12)
        if name != 'panda':
            J = pin.computeFrameJacobian(model, data, q, face, pin.LOCAL)
            expected = pin.crba(vendor, vendor_data, q) + J.T @ tool @ J
            M = pin.crba(model, data, q)
            assert_allclose(np.triu(M), np.triu(expected), atol=1e-9)


def place_meshes(model, geometry, q):
    """Return the rotation of every mesh, by its file and its position [m] in six digits."""
    data = geometry.createData()
    pin.updateGeometryPlacements(model, model.createData(), geometry, data, q)
    rotations = {}
    for mesh, place in zip(geometry.geometryObjects, data.oMg):
        position = tuple(place.translation.round(6))
        rotations[mesh.meshPath, position] = place.rotation
    return rotations


@pytest.mark.parametrize('name', OTHERS)
def test_arm_looks_as_the_vendors_does(name, rng):
    """Every mesh is where pinocchio places it, by the vendor's own links and joints."""
    arm = find_robot(name).arm
    model = arm.model()
    geometry = pin.buildGeomFromUrdfString(model, arm.urdf, pin.VISUAL)
    path = find_vendor_urdf(name)
    vendor = load_vendor_model(name)
    folders = [str(folder) for folder in path.parents[:5]]
    vendor_geometry = pin.buildGeomFromUrdf(
        vendor, str(path), pin.VISUAL, package_dirs=folders
    )
    q = rng.uniform(-1.0, 1.0, len(arm.links))
    meshes = place_meshes(model, geometry, q)
    vendor_meshes = place_meshes(vendor, vendor_geometry, q)
    assert meshes
    for mesh, rotation in meshes.items():
        assert_allclose(rotation, vendor_meshes[mesh], atol=1e-9)


@pytest.fixture
def controller(name):
    return validate(ControllerConfig, find_robot(name).controller_base())


@pytest.fixture
def plant(name):
    return validate(PlantConfig, find_robot(name).plant_values('rigid'))


@pytest.fixture
def controlled(name, controller):
    """Return the model that the controller has of a robot."""
    return RobotModel(controller.robot, find_robot(name).urdf_dir())


@pytest.mark.parametrize('name', ROBOTS)
def test_controller_warns_of_the_links_with_a_placeholder(name, controller, controlled):
    warned = []
    for text in controlled.list_warnings(controller.torque_limit):
        warned += re.findall(r'robot\.urdf\.(\w+)\.inertia', text) or [text]
    assert warned == PLACEHOLDERS.get(name, [])


def assert_between(values, lower, upper):
    assert (values > lower).all()
    assert (values < upper).all()


@pytest.mark.parametrize('name', ROBOTS)
def test_home_is_within_all_limits_with_the_tool_down(
    name, controller, plant, controlled
):
    home = np.array(plant.home)
    pose = controlled.update(home, np.zeros(len(home))).pose
    limits = controller.limits
    assert_between(pose.position_world, limits.workspace_lower, limits.workspace_upper)
    assert_between(home, limits.joint_lower, limits.joint_upper)
    tool_down = np.diag([-1.0, 1.0, -1.0])
    assert_allclose(pose.rotation_world, tool_down, atol=1e-8)
    assert jacobian_condition(find_robot(name).arm.model(), home) < 20.0


@pytest.mark.parametrize('name', ROBOTS)
def test_controller_and_plant_have_the_same_arm_before_the_same_surfaces(
    name, controller, plant, controlled
):
    assert controller.contact_names == plant.contact_names
    assert plant.robot == name
    assert controller.tool.mass == pytest.approx(find_robot(name).arm.carried_mass)
    pose = controlled.update(np.array(plant.home), np.zeros(len(plant.home))).pose
    for contact in controller.contact_names:
        surface = plant.surfaces[contact]
        known = controller.contacts[contact]
        tip = pose.position_world + pose.rotation_world @ known.point_operational
        gap = (np.array(surface.point_world) - tip) @ surface.normal_world
        assert 5e-3 <= gap <= 10e-3
        assert known.normal_world == surface.normal_world


@pytest.mark.parametrize(
    ('changes', 'field'),
    [
        ({'home': [0.0]}, 'home'),
        ({'mount_link': 'hand'}, 'mount_link'),
        ({'mount_link': 'panda_link5'}, 'joint_names'),
        ({'mount_link': ''}, 'mount_link'),
        ({'urdf': 'package://nowhere/a.urdf'}, 'urdf'),
        ({'urdf': 'package://example-robot-data/none.urdf'}, 'urdf'),
        (
            {'contacts': {'table': {'tip': 'nose', 'normal_world': [0, 0, -1]}}},
            'contacts.table.tip',
        ),
    ],
)
def test_robot_file_names_the_bad_field(tmp_path, changes, field):
    values = {**read_yaml(find_config_folder() / 'robots' / 'panda.yaml'), **changes}
    path = tmp_path / 'mine.yaml'
    path.write_text(yaml.safe_dump(values), encoding='utf-8')
    with pytest.raises(ConfigError) as caught:
        assert find_robot(str(path)).arm
    assert caught.value.field == field


# A lifted base, a tool on a gripper, and joints with the names of links.
WELDED = """<link name="floor"/><joint name="lift" type="prismatic"><parent link="floor"/>
<child link="base"/><axis xyz="0 0 1"/></joint><link name="sensor"/>
<joint name="sensor_joint" type="fixed"><parent link="l6"/><child link="sensor"/>
<origin xyz="0 0 0.05"/></joint>
<link name="stick"><inertial><origin xyz="0 0 0.1"/><mass value="0.4"/>
<inertia ixx="0.002" iyy="0.002" izz="0.0002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="stick" type="revolute"><parent link="sensor"/><child link="stick"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>
<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="stick"/>
<child link="tip"/><origin xyz="0 0 0.2"/></joint></robot>"""
LIMIT = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'


@pytest.fixture
def welded(tmp_path):
    """Return a URDF whose first joint has no limits of its own."""
    urdf = seven_joint_urdf(tmp_path)
    text = urdf.read_text().replace(LIMIT, '<limit lower="-3" upper="3"/>', 1)
    text = text.replace('</robot>', WELDED)
    urdf.write_text(re.sub(r'"[jl](\d)"', r'"link\1"', text))
    return urdf


@pytest.fixture
def convert(tmp_path, welded):
    """Write the files of the welded arm, and return what is said and the robot's file."""
    mine = tmp_path / 'mine.yaml'

    def write_files(sensor='sensor', tip='tip', lock=('lift=0.3',)):
        controller = tmp_path / 'controller.yaml'
        return new_robot(welded, sensor, tip, mine, controller, lock), mine

    return write_files


@pytest.mark.parametrize(
    ('sensor', 'tip', 'mass', 'below'),
    [
        ('sensor', 'tip', 0.4, 0.2),
        ('link6', 'link6', 0.4, 0.0),
        ('wrist', 'wrist', 0.5, 0.15),
    ],
)
def test_new_robot_writes_an_arm_that_a_plant_and_a_controller_share(
    tmp_path, convert, monkeypatch, sensor, tip, mass, below
):
    """With the tool in the URDF, and without."""
    _, mine = convert(sensor, tip)
    monkeypatch.chdir('/')
    robot = find_robot(str(mine))
    limits = [link.torque_limit for link in robot.arm.links]
    assert limits == [50.0] + [100.0] * 6
    assert robot.arm.links[0].placement.position == pytest.approx((0.0, 0.0, 0.5))
    assert robot.arm.carried_mass == pytest.approx(mass + 0.001)
    validate(PlantConfig, robot.plant_values('rigid'))
    model = robot.arm.model()
    home = np.array(robot.file.home)
    place = frame_pose(model, home).translation
    above_tip = place - frame_pose(model, home, 'tip').translation
    assert_allclose(above_tip, [0.0, 0.0, below], atol=1e-6)
    files = read_controller_files([tmp_path / 'controller.yaml'])
    config = files.config()
    assert config.sensor.require_push_test
    assert config.contact_names == ('table',)
    assert config.tool.mass == pytest.approx(robot.arm.carried_mass)
    controlled = RobotModel(config.robot, files.urdf_dir)
    pose = controlled.update(home, np.zeros(len(home))).pose
    assert_allclose(pose.position_world, place, atol=1e-9)


@pytest.mark.parametrize(
    ('sensor', 'tip', 'tool'),
    [('sensor', 'tip', []), ('link6', 'link6', []), ('wrist', 'wrist', ['tool'])],
)
def test_new_robot_says_what_is_missing(convert, sensor, tip, tool):
    lines, mine = convert(sensor, tip)
    missing = [text.split(': ')[1] for text in lines if text.startswith('missing: ')]
    assert missing == [
        *tool,
        'torque_limit of link0',
        'speed_limit of link0',
        'armature',
        'contacts',
    ]
    mine.write_text(mine.read_text().replace('\ntorque_limit', '\n# torque_limit'))
    with pytest.raises(ConfigError, match='torque_limit: .* for link0, got nothing'):
        assert find_robot(str(mine)).arm


@pytest.mark.parametrize(
    ('sensor', 'tip'), [('sensor', 'tip'), ('link6', 'link6'), ('wrist', 'wrist')]
)
def test_new_robot_writes_plain_numbers_and_words(tmp_path, convert, sensor, tip):
    convert(sensor, tip)
    for name in ('mine.yaml', 'controller.yaml'):
        text = (tmp_path / name).read_text()
        assert not re.search(r"\de-\d|'[a-z_]+':|-0\.0\b", text)


@pytest.mark.parametrize(
    ('sensor', 'tip', 'lock', 'message'),
    [
        (
            'sensor',
            'tip',
            [],
            "got 'lift', which is prismatic; add --lock lift=POSITION",
        ),
        (
            'sensor',
            'tip',
            ['lift=up'],
            r"--lock: expected JOINT=POSITION .*, got 'lift=up'",
        ),
        ('sensor', 'tip', ['left=0.1'], "--lock: expected one of .*, got 'left'"),
        (
            'sensor',
            'link6',
            ['lift=0.1'],
            "--tip: expected 'sensor' or a link beyond it, got 'link6'",
        ),
        (
            'link4',
            'tip',
            ['lift=0'],
            "6 or more joints that turn, .*, got 'link4', carried by 5 ",
        ),
        ('floor', 'tip', None, r"got 'floor', carried by 0 \(none\)"),
    ],
)
def test_new_robot_refuses_what_is_no_arm_in_one_line(
    tmp_path, monkeypatch, welded, sensor, tip, lock, message
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message) as caught:
        command(
            urdf=welded,
            tip=tip,
            sensor=sensor,
            out=None,
            controller=Path('controller.yaml'),
            overwrite=False,
            lock=lock,
        )
    assert '\n' not in str(caught.value)
    assert not list(tmp_path.glob('*.yaml'))


SIX_JOINTS = (DATA / 'six_joints.urdf').read_text(encoding='utf-8')
DECLARATION = '<?xml version="1.0"?>'
ORIGIN = '<origin xyz="0 0.06 0" rpy="0 0 0"/>'
TURNED = (
    '<origin xyz="0 0.06 0" quat_xyzw="0 0 0.7071067811865476 0.7071067811865476"/>'
)
SECOND = '<joint name="rod" type="fixed"><parent link="base"/><child link="l4"/></joint></robot>'


def convert_six_joints(folder, text=SIX_JOINTS, encoding='utf-8'):
    """Write files of the arm of six joints, by the text of its URDF; return what is said."""
    urdf = folder / 'arm.urdf'
    urdf.write_text(text, encoding)
    return new_robot(urdf, 'l6', 'l6', folder / 'arm.yaml', folder / 'controller.yaml')


def read_six_joints(folder):
    """Return the robot whose files are written."""
    return find_robot(str(folder / 'arm.yaml'))


def home_condition(robot):
    """Return the condition number of the Jacobian at home."""
    return jacobian_condition(robot.arm.model(), np.array(robot.file.home))


def declare(encoding, comment):
    """Return the head of a file that declares its encoding."""
    return f'<?xml version="1.0" encoding="{encoding}"?>\n<!-- {comment} -->'


@pytest.mark.parametrize(
    ('old', 'new', 'encoding'),
    [
        (DECLARATION, declare('Shift_JIS', '鉄の腕 ①'), 'cp932'),
        (DECLARATION, declare('GBK', '机械臂'), 'gbk'),
        (DECLARATION, declare('UTF-16', 'Tür'), 'utf-16'),
        ('<robot ', '<robot xmlns="http://example.org/arm" ', 'utf-8'),
    ],
)
def test_new_robot_reads_every_encoding_and_a_default_namespace(
    tmp_path, old, new, encoding
):
    said = convert_six_joints(tmp_path, SIX_JOINTS.replace(old, new), encoding)
    assert 'xmlns' not in read_six_joints(tmp_path).arm.urdf
    assert said == convert_six_joints(tmp_path)


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        (
            DECLARATION,
            declare('utf8mb4', ''),
            'urdf: expected an encoding that is known, .*, got utf8mb4',
        ),
        (
            DECLARATION,
            declare('GBK', 'ä'),
            'urdf: expected text in GBK, as its first line says, got something else at byte ',
        ),
        (
            '</robot>',
            SECOND,
            'urdf: expected one parent of each link, got l4, which is the child of j4 and rod',
        ),
        (
            'link="l3"',
            'link="rod"',
            r"urdf\.j3\.child: expected a link of the URDF, got 'rod'",
        ),
        (
            '</robot>',
            '<link name="loose"/></robot>',
            'urdf: expected one link that no joint carries, the base, got base, loose',
        ),
        (
            ORIGIN,
            TURNED,
            r'urdf\.j5\.origin: expected rpy, in version 1\.0, got quat_xyzw; version="1\.1"',
        ),
        (
            '</robot>',
            '<x:include xmlns:x="http://ros.org/xacro" file="a"/></robot>',
            'urdf: expected a URDF, got .*, which is xacro; write one with',
        ),
    ],
)
def test_new_robot_names_what_is_wrong_with_a_urdf_in_one_line(
    tmp_path, old, new, message
):
    text = SIX_JOINTS.replace(old, new)
    with pytest.raises(ConfigError, match=message) as caught:
        convert_six_joints(tmp_path, text, 'latin-1')
    assert '\n' not in str(caught.value)
    assert not list(tmp_path.glob('*.yaml'))


def test_new_robot_takes_a_turn_by_quat_xyzw_in_version_1_1(tmp_path):
    text = SIX_JOINTS.replace('<robot ', '<robot version="1.1" ')
    angles = f'<origin xyz="0 0.06 0" rpy="0 0 {np.pi / 2}"/>'
    by_quaternion = convert_six_joints(tmp_path, text.replace(ORIGIN, TURNED))
    by_angles = convert_six_joints(tmp_path, text.replace(ORIGIN, angles))
    assert by_quaternion == by_angles
    assert by_quaternion != convert_six_joints(tmp_path)


def assert_home_is_found(lines):
    assert not any('missing: home' in line for line in lines)


@pytest.mark.parametrize(
    'rpy', ['0 0 0', '0 0.5235988 0', '0 1.5707963 0', '3.14159265 0 0']
)
def test_new_robot_finds_a_home_on_floor_slope_wall_and_ceiling(tmp_path, rpy):
    mount = (
        f'<link name="world"/><joint name="mount" type="fixed"><parent link="world"/>'
        f'<child link="base"/><origin xyz="0 0 1.2" rpy="{rpy}"/></joint></robot>'
    )
    said = convert_six_joints(tmp_path, SIX_JOINTS.replace('</robot>', mount))
    assert_home_is_found(said)
    robot = read_six_joints(tmp_path)
    model = robot.arm.model()
    home = np.array(robot.file.home)
    tip = frame_pose(model, home, 'tip').translation
    below = tip - frame_pose(model, home).translation
    assert_allclose(below, [0.0, 0.0, -0.15], atol=1e-6)
    assert home_condition(robot) < 30.0


def test_new_robot_does_not_stand_in_a_singular_home(tmp_path):
    """The middle of these ranges is the arm stretched straight up."""
    even = re.sub(
        r'lower="[-.\d]+" upper="([.\d]+)"', r'lower="-\1" upper="\1"', SIX_JOINTS
    )
    assert_home_is_found(convert_six_joints(tmp_path, even))
    assert home_condition(read_six_joints(tmp_path)) < 20.0


def test_home_without_the_tool_straight_down_is_not_singular(tmp_path, monkeypatch):
    for finder in ('find_posture_at', 'find_posture_along'):
        monkeypatch.setattr(f'sim_bridge.new_robot.{finder}', lambda *_: None)
    said = '\n'.join(convert_six_joints(tmp_path))
    assert 'missing: home: no posture with the tool' in said
    assert home_condition(read_six_joints(tmp_path)) < 20.0


def test_new_robot_guesses_torque_limits_that_hold_a_heavy_arm(tmp_path):
    hundredfold = re.sub(
        r'(mass value|ixx|iyy|izz)="([-\d.e]+)"',
        lambda found: f'{found[1]}="{100.0 * float(found[2])}"',
        SIX_JOINTS,
    )
    text = re.sub(r' effort="\d+"', ' effort="0"', hundredfold)
    said = '\n'.join(convert_six_joints(tmp_path, text))
    assert 'missing: torque_limit of j1, j2, j3, j4, j5, j6: the URDF has none' in said
    share = re.search(r'gravity takes (\d+) % of the torque limit', said)
    assert int(share[1]) <= 34
    limits = [link.torque_limit for link in read_six_joints(tmp_path).arm.links]
    assert min(limits) >= 50.0
    assert max(limits) > 1000.0


GRIPPER = """<link name="knuckle"><inertial><origin xyz="0 0 0.02"/><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="knuckle" type="revolute"><parent link="stick"/><child link="knuckle"/>
<axis xyz="0 1 0"/><limit lower="0.1" upper="0.8" effort="5" velocity="1"/></joint>
<link name="finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="finger" type="revolute"><parent link="knuckle"/><child link="finger"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="5" velocity="1"/>
<mimic joint="pad" multiplier="2"/></joint><link name="pad"><inertial><origin xyz="0 0 0.02"/>
<mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="pad" type="revolute"><parent link="stick"/><child link="pad"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="5" velocity="1"/>
<mimic joint="knuckle" multiplier="-1" offset="0.05"/></joint></robot>"""


@pytest.mark.parametrize(('lock', 'knuckle'), [([], 0.1), (['knuckle=0.5'], 0.5)])
def test_new_robot_locks_the_fingers_that_mimic_where_their_leader_leads_them(
    welded, convert, lock, knuckle
):
    welded.write_text(welded.read_text().replace('</robot>', GRIPPER))
    _, mine = convert(lock=['lift=0', *lock])
    pad = 0.05 - knuckle
    assert find_robot(str(mine)).file.locked == pytest.approx(
        {
            'lift': 0.0,
            'stick': 0.0,
            'knuckle': knuckle,
            'pad': pad,
            'finger': 2.0 * pad,
        }
    )


@pytest.mark.parametrize(
    ('joint', 'leader'),
    [('link4', 'link3'), ('stick', 'link5'), ('link4', 'nothing')],
)
def test_new_robot_refuses_a_joint_that_mimics_one_of_the_arm(
    tmp_path, welded, convert, joint, leader
):
    """In the chain, and in the tool, which would move with the arm."""
    opening = f'<joint name="{joint}" type="revolute">'
    mimic = f'{opening}<mimic joint="{leader}" multiplier="0.5"/>'
    text = welded.read_text()
    assert opening in text
    welded.write_text(text.replace(opening, mimic))
    message = f'got {joint} follows {leader}, no motor of its own'
    with pytest.raises(ConfigError, match=message):
        convert()
    assert not list(tmp_path.glob('*.yaml'))
