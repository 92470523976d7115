"""Edges, planes, moving and tilted surfaces: what the force loops make of them, in simulation."""

from canonical_runs import run_of
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_series import rms_within
from multicontact_control.judging.verdict import judge_run, STABLE
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_allclose
import pytest

pytestmark = pytest.mark.slow

H = 0.002
FRICTION = 0.1  # of the simulated surfaces


@pytest.mark.parametrize(
    ('scenario', 'plant', 'bound'),
    [('edge', 'rigid', 1.0), ('edge', 'puma', 1.0), ('plane', 'puma', 1.5)],
)
def test_forces_and_couples_are_kept_at_rest_and_while_sliding(scenario, plant, bound):
    setup = resolve(scenario, plant=plant, seed=1, duration=13.0)
    data = run_of(setup).data
    metrics = RunMetrics(data, setup)
    assert judge_run(metrics, mode='in_process', events=()).name == STABLE
    for contact in metrics.contacts:
        assert rms_within(metrics.windows.rest, contact.error) < 0.2
        assert rms_within(metrics.windows.moving, contact.error) < bound
        assert contact.losses == []
    # the couple of 3 N has moved the centre of pressure: a fifth of the half length
    held = (data.time > 6.5) & (data.time < 7.5)
    assert data.alpha_true[held, 1].mean() == pytest.approx(3.0, abs=0.1)


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def rest(loop, k):
    """Let nothing happen to the surfaces."""


def press(
    changes,
    *,
    ticks,
    disturb=rest,
    surfaces=None,
    names=('table', 'board'),
    motion=None,
):
    """Return the contacts, and the error of the last one's true force at every tick [N]."""
    names = list(names)
    steps = [{'time': 2.0, 'forces': dict.fromkeys(names, 15.0)}]
    setup = resolve(
        'quick',
        plant='rigid',
        duration=20.0,
        controller={'contact_names': names, 'contacts': changes},
        noise_estimator={'contact_names': names},
        plant_overrides={'contact_names': names, 'surfaces': surfaces or {}},
        scenario_overrides={'reference': {'force_steps': steps, 'motion': motion}},
    )
    loop = ClosedLoop(setup)
    errors = []
    for k in range(ticks):
        disturb(loop, k)
        loop.advance()
        errors.append(loop.sample.contact_force[-1] - 15.0)
    return loop.control.supervisor.controller.contacts, np.array(errors)


def test_a_moving_surface_is_pressed_as_one_that_rests():
    """
    Half a second after it has begun to move at 2 cm/s, or turned, with the friction configured.

    Forces along the line between both contacts, near the board's normal, no wrist sensor feels.
    """

    def receding(loop, k):
        if 3.0 < k * H <= 4.0:
            loop.plant.contacts.shift_surface(1, 0.02 * H)
        elif k * H > 4.0:
            loop.plant.contacts.shift_surface(1, -0.02 * H)

    settings = {
        'table': {'friction_coefficient': FRICTION},
        'board': {'friction_coefficient': FRICTION, 'surface_speed_limit': 0.1},
    }
    contacts, errors = press(settings, ticks=2500, disturb=receding)
    assert rms(errors[1750:2000]) < 0.3
    assert rms(errors[2250:2500]) < 0.3
    # The table's speed is not asked for.
    assert_allclose(contacts['surface_speed_est'], [0.0, -0.02], atol=2e-3)
    _, bare = press({}, ticks=2000, disturb=receding)
    assert rms(bare[1750:]) > 1.0


@pytest.mark.parametrize(
    ('degrees', 'limit', 'expected'),
    [(20.0, {}, 20.0), (30.0, {'normal_range': 0.2}, np.degrees(0.2))],
)
def test_unknown_tilt_is_followed_while_sliding_within_its_range(
    degrees, limit, expected
):
    tilt = np.radians(degrees)
    surface = {'table': {'normal_world': [np.sin(tilt), 0.0, -np.cos(tilt)]}}
    motion = {'start_time': 2.5, 'amplitude': 0.1, 'period': 6.0, 'blend_time': 1.0}
    contacts, errors = press(
        {'table': {'friction_std': 3.0, 'normal_turn_rate': 3.0, **limit}},
        ticks=3200,
        surfaces=surface,
        names=['table'],
        motion=motion,
    )
    normal = contacts['normal'][0]
    found = np.degrees(np.arctan2(normal[0], -normal[2]))
    assert found == pytest.approx(expected, abs=1.0)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    if not limit:
        without_roughness = np.convolve(errors[2100:], np.full(25, 1 / 25), 'valid')
        assert rms(without_roughness) < 0.3
        untold = {'table': {'friction_std': 3.0}}
        _, bare = press(untold, ticks=1250, surfaces=surface, names=['table'])
        assert bare[-100:].mean() > 0.8


def test_centres_of_pressure_follow_the_force_and_stay_inside():
    loop = ClosedLoop(resolve('edge', plant='rigid'), commanded=True)
    loop.advance()
    loop.control.set_forces({'edge': 10.0}, {'edge/along': 0.01})
    for _ in range(1400):
        loop.advance()
    force, couple = loop.sample.contact_force
    assert 0.05 * couple / force == pytest.approx(0.01, abs=5e-4)
    loop.control.set_forces({'edge': 20.0})
    for _ in range(300):
        loop.advance()
    assert_allclose(loop.sample.contact_force, [20.0, 4.0], atol=0.3)
    loop.control.set_forces({'edge': 5.0})  # 4 N of its couple would be too much there
    kept_inside = {'edge': 5.0, 'edge/along': 1.0}
    assert loop.control.commanded_forces == pytest.approx(kept_inside)
