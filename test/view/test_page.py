"""The page as it is served, without a browser."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from multicontact_control.errors import CommandError, RunError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.source import Scene, surfaces_of
import pytest

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
from multicontact_control.view.page import Page  # noqa: E402, I100

PORT = 8471


class Silent:
    """A source without samples, that refuses a tare."""

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
def make_page():
    pages = []

    def make(shown):
        pages.append(Page(shown, PORT))
        return pages[-1]

    yield make
    for page in pages:
        page.close()


def settle(page, condition):
    give_up = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up
        page.update()
        time.sleep(0.01)


def test_page_is_served_to_this_machine_only_and_holds_the_scene(make_page):
    page = make_page(Silent())
    assert urlsplit(page.url).hostname == '127.0.0.1'
    with urlopen(page.url) as answer:
        assert b'<html' in answer.read()
    with pytest.raises(HTTPError, match='403'):
        urlopen(Request(page.url, headers={'Host': 'other.example'}))
    for name in ('/arm/tool', '/arm/link2', '/surfaces/table', '/surfaces/board', '/handle',
                 '/forces/measured', '/forces/estimated', '/forces/desired',
                 '/contacts/table', '/labels/board'):
        assert page.server.scene.get_handle_by_name(name) is not None, name
    assert page.server.request_share_url() is None, 'a public tunnel'


def test_page_shows_answers_refusals_and_the_end(make_page):
    silent = Silent()
    page = make_page(silent)
    page.commander.give(None, source.FORCES, table=3.0)
    settle(page, lambda: 'done' in page.answer.content)
    page.commander.give(None, source.TARE)
    settle(page, lambda: 'expected none, found &lt;some&gt;' in page.answer.content)
    assert silent.given == [(source.FORCES, {'table': 3.0})]
    silent.why = 'the simulation has ended: <killed>'
    page.update()
    assert page.ended == silent.why and '&lt;killed&gt;' in page.status.content


def test_view_without_viser_exits_with_two_and_one_line():
    code = ("import sys; sys.modules['viser'] = None; from multicontact_control.cli import app; "
            "app(['view'])")
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count('\n') == 1
    assert "pip install 'multicontact_control[view]'" in done.stderr


@pytest.mark.slow
def test_view_serves_a_page_and_ends_with_all_it_started():
    process = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', 'view', '--port', str(PORT + 1),
         '--plant', 'rigid'], stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        while 'http' not in (line := process.stdout.readline()):
            assert line, 'it has ended'
        assert urlopen(line.split()[-1]).status == 200
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
