"""Every kind of page in a browser: what it shows, and what it answers to the mouse."""

from contextlib import contextmanager
import io

from browser import Tab
from multicontact_control.experiment import report
from multicontact_control.experiment.claim_metrics import disturbance_summary, evidence_of
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.html_figure import figure, plot
from multicontact_control.experiment.html_parts import write_page
from multicontact_control.experiment.panels import COLOURS, MEASURED, Panel, Span, Trace, TRUE
from multicontact_control.experiment.results import LoadedRun
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.measure import TRACES
from multicontact_control.experiment.study.page import write_study_page
from multicontact_control.experiment.study.presets.compare.study import ComparisonStudy
from multicontact_control.experiment.study.presets.faults.study import FaultStudy
from multicontact_control.experiment.study.presets.robustness.study import RobustnessStudy
from multicontact_control.experiment.study.presets.sweep.config import StudyConfig
from multicontact_control.experiment.study.presets.sweep.plan import plan_sweep
from multicontact_control.experiment.study.presets.sweep.study import SweepStudy
from multicontact_control.experiment.study.study import report_study
from multicontact_control.experiment.summary import summarise
from multicontact_control.files import finite
import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console
from synthetic_run import disturbance_setup, paper_run

pytestmark = pytest.mark.browser
DRAWN = ('() => [...document.querySelectorAll(".figure")].every('
         'place => place.dataset.state == "drawn")')
PLOTS = """
() => [...document.querySelectorAll('.figure')].flatMap(place => place.plots.map(plot => ({
  name: place.id, axes: plot.axes.map(axis => axis.label),
  curves: plot.series.slice(1).map(series => series.label),
  title: plot.root.querySelector('.u-title')?.innerText || ''})))
"""
RANGES = ('() => [...document.querySelectorAll(".figure")].flatMap(place => place.plots.map('
          'plot => [plot.scales.x.min, plot.scales.x.max]))')
REACTION = 1.0  # s of the processor, which a busy machine does not change
SIZE = {'width': 1240, 'height': 900}  # px


@pytest.fixture
def tab(chromium):
    """Return what opens a file; nothing may be wrong with it in the end."""
    opened = []

    def open_file(path):
        opened.append(Tab(chromium, path.as_uri(), viewport=SIZE))
        opened[-1].page.wait_for_function(DRAWN)
        return opened[-1]

    yield open_file
    for each in opened:
        assert each.problems == []
        assert each.requests == []
        each.page.close()


def drag(page, selector, start, end):
    """Drag over an element, between two places given as shares of its width and height."""
    box = page.locator(selector).first.bounding_box()
    at = [(box['x'] + x * box['width'], box['y'] + y * box['height']) for x, y in (start, end)]
    page.mouse.move(*at[0])
    page.mouse.down()
    page.mouse.move(*at[1], steps=4)
    page.mouse.up()


@contextmanager
def reaction(page, condition, argument=None):
    """Wait until what is done to a page has made something true; it may not be much work."""
    session = page.context.new_cdp_session(page)
    session.send('Performance.enable', {'timeDomain': 'threadTicks'})

    def worked():
        metrics = session.send('Performance.getMetrics')['metrics']
        return next(entry['value'] for entry in metrics if entry['name'] == 'TaskDuration')

    before = worked()
    yield
    page.wait_for_function(condition, arg=argument)
    assert 0.0 < worked() - before < REACTION


@pytest.fixture(scope='module')
def spike_page(tmp_path_factory):
    """Return a page of a minute of noise, in which one sample is a peak and some are missing."""
    clock = np.arange(30000) / 500.0
    values = 0.2 * np.random.default_rng(0).standard_normal(30000)
    values[17321] = 9.0
    values[100:200] = np.nan
    values[150] = -3.0
    path = tmp_path_factory.mktemp('spike') / 'spike.html'
    panel = Panel('force [N]', [Trace('measured', values, MEASURED)], (-10.0, 10.0))
    logarithmic = Panel('R [N²]', [Trace('R', np.where(clock < 30.0, 0.6, 90.0), TRUE)],
                        levels=((0.6, 'paper, at rest'),))
    write_page(path, 'Spike', figure('spike', [
        plot(panel, clock, 'Force', shaded=[Span('rest', 10.0, 20.0)]),
        plot(logarithmic, clock)]))
    return path, clock, values


def test_browser_draws_every_sample_that_was_packed(tab, spike_page):
    path, clock, values = spike_page
    found = tab(path).page.evaluate('() => document.querySelector(".figure").plots[0].data')
    np.testing.assert_allclose(found[0], clock, atol=1e-9)
    drawn = np.array(found[1], dtype=np.float64)
    np.testing.assert_allclose(drawn, values, atol=2e-4)
    assert np.isnan(drawn[100:150]).all() and len(drawn) == 30000


def test_peak_of_one_sample_is_seen_at_every_zoom(tab, spike_page):
    """Of 30000 samples on 1200 pixels, of the 25 around it, and with it alone at the edge."""
    path, clock, _ = spike_page
    opened = tab(path)
    top, bottom = clock[17321], clock[150]
    for low, high, place, y in (
            (0.0, 60.0, top, 8.5), (30.0, 40.0, top, 8.5), (top - 0.3, top + 2.0, top, 8.5),
            (top - 0.02, top + 0.03, top, 8.5), (top, top + 0.01, top, 9.0),
            (0.0, 60.0, bottom, -2.8), (0.1, 0.6, bottom, -3.0)):
        opened.page.evaluate(
            '([low, high]) => document.querySelector(".figure").plots[0].setScale('
            '"x", {min: low, max: high})', [low, high])
        seen = opened.page.evaluate("""async ([x, y]) => {
          await new Promise(requestAnimationFrame);
          const plot = document.querySelector('.figure').plots[0];
          const at = [plot.valToPos(x, 'x', true), plot.valToPos(y, 'y', true)].map(Math.round);
          const pixels = plot.ctx.getImageData(at[0] - 3, at[1] - 3, 7, 7).data;
          let found = 0;
          for (let i = 0; i < pixels.length; i += 4) {
            found += pixels[i] < 180 && pixels[i + 2] > pixels[i] + 40;
          }
          return found;
        }""", [place, y])
        assert seen > 0, (low, high, y)


def test_drag_zooms_all_figures_and_double_click_shows_all_again(tab, spike_page):
    page = tab(spike_page[0]).page
    before = page.evaluate(RANGES)
    with reaction(page, f'() => ({RANGES})().every(([low, high]) => Math.abs(low - 15) < 0.5 && '
                        'Math.abs(high - 30) < 0.5)'):
        drag(page, '.u-over', (0.25, 0.5), (0.5, 0.5))
    with reaction(page, f'whole => JSON.stringify(({RANGES})()) == whole',
                  str(before).replace(' ', '')):
        page.locator('.u-over').first.dblclick()
    assert page.locator('.u-legend .u-series').nth(1).inner_text().startswith('measured')
    with reaction(page, '() => !document.querySelector(".figure").plots[0].series[1].show'):
        page.locator('.u-legend .u-series th').nth(1).click()


def test_browser_without_decompression_says_so(chromium, spike_page):
    page = chromium.new_page()
    page.add_init_script('delete window.DecompressionStream')
    page.goto(spike_page[0].as_uri())
    assert page.locator('.figure').inner_text().startswith('This browser cannot unpack')
    page.close()
    page = chromium.new_page(java_script_enabled=False)
    page.goto(spike_page[0].as_uri())
    assert page.locator('.figure').inner_text() == 'Its curves need JavaScript.'
    page.close()


def loaded_run(folder, plant, seed):
    """Return a recording made to the paper."""
    setup = disturbance_setup(plant)
    data = paper_run(setup, seed)
    summary = summarise(data, setup, mode='in_process', timing={
        'deadline_misses': 0, 'tick_us': {'p50': 61.5}})
    return LoadedRun(folder / f'{plant}{seed}', setup, data, summary)


def test_report_of_two_runs(tab, tmp_path, monkeypatch):
    monkeypatch.setattr(report, 'FORMATS', ('png',))
    runs = [loaded_run(tmp_path, 'puma', 0), loaded_run(tmp_path, 'rigid', 1)]
    path = report.write_report(runs, tmp_path / 'report')[0]
    assert path.stat().st_size < 2e6
    opened = tab(path)
    page = opened.page
    assert page.locator('h2').all_inner_texts()[0] == 'Side by side'
    claims = opened.cells(0)
    assert claims[0] == ['claim', 'in the paper', 'measured', 'verdict', 'why']
    verdicts = {row[0]: row[3] for row in claims[1:]}
    assert verdicts['The noise variance is about 0.6 N² at rest'] == 'holds'
    assert 'not judged' in verdicts.values()
    numbers = {row[0]: row[1:] for row in opened.cells(1)[1:]}
    contacts = runs[0].summary['contacts'].values()
    assert numbers['step rise 63 % [s]'] == [f'{c["step_rise_63_s"]:.4g}' for c in contacts]
    assert 'p50 61.5' in str(opened.cells(2))
    plots = page.evaluate(PLOTS)
    assert [plot['name'] for plot in plots] == [
        f'run{n}-{name}' for n in (0, 1) for name in ('force0', 'force1', 'motion', 'variance')]
    assert [plot['axes'][1] for plot in plots[:4]] == [
        'force [N]', 'force [N]', 'x [m]', 'R [N²]']
    assert {plot['axes'][0] for plot in plots} == {'time [s]'}
    assert plots[0]['title'] == 'Fig. 3: contact force table'
    assert plots[0]['curves'] == ['measured', 'true', 'estimated (AOB)', 'commanded']
    inks = opened.ink('.figure canvas')
    assert len(inks) == len(plots)
    for plot_, ink in zip(plots, inks):
        assert 0.01 < ink['share'] < 0.9, plot_
    assert '#54a24b' in inks[0]['colours']  # the estimate: above the true force, below commands
    assert '#f2f2f2' in inks[0]['colours']  # judged windows
    assert opened.ink('img')[0]['share'] > 0.05
    with reaction(page, '() => document.querySelector("details pre").offsetHeight > 100'):
        page.locator('details summary').first.click()


@pytest.fixture(scope='module')
def comparison(tmp_path_factory):
    """Return the page of a comparison, of runs made to the paper instead of simulated ones."""
    folder = tmp_path_factory.mktemp('compare')
    study = ComparisonStudy(('rigid',), ('fixed', 'window'), seeds=2, preset='best')
    cache, made = JobCache(folder), {}
    for job in study.jobs():
        setup = job.setup()
        if job.seed not in made:
            data = paper_run(setup, job.seed)
            summary = summarise(data, setup, mode='in_process', timing={})
            made[job.seed] = JobResult(finite({
                'summary': summary, 'disturbances': disturbance_summary(data, setup, None),
                'evidence': evidence_of(data, setup, summary), 'final_error_share': 0.0}),
                {'time': data.time, **{name: getattr(data, series)
                                       for name, series in TRACES.items()}}, 1.0)
        cache.save(job.key(), job, made[job.seed])
    run = JobRun(folder, cache, {job: job.key() for job in study.jobs()}, {})
    content = study.content(run)
    report_study(study, content, run, Console(file=io.StringIO(), width=160))
    return folder / 'comparison.html', content


def test_comparison_draws_the_line_that_is_clicked(tab, comparison):
    path, content = comparison
    opened = tab(path)
    page, rows = opened.page, content['rows']
    head, *lines = opened.cells(0)
    assert head[:4] == ['estimator', 'stable', 'unstable after motion start [s]', 'rest rms [N]']
    assert [line[1] for line in lines if line[0] == 'fixed'][0] == '2/2'
    forces = page.locator('#forces-rigid')
    assert forces.locator('.u-title').inner_text().startswith('rigid, fixed, AOB, seed 0: stable')
    plots = page.evaluate(PLOTS)
    assert [plot['axes'] for plot in plots[:3]] == [
        ['time [s]', 'table [N]'], ['time [s]', 'board [N]'], ['time [s]', 'R [N²]']]
    assert plots[2]['curves'] == ['R table', 'R board']
    assert plots[3]['name'] == 'overview-0' and plots[3]['axes'][1] == 'rms [N]'
    assert '#18794e' in opened.ink('#overview-0 canvas')[0]['colours']
    line = page.locator('tr.choice').nth(1)
    label = line.locator('td').first.inner_text()
    title = 'document.querySelector("#forces-rigid .u-title").innerText'
    with reaction(page, f'label => {title}.includes(label)', f'rigid, {label}, '):
        line.click()
    assert page.locator('tr.chosen').count() == 1
    with reaction(page, f'() => {title}.includes("seed 1")'):
        page.get_by_role('button', name='seed 1').click()
    drawn_last = (TRUE, TRUE, COLOURS[1])  # R of both contacts is the same
    for ink, colour in zip(opened.ink('#forces-rigid canvas'), drawn_last):
        assert 0.01 < ink['share'] < 0.9
        assert colour in ink['colours']
    assert all(row['key'] in page.content() for row in rows)


def map_page(folder):
    ratios, delays = (0.5, 1.0, 2.0), (0, 1)
    content = {
        'schema': 1, 'plants': ['rigid'], 'estimators': ['fixed'], 'ratios': ratios,
        'delays': delays, 'points': [
            {'plant': 'rigid', 'estimator': 'fixed', 'ratio': ratio, 'delay_ticks': delay,
             'stable': ratio < 2.0 or not delay, 'overshoot_percent': 20.0 * ratio, 'key': ''}
            for ratio in ratios for delay in delays],
        'linear': {'rigid': [{'label': 'R 0.6 N²', 'largest_ratio': [3.0, None]}]}}
    study = RobustnessStudy(('rigid',), ('fixed',), ratios, delays)
    return write_study_page(study.page(content, folder), folder / 'robustness')[-1]


def sweep_page(folder):
    study = SweepStudy(plan_sweep(StudyConfig.model_validate({
        'name': 'one', 'description': 'What <it> shows', 'scenario': 'step', 'plants': ['rigid'],
        'seeds': 2, 'grid': {'plant.surfaces.*.stiffness': [600.0, 60000.0]}})))
    table = pa.table({
        'stable': [True, True, True, False], 'error': pa.array([None] * 4, pa.string()),
        'verdict': ['stable'] * 3 + ['not stable'],
        'contacts.table.step_rise_63_s': [0.04, 0.05, 0.06, 0.07]})
    return write_study_page(study.page(table, folder), folder / 'sweep')[-1]


def faults_page(folder):
    rows = [FaultRow(kind, 'wrench', seed, 'hold', 0.004, 12.0, 0.2, safe, 'rigid', 'rest')
            for kind, seed, safe in (('nan', 1, True), ('nan', 2, True), ('spike', 1, False))]
    return write_study_page(FaultStudy().page(rows, folder), folder / 'faults')[-1]


@pytest.mark.parametrize(('make', 'title', 'row', 'finding', 'colour'), [
    (map_page, 'How wrong stiffness and delay may be', ['fixed', '0.5 - 2', '0.5 - 1'], '',
     '#f3dcdc'),
    (sweep_page, 'Sweep one', ['rigid', '600', '2/2', '0.045'], '4 runs: 3 stable, 1 not',
     '#1f3b73'),
    (faults_page, 'Faults of inputs and plant',
     ['wrench', 'nan', '2', 'hold', '4', '12.0', '0.20'], '3 faults of 2 kinds, 1 unsafe', '')],
    ids=['map', 'sweep', 'faults'])
def test_page_of_a_study(tab, tmp_path, make, title, row, finding, colour):
    path = make(tmp_path)
    assert path.stat().st_size < 1e6
    opened = tab(path)
    assert opened.page.locator('h1').inner_text() == title
    assert row in [line[:len(row)] for line in opened.cells(0)]
    assert finding in opened.page.locator('body').inner_text()
    inks = opened.ink('img')
    assert len(inks) == bool(colour)
    for ink in inks:
        assert 0.02 < ink['share'] < 0.9 and colour in ink['colours']
