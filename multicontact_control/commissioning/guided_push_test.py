"""The push test of a running controller, as its user meets it."""

from __future__ import annotations

from multicontact_control.commissioning.resting_poses import Tell
from multicontact_control.errors import RunError
from multicontact_control.sensor.push_test import CANCELLED, DISABLED, FAILED, PASSED

OVER = (PASSED, FAILED, CANCELLED, DISABLED)  # beginnings of the text of a test's end
TIMEOUT = 10.0  # s, for an answer or a command of the controller


def lead_push_test(tell: Tell, namespace: str, domain_id: int | None) -> bool:
    """
    Lead through the push test of a running controller.

    Parameters
    ----------
    tell
        Is called with each instruction, and with the result.
    namespace, domain_id
        Where the controller runs.

    Returns
    -------
    bool
        Whether the sensor passed. Ctrl-C cancels the test.

    Raises
    ------
    RunError
        If the controller is not active, refuses the test, or does not answer.

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
        state = link.get_state(topics.CONTROLLER)
        if state != 'active':
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
                for status in link.take_statuses():
                    instruction = status.push_test
                    begun = begun or instruction not in ('', DISABLED)
                    if begun and instruction != text:
                        text = instruction or CANCELLED
                        tell(text)
        except KeyboardInterrupt:
            tell(link.request_service('cancel_push_test', Trigger, Trigger.Request()))
            raise
        return text.startswith(PASSED)
