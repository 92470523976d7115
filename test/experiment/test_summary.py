"""``summary.json`` and what is shown of it: verdict, supervisor, machine."""

from multicontact_control.cli.exits import end_by_verdict
from multicontact_control.experiment import figures
from multicontact_control.experiment.display import headline, summary_table, verdict_lines
from multicontact_control.experiment.judge import INTERRUPTED
from multicontact_control.experiment.results import summarise
from multicontact_control.experiment.scenario import resolve
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


def summary_of(data, setup, mode='in_process', **changes):
    return summarise(data, setup, mode=mode, timing={}, **changes)


@pytest.mark.parametrize(('ticks', 'changes', 'verdict', 'stable', 'code'), [
    (6000, {'events': [(0.0, CALM)]}, 'stable', True, None),
    (6000, {'events': CAUGHT}, 'held by the supervisor', False, 1),
    (3000, {'ended_early': 'tick 3000: singular'}, 'not stable', False, 1),
    (5000, {'ended_early': INTERRUPTED, 'mode': 'real_time'}, 'not judged', None, None),
    (1000, {}, 'not judged', None, None)])
def test_verdict_is_shown_and_decides_the_exit_code(
        setup, data, ticks, changes, verdict, stable, code):
    summary = summary_of(data.truncated(ticks), setup, **changes)
    assert (summary['verdict'], summary['stable']) == (verdict, stable)
    assert summary['ended_early'] == changes.get('ended_early')
    assert len(summary.get('events', ())) == len(changes.get('events', ()))
    assert f']{verdict}' in verdict_lines(summary, 'here')[1]
    if code is None:
        end_by_verdict(summary)
        return
    with pytest.raises(typer.Exit) as ended:
        end_by_verdict(summary)
    assert ended.value.exit_code == code


def test_truth_is_that_of_each_contact(setup, data):
    data.alpha_true[:, 1] = np.nan
    data.alpha_meas[:, 1] += 0.5
    summary = summary_of(data, setup, mode='external')
    assert (summary['truth'], summary['forces'], summary['without_truth']) == (
        False, 'measured', ['board'])
    table, board = (summary['contacts'][name]['rest'] for name in ('table', 'board'))
    assert (table['true_error_rms_n'], table['measured_error_rms_n']) == (0.0, None)
    assert (board['true_error_rms_n'], board['measured_error_rms_n']) == (None, 0.5)
    assert board['estimate_error_rms_n'] is None
    assert 'no ground truth of board' in headline(summary)
    labels = summary_table(summary).columns[0].cells
    assert {'rest: true error rms [N]', 'rest: measured error rms [N]'} < set(labels)
    shown = {panel.label for drawn in figures.run_figures(data, setup)[:2]
             for panel in drawn.panels}
    assert shown == {'force [N]', 'force [N], no ground truth'}


@pytest.mark.parametrize('verdict', ['stable', 'not stable: face: oscillates at 42 Hz'])
def test_figures_have_legal_file_names_and_a_bad_verdict(verdict, tmp_path, monkeypatch):
    titles = {}
    monkeypatch.setattr(figures.Figure, 'savefig', lambda figure, path, **_: titles.update(
        {path.name: figure.get_suptitle()}))
    setup = resolve('plane', plant='rigid', duration=10.0)
    figures.draw_figures(perfect_run(setup), setup, tmp_path, verdict=verdict)
    assert sorted(titles) == sorted(f'{name}.png' for name in (
        'fig3_force_face', 'fig4_force_face_along', 'fig3_3_force_face_across', 'fig5_motion',
        'fig6_noise_variance'))
    assert all((verdict in title) == (verdict != 'stable') for title in titles.values())
