from arms import plant_config
from multicontact_control.errors import ConfigError, RunError, ShapeError
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pinocchio as pin
import pytest
from sim_bridge.actuator_delay import ActuatorDelay
from sim_bridge.drives import PositionHold
from sim_bridge.posture import frame_jacobian
from sim_bridge.surface import move_surface

FREE = {'contact_names': (), 'joint_friction_scale': 0.0}


@pytest.mark.parametrize(
    ('change', 'field'),
    [
        ({'contact_names': ['table', 'wall']}, 'contact_names'),
        ({'contact_names': ['table', 'table']}, 'contact_names'),
        ({'drive_stiffness': [1.0, 2.0]}, 'drive_stiffness'),
        ({'drive_stiffness': [0.0] * 6}, 'drive_stiffness.0'),
        ({'push_start': [1.0]}, 'push_duration'),
        ({'sensor': {'mounting': [1.0]}}, 'sensor.mounting'),
        (
            {'surfaces': {'table': {'normal_world': [0.0, 0.0, -1.1]}}},
            'surfaces.table.normal_world',
        ),
        ({'surfaces': {'table': {'stifness': 1.0}}}, 'surfaces.table.stifness'),
        ({'surfaces': {'table': {'shape': 'sphere'}}}, 'surfaces.table.radius'),
        ({'home': [0.0, 0.0, 'nan', 0.0, 0.0, 0.0]}, 'home.2'),
        ({'contact': 'native'}, 'contact'),
        (
            {
                'contact': 'native',
                'engine': 'mujoco',
                'surfaces': {'table': {'shape': 'sphere', 'radius': 1.0}},
            },
            'surfaces.table',
        ),
    ],
)
def test_config_names_the_bad_field(change, field):
    with pytest.raises(ConfigError) as caught:
        plant_config('puma', **change)
    assert field in {error.field for error in caught.value.errors}


def record_samples(plant):
    """Run into both contacts while swinging along x; return every number of every sample."""
    samples = [plant.reset()]
    swing = np.array([3.0, 0.0, 0.0, 0.2, 0.3, 0.2])
    press = np.array([0.0, -8.0, 0.0, 0.0, 0.0, 0.0])
    for tick in range(150):
        torque = plant.initial_torque + np.sin(0.05 * tick) * swing + press
        samples.append(plant.step(torque))
    assert any(sample.contact_force.any() for sample in samples)
    return b''.join(part.tobytes() for sample in samples for part in sample[:6])


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_plant_repeats_bit_for_bit_with_its_seed(make_plant, preset):
    plant = make_plant(preset, seed=3)
    first = record_samples(plant)
    assert record_samples(plant) == first
    assert record_samples(make_plant(preset, seed=3)) == first
    assert record_samples(make_plant(preset, seed=4)) != first


def test_encoders_on_the_motors_show_springs_that_are_wound_up(make_plant):
    plant = make_plant('puma')
    wound = plant.initial_torque / np.array(plant.config.drive_stiffness)
    ahead = plant.reset().q - plant.config.home
    assert_allclose(ahead, wound, atol=1e-15)


def test_torque_is_limited_and_commands_that_do_not_fit_are_refused(make_plant, puma):
    plant = make_plant('rigid')
    assert_array_equal(plant.step(np.full(6, 1e3)).effort, puma.torque_limit)
    with pytest.raises(ShapeError):
        plant.step(np.zeros(7))
    with pytest.raises(RunError):
        plant.step(np.full(6, np.nan))


@pytest.mark.parametrize(
    ('change', 'field'),
    [
        ({'home': [0.0] * 5}, 'home'),
        ({'substep': 7e-4}, 'substep'),
        ({'surfaces': {'tip_link': 'tip_wall'}}, 'surfaces.table.tip_link'),
        ({'tool_push_link': 'link3'}, 'tool_push_link'),
    ],
)
def test_configuration_that_does_not_fit_the_arm_is_refused(make_plant, change, field):
    with pytest.raises(ConfigError) as caught:
        make_plant('rigid', **change)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ('period', 'way'),
    [
        (0.0, 0.02 * 0.3),
        (0.5, 0.02 * 0.5 / (2.0 * np.pi) * (1.0 - np.cos(2.0 * np.pi * 0.3 / 0.5))),
    ],
)
def test_surface_moves_as_configured(make_plant, period, way):
    """By v (t - t_0), or by v T / 2 pi (1 - cos 2 pi (t - t_0) / T)."""
    plant = make_plant(
        surfaces={'velocity': 0.02, 'motion_start': 0.1, 'motion_period': period}
    )
    surface = plant.contacts.surfaces[0]
    before = plant.contacts.places_world[0].copy()
    for _ in range(400):
        move_surface(surface, 1e-3)
    assert_allclose(surface['place'] - before, [0.0, 0.0, -way], atol=3e-5)


FORCE = (0.0, 0.0, 30.0)  # N, of a push
CONFIGURED_PUSH = {
    'push_start': (0.1,),
    'push_duration': (0.02,),
    'push_force_world': FORCE,
}


@pytest.mark.parametrize(
    ('configured', 'frame'), [(CONFIGURED_PUSH, 'wrist_point'), ({}, 'tip_board')]
)
def test_push_moves_the_arm_while_it_lasts(make_plant, model, puma, configured, frame):
    """The momentum it leaves behind: M dqd = J^T F dt at the point pushed."""
    pushed = make_plant(**FREE, **configured)
    still = make_plant(**FREE)
    for _ in range(50):
        before = pushed.step(pushed.initial_torque)
        reference = still.step(still.initial_torque)
        assert_array_equal(before.qd, reference.qd)
    if not configured:
        pushed.push(FORCE, 0.02, tool=True)
    for _ in range(10):
        sample = pushed.step(pushed.initial_torque)
    home = np.array(pushed.config.home)
    model.armature = np.array(puma.armature)
    M = pin.crba(model, model.createData(), home)
    impulse = 0.02 * np.array(FORCE)
    expected = np.linalg.solve(M, frame_jacobian(model, home, frame)[:3].T @ impulse)
    tolerance = 0.02 * np.abs(expected).max()
    assert_allclose(sample.qd, expected, atol=tolerance)
    after = pushed.step(pushed.initial_torque)
    assert_allclose(after.qd, sample.qd, atol=tolerance)


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_drives_without_commands_hold_where_they_are(make_plant, preset):
    plant = make_plant(preset)
    hold = PositionHold(plant.model)
    torque = plant.initial_torque + [3.0, -3.0, 2.0, 0, 0, 0]
    for _ in range(50):
        sample = plant.step(torque)
    begin = sample.q
    assert np.abs(sample.qd).max() > 0.02
    for _ in range(500):
        sample = plant.step(hold.holding_torque(sample.q, sample.qd))
    assert np.abs(sample.q - begin).max() < 0.01
    assert np.abs(sample.qd).max() < 0.005


@pytest.mark.parametrize('ticks', [0, 1, 5])
def test_command_for_sample_k_acts_from_k_plus_ticks(ticks):
    """Until then the initial one does; a missing one is replaced by the one before."""
    delay = ActuatorDelay(ticks, np.full(2, -7.0))
    commanded = []
    for tick in range(12):
        if tick != 8:
            delay.enter_command(tick, np.full(2, float(tick)))
        commanded.append(delay.torque_for(tick)[1])
    entered = [0, 1, 2, 3, 4, 5, 6, 7, 7, 9, 10, 11]
    assert commanded == [-7.0] * ticks + entered[: 12 - ticks]
