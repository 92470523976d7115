"""Every force law against its own equations, on the contact of eq. 32, and when it takes over."""

from dataclasses import asdict
from functools import cache
import re
import shlex

from multicontact_control.cli.options import SetupOptions
from multicontact_control.commissioning.law_report import (
    closed_loop_matrix,
    describe_design,
    design_for_range,
    find_margins,
    find_stable_ratios,
    write_design,
)
from multicontact_control.config import ForceConfig, read_yaml
from multicontact_control.config.force import (
    AdmittanceConfig,
    DobConfig,
    ImpedanceConfig,
    LqgConfig,
    PiConfig,
)
from multicontact_control.force.force_law import (
    add_extra_acceleration,
    answer_contact_forces,
    continue_laws,
    design_law,
    find_largest_stiffness_ratio,
    FORCE_SPACE,
    make_force_laws,
    make_loop_model,
    step_linear_law,
)
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.laws.design import find_law
from multicontact_control.force.laws.linear import LinearLaw
from multicontact_control.force.margins import spectral_radius
from multicontact_control.force.observer import solve_steady_gain
from multicontact_control.force.plant import make_delayed_plant
from multicontact_control.paths import find_config_folder
from multicontact_control.records import CONTACT, CONTROL, MAX_STATES
from multicontact_control.registry import FORCE_LAWS
from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_allclose, assert_equal
import pytest

H, K, DELAY = 0.002, 6000.0, 0.006
SPACE = np.zeros(1, dtype=FORCE_SPACE)[0]
LINEAR = [name for name in FORCE_LAWS if name != 'aob']
OTHER_GAINS = {
    'time_constant': 0.031,
    'second_pole_ratio': 1.7,
    'active_state_order': 2,
    'process_noise': 2.3e-3,
    'fed_forward': 'estimate',
    'pi': PiConfig(bandwidth=11.0, integral_rate=3.0, filter_cutoff=19.0),
    'dob': DobConfig(observer_bandwidth=31.0, bandwidth=17.0),
    'lqg': LqgConfig(noise_variance=1.3, input_weight=2.0),
    'admittance': AdmittanceConfig(
        bandwidth=13.0, inertia_time=0.007, integral_rate=3.0
    ),
    'impedance': ImpedanceConfig(natural_frequency=21.0),
}
INTEGRATING = ('aob', 'pi', 'dob', 'lqg', 'admittance')


def config_of(law, **force):
    return resolve(
        'quick', controller={'force': {'law': law, 'damping_rate': 100.0, **force}}
    ).controller


def law_of(name, **force):
    config = config_of(name, **force)
    design = design_law(name, config.force, make_loop_model(config, K))
    return (
        design
        if isinstance(design, LinearLaw)
        else make_steady_law(design, solve_steady_gain(design, 0.6))
    )


def run_steps(law, alphas, desired, speeds, extra=None):
    """Return what the compiled law answers to series."""
    record = law.record()[0]
    contact = np.zeros(1, dtype=CONTACT)[0]
    answers = []
    for k, values in enumerate(zip(alphas, desired, speeds)):
        contact['alpha_meas'], contact['answer']['alpha_des'] = values[:2]
        if k and extra is not None:
            record['extra'] = extra[k - 1]
        u = step_linear_law(record, contact, values[2], np.empty(MAX_STATES))
        answers.append(
            (u, float(contact['answer']['alpha_est']), float(record['p_est']))
        )
    return np.array(answers)


def series(seed=3, count=200):
    random = np.random.default_rng(seed)
    return (
        10.0 + random.standard_normal(count),
        np.full(count, 12.0),
        0.01 * random.standard_normal(count),
    )


@pytest.mark.parametrize('name', LINEAR)
def test_compiled_law_is_its_matrices(name):
    law = law_of(name)
    alphas, desired, speeds = series()
    extra = np.random.default_rng(5).standard_normal(len(alphas))
    outputs = run_steps(law, alphas, desired, speeds, extra)
    x = law.start_force * alphas[0]
    for k, y in enumerate(zip(alphas, desired, speeds)):
        x = x + (law.E * extra[k - 1] if k else 0.0)
        assert_allclose(outputs[k], law.C @ x + law.D @ y, rtol=1e-9, atol=1e-12)
        x = law.A @ x + law.B @ y


def test_pi_is_proportional_and_integral():
    alphas, desired, speeds = series()
    outputs = run_steps(
        law_of('pi', pi={'filter_cutoff': 0.0}), alphas, desired, speeds
    )[:, 0]
    gain = 24.0 * 100.0 / K
    error = desired - alphas
    integral = np.concatenate([[0.0], np.cumsum(0.5 * H * (error[1:] + error[:-1]))])
    # At the start only the force counts as known, and the command comes as a step.
    expected = gain * error + 5.0 * gain * (integral + 0.5 * H * desired[0])
    assert_allclose(outputs, expected, rtol=1e-9)


def test_impedance_is_a_spring_from_the_touch_on():
    alphas, desired, speeds = series()
    outputs = run_steps(law_of('impedance'), alphas, desired, speeds)[:, 0]
    depth = (
        alphas[0] / K
        + np.concatenate([[0.0], np.cumsum(0.5 * H * (speeds[1:] + speeds[:-1]))])
        + 0.5 * H * speeds[0]
    )
    assert_allclose(outputs, 900.0 * (desired / K - depth), rtol=1e-9)


def one_contact(desired):
    """Return the records of an active contact along z and its control; R = 0.6."""
    contacts = np.zeros(1, dtype=CONTACT)
    control = np.zeros(1, dtype=CONTROL)
    contacts['answer']['active'], contacts['N'] = True, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    contacts['noise_variance'], contacts['answer']['alpha_des'] = 0.6, desired
    control['measured'], contacts['mobility'] = True, 1.0
    return contacts, control


def hold(laws, ticks, *, disturbance, desired=10.0, state=None):
    """Let the compiled laws of one contact hold a force on a delayed plant."""
    contacts, control = one_contact(desired)
    plant = make_delayed_plant(K, 100.0, DELAY, H)
    x = desired * np.eye(len(plant.Gamma))[0] if state is None else state
    inputs = np.empty(1)
    forces = []
    for _ in range(ticks):
        contacts['alpha_meas'] = x[0]
        control['frame']['twist'][0, 2] = x[1] / K
        answer_contact_forces(laws, contacts, control[0], inputs, SPACE)
        x = plant.Phi @ x + plant.Gamma * (inputs[0] + disturbance)
        forces.append(x[0])
    return np.array(forces), x


def laws_of(name, **force):
    return make_force_laws(config_of(name, **force))[:1].copy()


@cache
def settled(name):
    """Return a law after 8 s of 0.5 m/s^2, its forces and the plant's state: not to be changed."""
    laws = laws_of(name)
    return laws, *hold(laws, 4000, disturbance=0.5)


@pytest.mark.parametrize('name', FORCE_LAWS)
def test_law_compensates_a_constant_disturbance_if_it_integrates(name):
    """0.5 m/s^2 shift the force of a law without integration by a known amount."""
    _, forces, _ = settled(name)
    if name in INTEGRATING:
        assert abs(forces[-1] - 10.0) < 0.02
    elif name == 'impedance':
        assert forces[-1] == pytest.approx(10.0 + K * 0.5 / 900.0, abs=0.01)
    else:
        assert forces[-1] > 100.0  # it has nothing to hold the contact with


@pytest.mark.parametrize(
    ('before', 'after'),
    [
        *(('aob', after) for after in INTEGRATING),
        *((before, 'dob') for before in INTEGRATING[1:]),
    ],
)
def test_law_that_takes_over_knows_force_and_disturbance(before, after):
    """At rest under a disturbance that by itself moves the force by more than half a newton."""
    laws, before_it, x = settled(before)
    new = laws_of(after)
    unaware = laws_of(after)
    continue_laws(new, laws)
    forces, _ = hold(new, 500, disturbance=0.5, state=x)
    assert np.abs(forces - before_it[-1]).max() < 0.4
    if after in ('pi', 'dob'):
        forces, _ = hold(unaware, 500, disturbance=0.5, state=x)
        assert np.abs(forces - before_it[-1]).max() > 0.5


@pytest.mark.parametrize('name', ['aob', 'dob', 'lqg'])
def test_law_knows_what_acts_beyond_its_answer(name):
    estimates = []
    for aware in (True, False):
        laws = laws_of(name)
        inputs = np.empty(1)
        (contacts, control) = one_contact(20.0)
        for _ in range(100):  # everything is clipped: nothing moves
            answer_contact_forces(laws, contacts, control[0], inputs, SPACE)
            if aware:
                add_extra_acceleration(laws, np.array([True]), -inputs)
        part = (
            laws[0]['linear']['p_est']
            if laws['is_linear'][0]
            else (
                laws[0]['observer']['x_est'][
                    laws[0]['observer']['design']['states'] - 1
                ]
            )
        )
        estimates.append(abs(float(part)))
    assert estimates[0] < 0.02 < 0.1 < estimates[1]


@pytest.mark.parametrize('name', [name for name in FORCE_LAWS if name != 'feedforward'])
def test_margins_are_where_the_loop_becomes_unstable(name):
    config = config_of(name)
    law = law_of(name)
    model = make_loop_model(config, K)
    margins = find_margins(law, model)
    (_, stiffest) = find_stable_ratios(law, model)
    if np.isfinite(stiffest):
        assert spectral_radius(closed_loop_matrix(law, model, 0.98 * stiffest)) < 1.0
        assert spectral_radius(closed_loop_matrix(law, model, 1.02 * stiffest)) > 1.0
        if (
            name != 'impedance'
        ):  # which reads the speed, that does not grow with the stiffness
            assert margins.gain == pytest.approx(stiffest, rel=0.01)
    for share, stable in ((0.97, True), (1.03, False)):
        delay = DELAY + share * margins.delay
        if delay > 10 * H:
            continue
        late = make_loop_model(config_of(name, input_delay=delay), K)
        assert (spectral_radius(closed_loop_matrix(law, late)) < 1.0 + 1e-9) == stable


@pytest.mark.parametrize('name', FORCE_LAWS)
def test_design_for_a_range_has_its_margins_on_every_surface_and_its_file_is_read(
    tmp_path, name
):
    """A law knows no contacts: their stiffness is in a setting beside its file."""
    result = design_for_range(
        name, stiffness=(2000.0, 8000.0), input_delay=DELAY, noise_variance=2.0
    )
    force = ForceConfig(**result.values)
    config = resolve('quick').controller.model_copy(update={'force': force})
    design = design_law(name, force, make_loop_model(config, result.stiffness))
    law = (
        design
        if isinstance(design, LinearLaw)
        else make_steady_law(design, solve_steady_gain(design, 2.0))
    )
    for stiffness in (2000.0, 4000.0, 8000.0, 15900.0):
        model = make_loop_model(config, stiffness)
        assert spectral_radius(closed_loop_matrix(law, model)) < 1.0 + 1e-9
    late = make_loop_model(
        config.model_copy(
            update={'force': force.model_copy(update={'input_delay': DELAY + 0.99 * H})}
        ),
        8000.0,
    )
    assert spectral_radius(closed_loop_matrix(law, late)) < 1.0 + 1e-9
    path = tmp_path / 'law.yaml'
    write_design(result, path)
    for text in (describe_design(result), path.read_text()):
        _, setting = shlex.split(re.search(r"--set '[^']+'", text)[0])
        read = SetupOptions(
            scenario='quick', preset=str(path), settings=[setting]
        ).setup()
        assert read.controller.force == force
        assert [
            x.stiffness for x in read.controller.contacts.values()
        ] == pytest.approx([result.stiffness] * 2, abs=0.5)


def test_every_law_has_ranges_to_tune_it_in_and_a_preset():
    names = set(FORCE_LAWS)
    assert set(read_yaml(find_config_folder() / 'tuning.yaml')) == names
    presets = {
        path.stem for path in (find_config_folder() / 'presets/laws').glob('*.yaml')
    }
    assert presets == names - {'aob'}  # `paper`, `best`, `adaptive`


@pytest.mark.parametrize('name', FORCE_LAWS)
def test_design_depends_on_the_gains_that_its_law_says_it_reads_and_on_no_others(name):
    config = config_of(name)
    model = make_loop_model(config, K)
    before = design_law(name, config.force, model)
    for field, other in OTHER_GAINS.items():
        force = config.force.model_copy(update={field: other})
        direct = find_law(name).design(model, force)
        design = design_law(name, force, model)
        assert (design is before) == (field not in find_law(name).reads), field
        assert_equal(asdict(design), asdict(direct))


def test_live_change_of_what_adaptive_limits_do_not_read_computes_none_anew():
    config = resolve('quick', preset='adaptive').controller
    laws = make_force_laws(config)
    known = find_largest_stiffness_ratio.cache_info().misses
    for field in set(OTHER_GAINS) - set(find_law('aob').reads):
        force = config.force.model_copy(update={field: OTHER_GAINS[field]})
        make_force_laws(config.model_copy(update={'force': force}))
    assert find_largest_stiffness_ratio.cache_info().misses == known
    force = config.force.model_copy(
        update={'time_constant': OTHER_GAINS['time_constant']}
    )
    limits = make_force_laws(config.model_copy(update={'force': force}))['stiffness'][
        'config'
    ]
    assert (limits['ratio_limit'] != laws['stiffness']['config']['ratio_limit']).all()
