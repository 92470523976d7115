"""A recording as a source of snapshots: played, paused, at another speed, from any moment."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from time import monotonic
from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.config import ControllerConfig, Vector3
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.judging.results import load_setup
from multicontact_control.judging.run_folders import (
    BAG_FOLDER,
    find_run_folder,
    is_run_folder,
    SUMMARY_FILE,
)
from multicontact_control.judging.run_summary import read_summary
from multicontact_control.judging.supervisor_events import (
    LogLine,
    read_event,
    SupervisorEvent,
)
from multicontact_control.runs.bag import MARKERS, mcap_files, read_messages
from multicontact_control.runs.recording import (
    CUT_OFF,
    read_bag,
    RunData,
    SERIES_FILE,
)
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.causes import NONE
from multicontact_control.view import source
from multicontact_control.view.curves import find_block_extremes
import numpy as np

HISTORY_TIME = 60.0  # s, of curves and events that a jump brings along
STAMP_TOLERANCE = 1e-9  # s, by which an event may be stamped after its sample
SURFACES = 'ground_truth/surfaces'

SurfacePlaces = Mapping[str, Vector3]  # a point on each surface by name, world axes [m]


class ReplaySource:
    """
    Plays a recording as a graph would run, and jumps to any moment of it.

    Time in the recording goes on by the clock, times the speed, while it plays. It is paused at
    first and at its end.

    Parameters
    ----------
    scene
        What stays the same; duration, true forces and further marks are found in the recording.
    data
        The recorded series.
    events
        The supervisor's log: time [s] and line. Without one, the states of the contacts are
        found in the desired forces.
    places
        Time from which surfaces are at other places [s], and those places.

    """

    def __init__(
        self,
        scene: source.Scene,
        data: RunData,
        events: Sequence[LogLine] = (),
        places: Sequence[tuple[float, SurfacePlaces]] = (),
    ) -> None:
        config = scene.config
        self._data = data
        self._place_times = [time for time, _ in places]
        self._places: list[SurfacePlaces] = [{}]
        if places:
            self._places = [points for _, points in places]
        self._normals = np.array(
            [config.contacts[name].normal_world for name in config.contact_names]
        )
        self._points = compute_curve_points(data, config)
        if events:
            # While a simulator pauses, several events have one time: they keep their order.
            log = sorted(events, key=itemgetter(0))
            self._events = [read_event(*line) for line in log]
        else:
            self._events = find_force_requests(data, list(config.force_columns))
        self._event_times = [event.time for event in self._events]
        self._end = (data.ticks - 1) / data.rate
        marks = list(scene.marks)
        describer = source.EventDescriber(config.contact_names)
        for event in self._events:
            text = describer.describe_changes(event)
            if text:
                marks.append((event.time, text))
        marks.sort(key=itemgetter(0))
        self.scene = replace(
            scene,
            duration=self._end,
            true_forces=bool(np.isfinite(data.alpha_true).any()),
            marks=tuple(marks),
        )
        self._playing = False
        self._speed = 1.0
        # Time in the recording [s] at a time of the clock, from where both go on.
        self._start_time = 0.0
        self._start_clock = monotonic()
        self._shown_until = -np.inf  # time of the last snapshot [s]
        self._next_snapshot = 0.0  # on the clock
        self._command_given = True  # so that a snapshot is due, even of a pause
        self._jumped = False

    def _advance_time(self) -> float:
        """Return the time in the recording [s]; pause at its end."""
        if not self._playing:
            return self._start_time
        time = self._start_time + self._speed * (monotonic() - self._start_clock)
        if time < self._end:
            return time
        self._start_time = self._end
        self._playing = False
        self._command_given = True
        return self._end

    def take_snapshots(self) -> list[source.Snapshot]:
        """
        Return a snapshot of the time in the recording if one is due.

        It is due `source.RATE` times a second while the recording plays, and once after each
        command. A recording does not end on its own: no RunError.
        """
        time = self._advance_time()
        is_due = self._playing and monotonic() >= self._next_snapshot
        if not is_due and not self._command_given:
            return []
        self._command_given = False
        self._next_snapshot = monotonic() + 1.0 / source.RATE
        snapshot = self._make_snapshot(time)
        self._shown_until = time
        self._jumped = False
        return [snapshot]

    def _make_snapshot(self, time: float) -> source.Snapshot:
        data = self._data
        k = int(time * data.rate + 1e-6)
        latest = time + STAMP_TOLERANCE
        first, end = np.searchsorted(
            self._points[:, 0], (self._shown_until, time), side='right'
        )
        event = self._events[_find_last(self._event_times, latest)]
        new_events = []
        for mark_time, text in self.scene.marks:
            if self._shown_until < mark_time <= latest:
                new_events.append((mark_time, text))
        return source.Snapshot(
            time=time,
            q=data.q[k],
            position=data.position[k],
            quaternion=data.quaternion[k],
            position_des=data.position_des[k],
            measured=data.alpha_meas[k],
            estimated=data.alpha_est[k],
            desired=data.alpha_des[k],
            true=data.alpha_true[k],
            normals_world=self._normals,
            states=event.contact_states,
            reaction=event.reaction,
            reasons=event.causes + event.limits,
            points=self._points[first:end],
            events=tuple(new_events),
            places_world=self._places[_find_last(self._place_times, time)],
            playing=self._playing,
            anew=self._jumped,
        )

    def give_command(self, name: str, /, **values: Any) -> str:
        """
        Play, pause, change the speed or jump; the next snapshot shows it.

        Parameters
        ----------
        name
            `source.PLAY`, `source.SPEED` or `source.SEEK`. To play at the end begins anew.
        values
            ``on``; ``factor`` of the real time; ``time`` in the recording [s].

        Raises
        ------
        CommandError
            If ``time`` is not in the recording.

        """
        time = self._advance_time()
        self._start_time = time
        self._start_clock = monotonic()
        self._command_given = True
        if name == source.PLAY:
            self._playing = values['on']
            if self._playing and time >= self._end:
                self._jump_to(0.0)
        elif name == source.SPEED:
            self._speed = values['factor']
        else:
            goal = values['time']
            if not 0.0 <= goal <= self._end:
                raise CommandError('time', f'0 to {self._end:g} s', f'{goal:g} s')
            self._jump_to(goal)
        return ''

    def _jump_to(self, time: float) -> None:
        self._start_time = time
        self._shown_until = time - HISTORY_TIME
        self._jumped = True

    def close(self) -> None:
        """Do nothing: a replay has read its files before it plays, and starts no process."""


def _find_last(times: Sequence[float], time: float) -> int:
    """Return the index of the last time that is not after another; 0 before the first."""
    return max(0, bisect_right(times, time) - 1)


def find_force_requests(
    data: RunData, force_columns: Sequence[int]
) -> list[SupervisorEvent]:
    """
    Return an event wherever contact forces begin or end to be asked for.

    It stands for the supervisor's log in a recording that has none: contacts are ``force`` while
    their desired force is above zero, else ``free``. Samples without desired forces are skipped.

    Parameters
    ----------
    data
        The recorded series.
    force_columns
        Indices of the normal force of each contact among forces and couples.

    """
    states = ('free',) * len(force_columns)
    events = [SupervisorEvent(0.0, NONE, (), (), states)]
    desired = data.alpha_des[:, force_columns]
    known = np.flatnonzero(np.isfinite(desired).all(axis=1))
    is_asked = desired[known] > 0.0
    is_asked_before = np.zeros_like(is_asked)
    is_asked_before[1:] = is_asked[:-1]
    for row in np.flatnonzero((is_asked != is_asked_before).any(axis=1)):
        states = tuple(np.where(is_asked[row], 'force', 'free').tolist())
        time = float(data.time[known[row]])
        events.append(SupervisorEvent(time, NONE, (), (), states))
    return events


def compute_curve_points(data: RunData, config: ControllerConfig) -> Matrix:
    """
    Return the curves of a whole recording, with the columns of `source.Snapshot.points`.

    Each block of samples makes two points, its least and greatest values, so that an oscillation
    keeps its height in curves that have far fewer points than the recording.
    """
    samples = np.column_stack(
        [
            data.time,
            data.alpha_meas,
            data.alpha_est,
            data.alpha_des,
            data.alpha_true,
            data.noise_variance,
            data.innovation,
            np.abs(data.torque) / source.find_torque_limits(config),
        ]
    )
    return find_block_extremes(samples, round(data.rate / source.RATE / source.BLOCKS))


def load_replay(path: Path, setup: Setup, namespace: str | None = None) -> ReplaySource:
    """
    Read a recording: a run with its configuration and log, or a bag recorded in any other way.

    Parameters
    ----------
    path
        Folder of `multicontact run` or `simulate`, folder of a bag, or a file of a bag.
    setup
        What is known of a bag that has no configuration beside it.
    namespace
        Namespace of the controller in the bag; None for the only one in it.

    Raises
    ------
    ConfigError
        If there is no recording, or it has none of the arm's joints.
    RunError
        If the recording cannot be read.

    """
    folder = path.parent if path.is_file() else path
    if not folder.is_dir():
        raise ConfigError(
            'recording', 'a folder of `multicontact run` or `simulate`, or a bag', path
        )
    run = find_run_folder(path)
    is_run = is_run_folder(run)
    titled = run
    bag = folder
    if is_run:
        setup = load_setup(run)
        bag = run / BAG_FOLDER
    elif path.is_file() and mcap_files(path):
        titled = bag = path  # whatever lies beside a file is another recording
    title = f'recording {titled.resolve().name}'
    places: list[tuple[float, SurfacePlaces]] = []
    if mcap_files(bag):
        # Events and marks are timed from the first answer on.
        is_answered = is_run and not setup.simulated
        content = read_bag(
            bag, setup.controller, namespace=namespace, answered=is_answered
        )
        data = content.data
        places = read_surface_places(bag, content.start, namespace)
        if CUT_OFF in content.remarks:  # what else is missing, curves show
            title = f'{title}, {CUT_OFF}'
    elif (run / SERIES_FILE).is_file():
        data = RunData.load(run)
    else:
        raise ConfigError(
            'recording', f'{BAG_FOLDER}/*.mcap or {SERIES_FILE} in it', run
        )
    if not np.isfinite(data.q).any():
        raise ConfigError(
            'recording',
            f'the joints {", ".join(setup.controller.robot.joint_names)}, or '
            '--scenario and --plant that it was recorded with',
            'others',
        )
    if is_run and setup.simulated:
        surfaces = source.list_simulated_surfaces(setup)
    else:
        surfaces = source.list_felt_surfaces(setup.controller)
    scene = source.Scene(title, setup.controller, setup.urdf_dir, surfaces)
    events: list[LogLine] = []
    if is_run:
        events = _read_log(run)
        if not setup.commanded_by_topic:
            scene = replace(scene, marks=tuple(list_scenario_marks(setup)))
    return ReplaySource(scene, data, events, places)


def _read_log(run: Path) -> list[LogLine]:
    """Return the supervisor's log; empty for a run that did not come to its end."""
    if not (run / SUMMARY_FILE).is_file():
        return []
    events = read_summary(run).get('events', ())
    return [(event['time_s'], event['what']) for event in events]


def read_surface_places(
    bag: Path,
    start: int,
    namespace: str | None,
) -> list[tuple[float, SurfacePlaces]]:
    """
    Return where a simulator's surfaces are in a bag, and from when on.

    Parameters
    ----------
    bag
        Folder or file of the bag.
    start
        Stamp of the first sample [ns], from which the times count.
    namespace
        Namespace of the simulator in the bag; None for the only one in it.

    Returns
    -------
    list
        Time [s] and a point on each surface by name, world axes [m]; empty without a simulator.

    """
    markers = read_messages(bag, {SURFACES: MARKERS}, namespace).by_topic.get(SURFACES)
    if markers is None:
        return []
    names = markers.names
    axes = np.stack([markers.values(axis, names) for axis in 'xyz'], axis=-1)
    places: list[tuple[float, SurfacePlaces]] = []
    for stamp, points in zip(markers.stamps.tolist(), axes.tolist()):
        place = {name: (x, y, z) for name, (x, y, z) in zip(names, points)}
        places.append((1e-9 * (stamp - start), place))
    return places


def list_scenario_marks(setup: Setup) -> list[LogLine]:
    """
    Return when a scenario begins its approach, its force steps and its motion, and which.

    These are the moments of a run that the user can jump to besides the events of the supervisor;
    those after the end of the scenario are left out.
    """
    reference = setup.scenario.reference
    marks = [(reference.approach.start_time, 'approach')]
    for step in reference.force_steps:
        forces = [f'{name} {force:g} N' for name, force in step.forces.items()]
        marks.append((step.time, f'force step: {", ".join(forces)}'))
    if reference.motion is not None:
        marks.append((reference.motion.start_time, 'motion starts'))
    return [mark for mark in marks if mark[0] < setup.scenario.duration]
