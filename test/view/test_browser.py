"""The page in a browser: it loads without an error, and its elements steer."""

from __future__ import annotations

import threading
import time

from browser import PATIENCE, Tab
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view.embedded import EmbeddedSource
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
pytestmark = [pytest.mark.slow, pytest.mark.webgl]

SMALL = {'width': 520, 'height': 640}  # px: the processor draws all of them
BOTH_PANELS = {'width': 1100, 'height': 480}  # px, and something of the scene between them
# Twice a second is enough for a scene at which nobody looks.
SELDOM = """
const draw = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = callback => setTimeout(() => draw(callback), 500);
"""


def wait_for(condition, what):
    give_up = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < give_up, f'{what}: did not happen'
        time.sleep(0.05)


@pytest.fixture
def page():
    """Show a simulation on a page."""
    from multicontact_control.view.page import Page

    page = Page(EmbeddedSource(resolve('paper', plant='rigid')), port=8481)
    stop = threading.Event()
    thread = threading.Thread(target=page.run, args=(stop,), daemon=True)
    thread.start()
    yield page
    stop.set()
    thread.join()
    page.close()


def press(element, key):
    """
    Press a key on an element.

    `click` of playwright waits for two frames first, and beside other work now and then for ever,
    although the page draws.
    """
    element.focus()
    element.press(key)


def wait_for_frames(tab, number):
    """Wait until the page has drawn a number of times."""
    tab.evaluate("""async number => {
        while (number--) await new Promise(done => requestAnimationFrame(done));
    }""", number)


def open_page(page, chromium, size):
    """Return context and tab of a browser that shows a page with samples."""
    context = chromium.new_context(viewport=size)
    context.add_init_script(SELDOM)
    opened = Tab(context, page.url)
    opened.page.get_by_text('Press with 10 N').wait_for()
    wait_for(lambda: page.server.get_clients() and page.newest, 'a connection and samples')
    return context, opened


def pixel(page, tab, point_world):
    """Return where a point is seen in the first browser's window [px]."""
    camera = next(iter(page.server.get_clients().values())).camera
    scene = tab.locator('canvas').first.bounding_box()
    w, x, y, z = camera.wxyz
    right, down, ahead = Rotation.from_quat([x, y, z, w]).inv().apply(
        point_world - camera.position)
    scale = 0.5 * scene['height'] / np.tan(0.5 * camera.fov) / ahead
    return (scene['x'] + 0.5 * scene['width'] + scale * right,
            scene['y'] + 0.5 * scene['height'] + scale * down)


def test_page_loads_without_errors_and_a_slider_presses(page, chromium):
    context, opened = open_page(page, chromium, SMALL)
    tab = opened.page
    slider = tab.get_by_role('slider').first
    slider.focus()
    tab.keyboard.press('End')  # one key each: a slow browser makes two of two
    wait_for(lambda: page.newest.commanded['table'] == 30.0, 'the largest force')
    tab.keyboard.press('Home')
    wait_for(lambda: page.newest.commanded['table'] == 0.0, 'letting go')
    tab.keyboard.press('ArrowRight')
    refused = tab.get_by_text('refused: force on table')
    refused.wait_for()
    assert '0 or 3 to 30 N, found 0.5 N' in refused.inner_text()
    press(tab.get_by_role('button', name='Press with 10 N'), 'Enter')
    wait_for(lambda: page.newest.commanded['table'] == 10.0, 'the button')
    before = page.newest.time
    context.close()
    # Without a browser it goes on, and presses as before.
    wait_for(lambda: page.newest.time > before + 1.0, 'time to pass')
    assert page.newest.commanded == {'table': 10.0, 'board': 10.0}
    assert opened.problems == []


def test_operational_point_is_dragged_along_the_table_by_the_mouse(page, chromium):
    context, opened = open_page(page, chromium, BOTH_PANELS)
    tab, handle = opened.page, page.scene_view._handle
    press(tab.get_by_role('button', name='Press with 10 N'), 'Enter')
    wait_for(lambda: page.newest.states == ('holding', 'holding'), 'both contacts')
    press(tab.get_by_role('tab', name='Move'), 'Enter')
    press(tab.get_by_label('drag').first, 'Space')
    wait_for(lambda: handle.visible, 'the handle')
    start = page.newest.position_des.copy()
    wait_for(lambda: np.abs(handle.position - start).max() < 1e-3, 'the handle at the arm')
    wait_for_frames(tab, 4)  # the browser grasps what it has drawn
    # By its arrow along the table and the board: where that is, is seen by the handle alone.
    for far in np.linspace(0.12, 0.2, 9):
        tab.mouse.move(*pixel(page, tab, start + [far, 0.0, 0.0]))
        if far == 0.12:
            wait_for_frames(tab, 2)
            tab.mouse.down()
        time.sleep(0.2)
    wait_for(lambda: page.newest.position_des[0] > start[0] + 0.05, 'the way to where it is')
    tab.mouse.up()
    wait_for(lambda: page.newest.goal is None, 'the arrival')
    moved = page.newest.position_des - start
    assert 0.05 < moved[0] < 0.11 and np.abs(moved[1:]).max() < 1e-3
    assert page.newest.states == ('holding', 'holding')
    assert np.abs(page.newest.estimated - 10.0).max() < 1.0
    context.close()
    assert opened.problems == []
