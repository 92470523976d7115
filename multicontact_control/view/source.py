"""What a page shows and steers: a running graph or a recording, both alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig, Vector3
from multicontact_control.judging.supervisor_events import LogLine, SupervisorEvent
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.causes import NONE
import numpy as np
from sim_bridge.surface_patch import Patch, shape_configured_patch

RATE = 25.0  # Hz, of snapshots
BLOCKS = 2  # of samples in each of them, that are drawn by their extremes
POINTS = 2 * BLOCKS  # of the curves in each of them

# Commands, each with the values it takes. Those up to `GAINS` are for a graph, `SURFACE` and
# `PUSH` for a simulated one, the last three for a recording.
FORCES = 'forces'  # force of each contact and couple by name [N]
GO_TO = 'go_to'  # position: of the operational point [m]
JOG = 'jog'  # offset: from the goal of the motion under way [m]
PATTERN = 'pattern'  # axis, amplitude [m], period [s]
STOP = 'stop'
HOLD = 'hold'  # on
RETRY = 'retry'
TARE = 'tare'
PUSH_TEST = 'push_test'
CANCEL_PUSH_TEST = 'cancel_push_test'
GAINS = 'gains'  # each of `GAIN_NAMES`
SURFACE = 'surface'  # name, stiffness [N/m], friction
PUSH = 'push'  # force [N]; tool: whether on the tool, or at the operational point
PLAY = 'play'  # on
SPEED = 'speed'  # factor
SEEK = 'seek'  # time [s]

GAIN_NAMES = (  # [rad/s], [s], [1/s]
    'motion.natural_frequency',
    'force.time_constant',
    'force.damping_rate',
)
KINDS = 6  # of curves for each force or couple, see `Snapshot.points`


class DrawnSurface(NamedTuple):
    """
    A surface as the page draws it.

    Attributes
    ----------
    name
        Name of the contact that touches the surface, or of the obstacle.
    normal_world
        Unit normal in world axes, into the surface.
    point_world
        Point on the surface in world axes [m]; None until a contact force shows where it is.
    patch
        Triangles around that point; None draws a plane.

    """

    name: str
    normal_world: Vector3
    point_world: Vector3 | None
    patch: Patch | None = None


class SurfaceState(NamedTuple):
    """
    The properties of a simulated surface that the page changes while the simulator runs.

    Attributes
    ----------
    stiffness
        Normal stiffness [N/m].
    friction
        Coefficient of Coulomb friction.

    """

    stiffness: float
    friction: float


class DrawnPush(NamedTuple):
    """
    A force from outside that disturbs a simulated arm, as the page draws it.

    Attributes
    ----------
    force_world
        Force on the arm in world axes [N].
    link
        Name of the URDF link at whose origin the force acts.

    """

    force_world: Vector3
    link: str


@dataclass(frozen=True)
class Scene:
    """
    What stays the same while the page shows one graph or one recording.

    Attributes
    ----------
    title
        What is shown, in a few words.
    config
        Configuration of the controller, its arm and its contacts.
    urdf_dir
        Folder that the path of the arm's URDF is relative to.
    surfaces
        Surfaces to draw: one for each contact, in the order of the contacts, then obstacles.
    simulated
        State of each surface at the start, by name; empty without a simulator.
    largest_force
        Largest contact force that the controller accepts [N].
    true_forces
        Whether the true contact forces are known, which only a simulator publishes.
    duration
        Length of a recording [s]; None for a graph that runs.
    marks
        Moments of a recording to jump to: time [s] and a short text.

    """

    title: str
    config: ControllerConfig
    urdf_dir: Path
    surfaces: tuple[DrawnSurface, ...]
    simulated: Mapping[str, SurfaceState] = field(default_factory=dict)
    largest_force: float = 30.0
    true_forces: bool = False
    duration: float | None = None
    marks: tuple[LogLine, ...] = ()


class LoopTiming(NamedTuple):
    """
    How regularly the control loop runs.

    Attributes
    ----------
    typical, worst
        Latency from a sample to its torque command in the last second, 50th and 99th
        percentile [us]; NaN where it is not known.
    misses
        Number of samples that got no command in time since the start.
    pace
        Real-time factor: time of the samples over time of the clock in the last seconds.

    """

    typical: float = math.nan
    worst: float = math.nan
    misses: int = 0
    pace: float = 1.0


@dataclass(frozen=True)
class Snapshot:
    """
    The state of arm, contacts and controller at one moment; n joints, r forces, nc contacts.

    Attributes
    ----------
    time
        Time of the newest sample [s].
    q
        Joint positions, shape (n,) [rad].
    position, quaternion
        Pose of the operational frame in world axes: shape (3,) [m]; scalar last, shape (4,).
    position_des
        Desired position of the operational point in world axes, shape (3,) [m].
    measured, estimated, desired, true
        Contact forces and couples, shape (r,) [N]; true forces are NaN where they are not known.
    normals_world
        Contact normals as the controller has them now, world axes, shape (nc, 3).
    states
        State of each contact in words.
    reaction
        What the supervisor does instead of the control law.
    points
        Curves since the snapshot before, shape (k, 1 + KINDS r + n): time [s]; measured,
        estimated, desired and true forces [N], R [N^2], innovation [N]; torque magnitudes over
        their limits. Two points hold the least and the greatest values of a block of samples.
    commanded
        Commanded force of each contact and couple by name [N].
    goal
        Where a motion on command leads, world axes [m]; None without one.
    reasons
        Causes of the reaction, and limits that act.
    events
        What has happened since the snapshot before: time [s] and text.
    timing
        How regularly the loop runs.
    held
        Whether a command holds pose and forces.
    moving
        Name of the motion under way; empty at rest.
    push_test
        What the push test asks the user to do now; empty without a test.
    gains
        Gain values by the names in `GAIN_NAMES`.
    surfaces
        State of each simulated surface by name.
    places_world
        Point on each surface by name, world axes [m].
    push
        Push under way, None without one.
    playing
        Whether time goes on; False in a recording that is paused.
    anew
        Whether this snapshot begins a new stretch of time: its curves and events replace those
        of the snapshots before.

    """

    time: float
    q: Vector
    position: Vector
    quaternion: Vector
    position_des: Vector
    measured: Vector
    estimated: Vector
    desired: Vector
    true: Vector
    normals_world: Matrix
    states: tuple[str, ...]
    reaction: str
    points: Matrix
    commanded: Mapping[str, float] = field(default_factory=dict)
    goal: Vector | None = None
    reasons: tuple[str, ...] = ()
    events: tuple[LogLine, ...] = ()
    timing: LoopTiming = LoopTiming()
    held: bool = False
    moving: str = ''
    push_test: str = ''
    gains: Mapping[str, float] = field(default_factory=dict)
    surfaces: Mapping[str, SurfaceState] = field(default_factory=dict)
    places_world: Mapping[str, Vector3] = field(default_factory=dict)
    push: DrawnPush | None = None
    playing: bool = True
    anew: bool = False


class SnapshotSource(Protocol):
    """
    Where the page takes snapshots from and gives commands to.

    A running graph and a recording both are such a source, so that the page draws them alike.
    All calls come from one thread.

    Attributes
    ----------
    scene
        What stays the same, and which commands the source takes.

    """

    scene: Scene

    def take_snapshots(self) -> list[Snapshot]:
        """
        Return the snapshots that are due, without waiting for one.

        The page calls this about every 10 ms and draws the last of them.

        Raises
        ------
        RunError
            If what the snapshots come from has ended, so that none follows.

        """

    def give_command(self, name: str, /, **values: Any) -> str:
        """
        Give a command to the controller, the simulator or the replay.

        Parameters
        ----------
        name
            One of the commands at the head of this module.
        values
            The values that the command takes, listed there with their units.

        Returns
        -------
        str
            What the command leads to, for the user; empty where the snapshots show it.

        Raises
        ------
        MulticontactError
            If the command is refused.

        """

    def close(self) -> None:
        """Leave the graph or the recording; a graph that was started elsewhere goes on."""


class EventDescriber:
    """
    Describes in words what each event of the supervisor changes.

    The supervisor logs its whole status at each event; the page lists only the differences
    between one event and the next, starting from contacts that are free.

    Parameters
    ----------
    contact_names
        Names of the contacts, in the order of the states in an event.

    """

    def __init__(self, contact_names: Sequence[str]) -> None:
        self._names = tuple(contact_names)
        self._before = SupervisorEvent(0.0, NONE, (), (), ('free',) * len(self._names))

    def describe_changes(self, event: SupervisorEvent) -> str:
        """
        Return what an event changes: reaction and causes, contact states, new limits.

        The parts are joined by commas; the text is empty if the event changes none of them. The
        next call compares with this event.
        """
        before = self._before
        self._before = event
        parts = []
        if event.reaction != before.reaction:
            if event.reaction == NONE:
                parts.append('control again')
            elif event.causes:
                parts.append(f'{event.reaction} ({" ".join(event.causes)})')
            else:
                parts.append(event.reaction)
        contacts = zip(self._names, before.contact_states, event.contact_states)
        for name, old_state, state in contacts:
            if state != old_state:
                parts.append(f'{name} {state}')
        new_limits = [limit for limit in event.limits if limit not in before.limits]
        if new_limits:
            parts.append(f'limit: {" ".join(new_limits)}')
        return ', '.join(parts)


def count_point_columns(config: ControllerConfig) -> int:
    """Return the number of columns of `Snapshot.points`: time, forces of all kinds, torques."""
    return 1 + KINDS * len(config.columns) + len(config.robot.joint_names)


def find_torque_limits(config: ControllerConfig) -> Vector:
    """
    Return the torque limits of the joints, shape (n,) [N m], to which curves relate the torques.

    They are infinite without limits in the configuration: such curves stay at 0.
    """
    limits = np.full(len(config.robot.joint_names), np.inf)
    if config.torque_limit:
        limits[:] = config.torque_limit
    return limits


def list_felt_surfaces(config: ControllerConfig) -> tuple[DrawnSurface, ...]:
    """
    Return a surface for each contact of an arm whose surroundings are not known.

    Each has the configured contact normal and no place: the page draws it where a contact force
    shows that it is there.
    """
    return tuple(
        DrawnSurface(name, config.contacts[name].normal_world, None)
        for name in config.contact_names
    )


def list_simulated_surfaces(setup: Setup) -> tuple[DrawnSurface, ...]:
    """
    Return the surfaces of a simulated plant, one for each contact and each obstacle.

    Their places and patches are those at the start; a surface that moves has its place in
    `Snapshot.places_world`.
    """
    surfaces = []
    for name, surface_name in setup.plant.drawn.items():
        surface = setup.plant.surfaces[surface_name]
        surfaces.append(
            DrawnSurface(
                name,
                surface.normal_world,
                surface.point_world,
                shape_configured_patch(surface),
            )
        )
    return tuple(surfaces)
