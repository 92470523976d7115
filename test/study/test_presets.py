"""What kinds of studies have beside their file, against simulations and by hand."""

import math

from multicontact_control.cli.options import describe_files
from multicontact_control.commissioning.arm_loop import ArmLoop
from multicontact_control.config import read_yaml
from multicontact_control.errors import ConfigError
from multicontact_control.faults.vocabulary import FAULTS
from multicontact_control.force.noise.window import design_lead_filter
from multicontact_control.paths import find_config_folder
from multicontact_control.registry import FORCE_LAWS, NOISE_ESTIMATORS
from multicontact_control.runs.closed_loop import run_in_process
from multicontact_control.runs.scenario import resolve
from multicontact_control.study.cells import plan_runs
from multicontact_control.study.config import apply_choices, read_study
from multicontact_control.study.measure import measure_run, metrics_row
from multicontact_control.study.presets import make_study, situations
from multicontact_control.study.presets.compare import CompareStudy
from multicontact_control.study.presets.faults import FaultJob
from multicontact_control.study.presets.tune import cost_of_run, SCALES
from multicontact_control.study.study import Results, run_study
import pandas as pd
import pytest
from rich.console import Console

QUIET = Console(quiet=True)


def study(name, law='', **choices):
    config = read_study(name).model_copy(update={'law': law})
    return make_study(apply_choices(config, choices))


# Runs of a quick study on rigid drives.
QUICK_RUNS = {'compare': 18, 'laws': 45, 'map': 64, 'delay': 14, 'faults': 12}


def test_studies_of_the_package_are_read_and_named_where_one_is_misspelt():
    names = describe_files('studies')
    assert {*QUICK_RUNS, 'robots', 'tune', 'stiffness', 'situations'} <= {*names}
    for name in names:
        assert read_study(name).name == name
    expected = ', '.join(names)
    with pytest.raises(ConfigError, match=f'^study: expected one of {expected}'):
        read_study('stifness')


@pytest.mark.parametrize('name', list(QUICK_RUNS))
def test_quick_studies_of_the_package_are_shorter(name):
    file = read_study(name)
    choices = {'seed': file.seeds[:1], **file.quick, 'plant': ('rigid',)}
    cells = study(name, **choices).plan_cells()
    assert len({cell.key for cell in cells}) == QUICK_RUNS[name]


def test_comparison_has_every_estimator_and_numbers_that_follow_from_the_lead_filter():
    setups = {}
    for cell in study('compare', plant=('puma',), seed=(0,)).plan_cells():
        if cell.factors['part'] == 'active state':
            setups[cell.factors['estimator']] = cell.job.setup()
    assert {*setups} == {*NOISE_ESTIMATORS, 'window rescaled', 'innovation matched'}
    usual = setups['lead_window']
    rescaled = setups['window rescaled'].noise_estimator
    matched = setups['innovation matched'].controller.force
    config = usual.noise_estimator
    f = design_lead_filter(config.zero_frequency, config.pole_frequency, config.rate)
    feedthrough = (f.pole - f.zero) ** 2 / (1.0 - f.pole**2)
    white_noise_gain = f.gain**2 * (1.0 + feedthrough)
    process_noise = usual.controller.force.process_noise / white_noise_gain
    assert rescaled.variance_scale == pytest.approx(white_noise_gain, rel=1e-12)
    assert matched.process_noise == pytest.approx(process_noise, rel=1e-12)


def test_every_law_has_ranges_whose_ends_are_acceptable():
    declared = read_yaml(find_config_folder() / 'tuning.yaml')
    assert set(declared) == set(FORCE_LAWS)
    for law, ranges in declared.items():
        ends = {}
        for name, values in ranges.items():
            ends[name] = [values[0], values[-1]]
        cells = plan_runs(apply_choices(study('tune', law).config, ends))
        assert 2 <= len(cells) <= 2 ** len(ranges)
        assert {cell.factors['seed'] for cell in cells} == {0}
        assert cells[0].job.setup().controller.force.law == law


@pytest.mark.slow
@pytest.mark.parametrize('damping_rate', [20.0, 60.0, 100.0])
def test_linear_boundary_is_the_simulated_one_within_a_tenth(damping_rate):
    """With R fixed, the model's T_d that of the actuator, no friction, roughness or noise."""

    def setup(ratio):
        surface = {'stiffness': 6000.0 * ratio, 'roughness_std': 0.0, 'friction': 0.0}
        return resolve(
            'step',
            plant='rigid',
            duration=3.5,
            noise_estimator={'estimator': 'fixed', 'fixed_variance': 0.6},
            controller={
                'friction': {'coulomb': [], 'viscous': []},
                'force': {'damping_rate': damping_rate, 'input_delay': 0.002},
            },
            plant_overrides={
                'substep': 2.5e-4,
                'actuator_delay_ticks': 1,
                'joint_friction_scale': 0.0,
                'sensor': {'noise': False, 'quantise': False},
                'surfaces': {'table': surface, 'board': surface},
            },
        )

    loop = ArmLoop(setup(1.0))
    linear = loop.largest_stable_ratio(0.6)
    for share, settles in ((0.9, True), (1.1, False)):
        run = measure_run(setup(share * linear), supervised=False)
        assert metrics_row(run)['settled'] == settles
    # What eq. 32 leaves out makes it more robust.
    assert loop.largest_stable_ratio(0.6, of_paper=True) < 0.9 * linear


@pytest.mark.slow
def test_row_of_a_fault_does_not_depend_on_the_faults_before_it():
    missing = ((('nan', 'wrench'),), 1)
    biased = ((('biased', 'wrench'),), 5)
    job = FaultJob('quick', 'rigid', 'approach', 0, (missing, biased))
    later = FaultJob('quick', 'rigid', 'rest', 0, (missing,))
    later_first = later.run()
    after_later = job.run()
    assert job.run() == after_later
    assert later.run() == later_first


@pytest.mark.nightly
@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_one_fault_of_every_kind_is_safe(tmp_path, plant):
    few = study('faults', seed=(20,), plant=(plant,))
    frame = run_study(few, tmp_path, console=QUIET).frame
    assert frame['safe'].all()
    assert len(frame) == len(FAULTS) + 12
    late = frame[~frame['back']]
    assert late['pair'].ne('').all()  # pairs of faults are recovered from later
    assert len(late) <= 3


def plan_keys(**choices):
    """Return the keys of the situations that are chosen."""
    return [cell.key for cell in study('situations', **choices).plan_cells()]


def test_every_situation_has_one_seed():
    """Whatever else is chosen: a share of one seed is the same share, as is that of a robot."""
    chosen = {'part': ('stiffness',), 'robot': ('ur5', 'foreign')}
    every = plan_keys(**chosen)
    by_seed = []
    for seed in range(4):
        by_seed += plan_keys(seed=(seed,), **chosen)
    assert sorted(by_seed) == sorted(set(every))
    assert len(every) == 15  # of two contacts: one arm
    assert set(plan_keys(part=('stiffness',), robot=('ur5',))) < set(every)


def test_situations_are_tried_on_the_drives_that_a_robot_has():
    tilted = study(
        'situations',
        robot=('ur5', 'panda'),
        part=('tilted surface',),
        speed=('0.1 m/s',),
        tilt=('3 deg',),
    )
    factors = [cell.factors for cell in tilted.plan_cells()]
    assert [each['robot'] for each in factors] == ['ur5', 'panda', 'panda']
    assert [each['plant'] for each in factors] == ['rigid', 'rigid', 'flexible']


def test_robot_that_is_not_installed_is_named_and_the_others_are_run(monkeypatch):
    monkeypatch.setattr(situations, 'find_means', not_installed)
    one = study('situations', robot=('fr3',), part=('payload',))
    assert not one.plan_cells()
    assert one.missing == {'fr3': 'urdf: expected the package x, got none'}


def not_installed(name):
    raise ConfigError('urdf', 'the package x', 'none')


@pytest.mark.nightly
def test_a_quarter_of_the_situations_is_safe(tmp_path):
    """On every arm that is installed; `multicontact study situations` has all of them."""
    results = run_study(study('situations', seed=(0,)), tmp_path, console=QUIET)
    frame = results.frame
    assert len(frame) >= 200
    assert frame['part'].nunique() == 11
    unsafe = frame[~frame['safe']]
    assert unsafe.empty, unsafe[['part', 'robot', 'what', 'problems']].to_string()


def test_cost_adds_figures_and_refuses_what_is_not_stable():
    row = {'stable': True, **SCALES}
    assert cost_of_run(row) == pytest.approx(len(SCALES))
    for changed in ({'stable': False}, {'rise_s': math.inf}, {'rest_rms_n': math.nan}):
        assert cost_of_run(row | changed) == math.inf


def test_page_tells_the_scales_of_the_cost():
    notes = read_study('tune').notes
    for scale in SCALES.values():
        assert f'{scale:g} ' in notes


def describe_tuning(runs):
    """Return what a study of aob finds; `runs` are part, seed, K_2 and whether a run is stable."""
    tried = study('tune', 'aob')
    rows = []
    for part, seed, damping_rate, stable in runs:
        gains = {
            'controller.force.damping_rate': damping_rate,
            'controller.force.time_constant': 0.02,
            'controller.force.fed_forward': 'mixed',
            'noise_estimator.slew_time': 0.0,
        }
        row = {'part': part, 'plant': 'rigid', 'seed': seed, 'stable': stable, **gains}
        rows.append({**row, 'error': None, **SCALES})
    frame = tried.complete_table(pd.DataFrame(rows))
    frame.attrs = {'factors': ['part', 'plant', *tried.gains, 'seed'], 'units': {}}
    return tried.describe_findings(Results([], frame, {}))


def test_best_gains_are_named_also_if_one_is_a_choice():
    best = describe_tuning([('', 0, 60.0, False), ('', 0, 100.0, True)])[0]
    assert 'damping_rate = 100, ' in best and 'fed_forward = mixed, ' in best


def test_gains_that_are_best_on_one_seed_stay_the_best_and_what_refutes_them_is_named():
    runs = [('', 0, 100.0, True)]
    for seed in (1, 2, 3):
        runs.append(('on other seeds', seed, 100.0, seed != 2))
    best, refuted = describe_tuning(runs)[:2]
    assert best.startswith('aob.yaml holds the best: ')
    assert refuted == 'They are unstable, or lack a figure, on seed 2.'


def test_no_gains_are_the_best_where_none_are_stable():
    finding = describe_tuning([('', 0, 60.0, False), ('', 0, 100.0, False)])[0]
    assert (
        finding == 'All combinations of aob are unstable in the task, or lack a figure.'
    )


@pytest.mark.slow
def test_best_gains_are_written_and_judged_on_other_seeds(tmp_path):
    rate = 'controller.force.damping_rate'
    tried = study('tune', 'dob', plant=('rigid',), **{rate: (40.0, 100.0)})
    for name, factor in tried.config.parts[''].factors.items():
        if name != rate:
            tried.config = apply_choices(tried.config, {name: factor.values[:1]})
    frame = run_study(tried, tmp_path, console=QUIET).frame
    assert frame['part'].tolist() == ['', '', *['on other seeds'] * 3]
    assert frame['cost'][0] <= frame['cost'][1]
    assert frame['seed'].tolist()[2:] == [1, 2, 3]
    force = resolve('quick', preset=str(tmp_path / 'dob.yaml')).controller.force
    assert force.law == 'dob'
    assert force.damping_rate == frame[rate][0]


@pytest.mark.slow
def test_comparison_judges_the_claims(tmp_path):
    small = study(
        'compare',
        plant=('rigid',),
        seed=(0,),
        part=('active state',),
        estimator=('lead_window', 'fixed'),
    )
    assert isinstance(small, CompareStudy)
    results = run_study(small, tmp_path, console=QUIET)
    sentences = small.describe_findings(results)
    assert sentences[0] == 'lead_window, fixed are stable on rigid in all runs.'
    assert 'agree with K_2 = 20 1/s' in sentences[-1]
    direct = run_in_process(small.plan_cells()[0].job.setup())
    assert results.frame['trajectory_sha256'][0] == direct.data.trajectory_sha256()
