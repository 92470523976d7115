"""``summary.json`` and what is shown of it: verdict, supervisor, machine."""

from dataclasses import replace

from multicontact_control.cli.exits import end_by_verdict
from multicontact_control.experiment import figures
from multicontact_control.experiment.display import (
    headline,
    next_lines,
    summary_table,
    verdict_lines,
)
from multicontact_control.experiment.judge import INTERRUPTED
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.summary import summarise, summarise_again
import numpy as np
import pytest
from synthetic_run import perfect_run
import typer

CALM = 'none |  | holding, holding'
LOST = 'none |  | holding, lost'
CAUGHT = [(0.0, CALM), *((3.0 + 0.1 * k, (LOST, CALM)[k % 2]) for k in range(20))]


@pytest.fixture(scope='module')
def setup():
    return resolve('quick', plant='rigid', duration=12.0)


@pytest.fixture
def data(setup):
    return perfect_run(setup)


def summary_of(data, setup, **changes):
    return summarise(data, setup, **{'mode': 'in_process', 'timing': {}, **changes})


def test_verdict_and_reasons_are_in_the_summary(setup, data):
    summary = summary_of(data, setup)
    assert (summary['stable'], summary['verdict'], summary['instabilities']) == (
        True, 'stable', [])
    assert summary['kept_real_time'] is summary['unstable_at_s'] is summary['ended_early'] is None
    assert summary['supervised'] is False and 'events' not in summary
    held = summary_of(data, setup, events=CAUGHT)
    assert (held['stable'], held['verdict']) == (False, 'held by the supervisor')
    assert held['instabilities'] == ['the supervisor stepped in 10 times under load']
    assert held['events'][1] == {'time_s': 3.0, 'what': LOST}


def test_run_that_ended_early_has_no_numbers_for_what_it_did_not_reach(setup, data):
    summary = summary_of(data.truncated(3000), setup, ended_early='tick 3000: singular',
                         events=[(0.0, CALM), (6.0, LOST)])
    assert summary['instabilities'][0] == summary['ended_early'] == 'tick 3000: singular'
    assert summary['contacts']['table']['moving']['true_error_rms_n'] is None
    assert len(summary['events']) == 1  # the other one came after the run


def test_run_that_was_interrupted_is_not_judged_and_no_failure(setup, data):
    summary = summary_of(data.truncated(5000), setup, ended_early=INTERRUPTED, mode='real_time')
    assert (summary['stable'], summary['verdict'], summary['unjudged']) == (
        None, 'not judged', 'interrupted by a signal')
    assert summary['ended_early'] == 'interrupted by a signal' and not summary['instabilities']
    assert verdict_lines(summary, 'here')[1] == (
        '[yellow]not judged: interrupted by a signal[/yellow]')
    # What older code called unstable for that.
    old = {**summary, 'stable': False, 'verdict': 'not stable',
           'instabilities': ['interrupted by a signal']}
    assert summarise_again(data.truncated(5000), setup, old) == summary


def test_run_without_load_is_not_judged_and_no_failure(setup, data):
    summary = summary_of(data.truncated(1000), setup)
    assert summary['stable'] is None
    assert verdict_lines(summary, 'here')[1] == '[yellow]not judged: never under load[/yellow]'
    end_by_verdict(summary)


def test_truth_is_told_of_each_contact(setup, data):
    data.alpha_true[:, 1] = np.nan
    data.alpha_meas[:, 1] += 0.5
    summary = summary_of(data, setup, mode='external')
    assert (summary['truth'], summary['forces'], summary['without_truth']) == (
        False, 'measured', ['board'])
    table, board = (summary['contacts'][name]['rest'] for name in ('table', 'board'))
    assert (table['true_error_rms_n'], table['measured_error_rms_n']) == (0.0, None)
    assert (board['true_error_rms_n'], board['measured_error_rms_n']) == (None, 0.5)
    assert board['estimate_error_rms_n'] is None
    assert headline(summary).endswith(', no ground truth of board: forces as measured')
    labels = summary_table(summary).columns[0].cells
    assert {'rest: true error rms [N]', 'rest: measured error rms [N]'} < set(labels)
    shown = {panel.label for drawn in figures.run_figures(data, setup)[:2]
             for panel in drawn.panels}
    assert shown == {'force [N]', 'force [N], no ground truth'}


def test_summary_is_the_same_again_and_brings_an_old_one_up_to_date(setup, data):
    summary = summary_of(data, setup, events=CAUGHT)
    assert summarise_again(data, setup, summary) == summary
    old = {name: value for name, value in summary.items()
           if name not in ('verdict', 'ended_early', 'kept_real_time', 'unstable_at_s')}
    assert summarise_again(data, setup, {**old, 'stable': True, 'instabilities': []}) == summary
    early = summarise_again(data, setup, {**old, 'instabilities': ['a', 'tick 7: singular']})
    assert early['ended_early'] == 'tick 7: singular'


@pytest.mark.parametrize(('events', 'line', 'code'), [
    ([(0.0, CALM)], '[green]stable[/green]', None),
    (CAUGHT, '[yellow]held by the supervisor: the supervisor stepped in 10 times', 1)])
def test_verdict_is_said_and_decides_the_exit_code(setup, data, events, line, code):
    summary = summary_of(data, setup, events=events)
    assert any(said.startswith(line) for said in verdict_lines(summary, 'here'))
    if code is None:
        end_by_verdict(summary)
        return
    with pytest.raises(typer.Exit) as ended:
        end_by_verdict(summary)
    assert ended.value.exit_code == code


def test_machine_that_could_not_keep_up_is_one_line(setup, data):
    data.torque[2500:2700] = np.nan
    held = [(0.0, CALM), (5.0, 'hold | joints_stale | holding, holding'), (5.4, CALM)]
    summary = summary_of(data, setup, mode='real_time', events=held, timing={
        'deadline_misses': 300, 'unanswered_samples': 200})
    assert (summary['kept_real_time'], summary['stable']) == (False, True)
    lines = verdict_lines(summary, 'here')
    assert '[yellow]stable as far as it could be judged' in lines[1]
    (line,) = [line for line in lines if 'warning' in line]
    assert ('could not keep real time: 300 of 6000 deadlines missed, 200 samples not answered, '
            '1 hold; figures are not representative') in line
    assert '85 % of the time under load' in line and '--lockstep has no deadlines' in line
    hopeless = summary_of(data, setup, mode='real_time', timing={'deadline_misses': 3000})
    assert (hopeless['stable'], hopeless['verdict']) == (None, 'not judged')
    assert verdict_lines(hopeless, 'here')[1].startswith('[yellow]not judged: the machine could')
    end_by_verdict(hopeless)  # no failure of the run
    kept = summary_of(perfect_run(setup), setup, mode='real_time', timing={
        'deadline_misses': 3, 'unanswered_samples': 1})
    assert kept['kept_real_time'] is True
    (line,) = [line for line in verdict_lines(kept, 'here') if 'warning' in line]
    assert '3 of 6000 deadlines missed, 1 sample not answered[' in line


@pytest.mark.parametrize(('scenario', 'forces'), [
    ('edge', ['fig3_force_edge', 'fig4_force_edge_along']),
    ('plane', ['fig3_force_face', 'fig4_force_face_along', 'fig3_3_force_face_across'])])
def test_figures_of_couples_have_legal_file_names(scenario, forces, tmp_path, monkeypatch):
    monkeypatch.setattr(figures.Figure, 'savefig', lambda figure, path, **_: path.write_text(''))
    setup = resolve(scenario, plant='rigid', duration=10.0)
    figures.draw_figures(perfect_run(setup), setup, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        f'{name}.png' for name in [*forces, 'fig5_motion', 'fig6_noise_variance'])


@pytest.mark.parametrize('verdict', ['stable', 'not stable: board: oscillates at 42 Hz'])
def test_figures_tell_what_is_not_stable(setup, data, tmp_path, monkeypatch, verdict):
    titles = []
    monkeypatch.setattr(figures.Figure, 'savefig',
                        lambda figure, *_, **__: titles.append(figure.get_suptitle()))
    figures.draw_figures(data, setup, tmp_path, verdict=verdict)
    assert len(titles) == 4
    assert all((verdict in title) == (verdict != 'stable') for title in titles)


def test_motion_that_is_commanded_by_and_by_is_shaded_as_one(setup, data):
    moved = np.clip(np.floor((data.time - 6.0) / 0.03) * 0.003, 0.0, 0.3)  # for 3 s
    data.position_des[:, 0] = moved
    data.command[:] = data.alpha_des
    page = figures.interactive_figures(data, replace(setup, commanded_by_topic=True), 0)
    assert page.count('"moving"') == len(figures.run_figures(data, setup))


def test_a_run_ends_with_what_to_open_next(tmp_path):
    (tmp_path / 'bag').mkdir()
    lines = [line.split() for line in next_lines(tmp_path)[1:]]
    assert lines == [['figures', f'{tmp_path}/figures'],
                     ['bag', 'multicontact', 'view', f'{tmp_path}'],
                     ['numbers', f'{tmp_path}/summary.json']]
    (tmp_path / 'report.html').touch()
    assert next_lines(tmp_path)[1].split() == ['figures', f'{tmp_path}/report.html']
