"""Measured torques of joints that are of no use, and what that leads to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from multicontact_control.config import ControllerConfig


def explain_unwatched(
    config: ControllerConfig,
    joints_without_effort: Mapping[str, Sequence[int]],
) -> str:
    """
    Return whose measured torques are of no use, and what that leads to; empty if none are due.

    `joints_without_effort` are indices of joints by what is wrong with their torques.
    """
    if not config.robot.measures_torque:
        return ''
    names = config.robot.joint_names
    texts = []
    count = 0
    for fault, joints in joints_without_effort.items():
        whose = 'all'
        if len(joints) < len(names):
            whose = ', '.join(names[j] for j in joints)
        texts.append(f'of {whose} {fault}')
        count += len(joints)
    if config.wrench_input == 'momentum':
        effect = 'there is no wrench of the contacts without them'
    elif config.collision.command_delay >= 0:
        effect = 'the commands stand in for them'
    elif count == len(names):
        effect = 'collisions are not watched'
    else:
        effect = 'what touches the arm is not seen in these joints, but in the others'
    return f'effort in joint_states: {", ".join(texts)}; {effect}'
