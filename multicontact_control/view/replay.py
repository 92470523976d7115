"""A recording, played back: pause, speed, and anywhere in it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from time import monotonic
from typing import Any

from multicontact_control.arrays import Matrix, Vector
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
from multicontact_control.judging.supervisor_events import read_event, SupervisorEvent
from multicontact_control.runs.bag import MARKERS, mcap_files, read_messages
from multicontact_control.runs.recording import (
    CUT_OFF,
    read_bag,
    RunData,
    SERIES_FILE,
)
from multicontact_control.runs.scenario import Setup
from multicontact_control.supervision.reactions import NONE
from multicontact_control.view import source
from multicontact_control.view.curves import block_extremes
import numpy as np

LOOKED_BACK = 60.0  # s, of curves after a jump
SURFACES = 'ground_truth/surfaces'


class ReplaySource:
    """
    Plays a recording: the series in `data`.

    `scene` gets its duration and further marks. `events` are times [s] and lines of the
    supervisor's log, `places` times from when on points of surfaces were where [m], by name.
    """

    def __init__(
        self,
        scene: source.Scene,
        data: RunData,
        events: Sequence[tuple[float, str]] = (),
        places: Sequence[tuple[float, Mapping[str, Vector3]]] = (),
    ) -> None:
        self._data = data
        self._places = [each for _, each in places] or [{}]
        self._place_times = [moment for moment, _ in places]
        config = scene.config
        self._normals = np.array(
            [config.contacts[name].normal_world for name in config.contact_names]
        )
        self._points = block_points(data, config)
        # While a simulator pauses, several things happen at one sample: they keep their order.
        in_time = sorted(events, key=itemgetter(0))
        self._events = [read_event(*line) for line in in_time] or presses(
            data, list(config.force_columns)
        )
        self._event_times = [event.time for event in self._events]
        changes = source.ChangeReader(config.contact_names)
        texts = [(event.time, changes.read(event)) for event in self._events]
        self._end = (data.ticks - 1) / data.rate
        self.scene = replace(
            scene,
            duration=self._end,
            true_forces=bool(np.isfinite(data.alpha_true).any()),
            marks=tuple(
                sorted(
                    [*scene.marks, *(each for each in texts if each[1])],
                    key=itemgetter(0),
                )
            ),
        )
        self._since, self._from = monotonic(), 0.0
        self._speed, self._playing, self._changed = 1.0, False, True
        self._shown, self._next = -np.inf, 0.0
        self._jumped = False

    def _now(self) -> float:
        """Return the time in the recording [s], and stop at its end."""
        if not self._playing:
            return self._from
        now = self._from + self._speed * (monotonic() - self._since)
        if now >= self._end:
            self._from, self._playing, self._changed = self._end, False, True
            return self._end
        return now

    def poll(self) -> list[source.Snapshot]:
        """Return a snapshot of now, if that is another one than the last."""
        now = self._now()
        if not self._changed and (not self._playing or monotonic() < self._next):
            return []
        self._changed, self._next = False, monotonic() + 1.0 / source.RATE
        last, self._shown = self._shown, now
        snapshot = self._snapshot(now, last)
        self._jumped = False
        return [snapshot]

    def _snapshot(self, now: float, last: float) -> source.Snapshot:
        data, k = self._data, int(now * self._data.rate + 1e-6)
        first, end = np.searchsorted(self._points[:, 0], (last, now), side='right')
        event = self._events[max(0, bisect_right(self._event_times, now + 1e-9) - 1)]
        return source.Snapshot(
            time=now,
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
            events=tuple(
                mark for mark in self.scene.marks if last < mark[0] <= now + 1e-9
            ),
            places_world=self._places[max(0, bisect_right(self._place_times, now) - 1)],
            playing=self._playing,
            anew=self._jumped,
        )

    def command(self, name: str, /, **values: Any) -> str:
        """Play, pause, jump, or play at another speed; see `Source.command`."""
        now = self._now()
        self._from, self._since, self._changed = now, monotonic(), True
        if name == source.PLAY:
            self._playing = values['on']
            if self._playing and now >= self._end:
                self._jump(0.0)
        elif name == source.SPEED:
            self._speed = values['factor']
        elif 0.0 <= (moment := values['time']) <= self._end:
            self._jump(moment)
        else:
            raise CommandError('time', f'0 to {self._end:g} s', f'{moment:g} s')
        return ''  # snapshots show it

    def _jump(self, moment: float) -> None:
        self._from, self._shown = moment, moment - LOOKED_BACK
        self._jumped = True

    def close(self) -> None:
        """Nothing has been started."""


def presses(data: RunData, leaders: Sequence[int]) -> list[SupervisorEvent]:
    """Return when forces were asked for, and no longer, in a recording without a log."""
    known = np.flatnonzero(np.isfinite(data.alpha_des[:, leaders]).all(axis=1))
    asked = data.alpha_des[known][:, leaders] > 0.0
    changed = np.any(
        np.diff(asked, axis=0, prepend=np.zeros((1, len(leaders)), bool)), axis=1
    )
    return [
        SupervisorEvent(0.0, NONE, (), (), ('free',) * len(leaders)),
        *(
            SupervisorEvent(
                float(data.time[k]),
                NONE,
                (),
                (),
                tuple(np.where(row, 'force', 'free').tolist()),
            )
            for k, row in zip(known[changed], asked[changed])
        ),
    ]


def block_points(data: RunData, config: ControllerConfig) -> Matrix:
    """Return the curves of a recording, as a snapshot has them."""
    limit: Vector = np.array(config.torque_limit or [np.inf] * len(data.joint_names))
    samples = np.column_stack(
        [
            data.time,
            data.alpha_meas,
            data.alpha_est,
            data.alpha_des,
            data.alpha_true,
            data.noise_variance,
            data.innovation,
            np.abs(data.torque) / limit,
        ]
    )
    return block_extremes(samples, round(data.rate / source.RATE / source.BLOCKS))


def load_replay(path: Path, setup: Setup, namespace: str | None = None) -> ReplaySource:
    """
    Read a run, or a bag that was recorded in any other way; ConfigError, RunError if it fails.

    `path` is the folder of `run` or `simulate`, that of a bag, or a bag's file; `setup` what is
    known of a bag that has no configuration beside it; `namespace` that of the graph, if not given
    the only one in the recording.
    """
    folder = path.parent if path.is_file() else path
    if not folder.is_dir():
        raise ConfigError(
            'recording', 'a folder of `multicontact run` or `simulate`, or a bag', path
        )
    run = find_run_folder(path)
    of_run = is_run_folder(run)
    # Whatever lies beside a file is another recording.
    alone = not of_run and path.is_file() and bool(mcap_files(path))
    title = f'recording {(path if alone else run).resolve().name}'
    bag = run / BAG_FOLDER if of_run else path if alone else folder
    events: list[tuple[float, str]] = []
    marks: list[tuple[float, str]] = []
    if of_run:
        setup = load_setup(run)
        if (run / SUMMARY_FILE).is_file():  # else it did not come to its end
            events = [
                (event['time_s'], event['what'])
                for event in read_summary(run).get('events', ())
            ]
        marks = [] if setup.commanded_by_topic else scenario_marks(setup)
    if alone or mcap_files(bag):
        # Events and marks are timed from the first answer on.
        content = read_bag(
            bag,
            setup.controller,
            namespace=namespace,
            answered=of_run and not setup.simulated,
        )
        data, places = content.data, recorded_places(bag, content.start, namespace)
        # What is missing besides, curves show.
        title += f', {CUT_OFF}' if CUT_OFF in content.remarks else ''
    elif (run / SERIES_FILE).is_file():
        data, places = RunData.load(run), []
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
    surfaces = (
        source.surfaces_of(setup)
        if of_run and setup.simulated
        else (source.felt_surfaces(setup.controller))
    )
    scene = source.Scene(
        title, setup.controller, setup.urdf_dir, surfaces, marks=tuple(marks)
    )
    return ReplaySource(scene, data, events, places)


def recorded_places(
    bag: Path,
    start: int,
    namespace: str | None,
) -> list[tuple[float, Mapping[str, Vector3]]]:
    """Return points of a simulator's surfaces by name [m], and from when after `start` [ns]."""
    markers = read_messages(bag, {SURFACES: MARKERS}, namespace).by_topic.get(SURFACES)
    if markers is None:
        return []
    names = markers.names
    axes = np.stack([markers.values(axis, names) for axis in 'xyz'], axis=-1)
    return [
        (
            (stamp - start) * 1e-9,
            {name: (x, y, z) for name, (x, y, z) in zip(names, row)},
        )
        for stamp, row in zip(markers.stamps.tolist(), axes.tolist())
    ]


def scenario_marks(setup: Setup) -> list[tuple[float, str]]:
    """Return when a scenario asks for something else, and for what."""
    reference = setup.scenario.reference
    marks = [(reference.approach.start_time, 'approach')]
    marks += [
        (
            step.time,
            'force step: '
            + ', '.join(f'{name} {force:g} N' for name, force in step.forces.items()),
        )
        for step in reference.force_steps
    ]
    if reference.motion is not None:
        marks.append((reference.motion.start_time, 'motion starts'))
    return [
        (moment, what) for moment, what in marks if moment < setup.scenario.duration
    ]
