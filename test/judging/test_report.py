"""Reports: of a run folder that is read back, their pages, and one of them in a browser."""

import json
import re
import shutil

from browser import Tab
from multicontact_control.cli.application import app
from multicontact_control.errors import ConfigError
from multicontact_control.files import replace_json_file
from multicontact_control.judging import figure_files, report
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.page import render_figure, thin_series, write_page
from multicontact_control.judging.panels import Panel, RunFigure, Trace
from multicontact_control.judging.results import load_run
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from synthetic_run import paper_run
from typer.testing import CliRunner

FIGURES = ['fig3_force_table', 'fig4_force_board', 'fig5_motion', 'fig6_noise_variance']
CLAIMS = ('Claims of the paper', 'as in the paper', 'not judged')
RANGES = (
    '() => [...document.querySelectorAll(".figure")].flatMap(place => place.plots.map('
    'plot => [plot.scales.x.min, plot.scales.x.max]))'
)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Make a run folder with a recording made to the paper."""
    folder = tmp_path_factory.mktemp('run')
    setup = resolve('disturbance', plant='puma')
    data = paper_run(setup)
    metrics = RunMetrics(data, setup)
    timing = {'kernels_compiled': 0}
    summary = summarise_run(metrics, mode='in_process', timing=timing)
    setup.write(folder / 'config')
    data.save(folder)
    replace_json_file(folder / 'summary.json', summary)
    return folder


def report_of(folder, out, *options):
    """Return what the command prints, and its page."""
    arguments = ['report', str(folder), '--out', str(out), *options]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output, (out / 'report.html').read_text(encoding='utf-8')


def test_report_command_writes_a_page_and_figures(folder, tmp_path):
    printed, text = report_of(folder, tmp_path)
    assert 'claim of the paper' not in printed
    for words in (
        'Contact force: table',
        'Noise variance',
        'Timing',
        'damping_rate: 100.0',
    ):
        assert words in text
    for words in CLAIMS:
        assert words not in text
    assert len(text) < 1e6
    files = {path.name for path in (tmp_path / 'figures').iterdir()}
    assert files == {
        *(f'{name}.pdf' for name in FIGURES),
        *(f'{name}.png' for name in FIGURES),
    }


def test_report_command_judges_the_claims_if_asked_to(folder, tmp_path):
    printed, text = report_of(folder, tmp_path, '--claims')
    assert 'claim of the paper' in printed
    for words in CLAIMS:
        assert words in text


def test_run_is_loaded_by_text_and_one_without_a_summary_is_said_to_be_one(
    folder, tmp_path
):
    assert load_run(str(folder)).summary == load_run(folder).summary
    shutil.copytree(folder / 'config', tmp_path / 'config')
    with pytest.raises(
        ConfigError,
        match='expected a run with summary.json, got one without, '
        'which did not come to its end; `multicontact report` reads',
    ):
        load_run(tmp_path)


def test_report_of_two_runs_has_figures_of_both_and_one_table(
    folder, tmp_path, monkeypatch
):
    monkeypatch.setattr(figure_files, 'FIGURE_FORMATS', ('png',))
    run = load_run(folder)
    runs = [run._replace(folder=tmp_path / name / 'first') for name in 'ab']
    page, *figures = report.write_report(runs, tmp_path / 'out')
    assert len(set(figures)) == 9
    assert all(path.is_file() for path in figures)
    before_figures, _, _ = page.read_text(encoding='utf-8').partition('<h2>')
    (table,) = re.findall('<table>.*?</table>', before_figures)
    rows = {}
    for row in re.findall('<tr>.*?</tr>', table):
        label, *values = re.findall('<t[hd].*?>(.*?)</t[hd]>', row)
        rows[label] = values
    assert rows.pop('') == ['a/first', 'b/first']
    assert {
        'verdict',
        'table: step rise 63 % [s]',
        'board: step rise 63 % [s]',
        'arm',
    } <= rows.keys()
    for first, second in rows.values():
        assert first == second


def test_page_needs_no_other_file(tmp_path):
    traces = [Trace('', np.array([1e-3, 0.6, np.nan, np.inf, -1.0]))]
    linear = Panel('R </script>', traces, logarithmic=False)
    logarithmic = Panel('R </script>', traces, logarithmic=True)
    figure = RunFigure('', 'Forces', [linear, logarithmic])
    drawn = render_figure('forces', figure, np.arange(5.0))
    embedded = re.search(r'json">(.*)</script>', drawn)[1]
    values = [each['data'][1] for each in json.loads(embedded)]
    assert values == [[1e-3, 0.6, None, None, -1.0], [1e-3, 0.6, None, None, None]]
    page = tmp_path / 'page.html'
    write_page(page, 'Title <1>', drawn)
    text = page.read_text(encoding='utf-8')
    assert 'Title &lt;1&gt;' in text
    assert 'uPlot (v' in text
    assert 'Copyright (c) 2022 Leon Sorokin' in text
    assert 'R </script>' not in text
    assert not re.search(r'<script[^>]+src=|<link|<img[^>]+src="http', text)
    write_page(page, 'No figure', '<p>text</p>')
    assert 'uPlot (v' not in page.read_text(encoding='utf-8')


def test_envelope_keeps_every_peak_and_its_place():
    time = np.arange(10001) / 500.0
    values = np.sin(time)
    values[4321] = 50.0
    values[777] = -40.0
    x, (y, clock) = thin_series(time, [values, time], 200)
    place = x[y.argmax()]
    assert len(x) == len(y) <= 202
    assert y.max() == 50.0
    assert y.min() == -40.0
    assert (np.diff(x) >= 0.0).all()
    assert (np.diff(clock) >= 0.0).all()
    assert place == pytest.approx(time[4321], abs=101 / 500.0)


@pytest.mark.browser
@pytest.mark.nightly
def test_report_in_a_browser(folder, chromium, tmp_path, monkeypatch):
    monkeypatch.setattr(figure_files, 'FIGURE_FORMATS', ('png',))
    path = report.write_report([load_run(folder)], tmp_path)[0]
    opened = Tab(chromium, path.as_uri(), viewport={'width': 1240, 'height': 900})
    tab = opened.page
    tab.wait_for_function(
        '() => [...document.querySelectorAll(".figure")].every('
        'place => place.dataset.state == "drawn")'
    )
    names = [place.get_attribute('id') for place in tab.query_selector_all('.figure')]
    assert names == [f'run0-{name}' for name in FIGURES]
    inks = opened.ink('.figure canvas')
    assert len(inks) == 7
    assert min(inks) > 0.01
    assert max(inks) < 0.99
    whole = tab.evaluate(RANGES)
    over = tab.locator('.u-over').first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    left = box['x'] + 0.25 * box['width']
    middle = box['x'] + 0.5 * box['width']
    height = box['y'] + 50
    tab.mouse.move(left, height)
    tab.mouse.down()
    tab.mouse.move(middle, height, steps=4)
    tab.mouse.up()
    tab.wait_for_function(  # a drag zooms all figures, a double click shows all again
        f'whole => ({RANGES})().every(([low, high], i) => high - low < 0.3 * whole[i][1])',
        arg=whole,
    )
    over.dblclick()
    tab.wait_for_function(
        f'whole => JSON.stringify(({RANGES})()) == JSON.stringify(whole)', arg=whole
    )
    assert opened.problems == []
    assert opened.requests == []
