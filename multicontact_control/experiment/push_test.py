"""The push test of a running controller, as its user meets it."""

from __future__ import annotations

from collections.abc import Callable

from multicontact_control.errors import RunError

PASSED, FAILED = 'push test passed', 'push test failed'

Tell = Callable[[str], None]


def push_running(
    tell: Tell, *, namespace: str = '', domain_id: int | None = None, timeout: float = 10.0,
) -> bool:
    """
    Lead the user through the push test of a running controller; return whether it was passed.

    `tell` is called with each instruction, and with the verdict; `timeout` is the longest wait for
    an answer or a command of the controller [s]. Raises RunError if none comes, or the controller
    is not active.
    """
    from multicontact_control.nodes import topics
    from multicontact_control.nodes.link import ControllerLink
    from std_srvs.srv import Trigger

    with ControllerLink((topics.EFFORT_COMMAND,), namespace=namespace, domain_id=domain_id,
                        timeout=timeout) as link:
        if (state := link.state(topics.CONTROLLER)) != 'active':
            raise RunError(f'{topics.CONTROLLER}: expected an active controller, found it {state}')
        instruction = link.ask('push_test', Trigger, Trigger.Request())
        tell(instruction)
        link.look()  # of before the test
        while not instruction.startswith((PASSED, FAILED)):
            link.fresh(topics.EFFORT_COMMAND)
            for status in link.look():
                if status.push_test not in ('', instruction):
                    tell(instruction := status.push_test)
        return instruction.startswith(PASSED)
