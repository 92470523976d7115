"""Commands of the page to a graph that runs: forces, motions, gains, surfaces and pushes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import Vector3Stamped
from multicontact_control.config import LimitsConfig
from multicontact_control.errors import CommandError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.link import ControllerLink
from multicontact_control.nodes.messages import (
    ControllerStatus,
    new_identifier,
    REFUSED,
)
from multicontact_control.view import source
from multicontact_control.view.motion import CommandedMotion
from multicontact_control.view.surfaces import SimulatedSurfaces
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

# A page that was busy makes up for the motion that it missed, up to the longest delay, in short
# steps: the motion is at most that much faster meanwhile.
LONGEST_DELAY = 0.2  # s
LONGEST_STEP = 0.012  # s
CATCH_UP = 1.3  # times the speed
MOTIONS = (source.GO_TO, source.JOG, source.PATTERN)


class GraphSteering:
    """
    Gives the commands of the page to a controller and to the simulator behind it.

    The page works out a motion itself: `advance_motion` commands one pose of it per sample. The
    motion ends as soon as the controller does not obey it.

    Parameters
    ----------
    link
        Connection to the controller.
    limits
        Limits of the controller, within which motions stay.
    surfaces
        Surfaces of the simulator.
    gains
        Gains that the controller has, by the names in `source.GAIN_NAMES`.

    Attributes
    ----------
    motion
        The motion under way, or the last one, at rest.
    gains
        Gains as they were set last, by name.

    """

    def __init__(
        self,
        link: ControllerLink,
        limits: LimitsConfig,
        surfaces: SimulatedSurfaces,
        gains: Mapping[str, float],
    ) -> None:
        self._link = link
        self._push_publisher = create_publisher(link.node, topics.PUSH)
        self.motion = CommandedMotion(limits)
        self._motion_identifier = ''
        self._delay = 0.0  # time of the samples that the motion is behind [s]
        self.gains = gains
        self._commands: Mapping[str, Callable[..., str]] = {
            source.FORCES: self._set_forces,
            source.GO_TO: self.motion.go_to,
            source.JOG: self.motion.jog,
            source.PATTERN: self.motion.start_sine,
            source.STOP: self.motion.stop,
            source.HOLD: self._hold_arm,
            source.GAINS: self._set_gains,
            source.SURFACE: surfaces.change_surface,
            source.PUSH: self._push_arm,
        }

    def give_command(self, name: str, /, **values: Any) -> str:
        """
        Give a command of `source`, and return what comes of it in words.

        A command that is none of motions, values or pushes is a service of the controller, as
        `source.TARE` is. See `SnapshotSource.give_command`.

        Raises
        ------
        CommandRefusedError
            If the controller refuses the command.
        MulticontactError
            If the page refuses it, or if there is no answer.

        """
        if name in MOTIONS:
            self._begin_motion()
        command = self._commands.get(name)
        if command is not None:
            return command(**values)
        answer = self._link.request_service(name, Trigger, Trigger.Request())
        return answer if answer else name

    def refuses_motion(self, status: ControllerStatus) -> bool:
        """Return whether a status is the controller's refusal of the motion under way."""
        of_motion = status.command == self._motion_identifier
        return bool(self.motion.name) and status.event == REFUSED and of_motion

    def end_disobeyed_motion(self, status: ControllerStatus) -> str:
        """
        End the motion under way if the controller does not obey it, as a status says.

        Returns
        -------
        str
            Why it ends, in words; empty if it goes on, or if there is none.

        """
        if not self.motion.name:
            return ''
        reason = ''
        if self.refuses_motion(status):
            reason = status.text
        elif status.held:
            reason = 'held'
        elif status.life_cycle != 'active':
            reason = status.life_cycle
        if reason:
            self.motion.halt()
        return reason

    def advance_motion(self, period: float) -> None:
        """
        Command the next pose of the motion under way, if there is one.

        Parameters
        ----------
        period
            Time of the samples since the call before [s]; the motion stands while samples stop or
            begin anew, with a period that is not positive.

        """
        if not self.motion.name or period <= 0.0:
            return
        self._delay = min(self._delay + period, LONGEST_DELAY)
        step = min(self._delay, CATCH_UP * period, LONGEST_STEP)
        self._delay -= step
        pose = self.motion.advance(step)
        if pose is not None:
            self._publish_motion(messages.motion_message(*pose))

    def _publish_motion(self, message: Any) -> None:
        self._link.publish_command(
            topics.MOTION_COMMAND, message, self._motion_identifier
        )

    def _begin_motion(self) -> None:
        """Begin a motion at the desired pose, or go on with the one under way."""
        status = self._link.last_status
        if status is not None and status.held:
            raise CommandError('~/hold', hint='the arm is held; release the hold first')
        if self.motion.name:
            return
        self._motion_identifier = new_identifier()
        self._delay = 0.0
        (desired,) = self._link.receive_fresh(topics.POSE_DESIRED)
        self.motion.start(*messages.pose_arrays(desired.pose))

    def _set_forces(self, **forces: float) -> str:
        names = list(forces)
        efforts = list(forces.values())
        self._link.command_until_answered(
            topics.FORCE_COMMAND, messages.joint_state_message(0, names, effort=efforts)
        )
        return ', '.join(f'{name} {force:g} N' for name, force in forces.items())

    def _hold_arm(self, on: bool) -> str:
        """Hold pose and forces, after a motion under way has come to rest; or release them."""
        if on and self.motion.name:
            self._publish_motion(messages.motion_message(*self.motion.halt()))
        return self._link.request_service('hold', SetBool, SetBool.Request(data=on))

    def _set_gains(self, **gains: float) -> str:
        self._link.set_parameters(topics.CONTROLLER, gains)
        self.gains = gains
        return 'gains are set'

    def _push_arm(self, force: list[float], tool: bool) -> str:
        """Push the simulated arm [N]; return nothing, so that a push test's words stay."""
        frame = 'tool' if tool else ''
        message = Vector3Stamped(header=Header(frame_id=frame))
        message.vector.x, message.vector.y, message.vector.z = force
        self._push_publisher.publish(message)
        return ''
