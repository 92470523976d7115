"""
What is left of an action, so that any of them is safe and ends no episode.

The supervisor takes an arm from its controller where the wrench contradicts the contacts. Actions
lead there that no task needs: a contact is let go and sought anew while its tip still presses, as
if the sensor read that in free space; a contact is made while the arm moves or presses elsewhere,
where friction reads as a touch; a tip that no force law drives goes into its surface; the tool
turns away from its surfaces, or loads the wrist sensor beyond its range.
"""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.controller import ControlOutput
from multicontact_control.dynamics.rotations import Pose, rotation_vector_between
from multicontact_control.learning.config import EnvironmentConfig
from multicontact_control.supervision.contacts import (
    HOLDING,
    IMPACT,
    PRESSED,
    SOUGHT,
    STATE_NAMES,
)
import numpy as np
from scipy.optimize import nnls

RAMP_SHARE = 0.1  # of the largest acceleration, by which a twist changes...
BRAKING_SHARE = 0.4  # ...and where a tip nears a surface, or the tool its largest tilt
FORCE_RATE = 200.0  # N/s, of a force that is asked for
# Of what the wrist sensor reads at most, from which on forces are lowered.
WRENCH_SHARE = 0.8
FREE_TIME = 0.3  # s that nothing is felt at a contact before it is sought anew
STIFFENING_TIME = 0.5  # s, in which the natural frequency of the motion changes e-fold
LEVER = 0.2  # m, at which an angular speed counts as a speed
TURNED = 'tilt of the tool'
TOUCHING = 'motion to a surface'
RAMPED = 'acceleration'
HELD_BACK = 'force'
MAKING = 'contact being made'
OVERLOADED = 'range of the wrist sensor'
STIFFENED = 'stiffness'


class ActionLimiter:
    """
    Limits what is commanded in an episode, and says what it has limited.

    Parameters
    ----------
    config, controller
        Of the environment, and of the episode's controller.
    length
        Of a step [s].
    start
        The pose at which the episode begins.
    free_reading
        What the contacts read before anything is touched, shape (r,) [N].

    Attributes
    ----------
    limited
        What has been limited since `begin_step`.

    """

    def __init__(
        self,
        config: EnvironmentConfig,
        controller: ControllerConfig,
        length: float,
        start: Pose,
        free_reading: Vector,
    ) -> None:
        self._largest_tilt = config.largest_tilt
        self._controller = controller
        self._length = length
        self._start = start
        self._free_reading = free_reading
        self._columns = np.array(controller.force_columns)
        self._free_time = np.full(len(self._columns), FREE_TIME)  # without a touch [s]
        self._twist = np.zeros(6)  # at the end of the step [m/s, rad/s]
        self._frequency = controller.motion.natural_frequency
        self.limited: set[str] = set()

    def begin_step(self, output: ControlOutput, states: tuple[str, ...]) -> None:
        """Take in the newest answered sample, and the states of the contacts."""
        contacts = output.contacts
        self._states = [STATE_NAMES.index(state) for state in states]
        self._rows: Matrix = contacts['N'][self._columns]
        self._position = output.pose.position_world
        beyond = (contacts['alpha_meas'] - self._free_reading)[self._columns]
        self._felt = beyond > self._controller.contact_state.contact_threshold
        self._free_time = np.where(self._felt, 0.0, self._free_time + self._length)
        self._makes_contact = any(state in SOUGHT + (IMPACT,) for state in self._states)
        self.limited = set()
        self._load = 0.0  # of the wrist sensor, a share of what it reads at most
        if self._controller.sensor.full_scale:
            wrench = output.controls['wrench'][0]
            self._load = float(
                np.abs(wrench / self._controller.sensor.full_scale).max()
            )

    def limit_forces(
        self, wanted: dict[str, float], before: dict[str, float]
    ) -> dict[str, float]:
        """
        Return forces and couples by name [N] that are as near to the wanted ones as is safe.

        A force changes at a bounded rate, and a contact is let go from the smallest one. It is
        sought anew once nothing has been felt there for a while, and until it holds no other one
        has more than the smallest or is let go. Couples keep their centres of pressure.
        """
        smallest = self._controller.contact_state.smallest_force
        change = FORCE_RATE * self._length
        forces = dict(wanted)
        names = self._controller.contact_names
        sought = {name for name in names if wanted[name] > 0.0 and before[name] == 0.0}
        makes = bool(sought) or self._makes_contact
        pressed_hard = any(before[name] > smallest for name in names)
        for name, state, free_time in zip(names, self._states, self._free_time):
            force = wanted[name]
            last = before[name]
            stays = force > 0.0 or (makes and state == HOLDING)
            if name in sought and (free_time < FREE_TIME or pressed_hard):
                forces[name] = 0.0
            elif force > 0.0 and state != HOLDING:
                forces[name] = smallest
            elif last > smallest or (last > 0.0 and stays):
                largest = last + change
                if makes:
                    largest = smallest
                if last * WRENCH_SHARE < largest * self._load:
                    largest = last * WRENCH_SHARE / self._load
                    self.limited.add(OVERLOADED)
                forces[name] = max(min(force, largest), last - change, smallest)
            if forces[name] != force:
                self.limited.add(MAKING if makes else HELD_BACK)
        for column in self._controller.columns:
            leader = self._controller.columns[column.leader].name
            if column.half_length and column.name in wanted and wanted[leader] > 0.0:
                forces[column.name] *= forces[leader] / wanted[leader]
        return forces

    def leave_surfaces(self, pose: Pose) -> Pose:
        """
        Return where to go on from: not behind a surface that a tip feels but does not press.

        While a contact was pressed, its force placed the tip. What was commanded may be deep in
        the surface, as where the tool has turned since.
        """
        position = pose.position_world.copy()
        for state, row, felt in zip(self._states, self._rows, self._felt):
            if felt and state not in PRESSED + SOUGHT:
                depth = float(row[:3] @ (position - self._position))
                position -= max(depth, 0.0) * row[:3]
        return Pose(position, pose.rotation_world)

    def limit_twist(self, wanted: Vector, pose: Pose) -> tuple[Vector, Vector]:
        """
        Return the twist at the end of the step and the acceleration to it, each (6,), world axes.

        It goes to the wanted one at a share of the largest accelerations, the larger one to keep
        tips off surfaces that no force law presses, and the tool within its largest tilt.
        """
        limits = self._controller.limits
        if self._makes_contact and wanted.any():
            wanted = np.zeros(6)
            self.limited.add(MAKING)
        wanted = np.concatenate(
            [
                shorten(wanted[:3], limits.operational_speed),
                shorten(wanted[3:], limits.operational_turn),
            ]
        )
        ramped = self._go_over(self._leave_out(wanted, pose), RAMP_SHARE)
        if (ramped != wanted).any() and not self.limited & {TOUCHING, TURNED}:
            self.limited.add(RAMPED)
        twist = self._go_over(self._leave_out(ramped, pose), BRAKING_SHARE)
        acceleration = (twist - self._twist) / self._length
        self._twist = twist
        return twist, acceleration

    def _go_over(self, wanted: Vector, share: float) -> Vector:
        """Return the twist that is reached by a share of the largest accelerations."""
        limits = self._controller.limits
        change = wanted - self._twist
        way = share * self._length
        return self._twist + np.concatenate(
            [
                shorten(change[:3], way * limits.operational_acceleration),
                shorten(change[3:], way * limits.operational_turn_acceleration),
            ]
        )

    def _leave_out(self, twist: Vector, pose: Pose) -> Vector:
        """Return the nearest twist that tilts no farther, and drives no tip into a surface."""
        rows: list[Vector] = []
        bounds: list[float] = []
        causes: list[str] = []
        speed = self._controller.contact_state.approach_speed
        for state, row, felt in zip(self._states, self._rows, self._felt):
            if state in PRESSED:
                continue
            bound = speed
            if state in SOUGHT:
                # Its displacement places the tip, but for what turns it.
                row = np.concatenate([np.zeros(3), row[3:]])
            elif felt:
                bound = -speed
            rows.append(row)
            bounds.append(bound)
            causes.append(TOUCHING)
        tilted = np.array(
            rotation_vector_between(pose.rotation_world, self._start.rotation_world)
        )
        tilt = float(np.linalg.norm(tilted))
        if tilt > 0.0:
            limits = self._controller.limits
            braking = BRAKING_SHARE * limits.operational_turn_acceleration
            left = max(self._largest_tilt - tilt, 0.0)
            rows.append(np.concatenate([np.zeros(3), tilted / tilt]))
            bounds.append(
                max(float(np.sqrt(2.0 * braking * left)) - braking * self._length, 0.0)
            )
            causes.append(TURNED)
        if not rows:
            return twist
        allowed, multipliers = nearest_within(twist, np.array(rows), np.array(bounds))
        for cause, multiplier in zip(causes, multipliers):
            if multiplier > 0.0:
                self.limited.add(cause)
        return allowed

    def limit_frequency(self, wanted: float) -> float:
        """Return the natural frequency of the motion, which changes slowly [rad/s]."""
        factor = float(np.exp(self._length / STIFFENING_TIME))
        frequency = min(max(wanted, self._frequency / factor), self._frequency * factor)
        if frequency != wanted:
            self.limited.add(STIFFENED)
        self._frequency = frequency
        return frequency


def shorten(vector: Vector, largest: float) -> Vector:
    """Return a vector, made as short as `largest` if it is longer."""
    return vector * (largest / max(float(np.linalg.norm(vector)), largest))


def nearest_within(
    twist: Vector, rows: Matrix, bounds: Vector
) -> tuple[Vector, Vector]:
    """
    Return the twist nearest to one, shape (6,), of which `rows` have at most `bounds`.

    Least distance programming by non-negative least squares (Lawson and Hanson 1974, ch. 23): x =
    t - G^T y with multipliers y >= 0, shape (k,), which are returned, too. An angular speed counts
    as the speed at `LEVER`.
    """
    scale = np.repeat([1.0, LEVER], 3)
    G = rows / scale
    t = scale * twist
    inside = np.linalg.pinv(G) @ bounds
    multipliers, _ = nnls(G.T, t - inside)
    return (t - G.T @ multipliers) / scale, multipliers
