"""The page: it knows snapshots and commands, not where they come from or go to."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import redirect_stdout
import html
import io
import json
from pathlib import Path
import time
from typing import Any

from multicontact_control.errors import MulticontactError, RunError
from multicontact_control.sensor.push_test import CANCELLED
from multicontact_control.supervision.reactions import NONE
from multicontact_control.view.access import guarding
from multicontact_control.view.controls import Controls, Requests
from multicontact_control.view.curves import COLOURS, CurveCharts
from multicontact_control.view.scene import newtons, SceneView, STATE_COLOURS
from multicontact_control.view.source import Scene, Snapshot, Source
import numpy as np
import viser
from viser._messages import RunJavascriptMessage

HOST = '127.0.0.1'
TURN = 0.01  # s
TEXT_TIME, CURVES_TIME = 0.25, 0.15  # s
LISTED = 12  # events
TOAST_TIME = 6.0  # s
AGAIN = 3.0  # s, after which the same refusal is told again
CURVES_WIDTH, CONTROLS_WIDTH = 370, 340  # px
SMALL = 'font-size:12px;line-height:18px;padding:2px 14px;white-space:pre-wrap;'
ONE_LINE = 'white-space:nowrap;overflow:hidden;text-overflow:ellipsis'
# Of what changes, so that nothing below moves under the mouse: px, of four lines and of twelve.
ANSWER, EVENTS = (
    f'box-sizing:content-box;height:{18 * lines}px;overflow-y:auto' for lines in (4, 12)
)
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
    A page in the browser for one source.

    Parameters
    ----------
    source
        What is shown and steered.
    port
        To listen on; the next one that is free.

    Attributes
    ----------
    url
        Of the page.
    requests
        Commands that were asked for.
    newest
        Snapshot, None before the first.
    ended
        Why there is nothing more to see, empty as long as there is.
    status, contacts, answer, events
        Elements with the texts: of the loop, the table of contacts, what came of the last command,
        and what happened.

    """

    def __init__(self, source: Source, port: int) -> None:
        self.source, self.requests = source, Requests()
        with guarding(), redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host=HOST, port=port, verbose=False)
        server.request_share_url = lambda *_, **__: (
            None
        )  # a client could ask for a public tunnel
        self.server = server
        self.url = f'http://{HOST}:{server.get_port()}/'
        self.ended = ''
        self.newest: Snapshot | None = None
        self._events: deque[tuple[float, str]] = deque(maxlen=LISTED)
        self._listed: list[tuple[float, str]] = []
        self._toast, self._push_test, self._undrawn = ('', 0.0), '', True
        self._answered = (
            True  # whether the newest snapshot shows what came of the last command
        )
        self._next_texts = self._next_curves = 0.0
        self._build(server.gui, source.scene)

    def _build(self, gui: Any, scene: Scene) -> None:
        gui.configure_theme(
            show_logo=False,
            show_share_button=False,
            brand_color=(46, 116, 190),
            control_width='medium',
        )
        gui.set_panel_label('multicontact view')
        gui._websock_interface.queue_message(
            RunJavascriptMessage(
                SCRIPT.format(
                    watch_inputs=WATCH_INPUTS.read_text(encoding='utf-8'),
                    # A recording may be searched with its slider.
                    sliders_wait=json.dumps(scene.duration is None),
                    title=json.dumps(scene.title),
                )
            )
        )
        self.scene_view = SceneView(self.server, scene)
        self.status = gui.add_html('')
        self.contacts = gui.add_html('')
        self.answer = gui.add_html(_line('', ANSWER))
        self.controls = Controls(gui, scene, self.requests, self.scene_view)
        with gui.add_folder('Events', expand_by_default=True):
            self.events = gui.add_html(events_html([]))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        panel = gui.add_panel()
        with panel.add_tab('Curves'):
            self.curves = CurveCharts(
                gui,
                scene.config.column_names,
                scene.config.robot.joint_names,
                scene.true_forces,
            )
        panel.dock_left()
        panel.set_width(CURVES_WIDTH)
        self.status.content = _lines(
            html.escape(scene.title), '<b>waiting for samples</b>', '&nbsp;'
        )

    def run(self, stop: Callable[[], bool]) -> None:
        """Give commands and show what comes until it is to stop; what has ended stays."""
        due = time.monotonic()
        while not stop():
            self.update()
            due = max(due + TURN, time.monotonic() - TURN)
            time.sleep(max(0.0, due - time.monotonic()))

    def update(self) -> None:
        """Give the command that has waited longest, and show what has come since the last call."""
        if self.ended:
            return
        if (asked := self.requests.take()) is not None:
            self._answered = False
            self._give(*asked)
        try:
            snapshots = self.source.poll()
        except RunError as error:
            self.ended = str(error)
            self._write(self._show_end)
            return
        for snapshot in snapshots:
            if snapshot.anew:
                self._events.clear()
            self.newest, self._answered = snapshot, True
            self.curves.history.add_points(snapshot.points)
            self._events.extend(snapshot.events)
        if self.newest is not None and self.server.get_clients():
            self._write(self._show, self.newest, bool(snapshots))

    def _write(self, work: Callable[..., None], *arguments: Any) -> None:
        """Change elements in the thread of viser's server, which they are not safe outside of."""

        async def change() -> None:
            work(*arguments)

        asyncio.run_coroutine_threadsafe(
            change(), self.server.get_event_loop()
        ).result()

    def _give(self, name: str, values: dict[str, Any]) -> None:
        try:
            colour, text = GREEN, self.source.command(name, **values)
        except MulticontactError as error:
            colour, text = RED, f'refused: {error}'
            self._write(self._notify, 'refused', str(error))
        if text:
            self._write(self._show_answer, text, f'color:{colour}')

    def _show_answer(self, text: str, style: str) -> None:
        self.answer.content = _line(html.escape(text), f'{style};{ANSWER}')

    def _show_end(self) -> None:
        self.status.content = _line(
            f'<b style="color:{RED}">{html.escape(self.ended)}</b>'
        )
        self._notify('ended', self.ended.splitlines()[0])

    def _show(self, snapshot: Snapshot, new: bool) -> None:
        """Show a `new` snapshot; of the newest one, now and then what follows the user as well."""
        now, scene, events = time.monotonic(), self.source.scene, [*self._events]
        texts, self._undrawn = now >= self._next_texts, self._undrawn or new
        with self.server.atomic():
            if new or texts:
                self.scene_view.show(snapshot, labels=texts)
            if texts:
                self._next_texts = now + TEXT_TIME
                self.status.content = status_html(scene.title, snapshot)
                self.contacts.content = contacts_html(scene, snapshot)
                if self._answered:
                    self.controls.show(snapshot)
                if (
                    snapshot.push_test != self._push_test
                ):  # takes the place of the last answer
                    self._push_test = snapshot.push_test
                    self._show_answer(self._push_test or CANCELLED, 'font-weight:bold')
            if events != self._listed:
                self._listed = events
                self.events.content = events_html(events)
            if self._undrawn and now >= self._next_curves:
                self._next_curves, self._undrawn = now + CURVES_TIME, False
                self.curves.draw()

    def _notify(self, title: str, text: str) -> None:
        """Notify all browsers, but not of the same again and again."""
        now = time.monotonic()
        before, when = self._toast
        if text == before and now - when < AGAIN:
            return
        self._toast = text, now
        for client in self.server.get_clients().values():
            client.add_notification(
                title, text, color='red', auto_close_seconds=TOAST_TIME
            )

    def close(self) -> None:
        """Close the page."""
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def _line(content: str, style: str = '') -> str:
    return f'<div style="{SMALL}{style}">{content}</div>'


def _lines(*contents: str) -> str:
    return ''.join(_line(content, ONE_LINE) for content in contents)


def status_html(title: str, snapshot: Snapshot) -> str:
    """Return what is shown, the time, and how regular the loop is or what takes its place."""
    timing = snapshot.timing
    slow = f', real-time factor {timing.pace:.2f}' if timing.pace < 0.97 else ''
    parts = [f'<b>{snapshot.time:.1f} s</b>{slow}']
    if snapshot.held:
        parts.append('<b>held</b>')
    if snapshot.moving:
        parts.append(html.escape(snapshot.moving))
    regular = '&nbsp;'
    if np.isfinite(timing.typical):
        regular = (
            f'latency {1e-3 * timing.typical:.2f} ms, 99 % below {1e-3 * timing.worst:.2f}'
            + (f' &middot; {timing.misses} late' if timing.misses else '')
        )
    if snapshot.reaction != NONE:
        reasons = html.escape(' '.join(snapshot.reasons))
        regular = (
            f'<b style="color:{RED}">{html.escape(snapshot.reaction)}</b> {reasons}'
        )
    return _lines(
        f'<span style="color:{GREY}">{html.escape(title)}</span>',
        ' &middot; '.join(parts),
        regular,
    )


def contacts_html(scene: Scene, snapshot: Snapshot) -> str:
    """Return a table of the contacts: state, and measured, estimated, desired and true force."""
    leaders, shown = scene.config.force_columns, 4 if scene.true_forces else 3
    rows = []
    for i, name in enumerate(scene.config.column_names):
        state = ''
        if i in leaders:
            state = snapshot.states[list(leaders).index(i)]
            r, g, b = STATE_COLOURS.get(state, STATE_COLOURS['free'])
            state = f'<span style="color:rgb({r},{g},{b})">&#9679;</span> {html.escape(state)}'
        numbers = ''.join(
            f'<td style="text-align:right">{newtons(float(values[i]))}</td>'
            for values in (
                snapshot.measured,
                snapshot.estimated,
                snapshot.desired,
                snapshot.true,
            )[:shown]
        )
        rows.append(
            f'<tr><td><b>{html.escape(name)}</b></td><td>{state}</td>{numbers}</tr>'
        )
    head = ''.join(
        f'<td style="text-align:right;color:{colour}">{text}</td>'
        for text, colour in zip(('meas.', 'est.', 'des.', 'true')[:shown], COLOURS)
    )
    return _line(
        '<table style="width:100%;border-spacing:0">'
        f'<tr><td>N</td><td></td>{head}</tr>{"".join(rows)}</table>'
    )


def events_html(events: list[tuple[float, str]]) -> str:
    """Return the newest events, the newest first."""
    return _line(
        '<br>'.join(
            f'<span style="color:{GREY}">{moment:.2f} s</span> {html.escape(text)}'
            for moment, text in reversed(events)
        )
        or 'none yet',
        EVENTS,
    )
