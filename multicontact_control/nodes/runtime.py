"""How a node process starts, spins, stops and reports what went wrong."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import contextlib
import errno
import gc
import inspect
import os
import signal
import sys
import tempfile
import time
import traceback
from typing import Any

from multicontact_control.errors import ConfigError, MulticontactError, RunError
from multicontact_control.paths import find_config_folder
from multicontact_control.process import settle_process
import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

try:
    from rclpy.experimental import EventsExecutor  # faster
except ImportError:
    EventsExecutor = SingleThreadedExecutor

# Of a disk, or of a user's share of it.
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
AUTOSTART = '--autostart'
SIGNALS = (signal.SIGINT, signal.SIGTERM)
UNAWAITED_TOPICS = ('/rosout', '/parameter_events')  # at the end of a node
# s; the last acknowledgement may take long after the data has come.
ACKNOWLEDGE_TIMEOUT = 5.0


def collect_stop_signals() -> list[int]:
    """
    Let SIGINT and SIGTERM be collected from now on, instead of ending the process.

    rclpy's own way would end a node that still sends.

    Returns
    -------
    list[int]
        The numbers of the signals that have come, to which further ones are appended.

    """
    received: list[int] = []

    def collect(number: int, _frame: Any) -> None:
        received.append(number)

    for number in SIGNALS:
        signal.signal(number, collect)
    return received


class Spinner:
    """
    Runs the callbacks of a node.

    Parameters
    ----------
    node
        The node, whose callbacks run in `spin_once` alone.
    stop
        Signals that have come: the node's `run` ends once there is one.

    """

    def __init__(self, node: Any, stop: Sequence[int]) -> None:
        self.stop = stop
        self._node = node
        self._executor: Executor | None = None

    def spin_once(self, timeout: float) -> None:
        """Wait for one callback for up to `timeout` [s] and run it."""
        # Made late: an executor empties the subscriptions whose messages a node takes.
        if self._executor is None:
            self._executor = EventsExecutor(context=self._node.context)
            self._executor.add_node(self._node)
        # The events executor raises for events of ends that are destroyed (rclpy issue 1644).
        with contextlib.suppress(InvalidHandle):
            self._executor.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        """Destroy the executor: no callback runs any more."""
        if self._executor is not None:
            self._executor.shutdown(timeout_sec=0)


def start_ros(args: Sequence[str] | None, **options: Any) -> None:
    """
    Initialise rclpy without its signal handlers, within this machine unless the environment says.

    Parameters
    ----------
    args
        Arguments of the command line; None for those of the process.
    options
        Further ones of `rclpy.init`.

    Raises
    ------
    ConfigError
        If the arguments, or a parameter file among them, are unreadable.
    RunError
        If the middleware does not start.

    """
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault(
        'FASTRTPS_DEFAULT_PROFILES_FILE', str(find_config_folder() / 'fastdds.xml')
    )
    home = os.environ.get('ROS_HOME') or os.environ.get('HOME', '')
    if not os.access(home, os.W_OK):
        os.environ.setdefault(
            'ROS_LOG_DIR', f'{tempfile.gettempdir()}/ros-{os.getuid()}'
        )
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO, **options)
    except (RuntimeError, UnicodeError) as error:
        text = shorten_ros_error(error)
        if 'parse' not in text and 'failed to' in text:
            raise RunError(f'ROS 2 cannot be started: {text}') from None
        hint = (
            'readable arguments and files in UTF-8, numbers of a list all with a point'
        )
        raise ConfigError('--ros-args', hint, text) from None


def shorten_ros_error(error: BaseException) -> str:
    """Return the text of an error in one line, without the place in the sources of ROS."""
    text, _, _ = str(error).partition(', at /')
    return ' '.join(text.split())


def run_node(make_node: Callable[[], Any]) -> int:
    """
    Run a node in this process, from the start of ROS to its end.

    `run(spinner)` of the node returns when it has been asked to stop, and `close()` follows.

    Returns
    -------
    int
        The exit code: 0; 2 for a bad configuration; the number of the error for a full disk; 1
        for another error. The process has said why on stderr.

    """
    program = os.path.basename(sys.argv[0])
    stop = collect_stop_signals()
    try:
        start_ros(None)
        check_command_line(program, make_node)
        _announce_compilation(program)
        _run_to_the_end(make_node(), stop)
        return 0
    except MulticontactError as error:
        errors = getattr(error, 'errors', [error])
        text = '; '.join(map(shorten_ros_error, errors))
        print(f'{program}: {text}', file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1
    except Exception as error:
        return _explain_failure(program, error)
    finally:
        # A signal that comes while interpreter and middleware shut down would end it with -15.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        sys.stderr.flush()
        # A life cycle holds its node in a circle; only without it is shared memory given back.
        gc.unfreeze()
        gc.collect()
        rclpy.try_shutdown()


def _announce_compilation(program: str) -> None:
    """Say that the start takes a while, if kernels have to be compiled."""
    kernels = loaded_kernels()
    if kernels is None:
        return
    folder = kernels.find_cache_folder()
    if not folder or not os.listdir(folder):
        print(
            f'{program}: compiling the numerical kernels: this takes a while, once; '
            '`multicontact compile` does it beforehand',
            file=sys.stderr,
            flush=True,
        )


def _explain_failure(program: str, error: Exception) -> int:
    """Print an error that is a mistake, or a full disk; return the exit code."""
    with contextlib.suppress(OSError):  # the log may be on the same disk
        if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS:
            code = error.errno
            print(f'{program}: {error}', file=sys.stderr)
        else:
            code = 1
            traceback.print_exception(error)
    return code


def check_command_line(program: str, node: Callable[[], Any]) -> None:
    """
    Print the help of a node and exit if asked to; exit with 2 at an argument that is not known.

    Known are those of ROS and, for a node with a life cycle, `--autostart`.
    """
    parser = argparse.ArgumentParser(
        program,
        description=(inspect.getdoc(node) or '').partition('\n')[0],
        allow_abbrev=False,
        epilog='ROS 2 arguments follow --ros-args: --params-file FILE, -p NAME:=VALUE, '
        '-r __ns:=/NAMESPACE. Every parameter with unit and default: '
        'docs/reference/parameters.md.',
    )
    if hasattr(node, 'trigger_configure'):  # it has a life cycle
        parser.add_argument(
            AUTOSTART,
            action='store_true',
            help='Configure and activate the node at once.',
        )
    parser.parse_args(remove_ros_args(sys.argv)[1:])


def loaded_kernels() -> Any:
    """Return the module `compiled` where the process has kernels; numba takes 0.3 s to import."""
    return sys.modules.get('multicontact_control.compiled')


def _run_to_the_end(node: Any, stop: Sequence[int]) -> None:
    """Run a node, then wait for its readers, close it and destroy it."""
    spinner = Spinner(node, stop)
    settle_process()
    try:
        node.run(spinner)
        if signal.SIGTERM not in stop:
            _await_acknowledgement(node)
    finally:
        spinner.close()
        try:
            node.close()
        finally:
            node.destroy_node()


def _await_acknowledgement(node: Any) -> None:
    """Wait until reliable readers have all messages of a node, or say which do not."""
    give_up = time.monotonic() + ACKNOWLEDGE_TIMEOUT
    for publisher in node.publishers:
        if publisher.topic_name in UNAWAITED_TOPICS:
            continue
        remaining = max(0.0, give_up - time.monotonic())
        if not publisher.wait_for_all_acked(Duration(seconds=remaining)):
            node.get_logger().warning(
                f'{publisher.topic_name}: a reader has not acknowledged all messages'
            )
