"""What an arm looks like, from its URDF."""

from __future__ import annotations

from multicontact_control.config import ControllerConfig, validate
from multicontact_control.config.files import read_parameters
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
from multicontact_control.view.shapes import read_shapes
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

HOME = np.array([1.847117449942421, 0.8705595994175255, 2.9372057614605662, 0.0,
                 -0.6661727072882984, 1.847117449942421])
TWO_JOINTS = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
  <joint name="1" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0 0.3 0.4" rpy="0 0 0"/></joint>
  <joint name="2" type="revolute"><parent link="b"/><child link="c"/>
    <origin xyz="0 0 0.2"/></joint></robot>"""


@pytest.mark.parametrize('urdf', sorted(config_dir().glob('*.urdf')), ids=lambda path: path.name)
def test_every_arm_we_ship_looks_like_something(urdf):
    from xml.etree import ElementTree

    root = ElementTree.parse(urdf).getroot()
    massive = {link.get('name') for link in root.findall('link')
               if float(link.find('inertial/mass').get('value')
                        if link.find('inertial') is not None else 0.0) > 0.01}
    assert {shape.link for shape in read_shapes(urdf.read_text())} >= massive


def test_the_bodies_of_the_puma_meet_where_its_joints_are():
    """The tool ends at the tips, and bodies reach the axes of the joints at both their ends."""
    config = validate(ControllerConfig, read_parameters(config_dir() / 'controller.yaml'))
    robot = RobotModel(config.robot, config_dir())
    shapes = read_shapes((config_dir() / config.robot.urdf).read_text())
    links = [f'link{i}' for i in range(1, 7)]
    poses = dict(zip([*links, 'base_link', 'tool'], robot.link_poses(
        HOME, [*links, 'base_link', 'tool'])))

    def gap(link, point):
        """Return the distance from a point to the nearest body of a link."""
        position, rotation = poses[link]
        local = rotation.T @ (point - position)
        found = []
        for shape in (each for each in shapes if each.link == link):
            w, x, y, z = shape.wxyz
            inside = Rotation.from_quat([x, y, z, w]).as_matrix().T @ (local - shape.position)
            if shape.kind == 'box':
                far = np.maximum(np.abs(inside) - 0.5 * np.array(shape.size), 0.0)
            elif shape.kind == 'cylinder':
                far = np.maximum([np.hypot(*inside[:2]) - shape.size[0],
                                  abs(inside[2]) - 0.5 * shape.size[1]], 0.0)
            else:
                far = max(np.linalg.norm(inside) - shape.size[0], 0.0)
            found.append(float(np.linalg.norm(far)))
        return min(found)

    tips = robot.link_poses(HOME, ['tip_table', 'tip_board'])
    assert all(gap('tool', tip.position_world) < 1e-9 for tip in tips)
    np.testing.assert_allclose(tips[0].position_world, [0.0, 0.55, 0.41], atol=1e-9)
    for link, following in zip(links, [*links[1:], 'tool']):
        # Somewhere along the axis: upper arm and forearm are beside the trunk.
        place, axes = poses[following]
        axis = [place + s * axes[:, 2] for s in np.arange(-0.2, 0.5, 0.01)]
        assert min(gap(link, point) for point in axis) < 1e-9, link
        assert min(gap(following, point) for point in axis) < 1e-9, following


def test_links_that_look_like_nothing_are_rods_to_the_next_joint():
    first, second = read_shapes(TWO_JOINTS)
    assert (first.link, second.link) == ('a', 'b')
    np.testing.assert_allclose(first.size[1], 0.5)
    np.testing.assert_allclose(first.position, [0.0, 0.15, 0.2])
    w, x, y, z = first.wxyz
    axis = Rotation.from_quat([x, y, z, w]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(axis, [0.0, 0.6, 0.8], atol=1e-12)


def test_what_is_no_urdf_is_refused():
    with pytest.raises(ConfigError, match='robot.urdf: expected XML'):
        read_shapes('<robot>')
    with pytest.raises(ConfigError, match="expected numbers, found 'a b c'"):
        read_shapes(TWO_JOINTS.replace('0 0.3 0.4', 'a b c'))
