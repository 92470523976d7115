from arms import plant_config
from multicontact_control.errors import ConfigError, RunError, ShapeError
import numpy as np
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


def fingerprint(plant, ticks=150):
    """Run into both contacts while swinging along x; return every number of every sample."""
    samples = [plant.reset()]
    swing = np.array([3.0, -8.0, 0.0, 0.2, 0.3, 0.2])
    for tick in range(ticks):
        samples.append(
            plant.step(
                plant.initial_torque
                + swing * [np.sin(0.05 * tick), 1.0, *np.sin(0.05 * tick) * np.ones(4)]
            )
        )
    assert any(sample.contact_force.any() for sample in samples)
    return b''.join(part.tobytes() for sample in samples for part in sample[:6])


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_plant_repeats_bit_for_bit_with_its_seed(make_plant, preset):
    plant = make_plant(preset, seed=3)
    first = fingerprint(plant)
    assert fingerprint(plant) == first == fingerprint(make_plant(preset, seed=3))
    assert fingerprint(make_plant(preset, seed=4)) != first
    if (
        preset == 'puma'
    ):  # its encoders are on the motors, before springs that are wound up
        wound = plant.initial_torque / np.array(plant.config.drive_stiffness)
        np.testing.assert_allclose(
            plant.reset().q - plant.config.home, wound, atol=1e-15
        )


def test_commands_and_configurations_that_do_not_fit_are_refused(make_plant, puma):
    plant = make_plant('rigid')
    np.testing.assert_array_equal(plant.step(np.full(6, 1e3)).effort, puma.torque_limit)
    with pytest.raises(ShapeError):
        plant.step(np.zeros(7))
    with pytest.raises(RunError):
        plant.step(np.full(6, np.nan))
    for change, field in (
        ({'home': [0.0] * 5}, 'home'),
        ({'substep': 7e-4}, 'substep'),
        ({'surfaces': {'tip_link': 'tip_wall'}}, 'surfaces.table.tip_link'),
        ({'tool_push_link': 'link3'}, 'tool_push_link'),
    ):
        with pytest.raises(ConfigError) as caught:
            make_plant('rigid', **change)
        assert caught.value.field == field


@pytest.mark.parametrize('period', [0.0, 0.5])
def test_surface_moves_as_configured(make_plant, period):
    """By v (t - t_0), or by v T / 2 pi (1 - cos 2 pi (t - t_0) / T)."""
    plant = make_plant(
        surfaces={'velocity': 0.02, 'motion_start': 0.1, 'motion_period': period}
    )
    surface, before = plant.contacts.surfaces[0], plant.contacts.places_world[0].copy()
    for _ in range(400):
        move_surface(surface, 1e-3)
    way = (
        0.02 * 0.3
        if not period
        else 0.02 * period / (2.0 * np.pi) * (1.0 - np.cos(2.0 * np.pi * 0.3 / period))
    )
    np.testing.assert_allclose(surface['place'] - before, [0.0, 0.0, -way], atol=3e-5)


@pytest.mark.parametrize(
    ('tool', 'frame'), [(False, 'wrist_point'), (True, 'tip_board')]
)
def test_push_moves_the_arm_while_it_lasts(make_plant, model, puma, tool, frame):
    """The momentum it leaves behind: M dqd = J^T F dt at the point pushed."""
    configured = (
        {}
        if tool
        else {
            'push_start': (0.1,),
            'push_duration': (0.02,),
            'push_force_world': (0.0, 0.0, 30.0),
        }
    )
    pushed, still = make_plant(**FREE, **configured), make_plant(**FREE)
    for tick in range(60):
        if tool and tick == 50:
            pushed.push([0.0, 0.0, 30.0], 0.02, tool=True)
        sample, reference = (p.step(p.initial_torque) for p in (pushed, still))
        assert tick >= 50 or (sample.qd == reference.qd).all()
    home = np.array(pushed.config.home)
    model.armature = np.array(puma.armature)
    expected = np.linalg.solve(
        pin.crba(model, model.createData(), home),
        frame_jacobian(model, home, frame)[:3].T @ [0.0, 0.0, 30.0 * 0.02],
    )
    np.testing.assert_allclose(
        sample.qd, expected, atol=0.02 * np.max(np.abs(expected))
    )
    after = pushed.step(pushed.initial_torque)
    np.testing.assert_allclose(
        after.qd, sample.qd, atol=0.02 * np.max(np.abs(expected))
    )


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_drives_without_commands_hold_where_they_are(make_plant, preset):
    plant = make_plant(preset)
    hold, torque = (
        PositionHold(plant.model),
        plant.initial_torque + [3.0, -3.0, 2.0, 0, 0, 0],
    )
    for _ in range(50):
        sample = plant.step(torque)
    begin = sample.q
    assert np.abs(sample.qd).max() > 0.02
    for _ in range(500):
        sample = plant.step(hold.holding_torque(sample.q, sample.qd))
    assert np.abs(sample.q - begin).max() < 0.01 and np.abs(sample.qd).max() < 0.005


@pytest.mark.parametrize('ticks', [0, 1, 5])
def test_command_for_sample_k_acts_from_k_plus_ticks(ticks):
    """A missing one is replaced by the one before."""
    delay = ActuatorDelay(ticks, np.full(2, -7.0))
    for tick in range(12):
        if tick != 8:
            delay.enter_command(tick, np.full(2, float(tick)))
        expected = tick - ticks if tick >= ticks else -7.0
        np.testing.assert_array_equal(
            delay.torque_for(tick), np.full(2, 7.0 if expected == 8 else expected)
        )
