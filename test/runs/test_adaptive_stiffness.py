"""The presets `best` and `adaptive` on surfaces whose stiffness the controller is not told."""

from canonical_runs import run_of, summary_of
from multicontact_control.runs.closed_loop import run_in_process
from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_allclose
import pytest

pytestmark = pytest.mark.slow

STEPS = ((2.0, 10.0), (3.5, 15.0))
# The arm gives way at the board's tip, in series with the surface: about 47 kN/m on `puma`.
ARM = {'rigid': np.inf, 'puma': 47e3}


def setup_of(plant, stiffness, seed, *, preset='adaptive', duration=5.0, motion=False):
    steps = []
    for time, force in STEPS:
        steps.append({'time': time, 'forces': {'table': force, 'board': force}})
    reference = {'force_steps': steps}
    if not motion:
        reference['motion'] = None
    surface = {'stiffness': stiffness}
    return resolve(
        'quick',
        plant=plant,
        seed=seed,
        preset=preset,
        plant_overrides={'surfaces': {'table': surface, 'board': surface}},
        scenario_overrides={'duration': duration, 'reference': reference},
    )


def longest_gap(data, contact):
    """Return the longest time that a contact was lost after its first touch [s]."""
    touched = np.flatnonzero(data.alpha_true[:, contact] > 0.0)
    return np.diff(touched).max() / data.rate


def largest_rms(error):
    """Return that of the contact with the largest [N]."""
    return np.sqrt((error**2).mean(axis=0)).max()


@pytest.mark.parametrize(
    ('plant', 'stiffness'),
    [('rigid', 300.0), ('puma', 300.0), ('rigid', 30_000.0), ('puma', 30_000.0)],
)
def test_adaptive_steps_are_the_same_on_every_surface(plant, stiffness):
    """Over 100:1 without a parameter changed; the first step may still be learning."""
    setup = setup_of(plant, stiffness, seed=31)
    data = run_of(setup).data
    contacts = summary_of(setup)['contacts']
    slowest = 0.07
    if stiffness < 1000.0:
        slowest = 0.13
    series = 1.0 / (1.0 / stiffness + 1.0 / ARM[plant])
    felt = {'table': stiffness, 'board': series}
    rest = slice(round(4.5 * data.rate), None)
    for contact, name in enumerate(data.contact_names):
        first, second = contacts[name]['steps']
        assert second['rise_63_s'] <= slowest
        assert second['overshoot_percent'] < 15.0
        assert first['rise_63_s'] < 0.3
        estimated = data.stiffness_est[rest, contact][0]
        assert estimated == pytest.approx(felt[name], rel=0.2)
        assert data.stiffness_std[rest, contact][0] < 0.2 * felt[name]
        assert data.margin[rest, contact][0] > 1.0
        used = data.stiffness[rest, contact]
        assert_allclose(used, used[0], rtol=0.004)  # no drift
        assert longest_gap(data, contact) <= 0.06


def test_friction_of_the_joints_does_not_open_a_hard_contact():
    """A slip by 33 um is 2 N there; the paper's law integrates against stiction, and slips."""

    def longest_opening(preset):
        data = run_of(setup_of('puma', 60_000.0, 1, preset=preset, duration=3.5)).data
        touched = np.maximum.accumulate(data.alpha_true > 1.0)
        opened = touched & (data.alpha_true < 0.2)
        return np.count_nonzero(opened, axis=0).max() / data.rate

    assert longest_opening('best') <= 0.01
    assert longest_opening('adaptive') <= 0.01
    assert longest_opening('paper') > 0.1


def test_adaptive_crosses_a_border_between_soft_and_hard_while_sliding():
    """1000 to 30 000 N/m within 2 mm of sliding, and back."""
    borders = {9.5: 30.0, 11.5: 1.0 / 30.0}

    def disturb(loop):
        for begin, factor in borders.items():
            if 0 <= loop.tick - round(begin * 500.0) < 10:
                for contact in (0, 1):
                    loop.plant.contacts.scale_stiffness(contact, factor**0.1)

    setup = setup_of('puma', 1000.0, seed=33, duration=13.0, motion=True)
    data = run_in_process(setup, supervised=True, disturb=disturb).data
    for begin, end in ((9.8, 11.5), (11.8, 13.0)):
        window = (data.time >= begin) & (data.time < end)
        assert largest_rms(data.alpha_true[window] - 15.0) < 2.0
    assert (data.alpha_true[data.time > 9.0] > 0.0).all()


@pytest.mark.parametrize('ratio', [0.05, 20.0])
def test_best_does_not_oscillate_however_wrong_its_stiffness(ratio):
    """At rest; a step on a surface that is far too stiff throws the tip back, for a moment."""
    setup = setup_of('puma', ratio * 6000.0, seed=36, preset='best', duration=5.5)
    data = run_of(setup).data
    assert largest_rms(data.alpha_true[data.time > 4.5] - 15.0) < 0.3
    pressed = data.part(round(1.7 * data.rate), data.ticks)
    for contact in (0, 1):
        assert longest_gap(pressed, contact) < 0.07
        assert pressed.alpha_true[-1, contact] > 0.0
