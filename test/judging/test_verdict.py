"""The verdict on a run and its summary: of recordings made by hand, and of runs that fail."""

from dataclasses import replace
import io

from canonical_runs import run_of
from multicontact_control.cli.run import end_by_verdict
from multicontact_control.judging.claims import judge_claims_of_run
from multicontact_control.judging.display import (
    list_summary_rows,
    list_verdict_lines,
    print_summary,
)
from multicontact_control.judging.figure_files import draw_figures
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_figures import describe_figures, list_shaded_spans
from multicontact_control.judging.run_modes import INTERRUPTED
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.judging.supervisor_events import read_event
from multicontact_control.judging.verdict import (
    HELD,
    judge_run,
    NOT_STABLE,
    STABLE,
)
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.report import EventLog, SupervisorStatus
import numpy as np
import pytest
from rich.console import Console
from synthetic_run import delayed, paper_run, perfect_run
import typer

RATE = 500.0
LOADED = 2.5  # s, the first force step of `quick`
CALM = 'none |  | holding, holding'
LOST = 'none |  | holding, lost'
SIDEWAYS = 'hold | wrench_sideways | holding, holding'
CAUGHT = [(0.0, CALM), *((3.0 + 0.1 * k, (LOST, CALM)[k % 2]) for k in range(20))]
SOON = {
    'reference': {
        'force_steps': [{'time': 1.5, 'forces': {'table': 15.0, 'board': 15.0}}],
        'motion': {'start_time': 2.0, 'blend_time': 1.0},
    }
}


@pytest.fixture(scope='module')
def setup():
    return resolve('quick', plant='rigid', duration=12.0)


@pytest.fixture
def data(setup):
    return perfect_run(setup)


def lose(data, start, lasting, contact=1):
    data.alpha_true[round(start * RATE) : round((start + lasting) * RATE), contact] = (
        0.0
    )


def saturate(data, start, lasting):
    data.torque[round(start * RATE) : round((start + lasting) * RATE), 4] = -20.1


@pytest.mark.parametrize('seconds', [0.08, 0.12])
@pytest.mark.parametrize(
    ('fault', 'reason'), [(lose, 'board: contact lost'), (saturate, 'torque saturated')]
)
def test_loss_and_saturation_may_last_a_tenth_of_a_second(
    setup, data, fault, reason, seconds
):
    fault(data, 6.0, seconds)
    verdict = judge_run(RunMetrics(data, setup))
    assert (verdict.name == NOT_STABLE) == (seconds > 0.1)
    assert all(reason in line for line in verdict.reasons)
    assert verdict.unstable_at == (pytest.approx(6.1) if seconds > 0.1 else None)
    weak = replace(
        setup, plant=setup.plant.model_copy(update={'torque_limit': (12.0,) * 6})
    )
    assert any(
        'simulated drives' in line for line in judge_run(RunMetrics(data, weak)).reasons
    ) == (fault is saturate and seconds > 0.1)


@pytest.mark.parametrize(
    ('losses', 'every', 'lasting', 'name'),
    [
        (5, 1.0, 0.006, STABLE),
        (6, 1.0, 0.006, NOT_STABLE),
        (6, 0.1, 0.006, NOT_STABLE),
        (60, 0.1, 0.002, STABLE),
    ],
)  # a tool leaves a rough surface for a sample
def test_contact_that_is_lost_more_than_five_times_is_not_stable(
    setup, data, losses, every, lasting, name
):
    for k in range(losses):
        lose(data, LOADED + 1.0 + k * every, lasting, contact=0)
    assert judge_run(RunMetrics(data, setup)).name == name


@pytest.mark.parametrize(
    ('start', 'force', 'reasons'),
    [
        (
            400,
            10.5,
            (),
        ),  # a touch of five times a preload of 2 N, below half of the ceiling
        (400, 31.0, ('table: force of 31 N at a command of 2 N',)),
        (5000, 76.0, ('table: force of 76 N at a command of 15 N',)),
    ],
)
def test_force_beyond_five_times_its_command_and_half_the_ceiling_is_not_stable(
    setup, data, start, force, reasons
):
    data.alpha_true[start, 0] = force
    data.alpha_des[4990:, 0] = 0.0
    verdict = judge_run(RunMetrics(data, setup))
    assert verdict.reasons == reasons
    assert verdict.unstable_at == (start / RATE if reasons else None)


@pytest.mark.parametrize(
    ('seconds', 'couple', 'reasons'),
    [
        (0.08, -15.0, ()),
        (0.12, -14.9, ()),
        (0.12, -15.0, ('edge/along: contact lost at one end for 0.12 s',)),
        (0.01, -31.0, ('edge/along: couple of -31 N at a command of 0 N',)),
    ],
)
def test_couple_as_large_as_its_force_is_a_lost_end_of_the_edge(
    seconds, couple, reasons
):
    edge = resolve('edge', plant='rigid', duration=12.0)
    data = perfect_run(edge)
    data.alpha_true[:, 1] = edge.commanded(data.time)[:, 1]
    data.alpha_true[4000 : 4000 + int(seconds * RATE), 1] = couple
    assert judge_run(RunMetrics(data, edge)).reasons == reasons


def test_missing_contacts_answers_and_infinite_numbers_are_not_stable(setup, data):
    assert judge_run(RunMetrics(data, setup)).reasons == ()
    data.torque[100] = np.nan
    assert judge_run(RunMetrics(data, setup)).name == STABLE
    data.torque[:900] = np.nan
    for mode in ('in_process', 'lockstep', 'free_running'):
        assert judge_run(RunMetrics(data, setup), mode=mode).reasons == (
            '15.0 % of the samples were not answered',
        )
    data.alpha_meas[7, 0] = np.inf
    data.alpha_des[:, 0] = 0.0
    assert {'a number is not finite', 'table: no contact was made'} <= {
        *judge_run(RunMetrics(data, setup)).reasons
    }


def test_run_that_ends_before_its_load_is_not_judged_and_tells_of_no_claim():
    setup = resolve('paper', plant='puma', duration=1.0)
    data = perfect_run(setup)
    data.alpha_true[:] = 0.0
    data.alpha_des[:] = 0.0
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    assert (summary['verdict'], summary['unjudged'], summary['instabilities']) == (
        'not judged',
        'never under load',
        [],
    )
    end_by_verdict(summary)
    summary['claims'] = [
        claim._asdict()
        for claim in judge_claims_of_run(RunMetrics(data, setup), summary)
    ]
    assert {claim['holds'] for claim in summary['claims']} == {None}
    console = Console(width=80, soft_wrap=True, record=True, file=io.StringIO())
    print_summary(console, summary, 'here')
    text = console.export_text()
    assert 'claim of the paper' not in text and '13 claims not judged' in text


@pytest.mark.parametrize(
    ('hidden', 'whose'),
    [
        (lambda data: (slice(None), 1), ' of board'),
        (lambda data: np.arange(data.ticks) % 10 > 0, ''),  # published at 50 Hz
        (lambda data: data.time > 3.0, ''),
    ],
)
def test_contact_without_truth_is_judged_by_its_measured_force(
    setup, data, hidden, whose
):
    data.alpha_true[hidden(data)] = np.nan
    verdict = judge_run(RunMetrics(data, setup), mode='external')
    assert (verdict.name, verdict.unjudged) == (
        'not judged',
        f'no ground truth{whose}; by the measured forces no limit was passed',
    )
    data.alpha_meas[3000:, 1] = 0.0
    verdict = judge_run(RunMetrics(data, setup), mode='external')
    assert (
        verdict.reasons == ('board: contact lost for 6.00 s',)
        and verdict.name == NOT_STABLE
    )


@pytest.mark.parametrize(
    'caught', [SIDEWAYS, LOST, 'none | torque_rate | holding, holding']
)
def test_supervisor_that_steps_in_more_than_five_times_holds_the_run(
    setup, data, caught
):
    for times, name in ((5, STABLE), (6, HELD)):
        texts = [(0.0, CALM)]
        for k in range(times):
            texts += [(3.0 + k, caught), (3.002 + k, CALM)]
        verdict = judge_run(RunMetrics(data, setup), events=texts)
        assert (verdict.name, len(verdict.reasons)) == (name, int(times > 5))
    cause = caught.split(' | ')[1].strip() or 'contact lost'
    assert f'({cause} 6)' in verdict.reasons[0] and verdict.unstable_at is None


def test_line_of_the_log_on_what_a_contact_reads_before_it_touches_is_read(setup, data):
    report = EventLog()
    for time, state in ((0.0, 'free'), (2.6, 'holding')):
        report.note_status(
            time,
            SupervisorStatus(
                'none',
                contact_states=(state, state),
                read_before=('table reads -1.0 N',),
            ),
        )
    assert [len(what.split(' | ')) for _, what in report.events] == [4, 4]
    assert judge_run(RunMetrics(data, setup), events=report.events).name == STABLE


def test_bounces_before_load_and_slow_references_are_no_interventions(setup, data):
    for start, every, cycle in (
        (0.5, 0.1, ('none |  | impact, holding', 'none |  | lost, holding')),
        (
            3.0,
            0.2,
            ('none | reference | holding, holding', 'none |  | approaching, impact'),
        ),
    ):
        texts = [(start + 0.5 * every * k, cycle[k % 2]) for k in range(40)]
        assert (
            judge_run(
                RunMetrics(data, setup), events=[(0.0, 'none |  | free, free'), *texts]
            ).name
            == STABLE
        )


@pytest.mark.parametrize('supervised', [True, False])
@pytest.mark.parametrize(
    ('scenario', 'changes', 'reason'),
    [
        (
            'quick',
            {
                'plant': 'puma',
                'seed': 51,
                'duration': 7.0,
                'scenario_overrides': SOON,
                'noise_estimator': {'estimator': 'fixed'},
            },
            'board: oscillates at 42 Hz',
        ),
        (
            'step',
            {
                'plant': 'rigid',
                'seed': 2,
                'plant_overrides': {
                    'surfaces': {
                        name: {'stiffness': 90000.0} for name in ('table', 'board')
                    }
                },
            },
            'board: oscillates',
        ),
    ],
)
def test_limit_cycle_is_named_with_and_without_supervisor(
    scenario, changes, reason, supervised
):
    """R fixed at 0.6 on flexible drives, and surfaces fifteen times as stiff as modelled."""
    setup = resolve(scenario, preset='paper', **changes)
    result = run_of(setup, supervised=supervised)
    verdict = judge_run(
        RunMetrics(result.data, setup),
        ended_early=result.ended_early,
        events=result.events,
    )
    assert verdict.name == NOT_STABLE and verdict.unstable_at is not None
    assert any(line.startswith(reason) for line in verdict.reasons)
    assert any('stepped in' in line for line in verdict.reasons) == supervised


@pytest.mark.parametrize(
    ('ticks', 'changes', 'verdict', 'stable', 'code'),
    [
        (6000, {'events': [(0.0, CALM)]}, 'stable', True, None),
        (6000, {'events': CAUGHT}, 'held by the supervisor', False, 1),
        (3000, {'ended_early': 'tick 3000: singular'}, 'not stable', False, 1),
        (
            3000,
            {'ended_early': 'arm has not published', 'mode': 'external'},
            'ended: robot silent',
            None,
            1,
        ),
        (
            5000,
            {'ended_early': INTERRUPTED, 'mode': 'real_time'},
            'not judged',
            None,
            None,
        ),
        (1000, {}, 'not judged', None, None),
    ],
)
def test_verdict_is_shown_and_decides_the_exit_code(
    setup, data, ticks, changes, verdict, stable, code
):
    summary = summarise_run(
        RunMetrics(data.part(0, ticks), setup),
        **{'mode': 'in_process', 'timing': {}, **changes},
    )
    assert (summary['verdict'], summary['stable']) == (verdict, stable)
    assert f']{verdict}' in list_verdict_lines(summary, 'here')[1]
    if code is None:
        end_by_verdict(summary)
        return
    with pytest.raises(typer.Exit) as ended:
        end_by_verdict(summary)
    assert ended.value.exit_code == code


@pytest.mark.parametrize(
    ('force', 'shift', 'reasons'),
    [
        (17.9, 0.0099, ()),
        (22.0, 0.0, ('table: overshoots its largest step by 150 %',)),
        (10.0, 0.026, ('motion error of 26 mm rms',)),
    ],
)
def test_force_or_motion_far_off_its_command_makes_a_stable_run_poor(
    setup, data, force, shift, reasons
):
    """A step from 2 to 10 N at 2.5 s, and a motion that is judged from 8.5 s on."""
    data.alpha_true[1300:1310, 0] = force
    data.position[data.time >= 8.5, 0] += shift
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    assert (summary['verdict'], summary['stable']) == (
        'poor' if reasons else 'stable',
        True,
    )
    assert tuple(summary['instabilities']) == reasons
    assert f'motion error {1e3 * shift:.2g} mm rms' in summary['quality']
    end_by_verdict(summary)


def test_figures_show_the_start_of_the_motion_and_what_of_r_is_a_median(setup, data):
    data.noise_variance[:, 0] = np.where(
        data.time < setup.scenario.reference.motion.start_time, 0.6, 100.0
    )
    start = setup.scenario.reference.motion.start_time
    data.noise_variance[np.argmax(data.time >= start + 1.0), 0] = 900.0
    run = RunMetrics(data, setup)
    spans = {name: (begin, end) for name, begin, end in list_shaded_spans(run)}
    assert spans['start'][0] == pytest.approx(start, abs=0.01)
    assert spans['start'][1] == pytest.approx(spans['moving'][0], abs=0.01)
    drawn = {each.file: each for each in describe_figures(run)}
    table, *_ = drawn['fig6_noise_variance'].panels[0].traces
    assert table.label == (
        'table: median 0.6 at rest, 100 moving; at most 900 from the start of '
        'the motion on'
    )
    below, above = drawn['fig5_motion'].panels[0].traces
    assert (below.label, below.broad, above.label) == ('commanded', True, 'measured')


@pytest.mark.parametrize(
    ('force', 'said'),
    [
        (10.7, 'as designed: '),
        (13.0, 'not as designed: overshoot at most 38 %; as designed: '),
    ],
)
def test_stable_run_says_beside_its_verdict_how_good_it_is(setup, data, force, said):
    data.alpha_true[:] = delayed(data, 0.05)
    data.alpha_true[1300:1310, 0] = force
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    verdict, quality = list_verdict_lines(summary, 'here')[1:3]
    assert 'stable' in verdict and quality.startswith(said)
    assert (
        'rise 1.02 of the design' in quality
        and 'steady-state error at most 0.00 N' in quality
    )


@pytest.mark.parametrize('delay', [0.02, 0.04, 0.06, 0.08])
def test_quality_and_claims_say_the_same_of_a_slow_small_step(delay):
    """The smallest step of board alone is late: both see it, by the same bounds."""
    setup = resolve('paper', plant='puma')
    data = paper_run(setup)
    small = min(
        RunMetrics(data, setup).contacts[1].timed_steps, key=lambda step: step.size_n
    )
    begin = round(small.time_s * RATE)
    before = float(setup.commanded(data.time)[begin - 1, 1])
    data.alpha_true[begin : begin + round(delay * RATE), 1] = before
    data.alpha_true[begin + round(delay * RATE) : begin + 100, 1] = (
        before + small.size_n
    )
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    rises = next(
        claim
        for claim in judge_claims_of_run(RunMetrics(data, setup), summary)
        if 'time constant' in claim.claim
    )
    bad, _, good = summary['quality'].rpartition('; ')
    said = bad if 'rise' in bad else good
    assert said.startswith('as designed') == rises.holds == (delay in (0.04, 0.06))
    ends = {part.split()[-1] for part in rises.measured.replace(' x', '').split(', ')}
    assert any(end in said for end in ends)


def test_loss_that_the_controller_alone_sees_is_named_as_such(setup, data):
    seen = [(0.0, CALM), (3.0, LOST), (3.1, CALM)]
    summary = summarise_run(
        RunMetrics(data, setup), mode='in_process', timing={}, events=seen
    )
    rows = {label: cells for label, *cells in list_summary_rows(summary)}
    assert rows['contact lost [times]'] == ['0', '0']
    assert rows['lost to the controller [times]'] == ['0', '1']


def test_event_is_read_with_what_was_read_of_contacts_before_a_touch():
    event = read_event(
        1.0, 'hold | joints_stale | free, force | table: read 3 N before a touch'
    )
    assert (event.reaction, event.causes) == ('hold', ('joints_stale',))
    assert event.contact_states == ('free', 'force')


def test_claims_of_the_paper_are_printed_in_a_narrow_terminal():
    setup = resolve('paper', plant='puma')
    data = paper_run(setup)
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    summary['claims'] = [
        claim._asdict()
        for claim in judge_claims_of_run(RunMetrics(data, setup), summary)
    ]
    console = Console(width=80, soft_wrap=True, record=True, file=io.StringIO())
    print_summary(console, summary, 'here')
    text = console.export_text()
    table = text[text.index('claim of the paper') :]
    assert max(map(len, table.splitlines()[:-1])) <= 80
    assert table.count('holds') == 8 and '5 claims not judged by one run' in table


def test_figures_of_a_plane_have_legal_file_names(tmp_path):
    setup = resolve('plane', plant='rigid', duration=10.0)
    data = perfect_run(setup)
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    draw_figures(RunMetrics(data, setup), summary, tmp_path, formats=('png',))
    assert {path.stem for path in tmp_path.iterdir()} == {
        'fig3_force_face',
        'fig4_force_face_along',
        'fig3_3_force_face_across',
        'fig5_motion',
        'fig6_noise_variance',
    }
