"""Every force law against its own equations, on the contact of eq. 32, and when it takes over."""

from dataclasses import asdict
from functools import cache
from itertools import product
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
from scipy.integrate import cumulative_trapezoid

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
    gains = {'law': law, 'damping_rate': 100.0, **force}
    return resolve('quick', controller={'force': gains}).controller


def linear_law(design, noise_variance=0.6):
    """Return a design as a linear law, which the AOB is once its gain has settled."""
    if isinstance(design, LinearLaw):
        return design
    return make_steady_law(design, solve_steady_gain(design, noise_variance))


def law_of(name, **force):
    config = config_of(name, **force)
    return linear_law(design_law(name, config.force, make_loop_model(config, K)))


def run_steps(law, inputs, extra, disturbance=0.0):
    """Return what the compiled law answers to alpha, alpha_des and speed, shape (3,) each."""
    record = law.record()[0]
    contact = np.zeros(1, dtype=CONTACT)[0]
    answer = contact['answer']
    outputs = []
    for values, late in zip(inputs, extra):
        contact['alpha_meas'], answer['alpha_des'], speed = values
        record['extra'] = late
        u = step_linear_law(record, contact, speed, disturbance, np.empty(MAX_STATES))
        outputs.append([u, float(answer['alpha_est']), float(record['p_est'])])
    return np.array(outputs)


@pytest.fixture
def inputs():
    """Return alpha, alpha_des and speed of 200 ticks, shape (200, 3)."""
    inputs = np.random.default_rng(3).standard_normal((200, 3))
    inputs *= [1.0, 0.0, 0.01]
    inputs += [10.0, 12.0, 0.0]
    return inputs


def integrate(values):
    """Return the integral up to every tick, by the trapezoidal rule."""
    return cumulative_trapezoid(values, dx=H, initial=0.0)


@pytest.mark.parametrize('name', LINEAR)
def test_compiled_law_is_its_matrices(name, inputs):
    law = law_of(name)
    extra = np.random.default_rng(5).standard_normal(len(inputs))
    extra[0] = 0.0
    outputs = run_steps(law, inputs, extra)
    x = law.start_force * inputs[0, 0]
    for output, y, late in zip(outputs, inputs, extra):
        x = x + law.E * late
        assert_allclose(output, law.C @ x + law.D @ y, rtol=1e-9, atol=1e-12)
        x = law.A @ x + law.B @ y


def test_pi_is_proportional_and_integral(inputs):
    law = law_of('pi', pi={'filter_cutoff': 0.0})
    outputs = run_steps(law, inputs, np.zeros(200))
    gain = 24.0 * 100.0 / K
    alphas, desired, _ = inputs.T
    error = desired - alphas
    # At the start only the force counts as known, and the command comes as a step.
    integral = integrate(error) + 0.5 * H * desired[0]
    expected = gain * (error + 5.0 * integral)
    assert_allclose(outputs[:, 0], expected, rtol=1e-9)


def test_impedance_is_a_spring_from_the_touch_on(inputs):
    outputs = run_steps(law_of('impedance'), inputs, np.zeros(200))
    alphas, desired, speeds = inputs.T
    depth = alphas[0] / K + integrate(speeds) + 0.5 * H * speeds[0]
    assert_allclose(outputs[:, 0], 900.0 * (desired / K - depth), rtol=1e-9)


def one_contact(desired):
    """Return the records of an active contact along z and its control; R = 0.6."""
    contacts = np.zeros(1, dtype=CONTACT)
    control = np.zeros(1, dtype=CONTROL)
    contacts['answer']['active'] = True
    contacts['answer']['alpha_des'] = desired
    contacts['N'] = np.eye(6)[2]
    contacts['noise_variance'] = 0.6
    contacts['mobility'] = 1.0
    control['measured'] = True
    return contacts, control


def hold(laws, ticks, state=None, known=0.0):
    """
    Let the laws of one contact hold 10 N on a delayed plant that 0.5 m/s^2 disturb.

    Of these so much is `known` from the motion before the touch.
    """
    contacts, control = one_contact(10.0)
    control['motion_observer']['disturbance'][0, 2] = known
    plant = make_delayed_plant(K, 100.0, DELAY, H)
    x = state
    if x is None:
        x = 10.0 * np.eye(len(plant.Gamma))[0]
    inputs = np.empty(1)
    forces = []
    for _ in range(ticks):
        contacts['alpha_meas'] = x[0]
        control['frame']['twist'][0, 2] = x[1] / K
        answer_contact_forces(laws, contacts, control[0], inputs, SPACE)
        x = plant.Phi @ x + plant.Gamma * (inputs[0] + 0.5)
        forces.append(x[0])
    return np.array(forces), x


def laws_of(name, **force):
    return make_force_laws(config_of(name, **force))[:1].copy()


@cache
def settled(name):
    """Return a law after 8 s of 0.5 m/s^2, its forces and the plant's state: not to be changed."""
    laws = laws_of(name)
    return laws, *hold(laws, 4000)


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
        *product(['aob'], INTEGRATING),
        *product(INTEGRATING[1:], ['dob']),
    ],
)
def test_law_that_takes_over_knows_force_and_disturbance(before, after):
    """At rest under a disturbance that by itself moves the force by more than half a newton."""
    laws, held, x = settled(before)
    new = laws_of(after)
    continue_laws(new, laws)
    forces, _ = hold(new, 500, state=x)
    assert np.abs(forces - held[-1]).max() < 0.4
    if after in ('pi', 'dob'):
        forces, _ = hold(laws_of(after), 500, state=x)
        assert np.abs(forces - held[-1]).max() > 0.5


@pytest.mark.parametrize('name', INTEGRATING)
def test_law_starts_from_what_disturbed_the_motion(name):
    forces, _ = hold(laws_of(name), 500, known=0.5)
    surprised, _ = hold(laws_of(name), 500)
    error = np.abs(forces - 10.0).max()
    assert error < 0.4
    assert error < 0.5 * np.abs(surprised - 10.0).max()


def estimate_disturbance(name, aware):
    """Return what a law takes for a disturbance where its whole answer is clipped [m/s^2]."""
    laws = laws_of(name)
    inputs = np.empty(1)
    contacts, control = one_contact(20.0)
    for _ in range(100):
        answer_contact_forces(laws, contacts, control[0], inputs, SPACE)
        if aware:
            add_extra_acceleration(laws[0], -inputs[0])
    law = laws[0]
    if law['is_linear']:
        return abs(law['linear']['p_est'])
    observer = law['observer']
    return abs(observer['x_est'][observer['design']['states'] - 1])


@pytest.mark.parametrize('name', ['aob', 'dob', 'lqg'])
def test_law_knows_what_acts_beyond_its_answer(name):
    assert estimate_disturbance(name, aware=True) < 0.02
    assert estimate_disturbance(name, aware=False) > 0.1


def radius(law, model, ratio=1.0):
    return spectral_radius(closed_loop_matrix(law, model, ratio))


WITH_MARGINS = [name for name in FORCE_LAWS if name != 'feedforward']


@pytest.mark.parametrize('name', WITH_MARGINS)
def test_gain_margin_is_where_the_loop_becomes_unstable(name):
    law = law_of(name)
    model = make_loop_model(config_of(name), K)
    _, stiffest = find_stable_ratios(law, model)
    if np.isinf(stiffest):
        return
    assert radius(law, model, 0.98 * stiffest) < 1.0
    assert radius(law, model, 1.02 * stiffest) > 1.0
    if (
        name != 'impedance'
    ):  # it reads the speed, which does not grow with the stiffness
        assert find_margins(law, model).gain == pytest.approx(stiffest, rel=0.01)


@pytest.mark.parametrize('name', WITH_MARGINS)
@pytest.mark.parametrize(('share', 'stable'), [(0.97, True), (1.03, False)])
def test_delay_margin_is_where_the_loop_becomes_unstable(name, share, stable):
    law = law_of(name)
    margins = find_margins(law, make_loop_model(config_of(name), K))
    delay = DELAY + share * margins.delay
    if delay > 10 * H:
        return
    late = make_loop_model(config_of(name, input_delay=delay), K)
    assert (radius(law, late) < 1.0 + 1e-9) == stable


@cache
def design_of(name):
    """Return the design of a law for 2000 to 8000 N/m, with R = 2."""
    return design_for_range(
        name, stiffness=(2000.0, 8000.0), input_delay=DELAY, noise_variance=2.0
    )


@pytest.mark.parametrize('name', FORCE_LAWS)
def test_design_for_a_range_has_its_margins_on_every_surface(name):
    ranged = design_of(name)
    force = ForceConfig(**ranged.values)
    config = resolve('quick').controller.model_copy(update={'force': force})
    model = make_loop_model(config, ranged.stiffness)
    law = linear_law(design_law(name, force, model), 2.0)
    for stiffness in (2000.0, 4000.0, 8000.0, 15900.0):
        assert radius(law, make_loop_model(config, stiffness)) < 1.0 + 1e-9
    late = force.model_copy(update={'input_delay': DELAY + 0.99 * H})
    model = make_loop_model(config.model_copy(update={'force': late}), 8000.0)
    assert radius(law, model) < 1.0 + 1e-9


@pytest.mark.parametrize('name', FORCE_LAWS)
def test_design_for_a_range_is_read_back_from_its_file(tmp_path, name):
    """A law knows no contacts: their stiffness is in a setting beside its file."""
    ranged = design_of(name)
    path = tmp_path / 'law.yaml'
    write_design(ranged, path)
    stiffness = pytest.approx(ranged.stiffness, abs=0.5)
    for text in (describe_design(ranged), path.read_text()):
        _, setting = shlex.split(re.search(r"--set '[^']+'", text)[0])
        options = SetupOptions(scenario='quick', preset=str(path), settings=[setting])
        read = options.setup().controller
        assert read.force == ForceConfig(**ranged.values)
        for contact in read.contacts.values():
            assert contact.stiffness == stiffness


def test_every_law_has_ranges_to_tune_it_in_and_a_preset():
    names = set(FORCE_LAWS)
    folder = find_config_folder()
    assert read_yaml(folder / 'tuning.yaml').keys() == names
    presets = {path.stem for path in (folder / 'presets/laws').glob('*.yaml')}
    assert presets == names - {'aob'}  # `paper`, `best`, `adaptive`


@pytest.mark.parametrize('name', FORCE_LAWS)
def test_design_depends_on_the_gains_that_its_law_says_it_reads_and_on_no_others(name):
    config = config_of(name)
    model = make_loop_model(config, K)
    before = design_law(name, config.force, model)
    for field, other in OTHER_GAINS.items():
        force = config.force.model_copy(update={field: other})
        law = find_law(name)
        design = design_law(name, force, model)
        assert (design is before) == (field not in law.reads), field
        assert_equal(asdict(design), asdict(law.design(model, force)))


def test_live_change_of_what_adaptive_limits_do_not_read_computes_none_anew():
    config = resolve('quick', preset='adaptive').controller
    laws = make_force_laws(config)
    known = find_largest_stiffness_ratio.cache_info().misses
    for field in set(OTHER_GAINS) - set(find_law('aob').reads):
        force = config.force.model_copy(update={field: OTHER_GAINS[field]})
        make_force_laws(config.model_copy(update={'force': force}))
    assert find_largest_stiffness_ratio.cache_info().misses == known
    read = {'time_constant': OTHER_GAINS['time_constant']}
    force = config.force.model_copy(update=read)
    changed = make_force_laws(config.model_copy(update={'force': force}))
    limits = changed['stiffness']['config']['ratio_limit']
    assert (limits != laws['stiffness']['config']['ratio_limit']).all()
