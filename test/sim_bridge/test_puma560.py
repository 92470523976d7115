import json
from pathlib import Path

from multicontact_control.config import merge, read_yaml, validate
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.arm import OPERATIONAL_FRAME, SENSOR_FRAME
from sim_bridge.puma560 import DATA_FILE, load_robot, puma_arm, RobotData, URDF_FILE

REFERENCE = json.loads(
    (Path(__file__).parents[1] / 'data' / 'puma560_reference.json').read_text())['samples']
HOME = np.array([1.847117449942421, 0.8705595994175255, 2.9372057614605662, 0.0,
                 -0.6661727072882984, 1.847117449942421])


@pytest.fixture
def bare_model(robot, model):
    """Return the arm as published: with rotors, without the tool."""
    link = robot.links[-1]
    model.inertias[6] = pin.Inertia(link.mass, np.array(link.com), np.diag(link.inertia))
    model.armature = np.array(robot.exact_armature)
    return model


@pytest.mark.parametrize('sample', REFERENCE)
def test_urdf_dynamics_agree_with_roboticstoolbox(bare_model, sample):
    """Torques, inertia, gravity and pose of the published arm (roboticstoolbox's Puma560)."""
    model, data = bare_model, bare_model.createData()
    q, qd, qdd = (np.array(sample[name]) for name in ('q', 'qd', 'qdd'))
    np.testing.assert_allclose(pin.rnea(model, data, q, qd, qdd), sample['tau'], atol=1e-9)
    upper = np.triu(pin.crba(model, data, q))
    np.testing.assert_allclose(upper + np.triu(upper, 1).T, sample['M'], atol=1e-9)
    np.testing.assert_allclose(
        pin.computeGeneralizedGravity(model, data, q), sample['g'], atol=1e-9)
    pin.framesForwardKinematics(model, data, q)
    pose = data.oMf[model.getFrameId(OPERATIONAL_FRAME)].homogeneous
    np.testing.assert_allclose(pose, sample['T'], atol=1e-9)


def test_urdf_in_config_is_the_generated_one(robot):
    committed = (config_dir() / URDF_FILE).read_text(encoding='utf-8')
    assert committed == puma_arm(robot).urdf, 'run python3 -m sim_bridge.puma560'


def test_exact_armature_rounds_to_the_published_one(robot):
    np.testing.assert_allclose(robot.exact_armature, robot.armature, atol=6e-4)


def test_home_has_tool_down_and_tips_where_the_paper_wants_them(model):
    """k_s = k_env (1 + |l x n|^2) is 6000 and 6217 N/m (P04 eq. 17), and axes are the world's."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, HOME)
    wrist = data.oMf[model.getFrameId(OPERATIONAL_FRAME)]
    np.testing.assert_allclose(wrist.rotation, np.diag([-1.0, 1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(wrist.translation, [0.0, 0.55, 0.65], atol=1e-12)
    stiffness = []
    for tip, normal in (('tip_table', [0.0, 0.0, -1.0]), ('tip_board', [0.0, 1.0, 0.0])):
        lever = data.oMf[model.getFrameId(tip)].translation - wrist.translation
        stiffness.append(6000.0 * (1.0 + np.sum(np.cross(lever, normal) ** 2)))
    np.testing.assert_allclose(stiffness, [6000.0, 6216.6], atol=1e-9)
    face = data.oMf[model.getFrameId(SENSOR_FRAME)]
    np.testing.assert_allclose(face.translation - wrist.translation, [0.0, 0.0, -0.056],
                               atol=1e-12)


def test_motion_along_x_keeps_clear_of_limits_and_singularities(model):
    """The sinusoid of 0.15 m from home, orientation fixed, by differential kinematics."""
    data, frame = model.createData(), model.getFrameId(OPERATIONAL_FRAME)
    for direction in (-1.0, 1.0):
        q = HOME.copy()
        for _ in range(150):
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            assert np.linalg.cond(jacobian) < 12.0
            q += np.linalg.solve(jacobian, [direction * 1e-3, 0.0, 0.0, 0.0, 0.0, 0.0])
            assert np.all(q > model.lowerPositionLimit + 0.5)
            assert np.all(q < model.upperPositionLimit - 0.5)


@pytest.mark.parametrize(('change', 'field'), [
    ({'torque_limit': [1.0]}, 'torque_limit'),
    ({'tool': {'mass': -1.0}}, 'tool.mass'),
    ({'arms': 2}, 'arms'),
])
def test_robot_data_names_the_bad_field(change, field):
    values = merge(read_yaml(config_dir() / DATA_FILE), change)
    with pytest.raises(ConfigError, match=rf'^{field}: expected'):
        validate(RobotData, values)


def test_load_robot_names_the_missing_file(tmp_path):
    with pytest.raises(ConfigError, match='readable file'):
        load_robot(tmp_path / 'none.yaml')
