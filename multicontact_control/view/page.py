"""The page in the browser: it knows snapshots and commands, not where they come from or go to."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
import html
import io
import json
from pathlib import Path
import time
from typing import Any

from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.judging.supervisor_events import LogLine
from multicontact_control.sensor.push_test import CANCELLED
from multicontact_control.supervision.causes import NONE
from multicontact_control.view.access import guard_viser_server
from multicontact_control.view.controls import CommandRequests, ControlPanel
from multicontact_control.view.curves import COLOURS, CurveCharts
from multicontact_control.view.scene import format_newtons, SceneView, STATE_COLOURS
from multicontact_control.view.source import Scene, Snapshot, SnapshotSource
import numpy as np
import viser
from viser._messages import RunJavascriptMessage

HOST = '127.0.0.1'
TURN_TIME = 0.01  # s, of the loop
TEXT_TIME = 0.25  # s, between texts
CURVES_TIME = 0.15  # s, between curves
LISTED_EVENTS = 12
NOTIFICATION_TIME = 6.0  # s
REPETITION_TIME = 3.0  # s, after which the same refusal is notified again
CURVES_WIDTH = 370  # px
CONTROLS_WIDTH = 340  # px
SLOW_PACE = 0.97  # real-time factor below which it is shown
SMALL = 'font-size:12px;line-height:18px;padding:2px 14px;white-space:pre-wrap;'
ONE_LINE = 'white-space:nowrap;overflow:hidden;text-overflow:ellipsis'
# Of what changes, so that nothing below moves under the mouse: 18 px for each line of text.
FIXED_HEIGHT = 'box-sizing:content-box;overflow-y:auto;height:{}px'
ANSWER_STYLE = FIXED_HEIGHT.format(18 * 4)
EVENTS_STYLE = FIXED_HEIGHT.format(18 * 12)
# What viser has no call for: when a value is a command, how large the ends of sliders are written,
# the title of the tab, and the time axes of charts, which uPlot leaves out of those that are made
# before their width is known.
SCRIPT = """
{watch_inputs}
watchInputs({sliders_wait});
window.slidersStyle ??= document.head.appendChild(Object.assign(document.createElement('style'), {{
  textContent: '.mantine-Slider-markLabel, .multi-slider-mark-label {{font-size: 11px !important}}'
}}));
document.title = {title};
window.axesTimer ??= setInterval(() => Object.values(window.__viserTestpoints?.uplots ?? {{}})
  .forEach(({{chart}}) => chart.axes[0]._space || chart.redraw(true, true)), 500);
"""
WATCH_INPUTS = Path(__file__).parent / 'page_assets' / 'commands.js'
GREEN, RED, GREY = '#34965c', '#c0392b', '#6b7280'


class Page:
    """
    The page of one source in the browsers of this machine: draws snapshots, gives commands.

    Parameters
    ----------
    source
        What is shown and steered.
    port
        TCP port that the page listens on; the next one that is free if it is taken.

    Attributes
    ----------
    url
        Address of the page.
    source, requests, server
        The source, the commands that wait, and the server of viser.
    newest
        The newest snapshot, None before the first.
    ended
        Why the source has ended, empty while it has not.
    status, contacts, answer, events
        Elements with texts: of the loop, the table of contacts, the answer to the last command,
        and the newest events.
    scene_view, controls, curves
        What else is on the page: the arm, the elements that steer, and the charts.

    Raises
    ------
    RunError
        If the server cannot be guarded against pages of other sites.

    """

    def __init__(self, source: SnapshotSource, port: int) -> None:
        self.source = source
        self.requests = CommandRequests()
        with guard_viser_server(), redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host=HOST, port=port, verbose=False)
        server.request_share_url = refuse_share_url
        self.server = server
        self.url = f'http://{HOST}:{server.get_port()}/'
        self.ended = ''
        self.newest: Snapshot | None = None
        self._events: deque[LogLine] = deque(maxlen=LISTED_EVENTS)
        self._listed: list[LogLine] = []
        self._last_notification = ''
        self._notification_time = 0.0
        self._push_test = ''
        self._curves_due = True
        # Whether the newest snapshot shows what came of the last command.
        self._shows_last_command = True
        self._next_texts = 0.0
        self._next_curves = 0.0
        self._build_elements(server.gui, source.scene)

    def _build_elements(self, gui: Any, scene: Scene) -> None:
        gui.configure_theme(
            show_logo=False,
            show_share_button=False,
            brand_color=(46, 116, 190),
            control_width='medium',
        )
        gui.set_panel_label('multicontact view')
        script = SCRIPT.format(
            watch_inputs=WATCH_INPUTS.read_text(encoding='utf-8'),
            # A recording may be searched with its slider.
            sliders_wait=json.dumps(scene.duration is None),
            title=json.dumps(scene.title),
        )
        gui._websock_interface.queue_message(RunJavascriptMessage(script))
        self.scene_view = SceneView(self.server, scene)
        self.status = gui.add_html('')
        self.contacts = gui.add_html('')
        self.answer = gui.add_html(_format_block('', ANSWER_STYLE))
        self.controls = ControlPanel(gui, scene, self.requests, self.scene_view)
        with gui.add_folder('Events', expand_by_default=True):
            self.events = gui.add_html(format_events([]))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        panel = gui.add_panel()
        with panel.add_tab('Curves'):
            self.curves = CurveCharts(gui, scene)
        panel.dock_left()
        panel.set_width(CURVES_WIDTH)
        self.status.content = _format_lines(
            html.escape(scene.title), '<b>waiting for samples</b>', '&nbsp;'
        )

    def run_until(self, should_stop: Callable[[], bool]) -> None:
        """
        Update the page every `TURN_TIME` until it is to stop.

        After the source has ended, its last snapshot stays on the page. A turn that takes longer
        is followed at once by the next, and what was missed is not made up for.
        """
        due = time.monotonic()
        while not should_stop():
            self.update_page()
            due = max(due + TURN_TIME, time.monotonic() - TURN_TIME)
            time.sleep(max(0.0, due - time.monotonic()))

    def update_page(self) -> None:
        """
        Give the command that has waited longest, and show what has come since the last call.

        Refusals of commands and the end of the source are shown on the page and not raised;
        nothing is drawn without a browser.
        """
        if self.ended:
            return
        request = self.requests.take_oldest()
        if request is not None:
            name, values = request
            self._shows_last_command = False
            self._give_command(name, values)
        try:
            snapshots = self.source.take_snapshots()
        except RunError as error:
            self.ended = str(error)
            self._change_elements(self._show_end)
            return
        for snapshot in snapshots:
            if snapshot.anew:
                self._events.clear()
            self.newest = snapshot
            self._shows_last_command = True
            self.curves.history.add_points(snapshot.points)
            self._events.extend(snapshot.events)
        if self.newest is not None and self.server.get_clients():
            self._change_elements(self._show_snapshot, self.newest, bool(snapshots))

    def _change_elements(self, change: Callable[..., None], *arguments: Any) -> None:
        """Call in the thread of viser's server, outside of which elements are not safe."""

        async def call_change() -> None:
            change(*arguments)

        called = asyncio.run_coroutine_threadsafe(
            call_change(), self.server.get_event_loop()
        )
        called.result()

    def _give_command(self, name: str, values: dict[str, Any]) -> None:
        colour = GREEN
        try:
            text = self.source.give_command(name, **values)
        except MulticontactError as error:
            colour = RED
            text = f'refused: {error}'
            self._change_elements(self._notify_browsers, 'refused', str(error))
        if text:
            self._change_elements(self._show_answer, text, f'color:{colour}')

    def _show_answer(self, text: str, style: str) -> None:
        self.answer.content = _format_block(
            html.escape(text), f'{style};{ANSWER_STYLE}'
        )

    def _show_end(self) -> None:
        self.status.content = _format_block(
            f'<b style="color:{RED}">{html.escape(self.ended)}</b>'
        )
        self._notify_browsers('ended', self.ended.splitlines()[0])

    def _show_snapshot(self, snapshot: Snapshot, is_new: bool) -> None:
        """Draw the newest snapshot if it is new; texts and curves when it is time for them."""
        now = time.monotonic()
        texts_due = now >= self._next_texts
        if is_new:
            self._curves_due = True
        with self.server.atomic():
            if is_new or texts_due:
                self.scene_view.draw_snapshot(snapshot, labels=texts_due)
            if texts_due:
                self._next_texts = now + TEXT_TIME
                self._show_texts(snapshot)
            events = list(self._events)
            if events != self._listed:
                self._listed = events
                self.events.content = format_events(events)
            if self._curves_due and now >= self._next_curves:
                self._next_curves = now + CURVES_TIME
                self._curves_due = False
                self.curves.draw_curves()

    def _show_texts(self, snapshot: Snapshot) -> None:
        scene = self.source.scene
        self.status.content = format_status(scene.title, snapshot)
        self.contacts.content = format_contacts(scene, snapshot)
        if self._shows_last_command:
            self.controls.show_snapshot(snapshot)
        if snapshot.push_test != self._push_test:
            # What the test asks for takes the place of the last answer.
            self._push_test = snapshot.push_test
            self._show_answer(self._push_test or CANCELLED, 'font-weight:bold')

    def _notify_browsers(self, title: str, text: str) -> None:
        """Notify all browsers; a text that repeats only every `REPETITION_TIME`."""
        now = time.monotonic()
        is_repeated = text == self._last_notification
        if is_repeated and now - self._notification_time < REPETITION_TIME:
            return
        self._last_notification = text
        self._notification_time = now
        for client in self.server.get_clients().values():
            client.add_notification(
                title, text, color='red', auto_close_seconds=NOTIFICATION_TIME
            )

    def close(self) -> None:
        """Stop the server; browsers that have the page open say that the connection is lost."""
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def refuse_share_url(*_arguments: Any, **_options: Any) -> None:
    """
    Refuse a public tunnel to the page, in place of the method of viser's server that opens one.

    Any browser that has the page open could ask the server for such a tunnel, and strangers would
    steer the arm by its address.
    """


def _format_block(content: str, style: str = '') -> str:
    return f'<div style="{SMALL}{style}">{content}</div>'


def _format_lines(*contents: str) -> str:
    """Return HTML with one line for each text, cut off where it is too long."""
    return ''.join([_format_block(content, ONE_LINE) for content in contents])


def format_status(title: str, snapshot: Snapshot) -> str:
    """
    Return three lines of HTML: what is shown; time and motion; the loop.

    The last line has the latency from sample to command [ms] and the number of late samples,
    or what the supervisor does instead of control, and why.
    """
    timing = snapshot.timing
    clock = f'<b>{snapshot.time:.1f} s</b>'
    if timing.pace < SLOW_PACE:
        clock = f'{clock}, real-time factor {timing.pace:.2f}'
    parts = [clock]
    if snapshot.held:
        parts.append('<b>held</b>')
    if snapshot.moving:
        parts.append(html.escape(snapshot.moving))
    loop = '&nbsp;'
    if snapshot.reaction != NONE:
        reaction = html.escape(snapshot.reaction)
        reasons = html.escape(' '.join(snapshot.reasons))
        loop = f'<b style="color:{RED}">{reaction}</b> {reasons}'
    elif np.isfinite(timing.typical):
        typical = 1e-3 * timing.typical
        worst = 1e-3 * timing.worst
        loop = f'latency {typical:.2f} ms, 99 % below {worst:.2f}'
        if timing.misses:
            loop = f'{loop} &middot; {timing.misses} late'
    return _format_lines(
        f'<span style="color:{GREY}">{html.escape(title)}</span>',
        ' &middot; '.join(parts),
        loop,
    )


def format_contacts(scene: Scene, snapshot: Snapshot) -> str:
    """
    Return a table in HTML with a row for each contact force and couple [N].

    Its columns are the name, the state of the contact with the colour that the view gives it,
    and the measured, estimated, desired and, in a simulator, true force.
    """
    forces = {
        'meas.': snapshot.measured,
        'est.': snapshot.estimated,
        'des.': snapshot.desired,
    }
    if scene.true_forces:
        forces['true'] = snapshot.true
    head = ''
    for label, colour in zip(forces, COLOURS):
        head += f'<td style="text-align:right;color:{colour}">{label}</td>'
    states = dict(zip(scene.config.force_columns, snapshot.states))
    rows = ''
    for column, name in enumerate(scene.config.column_names):
        state = ''
        if column in states:
            state = states[column]
            r, g, b = STATE_COLOURS.get(state, STATE_COLOURS['free'])
            state = f'<span style="color:rgb({r},{g},{b})">&#9679;</span> {html.escape(state)}'
        rows += f'<tr><td><b>{html.escape(name)}</b></td><td>{state}</td>'
        for values in forces.values():
            force = format_newtons(float(values[column]))
            rows += f'<td style="text-align:right">{force}</td>'
        rows += '</tr>'
    return _format_block(
        '<table style="width:100%;border-spacing:0">'
        f'<tr><td>N</td><td></td>{head}</tr>{rows}</table>'
    )


def format_events(events: Sequence[LogLine]) -> str:
    """
    Return a list of events in HTML, the newest first, in a block of fixed height.

    Each line has the time of the event [s] and its text; without events it says so.
    """
    lines = []
    for moment, text in reversed(events):
        lines.append(
            f'<span style="color:{GREY}">{moment:.2f} s</span> {html.escape(text)}'
        )
    return _format_block('<br>'.join(lines) or 'none yet', EVENTS_STYLE)
