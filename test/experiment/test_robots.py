"""Every robot in the loop, and what its surroundings may do to it."""

from multicontact_control.contact.surfaces import SLIDING_SPEED
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import run_in_process
from multicontact_control.experiment.scenario import plant_source, plants_of, resolve
from multicontact_control.experiment.summary import summarise
import numpy as np
import pytest
from robots import needs_mujoco, OTHERS, robot_parameters
from sim_bridge.robots import find_robot

DURATION = 9.5  # s, of `quick`, whose motion has been judged for 1 s then


def run(scenario, duration=DURATION, **options):
    setup = resolve(scenario, preset='best', duration=duration, **options)
    result = run_in_process(setup, supervised=True)
    summary = summarise(result.data, setup, mode='in_process', timing={},
                        ended_early=result.ended_early, events=result.events)
    assert summary['stable'], (summary['instabilities'], result.events[-3:])
    return result.data, list(summary['contacts'].values())


@pytest.mark.slow
@pytest.mark.parametrize('name', OTHERS)
def test_robot_presses_on_two_surfaces_and_slides_along_them(name):
    """Noisy sensor, rough surfaces with friction, rigid drives: 15 N on each."""
    data, contacts = run('quick', robot=name)
    assert data.q.shape[1] == len(find_robot(name).arm.links)
    for contact in contacts:
        assert contact['rest']['true_error_rms_n'] < 0.03
        assert contact['moving']['true_error_rms_n'] < 1.1
        assert contact['moving']['contact_loss_fraction'] == 0.0
        assert contact['step_rise_63_s'] < 0.06


@pytest.mark.slow
@pytest.mark.parametrize('name', ['panda', 'iiwa'])
def test_robot_with_flexible_drives_and_friction_presses_and_slides(name):
    _, contacts = run('quick', robot=name, plant='flexible')
    for contact in contacts:
        assert contact['rest']['true_error_rms_n'] < 0.15
        assert contact['moving']['true_error_rms_n'] < 1.2
        assert contact['moving']['contact_loss_fraction'] == 0.0


@needs_mujoco
@pytest.mark.slow
def test_engines_agree_in_the_loop_and_on_their_own_contacts():
    """The same surfaces give the same errors to some mN; the engine's own are smooth."""
    same = {'plant_overrides': {'engine': 'mujoco'}}
    native = {'plant_overrides': {'engine': 'mujoco', 'contact': 'native'}}
    (here, one), (there, other), (_, smooth) = (
        run('quick', robot='panda', **options) for options in ({}, same, native))
    np.testing.assert_allclose(here.q, there.q, atol=1e-3)
    for a, b, c in zip(one, other, smooth):
        for window in ('rest', 'moving'):
            assert a[window]['true_error_rms_n'] == pytest.approx(
                b[window]['true_error_rms_n'], abs=0.02)
        assert c['rest']['true_error_rms_n'] < 0.3 and c['moving']['true_error_rms_n'] < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(('scenario', 'largest'), [
    ('moving_surface', 1.5), ('curved', 2.0), ('tilt', 2.0)])
def test_surfaces_that_are_not_as_told_are_followed(scenario, largest):
    """Without losing the contact, and off by what tilt and friction take of 15 N at most."""
    _, contacts = run(scenario, robot='iiwa')
    for contact in contacts:
        assert contact['moving']['true_error_rms_n'] < largest
        assert contact['moving']['contact_loss_fraction'] == 0.0


@pytest.mark.parametrize('robot', robot_parameters(['puma', 'panda', 'iiwa', 'ur5']))
def test_untold_tilt_is_made_good_within_a_second_of_sliding_on_smooth_surfaces(robot):
    """20 degrees, which cost 0.9 N at rest; roughness alone would be 0.77 N in motion."""
    smooth = {name: {'roughness_std': 0.0} for name in ('table', 'board')}
    setup = resolve('tilt', robot=robot, plant='rigid', preset='best', duration=11.0,
                    plant_overrides={'surfaces': smooth})
    data = run_in_process(setup, supervised=True).data
    errors = data.alpha_true - 15.0
    speed = np.linalg.norm(np.gradient(data.position, setup.controller.period, axis=0), axis=1)
    sliding = np.flatnonzero((data.time > 6.5) & (speed > SLIDING_SPEED))[0]
    second = round(setup.controller.rate)
    assert np.abs(errors[sliding - second:sliding].mean(axis=0)).min() > 0.3
    assert np.sqrt((errors[sliding + second:] ** 2).mean(axis=0)).max() < 0.3


def test_plants_are_named_with_their_robot():
    assert plants_of() == ('rigid', 'puma')
    assert plant_source('flexible').name == plant_source('').name == 'puma'
    assert plants_of('panda') == ('panda/rigid', 'panda/flexible')
    assert plants_of('panda', ['rigid']) == ('panda/rigid',)
    assert plant_source('iiwa/rigid').robot.name == plant_source('', 'iiwa').robot.name == 'iiwa'
    assert plant_source('iiwa/rigid').name == 'iiwa/rigid'
    with pytest.raises(ConfigError, match='plant: expected one of rigid, flexible, or a path'):
        plant_source('puma', 'panda')
    with pytest.raises(ConfigError, match="robot: expected one of .*panda.*, found 'robbie'"):
        plant_source('rigid', 'robbie')


@pytest.mark.parametrize('name', robot_parameters(['panda', 'kinova']))
def test_written_configuration_of_another_robot_stands_alone(tmp_path, name):
    """URDF with the tool beside it, and the plant says whose it is."""
    from multicontact_control.config import ControllerConfig, read_parameters, validate
    from multicontact_control.dynamics.robot import RobotModel
    from sim_bridge.config import PlantConfig

    setup = resolve('quick', robot=name)
    files = setup.write(tmp_path)
    controller = validate(ControllerConfig, read_parameters(files['controller_node']))
    assert controller == setup.controller
    assert RobotModel(controller.robot, tmp_path).joint_count == len(find_robot(name).arm.links)
    assert validate(PlantConfig, read_parameters(files['sim_node'])).robot == name
