"""Every robot on every engine: the same rigid bodies as pinocchio's."""

import sys

from multicontact_control.config import validate
from multicontact_control.errors import ConfigError
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pinocchio as pin
import pytest
from robots import carried, ENGINES, needs_mujoco, ROBOTS
from sim_bridge import config as plant_parameters
from sim_bridge.arm import SENSOR_FRAME
from sim_bridge.config import PlantConfig
from sim_bridge.plant import make_engine_arm, Plant
from sim_bridge.posture import frame_jacobian, frame_pose
from sim_bridge.robots import find_robot

STEP = 5e-4
IDEAL = {'noise': False, 'quantise': False, 'saturate': False, 'low_pass': False}


def plant_config(name, **changes):
    plant = validate(PlantConfig, find_robot(name).plant_values('rigid'))
    sensor = plant.sensor.model_copy(update=IDEAL)
    return plant.model_copy(update={'substep': STEP, 'sensor': sensor, **changes})


def expected_wrench(arm, model, data, force, point):
    """
    Return what the sensor reads of the body behind it, in its frame, shape (6,).

    Newton and Euler, by the motion of the last joint in `data`, without the force [N] that pushes
    this body at a point [m], both in world axes.
    """
    face = model.frames[model.getFrameId(SENSOR_FRAME)].placement
    pose = data.oMi[model.nv] * face
    body = carried(arm)
    twist = face.actInv(data.v[model.nv])
    acceleration = face.actInv(data.a[model.nv])
    acceleration.linear -= pose.rotation.T @ model.gravity.linear
    inertial = body * acceleration + twist.cross(body * twist)
    push = pin.Force(force, np.cross(point, force))
    return (inertial - pose.actInv(push)).vector


def test_auto_is_pybullet_where_it_is_installed_else_mujoco(monkeypatch):
    assert plant_config('puma').engine == 'pybullet'
    monkeypatch.setattr(plant_parameters, 'find_spec', lambda name: None)
    assert plant_config('puma').engine == 'mujoco'
    chosen = find_robot('puma').plant_values('rigid') | {'engine': 'pybullet'}
    assert validate(PlantConfig, chosen).engine == 'pybullet'


@pytest.mark.parametrize(
    ('engine', 'module'), [('pybullet', 'bullet_arm'), ('mujoco', 'mujoco_arm')]
)
def test_engine_that_cannot_be_loaded_is_refused_with_its_name(
    monkeypatch, engine, module
):
    monkeypatch.setitem(sys.modules, engine, None)
    monkeypatch.delitem(sys.modules, f'sim_bridge.{module}', raising=False)
    config = plant_config('puma', engine=engine)
    with pytest.raises(ConfigError, match=f'engine: .* pip install {engine}, got'):
        make_engine_arm(config, find_robot('puma').arm)


@pytest.mark.parametrize('largest_push', [0.0, 1.0])
@pytest.mark.parametrize('engine', ENGINES)
@pytest.mark.parametrize('name', ROBOTS)
def test_steps_are_those_of_pinocchio_and_so_is_the_wrench(
    name, engine, largest_push, rng
):
    """Twenty steps from rest, alone and pushed: ABA, symplectic Euler, Newton and Euler."""
    arm = find_robot(name).arm
    model = arm.model()
    data = model.createData()
    n = model.nv
    tip = list(arm.tips)[-1]
    elbow = (n + 1) // 2
    link_numbers = {tip: n, 'wrist_point': n - 1, f'link{elbow}': elbow - 1}
    # PyBullet takes a pushed link for where it was a step before, and leaves a term of the
    # order of m w^2 r out of the wrench.
    wrench_error = 1e-8 if engine == 'mujoco' else 0.1
    exact = engine == 'mujoco' or not largest_push
    speed_error = 1e-9 if exact else 2e-4
    place_error = 1e-11 if exact else 1e-6
    body = make_engine_arm(plant_config(name, engine=engine), arm)
    q = rng.uniform(-0.7, 0.7, n)
    qd = np.zeros(n)
    body.reset(q)
    for _ in range(20):
        torque = 0.02 * np.array(arm.torque_limit) * rng.uniform(-1.0, 1.0, n)
        load = torque.copy()
        pushes = []
        for frame, link in link_numbers.items():
            force = largest_push * rng.uniform(-1.0, 1.0, 3)
            point = frame_pose(model, q, frame).translation
            load += frame_jacobian(model, q, frame)[:3].T @ force
            pushes.append([*force, *point, link])
        if largest_push:
            body.apply_pushes(pushes)
        wrench = np.array(body.step(torque))
        qdd = pin.aba(model, data, q, qd, load)
        pin.forwardKinematics(model, data, q, qd, qdd)
        force, point, _ = np.split(np.array(pushes[0]), [3, 6])
        expected = expected_wrench(arm, model, data, force, point)
        assert_allclose(wrench, expected, atol=wrench_error)
        qd = qd + STEP * qdd
        q = q + STEP * qd
        assert_allclose(body.qd, qd, atol=speed_error)
        assert_allclose(body.q, q, atol=place_error)
    assert np.abs(qd).max() > 0.01
    body.close()


@pytest.mark.parametrize('engine', ENGINES)
@pytest.mark.parametrize('name', ROBOTS)
def test_plant_rests_at_home_and_reads_the_weight(name, engine):
    config = plant_config(name, engine=engine)
    plant = Plant(config, rate=500.0, seed=0)
    start = plant.reset()
    for _ in range(20):
        sample = plant.step(plant.initial_torque)
    assert_allclose(sample.q, config.home, atol=1e-9)
    assert_array_equal(sample.contact_force, 0.0)
    # The sensor's z points straight down: the arm holds up, along -z, all that hangs on it.
    arm = plant.description
    weight = [0.0, 0.0, -9.81 * arm.carried_mass]
    lever = np.cross(arm.carried_com, weight)
    assert_allclose(start.wrench, [*weight, *lever], atol=1e-6)
    assert_allclose(sample.wrench, start.wrench, atol=1e-4)
    plant.close()


@pytest.mark.parametrize(
    ('engine', 'contact'),
    [('pybullet', 'compliant'), pytest.param('mujoco', 'native', marks=needs_mujoco)],
)
@pytest.mark.parametrize('name', ROBOTS)
def test_contact_is_as_stiff_as_the_surface_is_configured(name, engine, contact):
    """Pressed down with 12 N by a weak servo, the tip sinks in by 12 N over the stiffness."""
    config = plant_config(
        name, engine=engine, contact=contact, contact_names=('table',)
    )
    smooth = {'friction': 0.0, 'roughness_std': 0.0}
    surface = config.surfaces['table'].model_copy(update=smooth)
    config = config.model_copy(update={'surfaces': {'table': surface}})
    plant = Plant(config, rate=500.0, seed=0)
    model = plant.model
    data = model.createData()
    home = np.array(config.home)
    press = np.array([0.0, 0.0, -12.0, 0.0, 0.0, 0.0])
    stiffness = np.array([2000.0, 2000.0, 0.0, 100.0, 100.0, 100.0])
    damping = np.array([200.0, 200.0, 200.0, 10.0, 10.0, 10.0])
    sample = plant.reset()
    for _ in range(1000):
        J = frame_jacobian(model, sample.q)
        spring = stiffness * (J @ (sample.q - home))
        damper = damping * (J @ sample.qd)
        gravity = pin.computeGeneralizedGravity(model, data, sample.q)
        torque = gravity - 3.0 * sample.qd + J.T @ (press - spring - damper)
        sample = plant.step(torque)
    force = sample.contact_force[0]
    assert force == pytest.approx(12.0, abs=0.5)
    depth = surface.point_world[2] - plant.contacts.points_world[0, 2]
    assert depth == pytest.approx(force / surface.stiffness, rel=0.05)
    weight = 9.81 * plant.description.carried_mass
    assert sample.wrench[2] == pytest.approx(force - weight, abs=0.05)
    plant.close()
