"""Weighing the tool from a recording; tests of graphs weigh that of a running robot."""

from itertools import combinations, product
from types import SimpleNamespace
from typing import get_type_hints

from arms import controller_config
from fake_arm import wrench_message
from foreign_bag import controller_file, JOINTS, RATE, START
from multicontact_control.cli.robot import TiltOptions
from multicontact_control.commissioning.weighing import (
    CLEARANCE,
    find_clearing_way,
    identify_from_rests,
    TILTS,
    visit_poses,
    weigh_recording,
    write_tool,
)
from multicontact_control.config import read_parameters, ToolConfig
from multicontact_control.config.contact import ContactConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError
from multicontact_control.nodes import messages, topics
from multicontact_control.runs.scenario import read_controller_files
from multicontact_control.sensor.tool import (
    identify_tool,
    PoseReading,
    predict_weight_reading,
)
import numpy as np
from numpy.testing import assert_allclose
import pytest
from ros_graph import write_bag
from scipy.spatial.transform import Rotation

TOOL = ToolConfig(
    mass=1.3,
    com_sensor=(0.01, -0.03, 0.07),
    bias_sensor=(2.0, -1.0, 3.0, 0.1, -0.05, 0.02),
)
POSES = np.zeros((5, 7))
POSES[:, 3:6] = [
    [0.9, 0.5, -0.8],
    [1.4, 0.5, -0.8],
    [0.4, 0.5, -0.8],
    [0.9, 1.2, -0.2],
    [0.9, -0.3, -1.3],
]
REST = 2.0  # s
MOVE = 0.8  # s
GRAVITY = np.array([0.0, 0.0, -9.81])


def led_arm(file, offset, touched):
    """Yield messages of an arm led from pose to pose, whose sensor has stamps of its own."""
    read = read_controller_files([file])
    random = np.random.default_rng(0)
    robot = RobotModel(read.config().robot, read.urdf_dir)
    none = np.zeros(7)
    targets = np.append(POSES[1:], POSES[-1:], axis=0)
    for k in range(round(len(POSES) * (REST + MOVE) * RATE)):
        number, at = divmod(k / RATE, REST + MOVE)
        number = int(number)
        share = max(at - REST, 0.0) / MOVE
        q = POSES[number] + share * (targets[number] - POSES[number])
        noise = random.normal(size=6) * ([0.1] * 3 + [0.01] * 3)
        rotation = robot.update(q, none).sensor_pose.rotation_world
        wrench = predict_weight_reading(rotation, TOOL, GRAVITY) + TOOL.bias_sensor
        wrench += noise
        if number in touched:
            wrench[0] += 5.0 * np.sin(7.0 * at)
        stamp = START + round(k / RATE * 1e9)
        joints = messages.joint_state_message(stamp, JOINTS, position=q, velocity=none)
        yield topics.JOINT_STATES, stamp, joints
        reading = wrench_message(stamp + offset, 'wrist', wrench)
        yield topics.WRENCH, stamp + offset % 10**9, reading


def corners_of(contact):
    """Return the corners and the middle of what touches, shape (9, 3), operational frame."""
    normal = np.array(contact.normal_world)
    along = np.array(contact.direction_operational)
    across = np.cross(normal, along)
    length = contact.half_length * (contact.type != 'point')
    width = contact.half_width * (contact.type == 'plane')
    shares = np.array(list(product((-1, 0, 1), repeat=2)))
    return contact.point_operational + shares @ [length * along, width * across]


def test_least_tilt_that_calibrate_takes_determines_the_tool_from_any_four_poses():
    tilt = get_type_hints(TiltOptions, include_extras=True)['tilt'].__metadata__[0]
    poses = []
    for x, y in TILTS:
        turn = np.radians(tilt.min) * np.array([x, y, 0.0])
        rotation = Rotation.from_rotvec(turn).as_matrix()
        reading = predict_weight_reading(rotation, TOOL, GRAVITY) + TOOL.bias_sensor
        poses.append(PoseReading(rotation, reading))
    for chosen in combinations(poses, 4):
        assert identify_tool(chosen, GRAVITY).mass == pytest.approx(TOOL.mass)


@pytest.mark.parametrize('kind', ['point', 'edge', 'plane'])
@pytest.mark.parametrize(
    'normals',
    [
        [[0.0, 0.0, -1.0]],
        [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.6, -0.8], [0.8, 0.0, -0.6]],
    ],
)
def test_tool_is_lifted_until_no_tilt_leads_into_a_surface(kind, normals):
    contacts = {}
    for i, normal in enumerate(normals):
        along = np.cross(normal, [0.36, 0.48, 0.8])
        contacts[f'c{i}'] = ContactConfig(
            type=kind,
            normal_world=tuple(normal),
            point_operational=(0.05, -0.02, 0.2),
            direction_operational=tuple(along / np.linalg.norm(along)),
            half_width=0.08,
        )
    controller = SimpleNamespace(contact_names=list(contacts), contacts=contacts)
    tilts = [Rotation.from_rotvec([0.4 * x, 0.4 * y, 0.0]) for x, y in TILTS]
    way = find_clearing_way(controller, Rotation.identity(), tilts)
    for contact in contacts.values():
        corners = corners_of(contact)
        for tilt in tilts:
            depths = (tilt.apply(corners) + way - corners) @ contact.normal_world
            assert depths.max() <= -CLEARANCE + 1e-9
    assert 0.02 < np.linalg.norm(way) < 0.3


RESTING = PoseReading(np.eye(3), np.zeros(6))


def test_poses_without_a_rest_are_tried_again_and_named_if_they_stay_without():
    """The second gives one at its second try, the fifth never."""
    tried = []
    said = []

    def rest_at(number):
        tried.append(number)
        first_try = tried.count(number) == 1
        if number == 4 or (number == 1 and first_try):
            raise CalibrationError('no quiet rest')
        return RESTING

    found, lacking = visit_poses(5, rest_at, said.append)
    assert len(found) == 4
    assert lacking == 'pose 5: no quiet rest'
    assert tried == [0, 1, 2, 3, 4, 1, 4]
    assert '4 of 5 poses count' in said


def test_tool_is_not_identified_from_fewer_than_four_rests():
    expected = 'at least 4 quiet rests .*, got 3; pose 5: no qui'
    with pytest.raises(CalibrationError, match=expected):
        identify_from_rests([RESTING] * 3, controller_config(), 'pose 5: no quiet rest')


@pytest.mark.ros
@pytest.mark.parametrize(
    ('offset', 'touched'), [(700_000, (2,)), (3_600_000_000_700_000, ())]
)
def test_tool_is_identified_from_rests_whatever_the_clocks(tmp_path, offset, touched):
    """Stamps of the sensor beside those of the joints, or an hour off; a touched tool left out."""
    file = controller_file(tmp_path)
    write_bag(tmp_path / 'bag', led_arm(file, offset, touched))
    result = weigh_recording(tmp_path / 'bag', [file], None, print)
    assert result.poses == 5 - len(touched)
    assert result.mass == pytest.approx(TOOL.mass, abs=0.01)
    assert_allclose(result.com_sensor, TOOL.com_sensor, atol=2e-3)
    assert_allclose(result.bias_sensor[:3], TOOL.bias_sensor[:3], atol=0.05)
    written = controller_config(**read_parameters(write_tool(tmp_path, result)))
    assert written.tool == result.tool()
