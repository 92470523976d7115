"""The page as it is served, without a browser."""

import os
import signal
import subprocess
import sys
from unittest.mock import Mock
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from multicontact_control.errors import CommandError, RunError
from multicontact_control.runs.graph.domain import reserve_domain
from multicontact_control.runs.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.source import list_simulated_surfaces, Scene
import pytest
from ros_graph import start_command

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
from multicontact_control.view.page import Page  # noqa: E402, I100

PORT = 8471


class Silent:
    """A source without samples, that refuses a tare."""

    def __init__(self):
        setup = resolve('paper')
        self.scene = Scene(
            'nothing', setup.controller, setup.urdf_dir, list_simulated_surfaces(setup)
        )
        self.given, self.take_snapshots = [], list

    def give_command(self, name, /, **values):
        if name == source.TARE:
            raise CommandError('contacts', 'none', '<some>')
        self.given.append((name, values))
        return 'done'


@pytest.fixture
def page():
    page = Page(Silent(), PORT)
    yield page
    page.close()


def test_page_is_served_to_this_machine_only_and_holds_the_scene(page):
    assert urlsplit(page.url).hostname == '127.0.0.1'
    own = f'http://localhost:{urlsplit(page.url).port}'
    for headers in ({}, {'Host': urlsplit(own).netloc, 'Origin': own}):
        with urlopen(Request(page.url, headers=headers)) as answer:
            assert b'<html' in answer.read()
    for headers in (
        {'Host': 'rebound.example:8080'},
        {'Origin': 'https://evil.example'},
        {'Origin': 'http://localhost:9'},
        {'Origin': 'null'},
    ):
        with pytest.raises(HTTPError, match='403'):
            urlopen(Request(page.url, headers=headers))
    for name in (
        '/arm/tool',
        '/arm/link2',
        '/surfaces/table',
        '/handle',
        '/forces/measured',
        '/forces/estimated',
        '/forces/desired',
        '/contacts/table',
        '/labels/board',
    ):
        assert page.server.scene.get_handle_by_name(name) is not None, name
    assert page.server.request_share_url() is None, 'a public tunnel'


def test_page_gives_the_last_command_of_an_element_and_shows_refusals_and_the_end(page):
    slider = object()
    for force in (3.0, 4.0):
        page.requests.request_command(slider, source.FORCES, table=force)
    page.requests.request_command(None, source.TARE)
    page.update_page()
    assert 'done' in page.answer.content
    page.update_page()
    assert 'expected none, got &lt;some&gt;' in page.answer.content
    assert page.source.given == [(source.FORCES, {'table': 4.0})]
    page.source.take_snapshots = Mock(side_effect=RunError('sim_node ended: <killed>'))
    page.update_page()
    assert (
        page.ended == 'sim_node ended: <killed>'
        and '&lt;killed&gt;' in page.status.content
    )


def test_view_without_viser_exits_with_two_and_one_line():
    code = "import sys; sys.modules['viser'] = None; import multicontact_control.cli.__main__"
    done = subprocess.run(
        [sys.executable, '-c', code, 'view'], capture_output=True, text=True
    )
    assert done.returncode == 2 and done.stderr.count('\n') == 1
    assert 'pip install viser' in done.stderr


@pytest.mark.slow
@pytest.mark.ros
def test_view_serves_a_page_and_ends_with_the_graph_it_started(tmp_path):
    environment = {**os.environ, 'TMPDIR': str(tmp_path)}
    with (
        reserve_domain() as domain_id,
        start_command(
            'view',
            '--port',
            PORT + 1,
            '--plant',
            'rigid',
            '--domain-id',
            domain_id,
            stderr=None,
            start_new_session=True,
            env=environment,
        ) as process,
    ):
        try:
            while 'http' not in (line := process.stdout.readline()):
                assert line, 'it has ended'
            assert urlopen(line.split()[-1]).status == 200
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does
            assert process.wait(60.0) == 0
        finally:
            process.kill()  # nothing to one that has ended
    listed = subprocess.run(['ps', '-e', '-o', 'args'], capture_output=True, text=True)
    assert str(tmp_path) not in listed.stdout  # of a node, with its folder
    assert not list(tmp_path.iterdir())
