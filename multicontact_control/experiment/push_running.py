"""The push test of a controller that runs: asked for, shown, and waited for."""

from __future__ import annotations

from collections.abc import Callable
import time

from multicontact_control.errors import RunError
from multicontact_control.nodes import topics
from multicontact_control.nodes.link import ControllerLink
from std_srvs.srv import Trigger

SENSOR_STATUS = f'{topics.CONTROLLER}: sensor'
DONE = ('push test passed', 'push test failed')
POLL = 0.05  # s


def push_running(
    *, namespace: str = '', domain_id: int | None = None, timeout: float = 10.0,
    on_instruction: Callable[[str], None] = lambda text: None,
) -> bool:
    """
    Lead the user through the push test of a running controller; return whether it was passed.

    `on_instruction` is called with what is to be done, whenever that changes, and with the
    verdict; `timeout` is the longest wait for an answer, and without diagnostics [s]. Raises
    RunError if no controller answers, it is not active, or it is silent.
    """
    with ControllerLink((topics.DIAGNOSTICS,), namespace=namespace, domain_id=domain_id,
                        timeout=timeout) as link:
        state = link.state(topics.CONTROLLER)
        if state != 'active':
            raise RunError(f'{topics.CONTROLLER}: expected an active controller, found it {state}')
        said = link.ask('push_test', Trigger, Trigger.Request())
        on_instruction(said)
        link.queue(topics.DIAGNOSTICS)  # of before the test
        heard = time.monotonic()
        while True:
            time.sleep(POLL)
            now, reports = time.monotonic(), link.queue(topics.DIAGNOSTICS)
            for status in (status for report in reports for status in report.status):
                if status.name.endswith(SENSOR_STATUS):
                    heard = now
                    text = next((x.value for x in status.values if x.key == 'push_test'), said)
                    if text != said:
                        on_instruction(said := text)
                    if text.startswith(DONE):
                        return text.startswith(DONE[0])
            if now - heard > timeout:
                raise RunError(f'{topics.CONTROLLER}: expected diagnostics once a second, found '
                               f'none for {timeout:g} s')
