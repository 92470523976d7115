"""Link poses against pinocchio, and what a URDF must have."""

from multicontact_control.dynamics.robot import LinkTransforms
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

SLIDER = """<robot name="slider"><link name="world"/><link name="cart"/><link name="pole"/>
<joint name="rail" type="prismatic"><parent link="world"/><child link="cart"/>
<origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/><axis xyz="1 0 0"/></joint>
<joint name="hinge" type="revolute">
<limit lower="-9" upper="9" effort="1" velocity="1"/><parent link="cart"/><child link="pole"/>
<origin rpy="0.3 -0.2 0.7"/><axis xyz="0 3 4"/></joint></robot>"""


def placements(transforms):
    """Return the pose of each link in the root, by following the tree."""
    found = {transforms[0].parent: pin.SE3.Identity()}
    waiting = list(transforms)
    while waiting:
        transform = waiting.pop(0)
        if transform.parent not in found:
            waiting.append(transform)
            continue
        rotation = Rotation.from_quat(transform.quaternion_xyzw).as_matrix()
        found[transform.child] = found[transform.parent] * pin.SE3(
            rotation, np.array(transform.translation))
    return found


@pytest.mark.parametrize('text', [
    pytest.param(SLIDER, id='slider'),
    pytest.param((config_dir() / 'puma560.urdf').read_text(encoding='utf-8'), id='puma')])
def test_link_transforms_are_those_of_pinocchio(text):
    model = pin.buildModelFromXML(text)
    data = model.createData()
    rng = np.random.default_rng(3)
    links = LinkTransforms(text, world_frame='world')
    for _ in range(5):
        q = rng.uniform(-3.0, 3.0, model.nv)
        pin.framesForwardKinematics(model, data, q)
        found = placements(links.at(dict(zip(list(model.names)[1:], q))))
        names = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
        assert set(names) <= set(found)
        for name in names:
            np.testing.assert_allclose(
                found[name].homogeneous, data.oMf[model.getFrameId(name)].homogeneous,
                atol=1e-12)


@pytest.mark.parametrize('position', [np.inf, -np.inf, np.nan])
def test_link_transforms_leave_out_joints_whose_position_is_not_finite(position):
    for known, unknown, child in (('hinge', 'rail', 'pole'), ('rail', 'hinge', 'cart')):
        found = LinkTransforms(SLIDER).at({known: 0.1, unknown: position})
        assert [x.child for x in found] == [child]


@pytest.mark.parametrize(('old', 'new', 'match'), [
    ('<robot', '<', 'expected a valid URDF'),
    ('prismatic', 'floating', 'expected joints with one coordinate each')])
def test_link_transforms_refuse(old, new, match):
    with pytest.raises(ConfigError, match=match):
        LinkTransforms(SLIDER.replace(old, new, 1))
