from arms import plant_config
from multicontact_control.errors import ConfigError, RunError, ShapeError
import numpy as np
import pinocchio as pin
import pytest
from scipy import signal
from sim_bridge.plant import Plant
from sim_bridge.surface import move

IDEAL_SENSOR = {'noise': False, 'quantise': False, 'saturate': False}


def fingerprint(plant, ticks=150):
    """Run into both contacts while swinging along x; return every number of every sample."""
    samples = [plant.reset()]
    swing = np.array([3.0, 0.0, 0.0, 0.2, 0.3, 0.2])
    for tick in range(ticks):
        torque = plant.initial_torque + swing * np.sin(0.05 * tick)
        torque[1] -= 8.0
        samples.append(plant.step(torque))
    assert any(sample.contact_force.any() for sample in samples)
    return b''.join(
        part.tobytes() for sample in samples for part in (
            sample.q, sample.qd, sample.effort, sample.wrench, sample.wrench_filtered,
            sample.contact_force))


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_plant_repeats_bit_for_bit_with_its_seed(make_plant, preset):
    plant = make_plant(preset, seed=3)
    first = fingerprint(plant)
    assert fingerprint(plant) == first
    assert fingerprint(make_plant(preset, seed=3)) == first
    assert fingerprint(make_plant(preset, seed=4)) != first


def test_rigid_plant_moves_like_pinocchio_with_armature(puma, model, make_plant, rng):
    """A free motion, step by step: ABA with armature and symplectic Euler."""
    plant = make_plant('rigid', contact_names=())
    model.armature = np.array(puma.armature)
    data, step = model.createData(), plant.config.substep
    q, qd = plant.reset().q, np.zeros(6)
    for _ in range(50):
        torque = plant.initial_torque + rng.uniform(-1, 1, 6)
        sample = plant.step(torque)
        for _ in range(round(2e-3 / step)):
            qd = qd + step * pin.aba(model, data, q, qd, torque)
            q = q + step * qd
    np.testing.assert_allclose(sample.qd, qd, atol=1e-10)
    np.testing.assert_allclose(sample.q, q, atol=1e-11)


def test_encoders_sit_where_the_configuration_says(make_plant):
    motor, joint = (make_plant('puma', joint_sensing=side) for side in ('motor', 'joint'))
    wound = motor.initial_torque / np.array(motor.config.drive_stiffness)
    np.testing.assert_allclose(motor.reset().q - joint.reset().q, wound, atol=1e-15)


def test_torque_is_clipped_at_the_limits(puma, make_plant):
    plant = make_plant('rigid')
    sample = plant.step(np.full(6, 1e3))
    assert sample.saturated
    np.testing.assert_array_equal(sample.effort, puma.torque_limit)
    assert not plant.step(np.array(puma.torque_limit)).saturated


def test_commands_and_configurations_that_do_not_fit_are_refused(make_plant):
    plant = make_plant('rigid')
    with pytest.raises(ShapeError):
        plant.step(np.zeros(7))
    with pytest.raises(RunError):
        plant.step(np.full(6, np.nan))
    table = plant.config.surfaces['table'].model_copy(update={'tip_link': 'tip_wall'})
    for change, field in (
            ({'home': (0.0,) * 5}, 'home'), ({'substep': 7e-4}, 'substep'),
            ({'surfaces': {**plant.config.surfaces, 'table': table}}, 'surfaces.table.tip_link'),
            ({'tool_push_link': 'link3'}, 'tool_push_link')):
        with pytest.raises(ConfigError) as caught:
            Plant(plant.config.model_copy(update=change), rate=500.0, seed=0)
        assert caught.value.field == field


def test_obstacle_on_a_link_is_not_felt_by_the_sensor():
    """15 N at the elbow; the sensor feels the tool's inertia."""
    plant = Plant(plant_config('rigid', obstacle_names=['elbow'], surfaces={'elbow': {
        'tip_link': 'link3', 'roughness_std': 0.0, 'point_world': (9.0, 0.0, 0.0),
        'normal_world': (1.0, 0.0, 0.0), 'stiffness': 3000.0}}), rate=500.0, seed=0)
    still = plant.step(plant.initial_torque).wrench
    plant.contacts.put_before_tip(2, -5e-3)
    sample = plant.step(plant.initial_torque)
    np.testing.assert_allclose(plant.contacts.obstacles, 15.0, atol=1.0)
    assert (plant.load[:3] != 0.0).any() and (plant.load[3:] == 0.0).all()
    assert np.abs(sample.wrench - still).max() < 3.0
    plant.close()


def test_body_on_a_spring_gives_way_as_newton_says(make_plant):
    mass, stiffness, damping, force = 5.0, 1000.0, 100.0, 12.0
    plant = make_plant('rigid', surfaces={
        'mass': mass, 'mount_stiffness': stiffness, 'mount_damping': damping})
    surface, step = plant.contacts.surfaces[1], plant.config.substep
    start, surface['alpha'], places = surface['place'].copy(), force, []
    for _ in range(2000):
        move(surface, step)
        places.append((surface['place'] - start) @ surface['normal'])
    _, expected = signal.step(([force], [mass, damping, stiffness]), T=step * np.arange(2001))
    np.testing.assert_allclose(places, expected[1:], atol=np.diff(expected).max())


@pytest.mark.parametrize('period', [0.0, 0.5])
def test_surface_moves_as_configured(make_plant, period):
    """By v (t - t_0), or by v T / 2 pi (1 - cos 2 pi (t - t_0) / T)."""
    plant = make_plant(surfaces={
        'velocity': 0.02, 'motion_start': 0.1, 'motion_period': period})
    surface, before = plant.contacts.surfaces[0], plant.contacts.places_world[0].copy()
    for _ in range(400):
        move(surface, 1e-3)
    way = 0.02 * 0.3 if not period else 0.02 * period / (2.0 * np.pi) * (
        1.0 - np.cos(2.0 * np.pi * 0.3 / period))
    np.testing.assert_allclose(
        surface['place'] - before, [0.0, 0.0, -way], atol=3e-5)
