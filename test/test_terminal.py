"""Colours and moving bars where they can be seen, and nowhere else."""

import io
from pathlib import Path

from multicontact_control import terminal as module
from multicontact_control.experiment.display import count_bar
from multicontact_control.terminal import is_lively, terminal
import pytest
from rich.console import Console

PACKAGE = Path(module.__file__).parent
SURROUNDINGS = ('NO_COLOR', 'FORCE_COLOR', 'TTY_COMPATIBLE', 'TERM')


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch):
    for name in SURROUNDINGS:
        monkeypatch.delenv(name, raising=False)


def said(console):
    """Print and let a bar move; return what has come out."""
    with count_bar(console) as progress:
        bar = progress.add_task('moving', total=2)
        progress.advance(bar)
        console.print('[red]warning[/red]')
    return console.file.getvalue()


class Screen(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(('file', 'setting', 'lively'), [
    (io.StringIO, {}, False), (Screen, {}, True), (Screen, {'NO_COLOR': '1'}, False),
    (Screen, {'TERM': 'dumb'}, False), (Screen, {'NO_COLOR': ''}, True)])
def test_what_is_no_terminal_gets_plain_text(monkeypatch, file, setting, lively):
    monkeypatch.setenv('TERM', 'xterm-256color')
    for name, value in setting.items():
        monkeypatch.setenv(name, value)
    console = terminal()
    console.file = file()
    assert is_lively(console) == lively
    text = said(console)
    assert ('\x1b[' in text) == lively and ('moving' in text) == lively
    assert lively or text == 'warning\n'


def test_lines_say_how_far_a_study_is_where_no_bar_may_move():
    console = terminal()
    console.file = io.StringIO()
    progress = count_bar(console)
    progress.get_time = lambda: now[0]
    now = [progress._told]
    bar = progress.add_task('soaks', total=8)
    for _ in range(7):
        now[0] += 25.0
        progress.advance(bar)
    assert console.file.getvalue() == (
        'soaks: 3 of 8, about 2.1 min left\n' 'soaks: 6 of 8, about 50 s left\n')


def test_nobody_else_makes_a_console_or_a_bar():
    for path in PACKAGE.rglob('*.py'):
        if path.name != 'terminal.py':
            text = path.read_text(encoding='utf-8')
            assert ' Console(' not in text and 'with Progress(' not in text, path
    assert isinstance(terminal(), Console)
