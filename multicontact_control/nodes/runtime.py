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

DISK_FULL_ERRORS = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
)  # a disk, or what a user may have of it
AUTOSTART = '--autostart'
SIGNALS = (signal.SIGINT, signal.SIGTERM)
ACKNOWLEDGE_TIMEOUT = (
    5.0  # s; the last acknowledgement may take long after the data has come
)


def collect_stop_signals() -> list[int]:
    """Return a list that each SIGINT and SIGTERM joins, which then do not end the process."""
    received: list[int] = []
    for number in SIGNALS:  # rclpy's own way would end a node that still sends
        signal.signal(number, lambda number, _frame: received.append(number))
    return received


class Spinner:
    """Runs the callbacks of a node; a signal in the list `stop` ends everything."""

    def __init__(self, node: Any, stop: Sequence[int]) -> None:
        self.stop, self._node = stop, node
        self._executor: Executor | None = None

    def spin_once(self, timeout: float) -> None:
        """Wait for one callback for up to `timeout` [s] and run it."""
        if (
            self._executor is None
        ):  # made late: it empties the subscriptions that a node takes
            self._executor = EventsExecutor(context=self._node.context)
            self._executor.add_node(self._node)
        # The events executor raises for events of ends that are destroyed (rclpy issue 1644).
        with contextlib.suppress(InvalidHandle):
            self._executor.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        """Stop running callbacks."""
        if self._executor is not None:
            self._executor.shutdown(timeout_sec=0)


def start_ros(args: Sequence[str] | None, **options: Any) -> None:
    """Initialise rclpy without its signal handlers; ConfigError for unreadable arguments."""
    # Without it the graph would announce itself to the whole network.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault(
        'FASTRTPS_DEFAULT_PROFILES_FILE', str(find_config_folder() / 'fastdds.xml')
    )
    if not os.access(os.environ.get('ROS_HOME') or os.environ.get('HOME', ''), os.W_OK):
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
    """Return an error of ROS without the place in its sources."""
    return ' '.join(str(error).split(', at /')[0].split())


def run_node(make_node: Callable[[], Any]) -> int:
    """
    Run a node in this process until `run(spinner)` returns, then `close()`; return the exit code.

    It is 2 for a bad configuration, the number of the error for a full disk,
    and 1 for another error.
    """
    program, stop = os.path.basename(sys.argv[0]), collect_stop_signals()
    try:
        start_ros(None)
        check_command_line(program, make_node)
        kernels = loaded_kernels()
        kept = kernels.find_cache_folder() if kernels else None
        if kernels and not (kept and os.listdir(kept)):
            print(
                f'{program}: compiling the numerical kernels: this takes a while, once; '
                '`multicontact compile` does it beforehand',
                file=sys.stderr,
                flush=True,
            )
        _run(make_node(), stop)
        return 0
    except MulticontactError as error:
        text = '; '.join(map(shorten_ros_error, getattr(error, 'errors', [error])))
        print(f'{program}: {text}', file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1
    except Exception as error:
        code = (
            error.errno
            if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS
            else 1
        )
        with contextlib.suppress(OSError):  # the log may be on the same disk
            print(
                f'{program}: {error}', file=sys.stderr
            ) if code in DISK_FULL_ERRORS else (traceback.print_exc())
        return code
    finally:
        # A signal that comes while interpreter and middleware shut down would end it with -15.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        sys.stderr.flush()
        # A life cycle holds its node in a circle; only without it is shared memory given back.
        gc.unfreeze()
        gc.collect()
        rclpy.try_shutdown()


def check_command_line(program: str, node: Callable[[], Any]) -> None:
    """Print the help if asked for, and refuse arguments that are neither ours nor of ROS."""
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


def _run(node: Any, stop: Sequence[int]) -> None:
    """Run a node; unless SIGTERM ends it, wait until reliable readers have all messages."""
    spinner = Spinner(node, stop)
    settle_process()
    try:
        node.run(spinner)
        give_up = time.monotonic() + ACKNOWLEDGE_TIMEOUT
        for publisher in node.publishers if signal.SIGTERM not in stop else ():
            remaining = Duration(seconds=max(0.0, give_up - time.monotonic()))
            if publisher.topic_name not in ('/rosout', '/parameter_events') and not (
                publisher.wait_for_all_acked(remaining)
            ):
                node.get_logger().warning(
                    f'{publisher.topic_name}: a reader has not acknowledged all messages'
                )
    finally:
        spinner.close()
        try:
            node.close()
        finally:
            node.destroy_node()
