"""config/puma560.urdf and config/robots/puma.yaml against the published numbers."""

import json
from pathlib import Path

from multicontact_control.config import read_yaml
import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.arm import OPERATIONAL_FRAME

DATA = Path(__file__).parents[1] / 'data'
REFERENCE = json.loads((DATA / 'puma560_reference.json').read_text())['samples']
TABLE = read_yaml(DATA / 'puma560.yaml')


@pytest.mark.parametrize('sample', REFERENCE)
def test_urdf_dynamics_agree_with_roboticstoolbox(puma, model, sample):
    """Torques, inertia, gravity and pose of the published arm, without the tool."""
    link = TABLE['links'][-1]
    model.inertias[6] = pin.Inertia(
        link['mass'], np.array(link['com']), np.diag(link['inertia']))
    model.armature = np.array(puma.armature)
    data = model.createData()
    q, qd, qdd = (np.array(sample[name]) for name in ('q', 'qd', 'qdd'))
    np.testing.assert_allclose(pin.rnea(model, data, q, qd, qdd), sample['tau'], atol=1e-9)
    upper = np.triu(pin.crba(model, data, q))
    np.testing.assert_allclose(upper + np.triu(upper, 1).T, sample['M'], atol=1e-9)
    np.testing.assert_allclose(
        pin.computeGeneralizedGravity(model, data, q), sample['g'], atol=1e-9)
    pin.framesForwardKinematics(model, data, q)
    pose = data.oMf[model.getFrameId(OPERATIONAL_FRAME)].homogeneous
    np.testing.assert_allclose(pose, sample['T'], atol=1e-9)


def test_motors_and_limits_are_the_published_ones_at_the_joint(puma):
    """Jm G^2, b G^2 and F |G|; the armature is published rounded, too."""
    for number, (link, motor) in enumerate(zip(puma.links, TABLE['motors'], strict=True)):
        gear = abs(motor['gear'])
        positive, negative = motor['coulomb']
        np.testing.assert_allclose(
            [link.armature, link.viscous, link.coulomb_positive, link.coulomb_negative],
            [motor['rotor_inertia'] * gear ** 2, motor['viscous'] * gear ** 2,
             positive * gear, -negative * gear], rtol=1e-12)
        assert link.armature == pytest.approx(TABLE['armature'][number], abs=6e-4)
        assert link.torque_limit == TABLE['torque_limit'][number]
        assert link.speed_limit == TABLE['speed_limit'][number]
        np.testing.assert_allclose(
            np.degrees([link.lower, link.upper]), TABLE['position_limit_deg'][number])
