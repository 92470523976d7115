"""
How a node process starts, spins, stops and says what went wrong.

rclpy's own signal handling shuts the context down under the feet of a node that still has
messages to send; here a signal only sets a flag, and the loop ends by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import gc
import os
import signal
import sys
import time
import traceback
from types import FrameType
from typing import Any, Protocol

from multicontact_control.errors import ConfigError, MulticontactError
from multicontact_control.paths import config_dir
from multicontact_control.process import settle_process
import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

EXIT_OK, EXIT_ERROR, EXIT_CONFIG = 0, 1, 2
SPIN_TIMEOUT = 0.1
DRAIN_TIME = 0.1
ACKNOWLEDGE_TIMEOUT = 5.0


class StopFlag:
    """
    Set by SIGINT and SIGTERM; as often as they come.

    Attributes
    ----------
    signal
        The first that came.
    hurry
        Whether SIGTERM was among them: files are closed then, but nobody is waited for.

    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self.hurry = False

    def __bool__(self) -> bool:
        """Whether the process has been asked to stop."""
        return self.signal is not None

    def install(self) -> None:
        """Take over SIGINT and SIGTERM of this process."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.signal is None:
            self.signal = number
        self.hurry = self.hurry or number == signal.SIGTERM


class Spinner:
    """
    Runs the callbacks of a node.

    Parameters
    ----------
    node
        The node.
    stop
        The flag that ends everything.

    """

    def __init__(self, node: Any, stop: StopFlag) -> None:
        self.stop = stop
        self._node = node
        self._executor: Executor | None = None

    def spin_once(self, timeout: float = SPIN_TIMEOUT) -> None:
        """Wait for one callback for up to `timeout` [s] and run it."""
        executor = self._executor or self._make_executor()
        try:
            executor.spin_once(timeout_sec=timeout)
        except InvalidHandle as error:
            if not _is_of_a_destroyed_end(error):
                raise

    def _make_executor(self) -> Executor:
        """Make it when it is first needed: it would empty the subscriptions that a node takes."""
        self._executor = make_executor()
        self._executor.add_node(self._node)
        return self._executor

    def drain(self, duration: float = DRAIN_TIME) -> None:
        """Run the callbacks of what has arrived or is on its way, for `duration` [s]."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self.spin_once(0.01)

    def close(self) -> None:
        """Stop running callbacks."""
        if self._executor is not None:
            self._executor.shutdown(timeout_sec=0)


class RunnableNode(Protocol):
    """What `run_node` needs: `run` returns when the node has done its work or should stop."""

    def run(self, spinner: Spinner) -> None:
        """Do the node's work."""
        ...

    def close(self) -> None:
        """Write what is left to write; called however `run` ended."""
        ...

    def destroy_node(self) -> None:
        """Free the node's ROS resources."""
        ...


def prepare_environment() -> None:
    """
    Set what rclpy and Fast DDS read from the environment, unless the user has.

    The wheels keep their ament index in the Python environment; without a discovery range the
    graph would announce itself to the whole network; and what `fastdds.xml` turns off lets a
    process with two participants hang.
    """
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(config_dir() / 'fastdds.xml'))


def make_executor() -> Executor:
    """
    Return the fastest executor there is.

    The events executor answers in 3/4 of the time and half the CPU of the standard one. Its
    `spin()` hangs, so only `spin_once` with a timeout may be used; and it cannot pass message
    information to callbacks.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def _is_of_a_destroyed_end(error: InvalidHandle) -> bool:
    """
    Return whether an executor came to tell of a topic's end that is gone by now.

    The standard one ignores that; the events executor raises it (rclpy issue 1644).
    """
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and trace.tb_frame.f_code is EventHandler.take_data.__code__


def release_memory() -> None:
    """Free what is no longer used, while no node of the process works; undoes `settle_process`."""
    gc.unfreeze()
    gc.collect()


def yield_to_others(niceness: int) -> None:
    """
    Lower the priority of this thread.

    Only of this one: those in which the middleware takes in messages keep theirs (on Linux a
    niceness belongs to a thread).
    """
    with contextlib.suppress(OSError):
        os.nice(niceness)


def start_ros(args: Sequence[str] | None) -> None:
    """
    Initialise rclpy without its signal handlers.

    Raises
    ------
    ConfigError
        If the ROS arguments or a parameter file cannot be read.

    """
    prepare_environment()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        hint = 'readable ROS arguments and parameter files, numbers of a list all with a point'
        raise ConfigError('--ros-args', hint, _one_line(error)) from None


def _one_line(error: BaseException) -> str:
    return ' '.join(str(error).split(', at /')[0].split())


def run_node(make_node: Callable[[], Any], args: Sequence[str] | None = None) -> int:
    """
    Run a node in this process until it has ended or is asked to stop.

    Parameters
    ----------
    make_node
        Returns a `RunnableNode`; may raise `ConfigError`.
    args
        Command line, that of the process by default.

    Returns
    -------
    int
        Exit code: 0 after a clean end or a signal, 2 for a bad configuration (one line on
        stderr), 1 for anything else (a line or a traceback).

    """
    program = os.path.basename(sys.argv[0])
    stop = StopFlag()
    stop.install()
    try:
        start_ros(args)
        with _compilations_told(program):
            return _run(make_node(), stop)
    except ConfigError as error:
        print(f'{program}: {_one_line(error)}', file=sys.stderr)
        return EXIT_CONFIG
    except ExternalShutdownException:
        return EXIT_OK
    except MulticontactError as error:
        print(f'{program}: {_one_line(error)}', file=sys.stderr)
        return EXIT_ERROR
    except Exception:
        traceback.print_exc()
        return EXIT_ERROR
    finally:
        # All is written. A signal that comes while the interpreter and the middleware take
        # themselves apart, which lasts a second on a busy machine, would end it with -15.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        sys.stderr.flush()
        rclpy.try_shutdown()


def loaded_kernels() -> Any:
    """Return the module `compiled` where the process has kernels; numba takes 0.3 s to import."""
    return sys.modules.get('multicontact_control.compiled')


def _compilations_told(program: str) -> contextlib.AbstractContextManager[None]:
    """Say on stderr, at the first kernel, that this process has to compile."""
    told = False

    def tell(kernel: str) -> None:
        nonlocal told
        if not told:
            print(f'{program}: compiling the numerical kernels, beginning with {kernel}: '
                  'this takes a while, once; `multicontact compile` does it beforehand',
                  file=sys.stderr, flush=True)
        told = True

    compiled = loaded_kernels()
    return compiled.compilations_told(tell) if compiled else contextlib.nullcontext()


def _run(node: Any, stop: StopFlag) -> int:
    spinner = Spinner(node, stop)
    settle_process()
    try:
        node.run(spinner)
        if not stop.hurry:
            wait_until_sent(node)
    finally:
        spinner.close()
        try:
            node.close()
        finally:
            node.destroy_node()
    return EXIT_OK


def wait_until_sent(node: Node) -> None:
    """
    Wait until every reliable reader has what this node published.

    Not for long: the last acknowledgement may take seconds although the data has arrived.
    """
    give_up = time.monotonic() + ACKNOWLEDGE_TIMEOUT
    for publisher in node.publishers:
        if publisher.topic_name not in ('/rosout', '/parameter_events'):
            remaining = max(0.0, give_up - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=remaining))
