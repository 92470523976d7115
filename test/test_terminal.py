"""Colours and moving bars where they can be seen, and nowhere else."""

import io

from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.terminal import is_lively, terminal
import pytest


class Screen(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(('file', 'setting', 'lively'), [
    (io.StringIO, {}, False), (Screen, {}, True), (Screen, {'NO_COLOR': '1'}, False),
    (Screen, {'TERM': 'dumb'}, False), (Screen, {'NO_COLOR': ''}, True)])
def test_terminal_gives_plain_text_to_what_is_none(monkeypatch, file, setting, lively):
    for name in ('NO_COLOR', 'FORCE_COLOR', 'TTY_COMPATIBLE'):
        monkeypatch.delenv(name, raising=False)
    for name, value in {'TERM': 'xterm-256color', **setting}.items():
        monkeypatch.setenv(name, value)
    console = terminal()
    console.file = file()
    assert is_lively(console) == lively
    with count_bar(console) as progress:
        progress.advance(progress.add_task('moving', total=2))
        console.print('[red]warning[/red]')
    text = console.file.getvalue()
    assert ('\x1b[' in text) == lively and ('moving' in text) == lively
    assert lively or text == 'warning\n'
