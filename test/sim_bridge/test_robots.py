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

TABLE = read_yaml(Path(__file__).parents[1] / 'data' / 'puma560.yaml')


def vendor(name):
    """Return the vendor's own model of a robot."""
    file = find_robot(name).file
    path = find_urdf(file.urdf, find_config_folder())
    joints = [
        joint.get('name')
        for joint in ElementTree.parse(path).getroot().findall('joint')
        if joint.get('type') != 'fixed'
    ]
    others = [joint for joint in joints if joint not in file.joint_names]
    return load_model(path, dict.fromkeys(others, 0.0))


def test_motors_and_limits_of_the_puma_are_the_published_ones_at_the_joint(puma):
    """Jm G^2, b G^2 and F |G|; the armature is published rounded, too."""
    for number, (link, motor) in enumerate(
        zip(puma.links, TABLE['motors'], strict=True)
    ):
        gear = abs(motor['gear'])
        positive, negative = motor['coulomb']
        np.testing.assert_allclose(
            [link.armature, link.viscous, link.coulomb_positive, link.coulomb_negative],
            [
                motor['rotor_inertia'] * gear**2,
                motor['viscous'] * gear**2,
                positive * gear,
                -negative * gear,
            ],
            rtol=1e-12,
        )
        assert link.armature == pytest.approx(TABLE['armature'][number], abs=6e-4)
        assert link.torque_limit == TABLE['torque_limit'][number]
        assert link.speed_limit == TABLE['speed_limit'][number]
        np.testing.assert_allclose(
            np.degrees([link.lower, link.upper]), TABLE['position_limit_deg'][number]
        )


@pytest.mark.parametrize('name', ROBOTS)
def test_urdf_that_is_written_gives_the_same_arm_back(tmp_path, name):
    """But for what no URDF has: rotor inertia and friction; PyBullet adds no mass to it."""
    arm, path = find_robot(name).arm, tmp_path / 'arm.urdf'
    path.write_text(arm.urdf)
    client = bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    assert sum(
        bullet.getDynamicsInfo(body, link, client)[0]
        for link in range(bullet.getNumJoints(body, client))
    ) == pytest.approx(sum(x.mass for x in arm.bodies))
    bullet.disconnect(client)
    bare = tuple(
        replace(
            link, armature=0.0, viscous=0.0, coulomb_positive=0.0, coulomb_negative=0.0
        )
        for link in arm.links
    )
    again = replace(arm_of_urdf(arm.urdf), source_urdf='', visuals=arm.visuals)
    assert again == replace(arm, links=bare, source_urdf='')


@pytest.mark.parametrize('name', OTHERS)
def test_arm_moves_its_mount_and_its_masses_as_the_vendor_does(name, rng):
    """M = M_vendor + J^T I_tool J, but for the Panda, whose file has a hand there."""
    arm, own, file = find_robot(name).arm, vendor(name), find_robot(name).file
    model, turn, tool = arm.model(), pin.rpy.rpyToMatrix(*file.mount_rpy), carried(arm)
    own.armature = np.zeros(own.nv)
    data, other = model.createData(), own.createData()
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, model.nv)
        expected, now = frame_pose(own, q, file.mount_link), frame_pose(model, q)
        np.testing.assert_allclose(now.translation, expected.translation, atol=1e-12)
        np.testing.assert_allclose(now.rotation, expected.rotation @ turn, atol=1e-12)
        jacobian = pin.computeFrameJacobian(
            model, data, q, model.getFrameId('ft_face'), pin.LOCAL
        )
        if name != 'panda':
            expected = np.triu(
                pin.crba(own, other, q) + jacobian.T @ tool.matrix() @ jacobian
            )
            np.testing.assert_allclose(
                np.triu(pin.crba(model, data, q)), expected, atol=1e-9
            )


@pytest.mark.parametrize('name', OTHERS)
def test_arm_looks_as_the_vendors_does(name, rng):
    """Every mesh is where pinocchio places it, by the vendor's own links and joints."""
    arm, model, path = (
        find_robot(name).arm,
        vendor(name),
        find_urdf(find_robot(name).file.urdf, find_config_folder()),
    )
    q = rng.uniform(-1.0, 1.0, len(arm.links))
    folders = [str(folder) for folder in path.parents[:5]]
    places = []
    for body, geometry in (
        (arm.model(), pin.buildGeomFromUrdfString(arm.model(), arm.urdf, pin.VISUAL)),
        (
            model,
            pin.buildGeomFromUrdf(model, str(path), pin.VISUAL, package_dirs=folders),
        ),
    ):
        data = geometry.createData()
        pin.updateGeometryPlacements(body, body.createData(), geometry, data, q)
        places.append(
            {
                (each.meshPath, *place.translation.round(6)): place.rotation
                for each, place in zip(geometry.geometryObjects, data.oMg)
            }
        )
    ours, theirs = places
    assert ours and ours.keys() <= theirs.keys()
    np.testing.assert_allclose(
        list(ours.values()), [theirs[key] for key in ours], atol=1e-9
    )


# Links whose inertia is a placeholder, or has lost a decimal point, in the file of their vendor.
WRONG = {'panda': 'link6', 'ur5': 'link5'}


@pytest.mark.parametrize('name', ROBOTS)
def test_controller_and_plant_have_the_same_arm_at_home_before_its_surfaces(name):
    robot = find_robot(name)
    controller = validate(ControllerConfig, robot.controller_base())
    plant = validate(PlantConfig, robot.plant_values('rigid'))
    assert (controller.contact_names, name) == (plant.contact_names, plant.robot)
    model = RobotModel(controller.robot, robot.urdf_dir())
    assert [
        f'robot.urdf.{WRONG.get(name)}.inertia' in text
        for text in model.warnings(controller.torque_limit)
    ] == [True] * (name in WRONG)
    home, limits = np.array(plant.home), controller.limits
    pose = model.update(home, np.zeros(len(home))).pose
    place = pose.position_world
    assert (place > limits.workspace_lower).all() and (
        place < limits.workspace_upper
    ).all()
    assert (home > limits.joint_lower).all() and (home < limits.joint_upper).all()
    np.testing.assert_allclose(
        pose.rotation_world, np.diag([-1.0, 1.0, -1.0]), atol=1e-8
    )  # tool down
    assert jacobian_condition(robot.arm.model(), home) < 20.0
    for contact in controller.contact_names:
        surface, known = plant.surfaces[contact], controller.contacts[contact]
        tip = place + pose.rotation_world @ known.point_operational
        assert (
            5e-3
            <= (np.array(surface.point_world) - tip) @ surface.normal_world
            <= 10e-3
        )
        assert known.normal_world == surface.normal_world
    assert controller.tool.mass == pytest.approx(robot.arm.carried_mass)


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
    urdf.write_text(
        re.sub(r'"[jl](\d)"', r'"link\1"', text.replace('</robot>', WELDED))
    )
    return urdf


@pytest.mark.parametrize(
    ('sensor', 'tip', 'mass', 'below'),
    [
        ('sensor', 'tip', 0.4, 0.2),
        ('link6', 'link6', 0.4, 0.0),
        ('wrist', 'wrist', 0.5, 0.15),
    ],
)
def test_new_robot_writes_files_that_work_and_says_what_is_missing(
    tmp_path, welded, monkeypatch, sensor, tip, mass, below
):
    """With the tool in the URDF, and without."""
    mine, controller = tmp_path / 'mine.yaml', tmp_path / 'controller.yaml'
    lines = new_robot(welded, sensor, tip, mine, controller, ['lift=0.3'])
    missing = [text.split(': ')[1] for text in lines if text.startswith('missing: ')]
    assert missing == [
        *(['tool'] if sensor == 'wrist' else []),
        'torque_limit of link0',
        'speed_limit of link0',
        'armature',
        'contacts',
    ]
    for file in (mine, controller):
        text = file.read_text()
        assert not re.search(r"\de-\d|'[a-z_]+':|-0\.0\b", text), text
    monkeypatch.chdir('/')
    robot = find_robot(str(mine))
    assert [link.torque_limit for link in robot.arm.links] == [50.0] + [100.0] * 6
    assert robot.arm.links[0].placement.position == pytest.approx((0.0, 0.0, 0.5))
    model, home = robot.arm.model(), np.array(robot.file.home)
    assert robot.arm.carried_mass == pytest.approx(mass + 0.001)
    pose = frame_pose(model, home)
    np.testing.assert_allclose(
        pose.translation - frame_pose(model, home, 'tip').translation,
        [0.0, 0.0, below],
        atol=1e-6,
    )
    validate(PlantConfig, robot.plant_values('rigid'))
    files = read_controller_files([controller])
    config = files.config()
    assert config.sensor.require_push_test and config.contact_names == ('table',)
    assert config.tool.mass == pytest.approx(robot.arm.carried_mass)
    there = (
        RobotModel(config.robot, files.urdf_dir).update(home, np.zeros(len(home))).pose
    )
    np.testing.assert_allclose(there.position_world, pose.translation, atol=1e-9)
    mine.write_text(mine.read_text().replace('\ntorque_limit', '\n# torque_limit'))
    with pytest.raises(ConfigError, match='torque_limit: .* for link0, got nothing'):
        assert find_robot(str(mine)).arm


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
        ('floor', 'tip', [], r"got 'floor', carried by 0 \(none\)"),
        (
            'floor',
            'tip',
            None,
            'urdf: expected a URDF, got .*, which is xacro; write one with',
        ),
    ],
)
def test_new_robot_refuses_what_is_no_arm_in_one_line(
    tmp_path, monkeypatch, welded, sensor, tip, lock, message
):
    monkeypatch.chdir(tmp_path)
    if lock is None:
        welded.write_text(
            '<robot xmlns:x="http://ros.org/xacro"><x:include file="a"/></robot>'
        )
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
    assert '\n' not in str(caught.value) and not list(tmp_path.glob('*.yaml'))


SIX_JOINTS = Path(__file__).parents[1] / 'data' / 'six_joints.urdf'


def six_joints(folder, change=lambda text: text):
    """Write files of the arm of six joints, with its URDF changed, and return what is said."""
    urdf = folder / 'arm.urdf'
    text = change(SIX_JOINTS.read_text(encoding='utf-8'))
    urdf.write_bytes(text if isinstance(text, bytes) else text.encode())
    return new_robot(urdf, 'l6', 'l6', folder / 'arm.yaml', folder / 'controller.yaml')


def declared(encoding, comment):
    return lambda text: text.replace(
        '<?xml version="1.0"?>',
        f'<?xml version="1.0" encoding="{encoding}"?>\n<!-- {comment} -->',
    )


@pytest.mark.parametrize(
    'change',
    [
        lambda text: declared('Shift_JIS', '鉄の腕 ①')(text).encode('cp932'),
        lambda text: declared('GBK', '机械臂')(text).encode('gbk'),
        lambda text: declared('UTF-16', 'Tür')(text).encode('utf-16'),
        lambda text: text.replace('<robot ', '<robot xmlns="http://example.org/arm" '),
    ],
)
def test_new_robot_reads_every_encoding_and_a_default_namespace(tmp_path, change):
    assert six_joints(tmp_path, change) == six_joints(tmp_path)
    written = find_robot(str(tmp_path / 'arm.yaml')).arm.urdf
    assert 'xmlns' not in written


TURNED = (
    '<origin xyz="0 0.06 0" quat_xyzw="0 0 0.7071067811865476 0.7071067811865476"/>'
)
SECOND = '<joint name="rod" type="fixed"><parent link="base"/><child link="l4"/></joint></robot>'


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (
            declared('utf8mb4', ''),
            'urdf: expected an encoding that is known, .*, got utf8mb4',
        ),
        (
            lambda text: declared('GBK', 'ä')(text).encode('latin-1'),
            'urdf: expected text in GBK, as its first line says, got something else at byte ',
        ),
        (
            lambda text: text.replace('</robot>', SECOND),
            'urdf: expected one parent of each link, got l4, which is the child of j4 and rod',
        ),
        (
            lambda text: text.replace('link="l3"', 'link="rod"'),
            r"urdf\.j3\.child: expected a link of the URDF, got 'rod'",
        ),
        (
            lambda text: text.replace('</robot>', '<link name="loose"/></robot>'),
            'urdf: expected one link that no joint carries, the base, got base, loose',
        ),
        (
            lambda text: text.replace('<origin xyz="0 0.06 0" rpy="0 0 0"/>', TURNED),
            r'urdf\.j5\.origin: expected rpy, in version 1\.0, got quat_xyzw; version="1\.1"',
        ),
    ],
)
def test_new_robot_names_what_is_wrong_with_a_urdf_in_one_line(
    tmp_path, change, message
):
    with pytest.raises(ConfigError, match=message) as caught:
        six_joints(tmp_path, change)
    assert '\n' not in str(caught.value) and not list(tmp_path.glob('*.yaml'))


def test_new_robot_takes_a_turn_by_quat_xyzw_in_version_1_1(tmp_path):
    turned = TURNED.replace(
        'quat_xyzw="0 0 0.7071067811865476 0.7071067811865476"',
        f'rpy="0 0 {np.pi / 2}"',
    )
    said = [
        six_joints(
            tmp_path,
            lambda text, new=new: text.replace(
                '<origin xyz="0 0.06 0" rpy="0 0 0"/>', new
            ).replace('<robot ', '<robot version="1.1" '),
        )
        for new in (TURNED, turned)
    ]
    assert said[0] == said[1] != six_joints(tmp_path)


@pytest.mark.parametrize(
    'rpy', ['0 0 0', '0 0.5235988 0', '0 1.5707963 0', '3.14159265 0 0']
)
def test_new_robot_finds_a_home_on_floor_slope_wall_and_ceiling(tmp_path, rpy):
    mount = (
        f'<link name="world"/><joint name="mount" type="fixed"><parent link="world"/>'
        f'<child link="base"/><origin xyz="0 0 1.2" rpy="{rpy}"/></joint></robot>'
    )
    said = six_joints(tmp_path, lambda text: text.replace('</robot>', mount))
    assert not any('missing: home' in line for line in said)
    robot = find_robot(str(tmp_path / 'arm.yaml'))
    model, home = robot.arm.model(), np.array(robot.file.home)
    tip, sensor = (frame_pose(model, home, *name).translation for name in (['tip'], []))
    np.testing.assert_allclose(tip - sensor, [0.0, 0.0, -0.15], atol=1e-6)
    assert jacobian_condition(model, home) < 30.0


def test_new_robot_does_not_stand_in_a_singular_home(tmp_path):
    """The middle of these ranges is the arm stretched straight up."""
    said = six_joints(
        tmp_path,
        lambda text: re.sub(
            r'lower="[-.\d]+" upper="([.\d]+)"', r'lower="-\1" upper="\1"', text
        ),
    )
    assert not any('missing: home' in line for line in said)
    robot = find_robot(str(tmp_path / 'arm.yaml'))
    assert jacobian_condition(robot.arm.model(), np.array(robot.file.home)) < 20.0


def test_home_without_the_tool_straight_down_is_not_singular(tmp_path, monkeypatch):
    for finder in ('find_posture_at', 'find_posture_along'):
        monkeypatch.setattr(f'sim_bridge.new_robot.{finder}', lambda *_: None)
    said = six_joints(tmp_path)
    assert any(
        line.startswith('missing: home: no posture with the tool') for line in said
    )
    robot = find_robot(str(tmp_path / 'arm.yaml'))
    assert jacobian_condition(robot.arm.model(), np.array(robot.file.home)) < 20.0


def test_new_robot_guesses_torque_limits_that_hold_a_heavy_arm(tmp_path):
    def heavy(text):
        for name in ('mass value', 'ixx', 'iyy', 'izz'):
            text = re.sub(
                rf'{name}="([-\d.e]+)"',
                lambda found, name=name: f'{name}="{100.0 * float(found[1])}"',
                text,
            )
        return re.sub(r' effort="\d+"', ' effort="0"', text)

    said = six_joints(tmp_path, heavy)
    assert 'missing: torque_limit of j1, j2, j3, j4, j5, j6: the URDF has none' in said
    share = next(
        int(found[1])
        for line in said
        if (found := re.search('gravity takes (\\d+) % of the torque limit', line))
    )
    assert share <= 34
    limits = [
        link.torque_limit for link in find_robot(str(tmp_path / 'arm.yaml')).arm.links
    ]
    assert min(limits) >= 50.0 and max(limits) > 1000.0


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
    tmp_path, welded, lock, knuckle
):
    welded.write_text(welded.read_text().replace('</robot>', GRIPPER))
    mine = tmp_path / 'mine.yaml'
    new_robot(
        welded, 'sensor', 'tip', mine, tmp_path / 'controller.yaml', ['lift=0', *lock]
    )
    file = find_robot(str(mine)).file
    assert file.locked == pytest.approx(
        {
            'lift': 0.0,
            'stick': 0.0,
            'knuckle': knuckle,
            'pad': 0.05 - knuckle,
            'finger': 2.0 * (0.05 - knuckle),
        }
    )


@pytest.mark.parametrize(
    ('sensor', 'joint', 'leader'),
    [
        ('sensor', 'link4', 'link3'),
        ('sensor', 'stick', 'link5'),
        ('sensor', 'link4', 'nothing'),
    ],
)
def test_new_robot_refuses_a_joint_that_mimics_one_of_the_arm(
    tmp_path, welded, sensor, joint, leader
):
    """In the chain, and in the tool, which would move with the arm."""
    opening = f'<joint name="{joint}" type="revolute">'
    mimic = f'<mimic joint="{leader}" multiplier="0.5"/>'
    text = welded.read_text()
    assert opening in text
    welded.write_text(text.replace(opening, opening + mimic))
    with pytest.raises(
        ConfigError, match=f'got {joint} follows {leader}, no motor of its own'
    ):
        new_robot(
            welded,
            sensor,
            'tip',
            tmp_path / 'mine.yaml',
            tmp_path / 'controller.yaml',
            ['lift=0'],
        )
    assert not list(tmp_path.glob('*.yaml'))
