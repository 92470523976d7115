"""Pushes at wrist and tool: felt by the arm, those at the tool read by the sensor."""

import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.arm import SENSOR_FRAME

IDEAL_SENSOR = {'noise': False, 'quantise': False, 'saturate': False}
FREE = {'contact_names': (), 'joint_friction_scale': 0.0}


@pytest.mark.parametrize(('preset', 'link'), [('rigid', 'tip_board'), ('puma', 'tip_table')])
def test_sensor_reads_the_opposite_of_a_push_at_the_tool(make_plant, model, preset, link):
    """A held arm: force and moment as statics has them."""
    force = np.array([4.0, -6.0, 8.0])
    plant = make_plant(
        preset, sensor=IDEAL_SENSOR, **FREE, tool_push_start=(0.0,), tool_push_duration=(2.0,),
        tool_push_force_world=tuple(force), tool_push_link=link)
    sample = plant.reset()
    rest, home, data = sample.wrench, sample.q, model.createData()
    inertia = np.array([4.0, 6.0, 2.0, 0.2, 0.2, 0.2])
    for _ in range(800):
        sample = plant.step(plant.initial_torque - inertia * (
            400.0 * (sample.q - home) + 40.0 * sample.qd))
        np.testing.assert_array_equal(sample.tool_push_world, force)
    pin.framesForwardKinematics(model, data, plant.arm.q)
    face = data.oMf[model.getFrameId(SENSOR_FRAME)]
    local = face.rotation.T @ -force
    point = face.actInv(data.oMf[model.getFrameId(link)].translation)
    expected = rest + np.concatenate((local, np.cross(point, local)))
    np.testing.assert_allclose(sample.wrench, expected, atol=0.15)
    assert np.max(np.abs(sample.qd)) < 1e-2


@pytest.mark.parametrize(('prefix', 'frame'), [
    ('push', 'wrist_point'), ('tool_push', 'tip_board')])
def test_push_moves_the_arm_while_it_lasts(make_plant, model, puma, prefix, frame):
    """The momentum it leaves behind: M dqd = J^T F dt at the point pushed."""
    pushes = {f'{prefix}_start': (0.1,), f'{prefix}_duration': (0.02,),
              f'{prefix}_force_world': (0.0, 0.0, 30.0)}
    plant, still = make_plant(**FREE, **pushes), make_plant(**FREE)
    for tick in range(60):
        sample, reference = (p.step(p.initial_torque) for p in (plant, still))
        if tick < 50:
            np.testing.assert_array_equal(sample.qd, reference.qd)
        if prefix == 'tool_push':
            np.testing.assert_array_equal(sample.tool_push_world, [0, 0, 30.0 * (tick >= 50)])
    data, home = model.createData(), np.array(plant.config.home)
    pin.computeJointJacobians(model, data, home)
    pin.updateFramePlacements(model, data)
    jacobian = pin.getFrameJacobian(model, data, model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)
    model.armature = np.array(puma.armature)
    upper = np.triu(pin.crba(model, data, home))
    expected = np.linalg.solve(
        upper + np.triu(upper, 1).T, jacobian[:3].T @ [0.0, 0.0, 30.0 * 0.02])
    np.testing.assert_allclose(sample.qd, expected, atol=0.02 * np.max(np.abs(expected)))
    np.testing.assert_array_equal(plant.step(plant.initial_torque).tool_push_world, np.zeros(3))
