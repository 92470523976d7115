"""The elements of the page that steer: sliders, buttons and fields, and what they ask for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import math
import threading
import time
from typing import Any, NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.judging.supervisor_events import LogLine
from multicontact_control.view import source
from multicontact_control.view.source import Scene, Snapshot, SurfaceState
import numpy as np

# s without a request, after which the slider shows the time of a recording again.
SCRUB_TIME = 0.3
PRESS_FORCE = 10.0  # N
SIGNS = {'-': -1.0, '+': 1.0}
SPEEDS = {'0.1 x': 0.1, '0.5 x': 0.5, '1 x': 1.0, '2 x': 2.0, '5 x': 5.0}
STIFFNESS_RANGE = (200.0, 80_000.0)  # N/m
FRICTION_RANGE = (0.01, 1.0)
STIFFNESS_MARKS = {1000.0: '1000', 10_000.0: '10 000'}  # N/m
MAX_MARKS = 200  # that can be jumped to
# What a button does next.
PLAY, PLAY_AGAIN, PAUSE = 'Play', 'Play again from the start', 'Pause'
HOLD, RELEASE = 'Hold pose and forces', 'Release the hold'

CommandValues = dict[str, Any]  # as `SnapshotSource.give_command` takes them


class GainRange(NamedTuple):
    """
    The range of the slider of one gain.

    Attributes
    ----------
    unit
        Unit of the gain, and of the following values.
    least, largest, step
        Ends of the slider and distance of its values.

    """

    unit: str
    least: float
    largest: float
    step: float


GAIN_RANGES = dict(
    zip(
        source.GAIN_NAMES,
        (
            GainRange('rad/s', 5.0, 60.0, 1.0),
            GainRange('s', 0.01, 0.1, 0.001),
            GainRange('1/s', 0.0, 200.0, 5.0),
        ),
    )
)


class SurfaceElements(NamedTuple):
    """
    The elements of viser that show and change one simulated surface.

    Attributes
    ----------
    stiffness
        Field for the stiffness [N/m].
    scale
        Slider for its decimal logarithm.
    friction
        Slider for the coefficient of friction.

    """

    stiffness: Any
    scale: Any
    friction: Any

    def read_state(self) -> CommandValues:
        """Return stiffness [N/m] and friction that the user sees, as a command takes them."""
        return {
            'stiffness': float(self.stiffness.value),
            'friction': float(self.friction.value),
        }

    def show_state(self, state: SurfaceState) -> None:
        """Let the elements show the stiffness and the friction that the simulator has."""
        _show_value(self.stiffness, state.stiffness)
        _show_value(self.scale, _scale_exponents(state.stiffness))
        _show_value(self.friction, state.friction)


class CommandRequests:
    """
    Commands that elements of the page have asked for, and that the page has not given yet.

    A slider asks for many commands while it is dragged, faster than they can be given: of those
    of one element only the last is kept. Elements ask in threads of viser's server, and the page
    gives commands in its own, so that access is locked.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: dict[object, tuple[str, CommandValues]] = {}
        self._last_request = 0.0  # on the clock [s]

    def request_command(
        self, element: object | None, name: str, /, **values: Any
    ) -> None:
        """
        Ask for a command.

        Parameters
        ----------
        element
            Element that asks, in place of its command that waits; None if each command counts.
        name, values
            The command, as `SnapshotSource.give_command` takes it.

        """
        # The elements of viser cannot be hashed, and live as long as the page.
        key = object() if element is None else id(element)
        with self._lock:
            self._waiting[key] = (name, values)
            self._last_request = time.monotonic()

    def take_oldest(self) -> tuple[str, CommandValues] | None:
        """Return name and values of the command that has waited longest, None if none waits."""
        with self._lock:
            if not self._waiting:
                return None
            return self._waiting.pop(next(iter(self._waiting)))

    @property
    def is_any_waiting(self) -> bool:
        """Whether a command has been asked for and not been given, so that values will change."""
        return bool(self._waiting)

    @property
    def quiet_time(self) -> float:
        """Time since a command was last asked for [s], by which the end of a drag is known."""
        return time.monotonic() - self._last_request


class ControlPanel:
    """
    The tabs of the page whose elements ask for the commands that a source takes.

    A recording has one tab, `Replay`; a graph has `Press`, `Move`, `Tune` and `World`.

    Parameters
    ----------
    gui
        Interface of the viser server that makes elements.
    scene
        What the page shows, by which the commands are chosen.
    requests
        Takes what the elements ask for.
    scene_view
        Three-dimensional view, which has the drag handle.

    """

    def __init__(
        self, gui: Any, scene: Scene, requests: CommandRequests, scene_view: Any
    ) -> None:
        self._gui = gui
        self._requests = requests
        self._scene_view = scene_view
        self._forces: dict[str, Any] = {}
        self._surfaces: dict[str, SurfaceElements] = {}
        self._gains: dict[str, Any] = {}
        self._shown_gains: Mapping[str, float] = {}
        self._hold: Any = None
        self._play: Any = None
        self._time: Any = None
        self._has_begun = False
        tabs = gui.add_tab_group()
        if scene.duration is not None:
            with tabs.add_tab('Replay'):
                self._add_replay(scene.duration, scene.marks)
            return
        with tabs.add_tab('Press'):
            self._add_forces(scene)
        with tabs.add_tab('Move'):
            self._add_motion()
        with tabs.add_tab('Tune'):
            self._add_tuning()
        with tabs.add_tab('World'):
            if scene.simulated:
                for name, state in scene.simulated.items():
                    self._add_surface(name, state)
                self._add_push()
            else:
                gui.add_markdown('*needs a simulated plant*')

    def _add_button(
        self,
        text: str,
        name: str,
        hint: str = '',
        values: Callable[[], CommandValues] = dict,
    ) -> Any:
        """Add a button that asks for a command."""
        button = self._gui.add_button(text, hint=hint or None)

        def on_click(_event: Any) -> None:
            self._requests.request_command(button, name, **values())

        button.on_click(on_click)
        return button

    def _add_axis_buttons(
        self, text: str, name: str, values: Callable[[Vector], CommandValues]
    ) -> None:
        """Add buttons that ask for a command along each axis, either way."""
        for axis, unit_vector in zip('xyz', np.eye(3)):
            group = self._gui.add_button_group(
                f'{text} {axis}', (f'-{axis}', f'+{axis}')
            )

            def on_click(event: Any, unit_vector: Vector = unit_vector) -> None:
                direction = SIGNS[event.target.value[0]] * unit_vector
                self._requests.request_command(None, name, **values(direction))

            group.on_click(on_click)

    def _request_on_change(
        self,
        element: Any,
        name: str,
        values: Callable[[Any], CommandValues],
    ) -> None:
        """
        Let an element ask for a command when a user changes it, not when the page does.

        The callback is asynchronous, in viser's thread: it has the value of the change.
        """

        async def on_update(event: Any) -> None:
            if event.client_id is not None:
                self._requests.request_command(
                    element, name, **values(event.target.value)
                )

        element.on_update(on_update)

    def _add_forces(self, scene: Scene) -> None:
        config = scene.config
        largest = scene.largest_force
        smallest = config.contact_state.smallest_force
        for column in config.columns:
            least = 0.0
            hint = f'0, or {smallest:g} to {largest:g} N'
            if column.half_length > 0.0:  # a couple has both signs
                least = -largest
                hint = 'couple, as a force at its end'
            slider = self._gui.add_slider(
                f'{column.name} [N]',
                min=least,
                max=largest,
                step=0.5,
                initial_value=0.0,
                hint=hint,
            )
            self._request_on_change(
                slider, source.FORCES, partial(_name_value, column.name)
            )
            self._forces[column.name] = slider
        self._add_button(
            f'Press with {PRESS_FORCE:g} N',
            source.FORCES,
            'every contact',
            partial(dict.fromkeys, config.contact_names, PRESS_FORCE),
        )
        self._add_button(
            'Let go',
            source.FORCES,
            'of every contact',
            partial(dict.fromkeys, config.column_names, 0.0),
        )
        self._hold = self._add_button(HOLD, source.HOLD, values=self._read_hold)
        self._add_button('Seek given-up contacts again', source.RETRY)

    def _read_hold(self) -> CommandValues:
        return {'on': self._hold.label == HOLD}

    def _add_motion(self) -> None:
        gui = self._gui
        checkbox = gui.add_checkbox(
            'drag handle', False, hint='at the operational point'
        )

        def on_drag(position: Vector) -> None:
            self._requests.request_command(
                checkbox, source.GO_TO, position=position.tolist()
            )

        handle = self._scene_view.add_drag_handle(on_drag)

        async def on_update(event: Any) -> None:
            handle.visible = event.target.value

        checkbox.on_update(on_update)
        step = gui.add_slider('jog step [mm]', min=1, max=50, step=1, initial_value=10)

        def read_offset(direction: Vector) -> CommandValues:
            return {'offset': (1e-3 * step.value * direction).tolist()}

        self._add_axis_buttons('jog', source.JOG, read_offset)
        with gui.add_folder('Pattern'):
            axis = gui.add_dropdown('sine along', ('x', 'y', 'z'))
            amplitude = gui.add_slider(
                'amplitude [mm]', min=5, max=150, step=5, initial_value=80
            )
            period = gui.add_slider(
                'period [s]', min=2.0, max=16.0, step=0.5, initial_value=6.0
            )

            def read_pattern() -> CommandValues:
                return {
                    'axis': axis.value,
                    'amplitude': 1e-3 * amplitude.value,
                    'period': float(period.value),
                }

            self._add_button('Start the sine', source.PATTERN, values=read_pattern)
        self._add_button('Stop every motion', source.STOP)

    def _add_tuning(self) -> None:
        gui = self._gui
        for name, gain in GAIN_RANGES.items():
            self._gains[name] = gui.add_slider(
                f'{name} [{gain.unit}]',
                min=gain.least,
                max=gain.largest,
                step=gain.step,
                initial_value=gain.least,
            )
        self._add_button(
            'Set these gains',
            source.GAINS,
            'the torque goes over smoothly',
            self._read_gains,
        )
        with gui.add_folder('Wrist sensor'):
            self._add_button(
                'Tare the sensor', source.TARE, 'nothing may touch the tool'
            )
            self._add_button(
                'Start the push test', source.PUSH_TEST, 'proves sign, frame, scale'
            )
            self._add_button(
                'Cancel the push test',
                source.CANCEL_PUSH_TEST,
                'also one that has ended because nothing pushed',
            )

    def _read_gains(self) -> CommandValues:
        return {name: float(slider.value) for name, slider in self._gains.items()}

    def _add_surface(self, name: str, state: SurfaceState) -> None:
        gui = self._gui
        least, largest = STIFFNESS_RANGE
        smoothest, roughest = FRICTION_RANGE
        marks = [(math.log10(value), text) for value, text in STIFFNESS_MARKS.items()]
        with gui.add_folder(f'surfaces.{name}'):
            stiffness = gui.add_number('stiffness [N/m]', state.stiffness)
            scale = gui.add_multi_slider(
                'log scale',
                min=math.log10(min(least, state.stiffness)),
                max=math.log10(max(largest, state.stiffness)),
                step=0.01,
                initial_value=_scale_exponents(state.stiffness),
                marks=tuple(marks),
            )
            friction = gui.add_slider(
                'friction',
                min=min(smoothest, state.friction),
                max=max(roughest, state.friction),
                step=0.01,
                initial_value=state.friction,
            )
        elements = SurfaceElements(stiffness, scale, friction)
        self._surfaces[name] = elements

        def read_surface(_changed: object) -> CommandValues:
            return {'name': name, **elements.read_state()}

        def read_scaled_surface(exponents: tuple[float]) -> CommandValues:
            elements.stiffness.value = float(f'{10.0 ** exponents[0]:.2g}')
            return read_surface(exponents)

        self._request_on_change(elements.stiffness, source.SURFACE, read_surface)
        self._request_on_change(elements.friction, source.SURFACE, read_surface)
        self._request_on_change(elements.scale, source.SURFACE, read_scaled_surface)

    def _add_push(self) -> None:
        gui = self._gui
        with gui.add_folder('Push'):
            place = gui.add_dropdown('push at', ('operational point', 'tool'))
            force = gui.add_slider(
                'force [N]', min=1.0, max=20.0, step=1.0, initial_value=5.0
            )

            def read_push(direction: Vector) -> CommandValues:
                return {
                    'force': (force.value * direction).tolist(),
                    'tool': place.value == 'tool',
                }

            self._add_axis_buttons('push along', source.PUSH, read_push)

    def _add_replay(self, duration: float, marks: Sequence[LogLine]) -> None:
        gui = self._gui
        self._play = self._add_button(PLAY, source.PLAY, values=self._read_play)
        speed = gui.add_dropdown('speed', tuple(SPEEDS), initial_value='1 x')
        self._request_on_change(speed, source.SPEED, _read_speed)
        self._time = gui.add_slider(
            'time [s]', min=0.0, max=max(duration, 0.1), step=0.02, initial_value=0.0
        )
        self._request_on_change(self._time, source.SEEK, partial(_name_value, 'time'))
        moments = {'0 s: start': 0.0}
        for moment, text in marks[:MAX_MARKS]:
            moments[f'{moment:.2f} s: {text}'] = moment
        jump = gui.add_dropdown('jump to', tuple(moments))

        def read_moment(label: str) -> CommandValues:
            return {'time': moments[label]}

        self._request_on_change(jump, source.SEEK, read_moment)

    def _read_play(self) -> CommandValues:
        return {'on': self._play.label != PAUSE}

    def show_snapshot(self, snapshot: Snapshot) -> None:
        """
        Let the elements show what is in force: time, gains, forces, hold and surfaces.

        Those that a command may change stay while one waits, so that no element jumps back under
        the user's hand. The first snapshot of a recording starts to play it.
        """
        if self._time is not None:
            self._show_replay(snapshot)
        if snapshot.gains != self._shown_gains:  # else sliders keep what the user sets
            self._shown_gains = snapshot.gains
            for name, value in snapshot.gains.items():
                slider = self._gains[name]
                _show_value(slider, min(max(value, slider.min), slider.max))
        if self._requests.is_any_waiting:
            return
        for name, slider in self._forces.items():
            if name in snapshot.commanded:
                _show_value(slider, snapshot.commanded[name])
        if self._hold is not None:
            _show_label(self._hold, RELEASE if snapshot.held else HOLD)
        for name, elements in self._surfaces.items():
            elements.show_state(snapshot.surfaces[name])

    def _show_replay(self, snapshot: Snapshot) -> None:
        if not self._has_begun:  # with the first browser
            self._has_begun = True
            self._requests.request_command(self._play, source.PLAY, on=True)
        if self._requests.quiet_time > SCRUB_TIME:
            _show_value(self._time, round(min(snapshot.time, self._time.max), 2))
        if snapshot.playing:
            label = PAUSE
        elif snapshot.time >= self._time.max:
            label = PLAY_AGAIN
        else:
            label = PLAY
        _show_label(self._play, label)


def _read_speed(label: str) -> CommandValues:
    return {'factor': SPEEDS[label]}


def _name_value(name: str, value: Any) -> CommandValues:
    return {name: value}


def _scale_exponents(stiffness: float) -> tuple[float]:
    """Return the values of the logarithmic slider, a single one, at a stiffness [N/m]."""
    return (round(math.log10(stiffness), 2),)


def _show_value(element: Any, value: Any) -> None:
    """Let an element show a value; viser sends each assignment, so that it is made on change."""
    if element.value != value:
        element.value = value


def _show_label(button: Any, label: str) -> None:
    if button.label != label:
        button.label = label
