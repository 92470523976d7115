"""Surfaces as stiff as steel: how they are met, and how a contact comes back that bounced."""

from contextlib import closing

from multicontact_control.config.supervision import ContactStateConfig
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision import contacts
import numpy as np
import pytest
from robots import robot_parameters

STEEL = 1e6  # N/m
SMOOTH = 2.4e-7  # m, of which 0.24 N of roughness come
FORCE = 10.0  # N
SETTINGS = contacts.contact_settings(ContactStateConfig(), 0.002)[0]


def contact_of(**values):
    contact = np.array([contacts.FREE_CONTACT])
    for name, value in values.items():
        contact[name] = value
    return contact[0]


def press(controller, surface, **arguments):
    """Return the forces of 5 s on a table [N]."""
    table = {'contact_names': ['table']}
    setup = resolve(
        'one_contact',
        noise_estimator=table,
        controller={**table, **controller},
        plant_overrides={**table, 'surfaces': {'table': surface}},
        **arguments,
    )
    with closing(ClosedLoop(setup, commanded=True)) as loop:
        for _ in range(50):
            loop.advance()
        loop.control.set_forces({'table': FORCE})
        forces = []
        for _ in range(2500):
            loop.advance()
            forces.append(loop.sample.contact_force[0])
    return np.array(forces)


@pytest.mark.slow
@pytest.mark.parametrize('robot', robot_parameters(['puma', 'panda', 'iiwa', 'ur5']))
def test_steel_that_the_controller_is_told_of_is_met_and_held_within_a_few_newtons(
    robot,
):
    forces = press(
        {'contacts': {'table': {'stiffness': STEEL}}},
        {'stiffness': STEEL, 'roughness_std': SMOOTH},
        robot=robot,
        plant='rigid',
    )
    assert forces.max() < FORCE + 10.0
    np.testing.assert_allclose(forces[-300:], FORCE, atol=1.0)


@pytest.mark.parametrize('preset', ['best', 'adaptive'])
def test_steel_that_is_not_told_of_is_held_without_swinging_if_it_is_approached_slowly(
    preset,
):
    """170 times as stiff as the model, on flexible drives with friction."""
    forces = press(
        {'contact_state': {'approach_speed': 0.005}},
        {'stiffness': STEEL},
        plant='puma',
        preset=preset,
    )
    np.testing.assert_allclose(forces[-500:].mean(), FORCE, atol=0.3)
    assert forces[-500:].std() < 0.3


@pytest.mark.parametrize(
    ('stiffness', 'mobility', 'speed'),
    [(6000.0, 0.1, 0.02), (1e6, 0.16, 0.004), (1e6, 0.04, 0.002)],
)
def test_approach_is_as_slow_as_a_touch_of_ten_newtons_asks_for(
    stiffness, mobility, speed
):
    contact = contact_of(stiffness=stiffness)
    assert contacts.limit_approach_speed(contact, SETTINGS, mobility) == pytest.approx(
        speed
    )
    assert speed * np.sqrt(stiffness / mobility) <= 10.0 + 1e-9


def test_approach_has_its_speed_before_the_law_has_been_asked():
    assert (
        contacts.limit_approach_speed(contact_of(stiffness=STEEL), SETTINGS, 0.0)
        == 0.02
    )


@pytest.mark.parametrize(('below', 'bound'), [(0.0, 0.0), (0.004, 0.05), (-0.05, 0.05)])
def test_contact_that_is_not_felt_returns_no_faster_than_it_may_touch(below, bound):
    """And than a surface within `normal_range` falls away where it slides."""
    contact = contact_of(
        state=contacts.HOLDING,
        answered=True,
        time_below_threshold=below,
        approach_speed=0.02,
    )
    assert contacts.bound_contact_speed(contact, 0.03) == pytest.approx(bound)


@pytest.mark.parametrize(('felt', 'rises'), [(2.0, True), (8.0, False)])
def test_force_after_a_loss_rises_unless_more_is_felt_than_it_asks_for(felt, rises):
    contact = contact_of(
        state=contacts.HOLDING,
        wanted=True,
        answered=True,
        losses=1,
        surface_displacement=0.0,
        alpha_task=FORCE,
        force_limit=2.0,
        mean_force=felt,
        stiffness=6000.0,
        approach_speed=0.02,
    )
    contacts.advance_contact(contact, SETTINGS, felt, 0.0, 0.0, 0.0)
    assert (contact['force_limit'] > 2.0) == rises
