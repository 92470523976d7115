"""
Nodes as processes, forked from one that has loaded their modules already.

Loading its modules takes a node one to three seconds of a processor; the fork server of
`multiprocessing` loads them once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
import multiprocessing
from multiprocessing import forkserver
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import sys
import threading

from multicontact_control.process import limit_threads

MODULES = {
    'recorder_node': 'multicontact_control.nodes.recorder_node',
    'noise_estimator_node': 'multicontact_control.nodes.noise_estimator_node',
    'controller_node': 'multicontact_control.nodes.controller_node',
    'sim_node': 'sim_bridge.sim_node',
}
CONTEXT = multiprocessing.get_context('forkserver')


def prepare_nodes() -> None:
    """
    Begin to load the nodes' modules in the fork server; call it in the main thread.

    It returns at once: the server loads them while this process goes on.
    """
    limit_threads()
    CONTEXT.set_forkserver_preload(list(MODULES.values()))
    # Inherited by the server: a run stops its nodes in order, also when its terminal closes.
    at_hangup = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    at_interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Its modules would come from a checkout in which it is started.
    started_in = os.getcwd()
    os.chdir(sys.prefix)
    forkserver.ensure_running()
    os.chdir(started_in)
    signal.signal(signal.SIGHUP, at_hangup)
    signal.signal(signal.SIGINT, at_interrupt)


def start_node(
    module: str,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    log: Path,
    title: str = '',
) -> BaseProcess:
    """
    Start the `main` of a node's module in a process of its own, and return that.

    Parameters
    ----------
    module
        Dotted name of the module.
    arguments
        Its command line, without the name of the programme.
    environment
        All its environment variables.
    log
        File that its output is appended to.
    title
        What follows its name in the list of processes.

    """
    prepare_nodes()
    process = CONTEXT.Process(
        target=_become_node,
        args=(module, list(arguments), dict(environment), str(log), title),
        daemon=True,
    )
    process.start()
    return process


def _become_node(
    module: str,
    arguments: list[str],
    environment: dict[str, str],
    log: str,
    title: str,
) -> None:
    """Become the node: in the forked process, which still is a copy of the server."""
    from setproctitle import setproctitle

    name = module.rpartition('.')[2]
    setproctitle(f'{name} {title}'.strip())  # before the environment is another
    os.setsid()  # a Ctrl-C in the terminal is for the process that runs the graph
    signal.signal(signal.SIGINT, signal.default_int_handler)
    output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.close(output)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    os.environ.clear()
    os.environ.update(environment)
    threading.Thread(target=_follow_parent, daemon=True).start()
    sys.argv = [name, *arguments]
    sys.exit(import_module(module).main())


def _follow_parent() -> None:
    """Interrupt this process when the one that started it has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGINT)
