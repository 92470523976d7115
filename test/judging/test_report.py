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
    setup.write(folder / 'config')
    data.save(folder)
    replace_json_file(
        folder / 'summary.json',
        summarise_run(
            RunMetrics(data, setup), mode='in_process', timing={'kernels_compiled': 0}
        ),
    )
    return folder


def test_report_command_writes_a_page_and_figures(folder, tmp_path):
    claims = ('Claims of the paper', 'as in the paper', 'not judged')
    for options, shown in (((), ()), (('--claims',), claims)):
        result = CliRunner().invoke(
            app, ['report', str(folder), '--out', str(tmp_path), *options]
        )
        assert result.exit_code == 0, result.output
        assert ('claim of the paper' in result.output) == bool(options)
        text = (tmp_path / 'report.html').read_text(encoding='utf-8')
        for words in (
            'Contact force: table',
            'Noise variance',
            'Timing',
            'damping_rate: 100.0',
            *claims,
        ):
            assert (words in text) == (words not in claims or words in shown)
        assert len(text) < 1e6
    assert sorted(path.name for path in (tmp_path / 'figures').iterdir()) == [
        f'{name}.{ending}'
        for name in (
            'fig3_force_table',
            'fig4_force_board',
            'fig5_motion',
            'fig6_noise_variance',
        )
        for ending in ('pdf', 'png')
    ]


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
    runs = [
        load_run(folder)._replace(folder=tmp_path / name / 'first') for name in 'ab'
    ]
    paths = report.write_report(runs, tmp_path / 'out')[1:]
    assert len(paths) == len(set(paths)) == 9 and all(path.is_file() for path in paths)
    (table,) = re.findall(
        '<table>.*?</table>',
        (tmp_path / 'out/report.html').read_text(encoding='utf-8').partition('<h2>')[0],
    )
    head, verdict, *numbers = [
        re.findall('<t[hd].*?>(.*?)</t[hd]>', row)
        for row in re.findall('<tr>.*?</tr>', table)
    ]
    assert head == ['', 'a/first', 'b/first'] and verdict[0] == 'verdict'
    rows = {label: values for label, *values in numbers}
    assert {
        'table: step rise 63 % [s]',
        'board: step rise 63 % [s]',
        'arm',
    } <= rows.keys()
    assert all(len(values) == 2 and values[0] == values[1] for values in rows.values())


def test_page_needs_no_other_file(tmp_path):
    values = np.array([1e-3, 0.6, np.nan, np.inf, -1.0])
    drawn = render_figure(
        'forces',
        RunFigure(
            '',
            'Forces',
            [
                Panel('R </script>', [Trace('', values)], logarithmic=log)
                for log in (False, True)
            ],
        ),
        np.arange(5.0),
    )
    made = json.loads(re.search(r'json">(.*)</script>', drawn)[1])
    assert [each['data'][1] for each in made] == [
        [1e-3, 0.6, None, None, -1.0],
        [1e-3, 0.6, None, None, None],
    ]
    write_page(tmp_path / 'page.html', 'Title <1>', drawn)
    text = (tmp_path / 'page.html').read_text(encoding='utf-8')
    assert 'Title &lt;1&gt;' in text and 'uPlot (v' in text
    assert 'Copyright (c) 2022 Leon Sorokin' in text and 'R </script>' not in text
    assert not re.search(r'<script[^>]+src=|<link|<img[^>]+src="http', text)
    write_page(tmp_path / 'page.html', 'No figure', '<p>text</p>')
    assert 'uPlot (v' not in (tmp_path / 'page.html').read_text(encoding='utf-8')


def test_envelope_keeps_every_peak_and_its_place():
    time = np.arange(10001) / 500.0
    values = np.sin(time)
    values[4321], values[777] = 50.0, -40.0
    x, (y, clock) = thin_series(time, [values, time], 200)
    assert len(x) == len(y) <= 202
    assert (y.max(), y.min()) == (50.0, -40.0)
    assert (np.diff(x) >= 0.0).all() and (np.diff(clock) >= 0.0).all()
    assert abs(x[y.argmax()] - time[4321]) <= 101 / 500.0


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
    assert names == [
        f'run0-{name}'
        for name in (
            'fig3_force_table',
            'fig4_force_board',
            'fig5_motion',
            'fig6_noise_variance',
        )
    ]
    inks = opened.ink('.figure canvas')
    assert len(inks) == 7 and all(0.01 < ink < 0.99 for ink in inks)
    whole = tab.evaluate(RANGES)
    over = tab.locator('.u-over').first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    tab.mouse.move(box['x'] + 0.25 * box['width'], box['y'] + 50)
    tab.mouse.down()
    tab.mouse.move(box['x'] + 0.5 * box['width'], box['y'] + 50, steps=4)
    tab.mouse.up()
    tab.wait_for_function(  # a drag zooms all figures, a double click shows all again
        f'whole => ({RANGES})().every(([low, high], i) => high - low < 0.3 * whole[i][1])',
        arg=whole,
    )
    over.dblclick()
    tab.wait_for_function(
        f'whole => JSON.stringify(({RANGES})()) == JSON.stringify(whole)', arg=whole
    )
    assert (opened.problems, opened.requests) == ([], [])
