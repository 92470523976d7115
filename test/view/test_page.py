"""The page as it is served, without a browser."""

from __future__ import annotations

from contextlib import closing
from html.parser import HTMLParser
import http.client
import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace
from urllib.parse import urlsplit

from multicontact_control.errors import CommandError, RunError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.events import EventReader
from multicontact_control.view.replay import load_replay
from multicontact_control.view.simulation import Simulation
from multicontact_control.view.source import Scene, surfaces_of
import numpy as np
import pytest

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
page_module = pytest.importorskip('multicontact_control.view.page')

PORT = 8471
WITHOUT = """
import sys
sys.modules['viser'] = sys.modules['websockets'] = None
sys.argv = ['multicontact', 'view']
from multicontact_control.cli.application import main
main()
"""


class Silent:
    """A source from which nothing comes, and which refuses some."""

    def __init__(self):
        setup = resolve('paper')
        self.scene = Scene('nothing', setup.controller, setup.urdf_dir, surfaces_of(setup))
        self.refusals = dict.fromkeys(source.PLAYING, 'a recording')
        self.given, self.why = [], ''

    def poll(self):
        if self.why:
            raise RunError(self.why)
        return []

    def command(self, name, /, **values):
        if name == source.TARE:
            raise CommandError('contacts', 'none', '<some>')
        self.given.append((name, values))
        return 'done'

    def close(self):
        self.given.append('closed')


@pytest.fixture
def silent():
    return Silent()


def get(page, path='/', **headers):
    with closing(http.client.HTTPConnection(
            '127.0.0.1', urlsplit(page.url).port, timeout=20.0)) as connection:
        connection.request('GET', path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers


def settle(page, condition):
    give_up = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up
        page.update()
        time.sleep(0.01)


def test_surfaces_that_move_are_drawn_where_they_are(silent):
    surfaces = {name: {'motion_start': 0.0} for name in ('table', 'board')}
    simulation = Simulation(resolve(
        'moving_surface', plant='rigid', plant_overrides={'surfaces': surfaces}))
    page = page_module.Page(silent, port=PORT)
    try:
        for _ in range(500):
            simulation.advance()
        page.scene_view.show(simulation.snapshot(0, 1.0))
        for surface in silent.scene.surfaces:
            period = {'table': 6.283, 'board': 5.0}[surface.name]
            w = 2.0 * np.pi / period
            way = 0.02 / w * (1.0 - np.cos(w))
            np.testing.assert_allclose(
                page.scene_view._patches[surface.name].position,
                np.add(surface.point_world, way * np.array(surface.normal_world)), atol=1e-4)
    finally:
        page.close()
        simulation.close()


def test_page_is_served_to_this_machine_only_and_holds_what_is_shown(silent):
    page = page_module.Page(silent, port=PORT)
    try:
        status, body, _ = get(page)
        assert status == 200 and b'<html' in body
        assert urlsplit(page.url).hostname == '127.0.0.1' and page.local
        assert get(page, Host='other.example')[0] == 403
        sockets = page.server._websock_server
        assert sockets._host == '127.0.0.1'
        scene = page.server.scene
        for name in ('/arm/tool', '/arm/link2', '/surfaces/table', '/surfaces/board', '/handle',
                     '/forces/measured', '/forces/estimated', '/forces/desired',
                     '/contacts/table', '/labels/board'):
            assert scene.get_handle_by_name(name) is not None, name
        assert page.server.request_share_url() is None, 'a public tunnel'
    finally:
        page.close()
    assert silent.given[-1] == 'closed'


def test_a_page_for_others_asks_for_its_token(silent):
    page = page_module.Page(silent, host='0.0.0.0', port=PORT)
    try:
        assert not page.local
        assert get(page)[0] == 401
        parts = urlsplit(page.url)
        status, _, headers = get(page, f'/?{parts.query}')
        assert status == 303
        assert get(page, Cookie=headers['Set-Cookie'].split(';')[0])[0] == 200
    finally:
        page.close()


def test_what_comes_of_commands_is_said_and_so_is_the_end(silent):
    page = page_module.Page(silent, port=PORT)
    try:
        page.commander.give(None, source.FORCES, table=3.0)
        settle(page, lambda: 'done' in page._answer.content)
        page.commander.give(None, source.TARE)
        settle(page, lambda: 'refused' in page._answer.content)
        assert 'expected none, found &lt;some&gt;' in page._answer.content
        assert silent.given == [(source.FORCES, {'table': 3.0})]
        silent.why = 'the simulation has ended: <killed>'
        page.update()
        assert page.ended == silent.why
        assert 'ended: &lt;killed&gt;' in page._status.content
        page.update()
    finally:
        page.close()


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.text = [], ''

    def handle_starttag(self, tag, attrs):
        if tag != 'br':
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_a_recording_is_drawn(recorded_run, monkeypatch):
    shown = load_replay(recorded_run, resolve('paper'))
    page = page_module.Page(shown, port=PORT)
    try:
        monkeypatch.setattr(page.server, 'get_clients', lambda: {})
        page.update()
        monkeypatch.setattr(page.server, 'get_clients', lambda: {0: None})
        page.commander.give(None, source.PLAY, on=False)
        settle(page, lambda: page.newest is not None and not page.newest.playing)
        page.commander.give(None, source.SEEK, time=2.5)
        settle(page, lambda: page.newest.time == 2.5)
        page._count = 0
        page._show(page.newest)
        arrow = page.server.scene.get_handle_by_name('/forces/measured').points
        normals = page.newest.normals_world
        along = np.einsum('ij,ij->i', arrow[:, 1] - arrow[:, 0], normals)
        np.testing.assert_allclose(along, 0.012 * page.newest.measured, rtol=1e-4)
        for html, word in ((page._contacts.content, 'holding'), (page._status.content, '2.5 s')):
            tags = Tags()
            tags.feed(html)
            assert tags.open == [] and word in tags.text
        page.curves.draw()
    finally:
        page.close()


def test_what_happens_while_nobody_looks_is_listed_for_who_comes_back(recorded_run, monkeypatch):
    page = page_module.Page(load_replay(recorded_run, resolve('paper')), port=PORT)

    def seen_by(clients, command, condition, **values):
        monkeypatch.setattr(page.server, 'get_clients', lambda: clients)
        page.commander.give(None, command, **values)
        settle(page, lambda: page.newest is not None and condition(page.newest))

    try:
        seen_by({}, source.PLAY, lambda snapshot: not snapshot.playing, on=False)
        seen_by({0: None}, source.SEEK, lambda snapshot: snapshot.time == 0.5, time=0.5)
        assert 'approaching' in page._list.content
        seen_by({}, source.SEEK, lambda snapshot: snapshot.time == 2.0, time=2.0)
        assert 'holding' not in page._list.content
        seen_by({0: None}, source.PLAY, lambda snapshot: snapshot.time > 2.0, on=True)
        assert 'holding' in page._list.content
    finally:
        page.close()


def test_a_browser_that_leaves_lets_go_of_the_handle(silent):
    simulation = Simulation(resolve('paper', plant='rigid'))
    page = page_module.Page(silent, port=PORT)
    try:
        for _ in range(20):
            simulation.advance()
        snapshot, view = simulation.snapshot(0, 1.0), page.scene_view
        view.show_handle(True)
        view._dragged_by = 7
        view._handle.position = (1.0, 1.0, 1.0)
        for leaving, held in ((8, True), (7, False)):
            for call in page.server._client_disconnect_cb:
                call(SimpleNamespace(client_id=leaving))
            view.show(snapshot)
            assert (tuple(view._handle.position) == (1.0, 1.0, 1.0)) == held
        np.testing.assert_allclose(view._handle.position, snapshot.position_des)
    finally:
        page.close()
        simulation.close()


def test_without_viser_it_is_said_what_to_install():
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count('\n') == 1
    assert "expected viser, by pip install 'multicontact_control[view]', found none" in done.stderr


def test_command_serves_a_page_and_ends_with_all_it_started():
    process = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', 'view', '--port', str(PORT + 1),
         '--plant', 'rigid'], stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        while 'http' not in (said := process.stdout.readline()):
            assert said, 'it has ended'
        address = said.split()[-1]
        assert 'only this machine can reach it' in process.stdout.readline()
        with closing(http.client.HTTPConnection(urlsplit(address).netloc)) as connection:
            connection.request('GET', '/')
            assert connection.getresponse().status == 200
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        assert process.wait(60.0) == 0
        give_up = time.monotonic() + 60.0
        with pytest.raises(ProcessLookupError):
            while time.monotonic() < give_up:
                os.killpg(process.pid, 0)
                time.sleep(0.05)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_events_say_what_has_changed():
    reader = EventReader(('table', 'board'))
    assert reader.read('none |  | free, free') == ''
    assert reader.read('none |  | approaching, free') == 'table approaching'
    assert reader.read('hold | wrench_stale | approaching, free') == 'hold (wrench_stale)'
    assert reader.read('none | torque | holding, free') == (
        'control again, table holding, limit: torque')
    assert reader.read('pushed by +5 N along x') == 'pushed by +5 N along x'


def test_numbers_do_not_move_what_is_below_them():
    def found(**timing):
        shown = {'typical': np.nan, 'worst': np.nan, 'misses': 0, 'pace': 1.0}
        return page_module.status_html('arm', SimpleNamespace(
            time=1.0, timing=SimpleNamespace(**{**shown, **timing}), reaction='none', reasons=(),
            held=False, moving=''))
    pages = [found(), found(typical=1e5, worst=2e5),
             found(typical=1e6, worst=2e7, misses=123456, pace=0.5)]
    assert {page.count('<br>') + page.count('<div') for page in pages} == {3}
    # A line that grows is cut, not broken.
    assert all('white-space:nowrap' in page.split('<br>')[1] for page in pages)
    assert 'none late' in pages[1] and '123456 late' in pages[2] and '0.50 of' in pages[2]
