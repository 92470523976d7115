"""The page in a browser: it loads without an error, and its elements steer."""

from contextlib import closing, ExitStack
import threading

from browser import Tab
from multicontact_control.runs.graph.domain import reserve_domain
from multicontact_control.runs.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.run import start_simulated_graph, ViewSubject
import numpy as np
import pytest
from ros_graph import wait_for

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
pytestmark = [pytest.mark.nightly, pytest.mark.browser, pytest.mark.ros]

SELDOM = """  // the processor draws all of it: twice a second is enough
const draw = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = callback => setTimeout(() => draw(callback), 500);
"""


@pytest.fixture
def page():
    """Show a simulated graph, which starts for it, on a page."""
    from multicontact_control.view.page import Page

    with reserve_domain() as domain_id, ExitStack() as stack:
        subject = ViewSubject(resolve('paper', plant='rigid'), domain_id=domain_id)
        shown = stack.enter_context(
            closing(start_simulated_graph(subject, stack, (), print))
        )
        page = stack.enter_context(closing(Page(shown, 8481)))
        stop = threading.Event()
        thread = threading.Thread(
            target=page.run_until, args=(stop.is_set,), daemon=True
        )
        thread.start()
        yield page
        stop.set()
        thread.join()


@pytest.fixture
def given(page, monkeypatch):
    """Return the forces that the page commands, as it goes on."""
    forces, command = [], page.source.give_command

    def record(name, /, **values):
        forces.extend([values] if name == source.FORCES else [])
        return command(name, **values)

    monkeypatch.setattr(page.source, 'give_command', record)
    return forces


def test_force_is_commanded_when_it_is_entered_and_every_browser_shows_what_is_obeyed(
    page, given, chromium
):
    context = chromium.new_context(viewport={'width': 1100, 'height': 480})
    context.add_init_script(SELDOM)
    tabs = [Tab(context, page.url).page for _ in range(2)]
    own, other = (tab.locator('.mantine-NumberInput-input').first for tab in tabs)
    thumb = tabs[0].get_by_role('slider').first
    for field in (own, other):
        field.wait_for()
    wait_for(lambda: page.newest, 'samples')

    def shows(force):
        return [
            thumb.get_attribute('aria-valuenow'),
            own.input_value(),
            other.input_value(),
        ] == [force] * 3

    for text, key in (('8', 'Enter'), ('15', 'Enter'), ('25', 'Tab')):
        own.select_text()
        own.press('Backspace')
        own.press_sequentially(
            text, delay=80
        )  # as of one who types: viser sends what waits 50 ms
        assert not shows(text)
        own.press(key)
        wait_for(lambda text=text: shows(text), f'{text} N')
    assert given == [{'table': 8.0}, {'table': 15.0}, {'table': 25.0}]
    for text, key in (('250', 'Enter'), ('250', 'Tab'), ('1', 'Tab')):
        before = len(given)
        own.select_text()
        own.press_sequentially(text, delay=80)
        own.press(key)
        wait_for(lambda before=before: len(given) > before, 'a command that is refused')
        wait_for(lambda: shows('25'), 'the force that is obeyed')
    for text, key in (('', 'Enter'), ('12', 'Escape'), ('-', 'Tab')):
        own.select_text()
        own.press('Backspace')
        own.press_sequentially(text, delay=80)
        own.press(key)
        wait_for(lambda: shows('25'), 'the force that is obeyed')
    context.close()


def test_slider_commands_a_force_when_it_is_released(page, given, chromium):
    context = chromium.new_context(viewport={'width': 1100, 'height': 480})
    context.add_init_script(SELDOM)
    own, other = (Tab(context, page.url).page for _ in range(2))
    thumb = own.get_by_role('slider').first
    fields = [tab.locator('.mantine-NumberInput-input').first for tab in (own, other)]
    for field in fields:
        field.wait_for()
    wait_for(lambda: page.newest, 'samples')
    track = own.locator('.mantine-Slider-trackContainer').first.bounding_box()
    middle = track['y'] + 0.5 * track['height']
    own.mouse.move(track['x'] + 0.8 * track['width'], middle)
    own.mouse.down()
    for share in (0.7, 0.6, 0.5, 0.4):
        own.mouse.move(track['x'] + share * track['width'], middle)
        wait_for(
            lambda share=share: (
                abs(float(thumb.get_attribute('aria-valuenow')) - 30.0 * share) < 1.0
            ),
            'the slider',
        )
    assert given == [] and fields[1].input_value() == '0', 'it has not been released'
    own.mouse.up()
    wait_for(
        lambda: [field.input_value() for field in fields] == ['12', '12'],
        'the force in both browsers',
    )
    wait_for(lambda: page.newest.commanded['table'] == 12.0, 'the force')
    assert given == [{'table': 12.0}]
    context.close()


def test_buttons_press_and_move_and_sliders_command_forces(page, chromium):
    context = chromium.new_context(viewport={'width': 1100, 'height': 480})
    context.add_init_script(SELDOM)
    opened = Tab(context, page.url)
    tab = opened.page
    tab.get_by_text('Press with 10 N').wait_for()
    wait_for(
        lambda: page.server.get_clients() and page.newest, 'a connection and samples'
    )
    tab.wait_for_function(
        'Object.values(__viserTestpoints.uplots).every('
        'x => x.chart.axes.every(axis => axis._splits?.length >= 3))'
    )
    assert tab.title() == page.source.scene.title
    place = tab.get_by_role('tab', name='Move').bounding_box()
    tab.get_by_role('button', name='Press with 10 N').press('Enter')
    wait_for(lambda: page.newest.states == ('holding', 'holding'), 'both contacts')
    assert tab.get_by_role('tab', name='Move').bounding_box() == place, (
        'a line moved it'
    )
    start = page.newest.position_des.copy()
    tab.get_by_role('tab', name='Move').press('Enter')
    tab.get_by_label('drag handle').first.press('Space')
    handle = page.server.scene.get_handle_by_name('/handle')
    wait_for(
        lambda: handle.visible and np.abs(handle.position - start).max() < 1e-3,
        'the handle at the arm',
    )
    tab.get_by_role('button', name='+x').first.press('Enter')
    wait_for(lambda: page.newest.position_des[0] > start[0] + 0.0099, 'the jog')
    assert page.newest.states == ('holding', 'holding')
    assert np.abs(page.newest.estimated - 10.0).max() < 1.0
    tab.get_by_role('tab', name='Press').press('Enter')
    tab.get_by_role('button', name='Press with 10 N').wait_for()
    slider = tab.get_by_role('slider').first
    # Again and again: a page that is being drawn may miss what is done with it.
    wait_for(
        lambda: slider.press('End') or page.newest.commanded['table'] == 30.0,
        'most force',
    )
    wait_for(
        lambda: slider.press('Home') or page.newest.commanded['table'] == 0.0,
        'no force',
    )
    slider.press('ArrowRight')
    tab.get_by_text('force on table: expected 0 or').first.wait_for()
    for label, held in (('Hold pose and forces', True), ('Release the hold', False)):
        tab.get_by_role('button', name=label).press('Enter')
        wait_for(lambda held=held: page.newest.held is held, label)
    tab.get_by_role('tab', name='World').press('Enter')
    thumb = tab.locator('.multi-slider-thumb').first
    goal = tab.get_by_text('10 000').first

    def dragged_to_goal():
        thumb.drag_to(goal)
        tab.wait_for_timeout(
            2e3
        )  # a drag that begins while the last is obeyed moves it on
        return 9e3 < page.newest.surfaces['table'].stiffness < 1.1e4

    wait_for(dragged_to_goal, 'a stiffer table')
    wait_for(
        lambda: float(tab.get_by_label('stiffness').first.input_value()) > 9e3,
        'its number',
    )
    context.close()
    assert opened.problems == []
