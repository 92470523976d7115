"""The push test of a running controller, as its user meets it."""

from __future__ import annotations

from collections.abc import Callable

from multicontact_control.errors import RunError
from multicontact_control.sensor.push_test import CANCELLED, DISABLED, FAILED, PASSED

OVER = (
    PASSED,
    FAILED,
    CANCELLED,
    DISABLED,
)  # how the texts of a test begin that is over
TIMEOUT = 10.0  # s, for an answer or a command of the controller


def push_running(
    tell: Callable[[str], None], namespace: str, domain_id: int | None
) -> bool:
    """
    Lead through the push test of a running controller; return whether it passed; RunError.

    Ctrl-C cancels it.
    """
    from multicontact_control.nodes import topics
    from multicontact_control.nodes.link import ControllerLink
    from std_srvs.srv import Trigger

    with ControllerLink(
        (topics.EFFORT_COMMAND,),
        namespace=namespace,
        domain_id=domain_id,
        timeout=TIMEOUT,
    ) as link:
        if (state := link.get_state(topics.CONTROLLER)) != 'active':
            raise RunError(
                f'{topics.CONTROLLER}: expected an active controller, got {state}'
            )
        text = link.request_service('push_test', Trigger, Trigger.Request())
        tell(text)
        link.take_statuses()  # of before the test
        begun = False
        try:
            while not text.startswith(OVER):
                link.receive_fresh(topics.EFFORT_COMMAND)
                for instruction in [
                    status.push_test for status in link.take_statuses()
                ]:
                    begun = begun or instruction not in ('', DISABLED)
                    if begun and instruction != text:
                        text = instruction or CANCELLED
                        tell(text)
        except KeyboardInterrupt:
            tell(link.request_service('cancel_push_test', Trigger, Trigger.Request()))
            raise
        return text.startswith(PASSED)
