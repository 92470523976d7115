"""What an arm looks like, from its URDF."""

from xml.etree import ElementTree

from multicontact_control.paths import find_config_folder
import numpy as np
import pytest

pytest.importorskip('trimesh', reason='viser is not installed (extra [view])')
from multicontact_control.view.shapes import read_shapes  # noqa: E402, I100

TWO_JOINTS = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
  <joint name="1" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0 0.3 0.4" rpy="0 0 0"/></joint>
  <joint name="2" type="revolute"><parent link="b"/><child link="c"/>
    <origin xyz="0 0 0.2"/></joint>
  <link name="place"><inertial><mass value="0.0"/></inertial></link>
  <joint name="3" type="fixed"><parent link="c"/><child link="place"/>
    <origin xyz="0 0 0.2"/></joint></robot>"""


@pytest.mark.parametrize(
    'urdf', sorted(find_config_folder().glob('*.urdf')), ids=lambda path: path.name
)
def test_shapes_are_there_for_every_massive_link_we_ship(urdf):
    root = ElementTree.parse(urdf).getroot()
    massive = {
        link.get('name')
        for link in root.findall('link')
        if (mass := link.find('inertial/mass')) is not None
        and float(mass.get('value')) > 0.01
    }
    assert massive and read_shapes(urdf).keys() >= massive


def test_links_without_visuals_are_rods_to_the_next_joint(tmp_path):
    urdf = tmp_path / 'two.urdf'
    urdf.write_text(TWO_JOINTS)
    shapes = read_shapes(urdf)
    assert list(shapes) == ['a', 'b']
    rod = shapes['a'].to_mesh()
    np.testing.assert_allclose(rod.center_mass, [0.0, 0.15, 0.2], atol=1e-9)
    assert (rod.vertices @ [0.0, 0.6, 0.8]).max() == pytest.approx(0.5)
