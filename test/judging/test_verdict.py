"""The verdict on a run and its summary: of recordings made by hand, and of runs that fail."""

from dataclasses import replace
import io
from operator import attrgetter
import re

from canonical_runs import run_of
from multicontact_control.cli.run import end_by_verdict
from multicontact_control.judging import figure_files
from multicontact_control.judging.claims import judge_claims_of_run
from multicontact_control.judging.display import (
    list_summary_rows,
    list_verdict_lines,
    print_summary,
)
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
SOON = {
    'reference': {
        'force_steps': [{'time': 1.5, 'forces': {'table': 15.0, 'board': 15.0}}],
        'motion': {'start_time': 2.0, 'blend_time': 1.0},
    }
}


def alternate_events(start, every, times, first, second, lasting=None):
    """Return a calm beginning and two events in turn, evenly or the first one for a while [s]."""
    events = [(0.0, CALM)]
    for number in range(times):
        time = start + every * number
        events += [(time, first), (time + (lasting or every / 2), second)]
    return events


CAUGHT = alternate_events(3.0, 0.2, 10, LOST, CALM)


def judge(data, setup, **options):
    return judge_run(RunMetrics(data, setup), **options)


def summarise(data, setup, **changes):
    """Return the summary of a run in process, or in another mode."""
    options = {'mode': 'in_process', 'timing': {}, **changes}
    return summarise_run(RunMetrics(data, setup), **options)


def print_with_claims(data, setup):
    """Return the summary with the claims of the paper, and what is printed of it."""
    summary = summarise(data, setup)
    judged = judge_claims_of_run(RunMetrics(data, setup), summary)
    summary['claims'] = [claim._asdict() for claim in judged]
    console = Console(width=80, soft_wrap=True, record=True, file=io.StringIO())
    print_summary(console, summary, 'here')
    return summary, console.export_text()


@pytest.fixture(scope='module')
def setup():
    return resolve('quick', plant='rigid', duration=12.0)


@pytest.fixture
def data(setup):
    return perfect_run(setup)


def window(start, lasting):
    """Return the samples of some time [s]."""
    return slice(round(start * RATE), round((start + lasting) * RATE))


def lose(data, start, lasting, contact=1):
    data.alpha_true[window(start, lasting), contact] = 0.0


def saturate(data, start, lasting):
    data.torque[window(start, lasting), 4] = -20.1


FAULTS = [(lose, 'board: contact lost'), (saturate, 'torque saturated')]


@pytest.mark.parametrize(('fault', 'reason'), FAULTS)
def test_loss_and_saturation_for_a_tenth_of_a_second_are_stable(
    setup, data, fault, reason
):
    fault(data, 6.0, 0.08)
    verdict = judge(data, setup)
    assert verdict.name == STABLE
    assert verdict.unstable_at is None


@pytest.mark.parametrize(('fault', 'reason'), FAULTS)
def test_longer_loss_and_saturation_are_not_stable(setup, data, fault, reason):
    fault(data, 6.0, 0.12)
    verdict = judge(data, setup)
    assert verdict.name == NOT_STABLE
    assert reason in verdict.reasons[0]
    assert verdict.unstable_at == pytest.approx(6.1)


def test_saturation_beyond_the_simulated_drives_is_said_to_be_so(setup, data):
    weak_drives = setup.plant.model_copy(update={'torque_limit': (12.0,) * 6})
    weak = replace(setup, plant=weak_drives)
    lose(data, 3.0, 0.12)
    saturate(data, 5.0, 0.08)
    assert 'simulated drives' not in '\n'.join(judge(data, weak).reasons)
    saturate(data, 6.0, 0.12)
    assert 'simulated drives' in '\n'.join(judge(data, weak).reasons)
    assert 'simulated drives' not in '\n'.join(judge(data, setup).reasons)


@pytest.mark.parametrize(
    ('losses', 'every', 'lasting', 'name'),
    [
        (5, 1.0, 0.006, STABLE),
        (6, 1.0, 0.006, NOT_STABLE),
        (6, 0.1, 0.006, NOT_STABLE),
        # A tool leaves a rough surface for a sample.
        (60, 0.1, 0.002, STABLE),
    ],
)
def test_contact_that_is_lost_more_than_five_times_is_not_stable(
    setup, data, losses, every, lasting, name
):
    for k in range(losses):
        lose(data, LOADED + 1.0 + k * every, lasting, contact=0)
    assert judge(data, setup).name == name


@pytest.mark.parametrize(
    ('start', 'force', 'reasons'),
    [
        # A touch of five times a preload of 2 N, below half of the ceiling.
        (400, 10.5, ()),
        (400, 31.0, ('table: force of 31 N at a command of 2 N',)),
        (5000, 76.0, ('table: force of 76 N at a command of 15 N',)),
    ],
)
def test_force_beyond_five_times_its_command_and_half_the_ceiling_is_not_stable(
    setup, data, start, force, reasons
):
    data.alpha_true[start, 0] = force
    data.alpha_des[4990:, 0] = 0.0
    verdict = judge(data, setup)
    assert verdict.reasons == reasons
    if reasons:
        assert verdict.unstable_at == start / RATE
    else:
        assert verdict.unstable_at is None


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
    data.alpha_true[window(8.0, seconds), 1] = couple
    assert judge(data, edge).reasons == reasons


@pytest.mark.parametrize('mode', ['in_process', 'lockstep', 'free_running'])
def test_run_in_which_many_samples_are_not_answered_is_not_stable(setup, data, mode):
    data.torque[100] = np.nan
    assert judge(data, setup, mode=mode).name == STABLE
    data.torque[:900] = np.nan
    reasons = judge(data, setup, mode=mode).reasons
    assert reasons == ('15.0 % of the samples were not answered',)


def test_infinite_number_is_not_stable(setup, data):
    data.alpha_meas[7, 0] = np.inf
    assert 'a number is not finite' in judge(data, setup).reasons


def test_contact_that_is_never_made_is_not_stable(setup, data):
    data.alpha_des[:, 0] = 0.0
    assert 'table: no contact was made' in judge(data, setup).reasons


def test_run_that_ends_before_its_load_is_not_judged_and_tells_of_no_claim():
    setup = resolve('paper', plant='puma', duration=1.0)
    data = perfect_run(setup)
    data.alpha_true[:] = 0.0
    data.alpha_des[:] = 0.0
    summary, text = print_with_claims(data, setup)
    assert summary['verdict'] == 'not judged'
    assert summary['unjudged'] == 'never under load'
    assert summary['instabilities'] == []
    end_by_verdict(summary)
    assert {claim['holds'] for claim in summary['claims']} == {None}
    assert 'claim of the paper' not in text
    assert '13 claims not judged' in text


EVERY = np.arange(6000)  # all samples
HIDDEN = [
    (EVERY, 1, ' of board'),
    (EVERY[EVERY % 10 > 0], slice(None), ''),  # published at 50 Hz
    (EVERY[1501:], slice(None), ''),
]


@pytest.mark.parametrize(('ticks', 'contact', 'whose'), HIDDEN)
def test_contact_without_truth_is_judged_by_its_measured_force(
    setup, data, ticks, contact, whose
):
    data.alpha_true[ticks, contact] = np.nan
    verdict = judge(data, setup, mode='external')
    assert verdict.name == 'not judged'
    assert verdict.unjudged == (
        f'no ground truth{whose}; by the measured forces no limit was passed'
    )
    data.alpha_meas[3000:, 1] = 0.0
    verdict = judge(data, setup, mode='external')
    assert verdict.name == NOT_STABLE
    assert verdict.reasons == ('board: contact lost for 6.00 s',)


@pytest.mark.parametrize(
    ('caught', 'cause'),
    [
        (SIDEWAYS, 'wrench_sideways'),
        (LOST, 'contact lost'),
        ('none | torque_rate | holding, holding', 'torque_rate'),
    ],
)
def test_supervisor_that_steps_in_more_than_five_times_holds_the_run(
    setup, data, caught, cause
):
    five_times = alternate_events(3.0, 1.0, 5, caught, CALM, 0.002)
    assert judge(data, setup, events=five_times).name == STABLE
    six_times = alternate_events(3.0, 1.0, 6, caught, CALM, 0.002)
    verdict = judge(data, setup, events=six_times)
    assert verdict.name == HELD
    (reason,) = verdict.reasons
    assert f'({cause} 6)' in reason
    assert verdict.unstable_at is None


def test_line_of_the_log_on_what_a_contact_reads_before_it_touches_is_read(setup, data):
    report = EventLog()
    for time, state in ((0.0, 'free'), (2.6, 'holding')):
        status = SupervisorStatus(
            'none',
            contact_states=(state, state),
            read_before=('table reads -1.0 N',),
        )
        report.note_status(time, status)
    for _, text in report.events:
        assert text.endswith(' | table reads -1.0 N')
    assert judge(data, setup, events=report.events).name == STABLE


@pytest.mark.parametrize(
    ('start', 'every', 'first', 'second'),
    [
        (0.5, 0.1, 'none |  | impact, holding', 'none |  | lost, holding'),
        (
            3.0,
            0.2,
            'none | reference | holding, holding',
            'none |  | approaching, impact',
        ),
    ],
)
def test_bounces_before_load_and_slow_references_are_no_interventions(
    setup, data, start, every, first, second
):
    _, *events = alternate_events(start, every, 20, first, second)
    events = [(0.0, 'none |  | free, free'), *events]
    assert judge(data, setup, events=events).name == STABLE


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
                        'table': {'stiffness': 90000.0},
                        'board': {'stiffness': 90000.0},
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
    assert verdict.name == NOT_STABLE
    assert verdict.unstable_at is not None
    assert any(line.startswith(reason) for line in verdict.reasons)
    assert ('stepped in' in '\n'.join(verdict.reasons)) == supervised


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
    summary = summarise(data.part(0, ticks), setup, **changes)
    assert summary['verdict'] == verdict
    assert summary['stable'] is stable
    assert f']{verdict}' in list_verdict_lines(summary, 'here')[1]
    if code is None:
        end_by_verdict(summary)
        return
    with pytest.raises(typer.Exit) as ended:
        end_by_verdict(summary)
    assert ended.value.exit_code == code


@pytest.mark.parametrize(
    ('force', 'shift', 'verdict', 'reasons'),
    [
        (17.9, 0.0099, 'stable', []),
        (22.0, 0.0, 'poor', ['table: overshoots its largest step by 150 %']),
        (10.0, 0.026, 'poor', ['motion error of 26 mm rms']),
    ],
)
def test_force_or_motion_far_off_its_command_makes_a_stable_run_poor(
    setup, data, force, shift, verdict, reasons
):
    """A step from 2 to 10 N at 2.5 s, and a motion that is judged from 8.5 s on."""
    data.alpha_true[1300:1310, 0] = force
    data.position[data.time >= 8.5, 0] += shift
    summary = summarise(data, setup)
    assert summary['verdict'] == verdict
    assert summary['stable'] is True
    assert summary['instabilities'] == reasons
    assert f'motion error {1e3 * shift:.2g} mm rms' in summary['quality']
    end_by_verdict(summary)


def draw_panels(data, setup, file):
    """Return the panels of a figure of a run."""
    for figure in describe_figures(RunMetrics(data, setup)):
        if figure.file == file:
            return figure.panels
    raise LookupError(file)


def test_figures_shade_the_start_of_the_motion_until_it_is_judged(setup, data):
    spans = {}
    for name, begin, end in list_shaded_spans(RunMetrics(data, setup)):
        spans[name] = begin, end
    begin, end = spans['start']
    motion = setup.scenario.reference.motion
    assert begin == pytest.approx(motion.start_time, abs=0.01)
    assert end == pytest.approx(spans['moving'][0], abs=0.01)


def test_figure_of_r_says_what_is_a_median_and_the_largest(setup, data):
    start = setup.scenario.reference.motion.start_time
    data.noise_variance[:, 0] = np.where(data.time < start, 0.6, 100.0)
    data.noise_variance[np.argmax(data.time >= start + 1.0), 0] = 900.0
    table = draw_panels(data, setup, 'fig6_noise_variance')[0].traces[0]
    assert table.label == (
        'table: median 0.6 at rest, 100 moving; at most 900 from the start of '
        'the motion on'
    )


def test_figure_of_the_motion_has_the_measured_one_upon_a_broad_command(setup, data):
    below, above = draw_panels(data, setup, 'fig5_motion')[0].traces
    assert below.label == 'commanded'
    assert below.broad
    assert above.label == 'measured'


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
    _, verdict, quality, *_ = list_verdict_lines(summarise(data, setup), 'here')
    assert 'stable' in verdict
    assert quality.startswith(said)
    assert 'rise 1.02 of the design' in quality
    assert 'steady-state error at most 0.00 N' in quality


@pytest.mark.parametrize('delay', [0.02, 0.04, 0.06, 0.08])
def test_quality_and_claims_say_the_same_of_a_slow_small_step(delay):
    """The smallest step of board alone is late: both see it, by the same bounds."""
    setup = resolve('paper', plant='puma')
    data = paper_run(setup)
    steps = RunMetrics(data, setup).contacts[1].timed_steps
    small = min(steps, key=attrgetter('size_n'))
    begin = round(small.time_s * RATE)
    before = float(setup.commanded(data.time)[begin - 1, 1])
    after = begin + round(delay * RATE)
    data.alpha_true[begin:after, 1] = before
    data.alpha_true[after : begin + 100, 1] = before + small.size_n
    summary = summarise(data, setup)
    (rises,) = [
        claim
        for claim in judge_claims_of_run(RunMetrics(data, setup), summary)
        if 'time constant' in claim.claim
    ]
    as_designed = delay in (0.04, 0.06)
    assert rises.holds == as_designed
    (said,) = [part for part in summary['quality'].split('; ') if 'rise' in part]
    assert said.startswith('as designed') == as_designed
    ratios = re.findall(r'[\d.]+(?= x)', rises.measured)
    assert any(ratio in said for ratio in ratios)


def test_loss_that_the_controller_alone_sees_is_named_as_such(setup, data):
    seen = [(0.0, CALM), (3.0, LOST), (3.1, CALM)]
    rows = [[*row] for row in list_summary_rows(summarise(data, setup, events=seen))]
    assert ['contact lost [times]', '0', '0'] in rows
    assert ['lost to the controller [times]', '0', '1'] in rows


def test_event_is_read_with_what_was_read_of_contacts_before_a_touch():
    event = read_event(
        1.0, 'hold | joints_stale | free, force | table: read 3 N before a touch'
    )
    assert event.reaction == 'hold'
    assert event.causes == ('joints_stale',)
    assert event.contact_states == ('free', 'force')


def test_claims_of_the_paper_are_printed_in_a_narrow_terminal():
    setup = resolve('paper', plant='puma')
    _, text = print_with_claims(paper_run(setup), setup)
    table = text[text.index('claim of the paper') :]
    *lines, _ = table.splitlines()
    assert max(map(len, lines)) <= 80
    assert table.count('holds') == 8
    assert '5 claims not judged by one run' in table


def test_figures_of_a_plane_have_legal_file_names(tmp_path, monkeypatch):
    setup = resolve('plane', plant='rigid', duration=10.0)
    data = perfect_run(setup)
    summary = summarise(data, setup)
    monkeypatch.setattr(figure_files, 'FIGURE_FORMATS', ('png',))
    figure_files.draw_figures(RunMetrics(data, setup), summary, tmp_path)
    assert {path.stem for path in tmp_path.iterdir()} == {
        'fig3_force_face',
        'fig4_force_face_along',
        'fig3_3_force_face_across',
        'fig5_motion',
        'fig6_noise_variance',
    }
