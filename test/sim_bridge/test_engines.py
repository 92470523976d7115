"""Every robot on every engine: the same rigid bodies as pinocchio's."""

from multicontact_control.config import validate
import numpy as np
import pinocchio as pin
import pytest
from robots import carried, ENGINES, needs_mujoco, ROBOTS
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


@pytest.mark.parametrize('engine', ENGINES)
@pytest.mark.parametrize('name', ROBOTS)
def test_steps_are_those_of_pinocchio_and_so_is_the_wrench(name, engine, rng):
    """Twenty steps from rest, alone and pushed: ABA, symplectic Euler, Newton and Euler."""
    arm = find_robot(name).arm
    model, data = arm.model(), arm.model().createData()
    n, tip, elbow = model.nv, list(arm.tips)[-1], (model.nv + 1) // 2
    body = make_engine_arm(plant_config(name, engine=engine), arm)
    places = {tip: n, 'wrist_point': n - 1, f'link{elbow}': elbow - 1}
    face = model.frames[model.getFrameId(SENSOR_FRAME)].placement
    for largest_push in (0.0, 1.0):
        # PyBullet takes a pushed link for where it was a step before, and leaves a term of the
        # order of m w^2 r out of the wrench.
        exact = engine == 'mujoco' or not largest_push
        q, qd = rng.uniform(-0.7, 0.7, n), np.zeros(n)
        body.reset(q)
        for _ in range(20):
            torque = 0.02 * np.array(arm.torque_limit) * rng.uniform(-1.0, 1.0, n)
            forces = dict(zip(places, largest_push * rng.uniform(-1.0, 1.0, (3, 3))))
            points = {name: frame_pose(model, q, name).translation for name in places}
            load = torque + sum(
                frame_jacobian(model, q, name)[:3].T @ forces[name] for name in places
            )
            if largest_push:
                body.apply_pushes(
                    [[*forces[name], *points[name], places[name]] for name in places]
                )
            wrench = np.array(body.step(torque))
            qdd = pin.aba(model, data, q, qd, load)
            pin.forwardKinematics(model, data, q, qd, qdd)
            pose, inertia = data.oMi[n] * face, carried(arm)
            speed, acceleration = face.actInv(data.v[n]), face.actInv(data.a[n])
            acceleration.linear -= pose.rotation.T @ model.gravity.linear
            expected = (
                inertia * acceleration + speed.cross(inertia * speed)
            ).vector.copy()
            local = pose.rotation.T @ forces[tip]
            expected -= np.concatenate(
                (local, np.cross(pose.actInv(points[tip]), local))
            )
            np.testing.assert_allclose(
                wrench, expected, atol=1e-8 if engine == 'mujoco' else 0.1
            )
            qd = qd + STEP * qdd
            q = q + STEP * qd
            np.testing.assert_allclose(body.qd, qd, atol=1e-9 if exact else 2e-4)
            np.testing.assert_allclose(body.q, q, atol=1e-11 if exact else 1e-6)
    assert np.abs(qd).max() > 0.01
    body.close()


@pytest.mark.parametrize('engine', ENGINES)
@pytest.mark.parametrize('name', ROBOTS)
def test_plant_rests_at_home_and_reads_the_weight(name, engine):
    config = plant_config(name, engine=engine)
    plant, arm = Plant(config, rate=500.0, seed=0), find_robot(name).arm
    start = plant.reset()
    for _ in range(20):
        sample = plant.step(plant.initial_torque)
    np.testing.assert_allclose(sample.q, config.home, atol=1e-9)
    np.testing.assert_array_equal(sample.contact_force, 0.0)
    # The sensor's z points straight down: the arm holds up, along -z, all that hangs on it.
    weight = 9.81 * arm.carried_mass
    lever = np.cross(arm.carried_com, [0.0, 0.0, -weight])
    np.testing.assert_allclose(start.wrench, [0, 0, -weight, *lever], atol=1e-6)
    np.testing.assert_allclose(sample.wrench, start.wrench, atol=1e-4)
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
    surface = config.surfaces['table'].model_copy(
        update={'friction': 0.0, 'roughness_std': 0.0}
    )
    plant = Plant(
        config.model_copy(update={'surfaces': {'table': surface}}), rate=500.0, seed=0
    )
    model, data, home = plant.model, plant.model.createData(), np.array(config.home)
    servo = np.array([2000.0, 2000.0, 0.0, 100.0, 100.0, 100.0])
    damper = np.array([200.0, 200.0, 200.0, 10.0, 10.0, 10.0])
    sample = plant.reset()
    for _ in range(1000):
        jacobian = frame_jacobian(model, sample.q)
        gravity = pin.computeGeneralizedGravity(model, data, sample.q)
        sample = plant.step(
            gravity
            - 3.0 * sample.qd
            + jacobian.T
            @ (
                [0.0, 0.0, -12.0, 0.0, 0.0, 0.0]
                - servo * (jacobian @ (sample.q - home))
                - damper * (jacobian @ sample.qd)
            )
        )
    force = sample.contact_force[0]
    assert force == pytest.approx(12.0, abs=0.5)
    depth = surface.point_world[2] - plant.contacts.points_world[0, 2]
    assert depth == pytest.approx(force / surface.stiffness, rel=0.05)
    assert sample.wrench[2] == pytest.approx(
        force - 9.81 * plant.description.carried_mass, abs=0.05
    )
    plant.close()
