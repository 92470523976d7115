"""Contacts that the noise of the wrist sensor hides, against drawn readings and by the units."""

from arms import controller_config
from multicontact_control.config import merge
from multicontact_control.contact.resolution import force_noise
from multicontact_control.contact.wrench import CONTACT_SPACE, measure_contacts
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import find_config_folder
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.signal import butter, lfilter

NOISE = np.repeat([0.05, 0.004], 3)  # the defaults [N, N m]

SPACE = np.zeros(1, dtype=CONTACT_SPACE)[0]


def pair(apart, degrees=0.0, **changes):
    """Return the configuration of two contacts of one tool, so far apart [m, deg]."""
    turn = np.radians(degrees)
    contacts = {
        'table': {
            'normal_world': [0.0, 0.0, -1.0],
            'point_operational': [0.0, 0.0, 0.214],
        },
        'board': {
            'normal_world': [np.sin(turn), 0.0, -np.cos(turn)],
            'point_operational': [apart, 0.0, 0.214],
        },
    }
    return controller_config(**merge({'contacts': contacts}, changes))


def controller(config):
    return Controller(config, RobotModel(config.robot, find_config_folder()))


@pytest.mark.parametrize('friction_std', [0.0, 0.5])
def test_force_noise_is_that_of_drawn_readings(friction_std):
    law = controller(
        pair(
            0.05,
            5.0,
            contacts={
                name: {'friction_std': friction_std} for name in ('table', 'board')
            },
        )
    )
    expected = force_noise(law.controls, law.contacts, NOISE)
    readings = NOISE * np.random.default_rng(0).standard_normal((4000, 6))
    controls = law.controls.copy()
    columns = law.contacts.copy()
    drawn = []
    controls['tool'] = 0
    for reading in readings:
        controls['wrench'] = reading
        assert measure_contacts(controls[0], columns, SPACE)
        drawn.append(columns['alpha_meas'].copy())
    assert_allclose(np.std(drawn, axis=0), expected, rtol=0.05)


@pytest.mark.parametrize(
    ('apart', 'degrees'), [(0.005, 0.0), (0.01, 0.0), (0.01, 1.0), (0.0, 1.0)]
)
def test_contacts_that_the_noise_hides_are_refused_with_the_figure(apart, degrees):
    config = pair(apart, degrees)
    with pytest.raises(
        ConfigError,
        match=(
            r'contacts: expected forces whose noise is at most 0.375 N, 1/4 of contact_state.'
            r'contact_threshold, got table [0-9.]+ N, board [0-9.]+ N; '
        ),
    ) as caught:
        controller(config)
    assert '\n' not in str(caught.value)
    # A sensor of a tenth of the noise tells them apart.
    fine = config.sensor.model_copy(
        update={'force_noise_std': 0.005, 'torque_noise_std': 4e-4}
    )
    assert all(
        each.suffices
        for each in controller(config.model_copy(update={'sensor': fine})).resolutions
    )


def test_contacts_far_enough_apart_are_accepted_and_their_noise_is_told():
    config = pair(0.03)
    loop = ControlLoop(config, None, CommandLimits(), find_config_folder())
    assert loop.remark.endswith('the noise of the sensor: table 0.17 N, board 0.163 N')
    # What cannot be read any more is refused live as well.
    contacts = {
        **config.contacts,
        'board': config.contacts['board'].model_copy(
            update={'point_operational': (0.004, 0.0, 0.214)}
        ),
    }
    with pytest.raises(ConfigError, match='forces whose noise'):
        loop.supervisor.controller.design(
            config.model_copy(update={'contacts': contacts})
        )


@pytest.mark.parametrize(
    ('half_length', 'accepted'), [(0.05, True), (0.01, True), (0.004, False)]
)
def test_couple_that_noise_would_lift_an_end_by_is_refused(half_length, accepted):
    config = controller_config(
        force={'allocation': 'decoupled'},
        contact_names=['table'],
        contacts={
            'table': {
                'type': 'edge',
                'half_length': half_length,
                'direction_operational': [0.0, 1.0, 0.0],
            }
        },
    )
    if accepted:
        deviation = controller(config).resolutions[1].noise
        assert deviation == pytest.approx(0.004 / half_length, rel=0.3)
    else:
        with pytest.raises(
            ConfigError, match='1/4 of .*smallest_force, got table/along'
        ):
            controller(config)


@pytest.mark.parametrize(('order', 'cutoff'), [(1, 40.0), (2, 40.0), (2, 125.0)])
def test_low_pass_leaves_a_share_of_the_noise(order, cutoff):
    sensor = controller_config().sensor.model_copy(
        update={'filter_order': order, 'filter_cutoff': cutoff}
    )
    noise = np.random.default_rng(1).standard_normal(100_000)
    filtered = lfilter(*butter(order, cutoff, fs=500.0), noise)
    assert sensor.noise_share(500.0) == pytest.approx(np.std(filtered), rel=0.02)
