"""What a page shows and steers: a running graph or a recording, both alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig, Vector3
from multicontact_control.judging.supervisor_events import SupervisorEvent
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.reactions import NONE
from sim_bridge.surface_patch import Patch, shape_configured_patch

RATE = 25.0  # Hz, of snapshots
BLOCKS = 2  # of samples in each of them, that are drawn by their extremes
POINTS = 2 * BLOCKS  # of the curves in each of them

# Commands, each with the values it takes: of a graph, of one that is simulated, of a recording.
FORCES = 'forces'  # of contacts, by name [N]
GO_TO = 'go_to'  # position: of the operational point [m]
JOG = 'jog'  # offset: from where it is to go by now [m]
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


class Surface(NamedTuple):
    """A surface to draw."""

    name: str  # of its contact, or of the surface itself
    normal_world: Vector3  # into it
    point_world: Vector3 | None  # on it [m]; None until something is felt there
    patch: Patch | None = None  # what it looks like around that point; None for a plane


class SurfaceState(NamedTuple):
    """Stiffness [N/m] and friction of a simulated surface."""

    stiffness: float
    friction: float


class Push(NamedTuple):
    """A force that pushes the arm."""

    force_world: Vector3  # [N]
    link: str  # URDF link at whose origin it acts


@dataclass(frozen=True)
class Scene:
    """What does not change while it is shown."""

    title: str
    config: ControllerConfig
    urdf_dir: Path  # that its URDF is relative to
    surfaces: tuple[Surface, ...]  # those of the contacts first
    # Surfaces at the start, by name; none without a simulator.
    simulated: Mapping[str, SurfaceState] = field(default_factory=dict)
    largest_force: float = 30.0  # that may be commanded [N]
    true_forces: bool = False  # whether they are known, as a simulator knows them
    duration: float | None = None  # of a recording [s]; None of a graph
    marks: tuple[
        tuple[float, str], ...
    ] = ()  # times in it to jump to [s], and what is there


class Timing(NamedTuple):
    """How regular the control loop is."""

    typical: float = float(
        'nan'
    )  # latency from a sample to its command in the last second,
    worst: float = float(
        'nan'
    )  # 50th and 99th percentile [us]; NaN where it is not known
    misses: int = 0  # samples without a command since the start
    pace: float = 1.0  # real-time factor of the last seconds


@dataclass(frozen=True)
class Snapshot:
    """What there is to show of one moment."""

    time: float  # of the sample [s]
    q: Vector  # joint positions, shape (n,) [rad]
    position: Vector  # of the operational frame, world axes [m]
    quaternion: Vector  # likewise, scalar last
    position_des: Vector  # where it should be [m]
    measured: Vector  # forces and couples, shape (r,) [N]
    estimated: Vector
    desired: Vector
    true: Vector  # NaN where they are not known
    normals_world: Matrix  # of the contacts now, shape (nc, 3)
    states: tuple[str, ...]  # of the contacts
    reaction: str  # what the supervisor does instead of control
    # Curves since the snapshot before, shape (k, 1 + KINDS r + n): time [s]; measured, estimated,
    # desired and true forces [N], R [N^2], innovation [N]; sizes of torques over their limits. Two
    # points are the least and the greatest values of a block of samples.
    points: Matrix
    commanded: Mapping[str, float] = field(default_factory=dict)  # forces, by name [N]
    goal: Vector | None = None  # where a command leads it [m]
    reasons: tuple[str, ...] = ()  # causes of the reaction, and the limits that act
    events: tuple[
        tuple[float, str], ...
    ] = ()  # since the snapshot before: time [s], and words
    timing: Timing = Timing()
    held: bool = False  # whether pose and forces are held on command
    moving: str = ''  # motion under way
    push_test: str = ''  # what the user should do now
    gains: Mapping[str, float] = field(default_factory=dict)  # of `GAIN_NAMES`
    surfaces: Mapping[str, SurfaceState] = field(
        default_factory=dict
    )  # simulated ones, by name
    places_world: Mapping[str, Vector3] = field(
        default_factory=dict
    )  # points of surfaces [m]
    push: Push | None = None  # under way
    playing: bool = True  # whether time goes on
    anew: bool = (
        False  # whether curves and events of before are over: its own take their place
    )


class Source(Protocol):
    """
    Where snapshots come from and commands go to; all calls come from one thread.

    Attributes
    ----------
    scene
        What does not change, and which commands there are.

    """

    scene: Scene

    def poll(self) -> list[Snapshot]:
        """
        Return the snapshots that are due, without waiting for any; called about every 10 ms.

        Raises
        ------
        RunError
            If there will be no more: what they come from has ended.

        """

    def command(self, name: str, /, **values: Any) -> str:
        """
        Give a command; MulticontactError if it is refused.

        Returns what comes of it, nothing where snapshots show that.
        """

    def close(self) -> None:
        """Leave what is shown."""


class ChangeReader:
    """Puts into words what has changed from one event of the supervisor to the next."""

    def __init__(self, contact_names: Sequence[str]) -> None:
        self._names = tuple(contact_names)
        self._before = SupervisorEvent(0.0, NONE, (), (), ('free',) * len(self._names))

    def read(self, event: SupervisorEvent) -> str:
        """Return what has changed, nothing if that is nothing."""
        before, self._before = self._before, event
        parts = []
        if event.reaction != before.reaction:
            causes = f' ({" ".join(event.causes)})' if event.causes else ''
            parts.append(
                event.reaction + causes if event.reaction != NONE else 'control again'
            )
        parts += [
            f'{name} {state}'
            for name, state, last in zip(
                self._names, event.contact_states, before.contact_states
            )
            if state != last
        ]
        if limits := [limit for limit in event.limits if limit not in before.limits]:
            parts.append(f'limit: {" ".join(limits)}')
        return ', '.join(parts)


def point_width(config: ControllerConfig) -> int:
    """Return the number of columns of `Snapshot.points`."""
    return 1 + KINDS * len(config.columns) + len(config.robot.joint_names)


def felt_surfaces(config: ControllerConfig) -> tuple[Surface, ...]:
    """Return a surface for each contact, of which the place is not known."""
    return tuple(
        Surface(name, config.contacts[name].normal_world, None)
        for name in config.contact_names
    )


def surfaces_of(setup: Setup) -> tuple[Surface, ...]:
    """Return the surfaces of a simulated plant, one for each contact and obstacle."""
    known = setup.plant.surfaces
    return tuple(
        Surface(
            name,
            known[one].normal_world,
            known[one].point_world,
            shape_configured_patch(known[one]),
        )
        for name, one in setup.plant.drawn.items()
    )
