"""The page: it knows snapshots and commands, not where they come from or go to."""

from __future__ import annotations

from collections import deque
from contextlib import redirect_stdout
import html
import io
import threading
import time
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.view.access import guarding
from multicontact_control.view.commander import Commander, Outcome
from multicontact_control.view.controls import Controls
from multicontact_control.view.curves import Curves
from multicontact_control.view.events import EventReader
from multicontact_control.view.scene import newtons, SceneView, STATE_COLOURS
from multicontact_control.view.source import RATE, Snapshot, Source
import numpy as np
import viser

HOST = '127.0.0.1'
TEXT_EVERY, CURVES_EVERY = 6, 4  # snapshots
LISTED = 12  # events
TOAST_TIME = 6.0  # s
AGAIN = 3.0  # s, after which the same refusal is said again
CURVES_WIDTH, CONTROLS_WIDTH = 370, 340  # px
SMALL = 'font-size:12px;line-height:1.5;padding:2px 14px'


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
    commander
        Who gives the commands.
    newest
        Snapshot, None before the first.
    ended
        Why there is nothing more to see, empty as long as there is.
    status, contacts, answer, events
        Elements with the texts: of the loop, the table of contacts, what came of the last command,
        and what happened.

    """

    def __init__(self, source: Source, port: int) -> None:
        self.source = source
        with guarding(), redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host=HOST, port=port, verbose=False)
        server.request_share_url = lambda *_, **__: None  # a client could ask for a public tunnel
        self.server = server
        self.url = f'http://{HOST}:{self.server.get_port()}/'
        self.ended = ''
        self._outcomes: deque[Outcome] = deque(maxlen=8)
        self._events: deque[tuple[float, str]] = deque(maxlen=LISTED)
        self._unlisted = False  # whether there are events that the list does not show
        self._refused = ('', 0.0)
        self._count = 0
        self._gains: tuple[float, ...] = ()
        self.newest: Snapshot | None = None
        self._reader = EventReader(source.scene.config.contact_names)
        self.commander = Commander(source, self._outcomes.append)
        self._build()

    def _build(self) -> None:
        server, scene = self.server, self.source.scene
        gui = server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(46, 116, 190),
            control_width='medium')
        gui.set_panel_label('multicontact view')
        self.scene_view = SceneView(server, scene)
        self.status = gui.add_html('')
        self.contacts = gui.add_html('')
        self.answer = gui.add_html('')
        self.controls = Controls(gui, self.source, self.commander, self.scene_view)
        with gui.add_folder('Events', expand_by_default=True):
            self.events = gui.add_html('')
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        panel = gui.add_panel()
        with panel.add_tab('Curves'):
            self.curves = Curves(
                gui, scene.config.column_names, scene.config.robot.joint_names)
        panel.dock_left()
        panel.set_width(CURVES_WIDTH)
        self.status.content = _line(f'<b>{html.escape(scene.title)}</b>: waiting for samples')

    def run(self, stop: threading.Event) -> None:
        """Show what comes until it is to stop; what has ended stays to be seen."""
        while not stop.wait(1.0 / RATE):
            self.update()

    def update(self) -> None:
        """Show what has come since the last call."""
        if self.ended:
            return
        try:
            found = self.source.poll()
        except RunError as error:
            self.ended = str(error)
            self.status.content = _line(
                f'<b style="color:#c0392b">{html.escape(self.ended)}</b>')
            self._tell('ended', self.ended)
            return
        watched = bool(self.server.get_clients())
        if found and self.newest is not None and found[-1].time < self.newest.time:
            self._begin_anew()
        for snapshot in found:
            self.curves.history.add(snapshot.points)
            self._events.extend(
                (moment, text) for moment, what in snapshot.events
                if (text := self._reader.read(what)))
            self._unlisted |= bool(snapshot.events)
        while self._outcomes:
            self._show_outcome(self._outcomes.popleft())
        if found:
            self.newest = found[-1]
            if watched:
                self._show(found[-1])

    def _begin_anew(self) -> None:
        """Forget what was said: time has gone back."""
        self._events.clear()
        self._reader = EventReader(self.source.scene.config.contact_names)
        self.events.content, self._unlisted = '', False

    def _show(self, snapshot: Snapshot) -> None:
        self._count += 1
        texts = self._count % TEXT_EVERY == 1
        with self.server.atomic():
            self.scene_view.show(snapshot, labels=texts)
            if texts:
                self.status.content = status_html(self.source.scene.title, snapshot)
                self.contacts.content = contacts_html(
                    self.source.scene.config.column_names, self.source.scene.config.leaders,
                    snapshot)
                self.controls.show(snapshot)
                if snapshot.gains != self._gains:
                    self._gains = snapshot.gains
                    self.controls.show_gains(snapshot)
            if self._unlisted:
                self._unlisted = False
                self.events.content = events_html(list(self._events))
            if self._count % CURVES_EVERY == 0:
                self.curves.draw()

    def _show_outcome(self, outcome: Outcome) -> None:
        colour = '#34965c' if outcome.obeyed else '#c0392b'
        what = '' if outcome.obeyed else 'refused: '
        self.answer.content = _line(
            f'<span style="color:{colour}">{what}{html.escape(outcome.text)}</span>')
        if not outcome.obeyed:
            self._tell('refused', outcome.text)

    def _tell(self, title: str, text: str) -> None:
        """Notify all browsers, but not of the same again and again."""
        now = time.monotonic()
        before, when = self._refused
        if text == before and now - when < AGAIN:
            return
        self._refused = text, now
        for client in self.server.get_clients().values():
            client.add_notification(
                title, text, color='red', auto_close_seconds=TOAST_TIME)

    def close(self) -> None:
        """Close the page and its source."""
        self.commander.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()
        self.source.close()


def _line(content: str) -> str:
    return f'<div style="{SMALL}">{content}</div>'


def status_html(title: str, snapshot: Snapshot) -> str:
    """
    Return the time, what the loop does, and how regular it is.

    The number of its lines does not follow the numbers: what is below would move under the mouse.
    """
    timing = snapshot.timing
    slow = f' at {timing.pace:.2f} of real time' if timing.pace < 0.97 else ''
    parts = [f'<b>{snapshot.time:.1f} s</b>{slow}']
    reaction = snapshot.reaction
    if reaction not in ('none', '', 'recorded'):
        reasons = html.escape(' '.join(snapshot.reasons))
        parts.append(f'<b style="color:#c0392b">{html.escape(reaction)}</b> {reasons}')
    if snapshot.held:
        parts.append('<b>held</b>')
    if snapshot.moving:
        parts.append(html.escape(snapshot.moving))
    regular = '&nbsp;'
    if np.isfinite(timing.typical):
        late = f'{timing.misses} late' if timing.misses else 'none late'
        regular = (f'tick {1e-3 * timing.typical:.2f} ms, at worst {1e-3 * timing.worst:.2f}'
                   f' &middot; {late}')
    return _line(f'<span style="color:#6b7280">{html.escape(title)}</span><br>'
                 f'{" &middot; ".join(parts)}'
                 f'<div style="white-space:nowrap;overflow:hidden">{regular}</div>')


def contacts_html(names: Any, leaders: Any, snapshot: Snapshot) -> str:
    """Return a table of the contacts: state, measured, estimated and desired force."""
    rows = []
    for i, name in enumerate(names):
        state = ''
        if i in leaders:
            found = snapshot.states[list(leaders).index(i)]
            r, g, b = STATE_COLOURS.get(found, STATE_COLOURS['free'])
            state = (f'<span style="color:rgb({r},{g},{b})">&#9679;</span> {html.escape(found)}')
        numbers = ''.join(
            f'<td style="text-align:right">{newtons(float(values[i]))}</td>'
            for values in (snapshot.measured, snapshot.estimated, snapshot.desired))
        rows.append(f'<tr><td><b>{html.escape(name)}</b></td><td>{state}</td>{numbers}</tr>')
    head = ''.join(
        f'<td style="text-align:right;color:{colour}">{text}</td>' for text, colour in (
            ('meas.', '#e07a28'), ('est.', '#2e74be'), ('des. N', '#34965c')))
    return (f'<div style="{SMALL}"><table style="width:100%;border-spacing:0">'
            f'<tr><td></td><td></td>{head}</tr>{"".join(rows)}</table></div>')


def events_html(events: list[tuple[float, str]]) -> str:
    """Return the newest events, the newest first."""
    return _line('<br>'.join(
        f'<span style="color:#6b7280">{moment:.2f} s</span> {html.escape(what)}'
        for moment, what in reversed(events)) or 'none yet')
