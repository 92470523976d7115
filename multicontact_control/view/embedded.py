"""A simulation of its own, in another process: what a page shows where nothing runs yet."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import multiprocessing
import os
import pickle
import signal
import socket
import threading
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.scenario import Setup
from multicontact_control.view.source import (
    RATE,
    refuse_if_unknown,
    Scene,
    Snapshot,
    surfaces_of,
    taken,
)

MESSAGE = 1 << 20  # bytes, at most
KEPT = round(2.0 * RATE)  # snapshots; a page that polls less often misses some
ANSWER_TIMEOUT = 5.0  # s
END_TIMEOUT = 2.0  # s
LAST_WORDS = -2


class Refusal(RunError):
    """The simulation does not obey; it says why."""


class EmbeddedSource:
    """
    Starts a simulation in a process of its own, which ends with this one.

    Parameters
    ----------
    setup
        What to simulate; it obeys commands, not the scenario.

    """

    def __init__(self, setup: Setup) -> None:
        # Only now: it is the child that needs all of it, and its names are the same here.
        from multicontact_control.view.simulation import REFUSALS, run_simulation

        self.refusals: Mapping[str, str] = REFUSALS
        self.scene = Scene(
            f'simulation of {setup.plant_name}, in real time', setup.controller, setup.urdf_dir,
            surfaces_of(setup))
        self._snapshots: deque[Snapshot] = deque(maxlen=KEPT)
        self._answers: dict[int, tuple[bool, str]] = {}
        self._answered = threading.Condition()
        self._numbers = 0
        self._why = ''
        self._over = False
        self._connection, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._process = multiprocessing.get_context('spawn').Process(
            target=run_simulation, args=(setup, other, os.getpid()), daemon=True,
            name='simulation')
        with _interrupts_ignored():  # by the child from its first line on: it ends with this one
            self._process.start()
        other.close()
        self._reader = threading.Thread(target=self._read, daemon=True, name='simulation reader')
        self._reader.start()

    @property
    def pid(self) -> int:
        """Return the number of the process that simulates."""
        return self._process.pid or -1

    def _read(self) -> None:
        """Take in what the simulation sends, until it ends."""
        while True:
            try:
                message = self._connection.recv(MESSAGE)
            except OSError:
                message = b''
            if not message:
                break
            number, content = pickle.loads(message)  # from a process that this one started
            if number == -1:
                if content is not None:
                    self._snapshots.append(content)
            elif number == LAST_WORDS:
                self._why = content
            else:
                with self._answered:
                    self._answers[number] = content
                    self._answered.notify_all()
        with self._answered:
            self._over = True
            self._answered.notify_all()

    def poll(self) -> list[Snapshot]:
        """Return the snapshots since the last call; RunError once the simulation has ended."""
        found = taken(self._snapshots)
        if not found and self._over:
            raise RunError(self._ended())
        return found

    def _ended(self) -> str:
        self._process.join(END_TIMEOUT)
        code = self._process.exitcode
        how = self._why or (f'killed by signal {-code}' if code and code < 0 else
                            f'exit code {code}')
        return f'the simulation has ended: {how}'

    def command(self, name: str, /, **values: Any) -> str:
        """Give a command, and return what comes of it; see `Source.command`."""
        refuse_if_unknown(name, self.refusals)
        with self._answered:
            self._numbers += 1
            number = self._numbers
        try:
            self._connection.send(pickle.dumps((number, (name, values))))
        except OSError:
            raise RunError(self._ended()) from None
        with self._answered:
            self._answered.wait_for(
                lambda: number in self._answers or self._over, ANSWER_TIMEOUT)
            obeyed, text = self._answers.pop(number, (False, ''))
        if not obeyed:
            raise Refusal(text or (self._ended() if self._over else
                                   f'no answer within {ANSWER_TIMEOUT:g} s'))
        return text

    def close(self) -> None:
        """End the simulation."""
        self._connection.close()
        self._process.join(END_TIMEOUT)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(END_TIMEOUT)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C meanwhile, which a process that is started then goes on doing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
