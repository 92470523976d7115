"""What a page shows and steers: a simulation, a running graph or a recording, all alike."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig, Vector3
from multicontact_control.errors import CommandError
from multicontact_control.experiment.scenario import Setup
import numpy as np
from sim_bridge.surface_patch import Patch, patch_of

RATE = 25.0  # Hz, of snapshots
POINTS = 2  # of the curves, in each of them

# Commands, each with the values it takes.
FORCES = 'forces'  # of contacts, by name [N]
GO_TO = 'go_to'  # position: of the operational point [m]
JOG = 'jog'  # offset: from where it is to go by now [m]
PATTERN = 'pattern'  # axis, amplitude [m], period [s]
STOP = 'stop'
HOLD = 'hold'  # on
RETRY = 'retry'
TARE = 'tare'
PUSH_TEST = 'push_test'
HAND = 'hand'  # the simulated hand pushes the tool as the push test asks
ESTIMATOR = 'estimator'  # name
GAINS = 'gains'  # natural_frequency [rad/s], time_constant [s], damping_rate [1/s]
SURFACE = 'surface'  # name, stiffness [N/m], friction
PUSH = 'push'  # force: on the operational point [N], for half a second
RESET = 'reset'
PLAY = 'play'  # on
SPEED = 'speed'  # factor
SEEK = 'seek'  # time [s]

STEERING = (FORCES, GO_TO, JOG, PATTERN, STOP, HOLD, RETRY, TARE, PUSH_TEST, GAINS)
SIMULATED = (HAND, ESTIMATOR, SURFACE, PUSH, RESET)
PLAYING = (PLAY, SPEED, SEEK)
COMMANDS = (*STEERING, *SIMULATED, *PLAYING)

# Of what the curves are made, for each force or couple; then the use of each torque.
MEASURED, ESTIMATED, DESIRED, VARIANCE, INNOVATION = range(5)
KINDS = 5


class Surface(NamedTuple):
    """
    A surface to draw.

    Attributes
    ----------
    name
        Of its contact, or of the surface itself.
    normal_world
        Into it.
    point_world
        On it [m]; None until a simulator tells it, or something is felt there.
    patch
        What it looks like around that point; None for a plane, or until a simulator tells it.

    """

    name: str
    normal_world: Vector3
    point_world: Vector3 | None
    patch: Patch | None = None


@dataclass(frozen=True)
class Scene:
    """
    What does not change while it is shown.

    Attributes
    ----------
    title
        What is shown, in a few words.
    config
        The controller's.
    urdf_dir
        Folder that its URDF is relative to.
    surfaces
        What may be pressed on.
    largest_force
        That may be commanded [N].
    duration
        Of a recording, 0 otherwise [s].
    marks
        Times in it to jump to [s], and what happens there.

    """

    title: str
    config: ControllerConfig
    urdf_dir: Path
    surfaces: tuple[Surface, ...]
    largest_force: float = 30.0
    duration: float = 0.0
    marks: tuple[tuple[float, str], ...] = ()


class Timing(NamedTuple):
    """
    How regular the control loop is.

    Attributes
    ----------
    typical, worst
        50th and 99th percentile of the time that a tick, or an answer over the graph, took of
        late [us]; NaN where it is not known.
    misses
        Deadlines missed since the start.
    pace
        Time of the samples per time on the wall.

    """

    typical: float = float('nan')
    worst: float = float('nan')
    misses: int = 0
    pace: float = 1.0


class SurfaceState(NamedTuple):
    """Stiffness [N/m] and friction of a simulated surface."""

    stiffness: float
    friction: float


@dataclass(frozen=True)
class Snapshot:
    """
    What there is to show of one moment.

    Attributes
    ----------
    time
        Of the sample [s].
    q
        Joint positions, shape (n,) [rad].
    position, quaternion
        Of the operational frame, world axes, scalar last [m].
    position_des
        Where it should be [m].
    commanded
        Forces and couples that are commanded, whether they are controlled already or not, by
        name [N].
    goal
        Where a command leads it [m]; None where none does.
    measured, estimated, desired
        Forces and couples, shape (r,) [N].
    normals_world
        Of the contacts now, shape (nc, 3).
    states, reaction, reasons
        Of the contacts, and what the supervisor does instead of control, with its causes and the
        limits it enforces.
    points
        Curves since the snapshot before, shape (k, 1 + KINDS r + n): time [s], measured,
        estimated and desired forces [N], R [N^2], rms of the innovation [N], and the largest
        torque relative to its limit.
    events
        Since the snapshot before: time [s] and what it was.
    timing
        Of the control loop.
    held
        Whether pose and forces are held on command.
    moving
        What motion is being made, empty for none.
    push_test
        What the user should do now, empty for nothing.
    asked_push
        The push that the push test waits for, if it does [N].
    gains
        Natural frequency [rad/s], time constant [s] and K_2 [1/s].
    estimator
        Of R; empty where it is not known.
    surfaces
        As they are now, by name.
    places_world
        A point of each surface, where that is known, by name [m].
    patches
        What surfaces look like of which the scene does not say it, by name.
    playing, speed
        Of a recording.

    """

    time: float
    q: Vector
    position: Vector
    quaternion: Vector
    position_des: Vector
    measured: Vector
    estimated: Vector
    desired: Vector
    normals_world: Matrix
    states: tuple[str, ...]
    reaction: str
    points: Matrix
    commanded: Mapping[str, float] = field(default_factory=dict)
    goal: Vector | None = None
    reasons: tuple[str, ...] = ()
    events: tuple[tuple[float, str], ...] = ()
    timing: Timing = Timing()
    held: bool = False
    moving: str = ''
    push_test: str = ''
    asked_push: tuple[float, ...] = ()
    gains: tuple[float, float, float] = (float('nan'),) * 3
    estimator: str = ''
    surfaces: Mapping[str, SurfaceState] = field(default_factory=dict)
    places_world: Mapping[str, Vector3] = field(default_factory=dict)
    patches: Mapping[str, Patch] = field(default_factory=dict)
    playing: bool = False
    speed: float = 1.0


class Source(Protocol):
    """
    Where snapshots come from and commands go to.

    Attributes
    ----------
    scene
        What does not change.
    refusals
        Commands that are never obeyed here, each with the reason.

    """

    scene: Scene
    refusals: Mapping[str, str]

    def poll(self) -> list[Snapshot]:
        """
        Return the snapshots since the last call, without waiting for any.

        Raises
        ------
        RunError
            If there will be no more: what they come from has ended.

        """

    def command(self, name: str, /, **values: Any) -> str:
        """
        Give a command.

        Returns
        -------
        str
            What comes of it.

        Raises
        ------
        MulticontactError
            If it is refused; the message says why.

        """

    def close(self) -> None:
        """End what has been started for this."""


def taken(snapshots: deque[Snapshot]) -> list[Snapshot]:
    """Take all there are; another thread may add more meanwhile."""
    found = []
    while snapshots:
        found.append(snapshots.popleft())
    return found


def refuse_if_unknown(name: str, refusals: Mapping[str, str]) -> None:
    """Raise `CommandError` for a command that is never obeyed."""
    if name in refusals:
        raise CommandError(name, refusals[name], 'none')
    if name not in COMMANDS:
        raise CommandError('command', f'one of {", ".join(COMMANDS)}', f"'{name}'")


class CurveLayout(NamedTuple):
    """
    Where things are in the points of the curves.

    Attributes
    ----------
    columns
        Number r of forces and couples.
    joints
        Number n.

    """

    columns: int
    joints: int

    @property
    def width(self) -> int:
        """Return the number of columns."""
        return 1 + KINDS * self.columns + self.joints

    def of(self, kind: int, column: int) -> int:
        """Return where a kind of curve of a force or couple is."""
        return 1 + kind * self.columns + column

    @property
    def torque_use(self) -> slice:
        """Return where the use of the torques is."""
        return slice(1 + KINDS * self.columns, self.width)


def no_points(layout: CurveLayout) -> Matrix:
    """Return the curves of no time at all."""
    return np.zeros((0, layout.width))


def felt_surfaces(config: ControllerConfig) -> tuple[Surface, ...]:
    """Return a surface for each contact, of which the place is not known."""
    return tuple(Surface(name, config.contacts[name].normal_world, None)
                 for name in config.contact_names)


def surfaces_of(setup: Setup) -> tuple[Surface, ...]:
    """Return the surfaces of a simulated plant, one for each contact and obstacle."""
    known = setup.plant.surfaces
    return tuple(
        Surface(name, known[one].normal_world, known[one].point_world, patch_of(known[one]))
        for name, one in setup.plant.drawn.items())
