"""The page in a browser: it loads without an error, and its elements steer."""

from __future__ import annotations

from contextlib import ExitStack
import threading
import time

from browser import Tab
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view.run import started
import numpy as np
import pytest
from ros_graph import own_domain, wait_for
from scipy.spatial.transform import Rotation

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
pytestmark = [pytest.mark.nightly, pytest.mark.browser, pytest.mark.ros]

BOTH_PANELS = {'width': 1100, 'height': 480}  # px, and something of the scene between them
SELDOM = """  // the processor draws all of it: twice a second is enough
const draw = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = callback => setTimeout(() => draw(callback), 500);
"""
FRAMES = """async number => {
    while (number--) await new Promise(done => requestAnimationFrame(done));
}"""


@pytest.fixture
def page():
    """Show a graph that was started for it on a page."""
    from multicontact_control.view.page import Page

    with own_domain() as domain_id, ExitStack() as stack:
        page = Page(started(
            resolve('paper', plant='rigid'), None, domain_id, stack, (), print), 8481)
        stop = threading.Event()
        thread = threading.Thread(target=page.run, args=(stop.is_set,), daemon=True)
        thread.start()
        yield page
        stop.set()
        thread.join()
        page.close()
        page.source.close()


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


def test_sliders_press_buttons_press_and_the_mouse_drags(page, chromium):
    context = chromium.new_context(viewport=BOTH_PANELS)
    context.add_init_script(SELDOM)
    opened = Tab(context, page.url)
    tab, handle = opened.page, page.server.scene.get_handle_by_name('/handle')
    tab.get_by_text('Press with 10 N').wait_for()
    wait_for(lambda: page.server.get_clients() and page.newest, 'a connection and samples')
    tab.get_by_role('button', name='Press with 10 N').press('Enter')
    wait_for(lambda: page.newest.states == ('holding', 'holding'), 'both contacts')
    tab.get_by_role('tab', name='Move').press('Enter')
    tab.get_by_label('drag').first.press('Space')
    wait_for(lambda: handle.visible, 'the handle')
    start = page.newest.position_des.copy()
    wait_for(lambda: np.abs(handle.position - start).max() < 1e-3, 'the handle at the arm')
    tab.evaluate(FRAMES, 4)  # the browser grasps what it has drawn
    # By its arrow along the table and the board.
    for far in np.linspace(0.12, 0.2, 9):
        tab.mouse.move(*pixel(page, tab, start + [far, 0.0, 0.0]))
        if far == 0.12:
            tab.evaluate(FRAMES, 2)
            tab.mouse.down()
        time.sleep(0.2)
    wait_for(lambda: page.newest.position_des[0] > start[0] + 0.05, 'the way to where it is')
    tab.mouse.up()
    wait_for(lambda: page.newest.goal is None, 'the arrival')
    moved = page.newest.position_des - start
    assert 0.05 < moved[0] < 0.11 and np.abs(moved[1:]).max() < 1e-3
    assert page.newest.states == ('holding', 'holding')
    assert np.abs(page.newest.estimated - 10.0).max() < 1.0
    tab.get_by_role('tab', name='Press').press('Enter')
    tab.get_by_role('slider').first.focus()
    tab.keyboard.press('End')  # one key each: a slow browser makes two of two
    wait_for(lambda: page.newest.commanded['table'] == 30.0, 'the largest force')
    tab.keyboard.press('Home')
    wait_for(lambda: page.newest.commanded['table'] == 0.0, 'letting go')
    tab.keyboard.press('ArrowRight')
    tab.get_by_text('force on table').wait_for()
    context.close()
    assert opened.problems == []
