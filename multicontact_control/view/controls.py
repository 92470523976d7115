"""The elements of the page that steer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import math
import threading
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.view import source
from multicontact_control.view.source import Scene, Snapshot

SCRUBBED = (
    0.3  # s without a request, after which the slider shows the time of a recording
)
PRESS = 10.0  # N
SIGNS = {'-': -1.0, '+': 1.0}
SPEEDS = {'0.1 x': 0.1, '0.5 x': 0.5, '1 x': 1.0, '2 x': 2.0, '5 x': 5.0}
STIFFNESS, FRICTION = (200.0, 80_000.0), (0.01, 1.0)  # N/m
MARKED = {1000.0: '1000', 10_000.0: '10 000'}  # N/m
# Unit, least, largest, step.
GAINS = dict(
    zip(
        source.GAIN_NAMES,
        (('rad/s', 5.0, 60.0, 1.0), ('s', 0.01, 0.1, 0.001), ('1/s', 0.0, 200.0, 5.0)),
    )
)
MAX_MARKS = 200  # that can be jumped to
# What a button does next.
PLAY, PLAY_AGAIN, PAUSE = 'Play', 'Play again from the start', 'Pause'
HOLD, RELEASE = 'Hold pose and forces', 'Release the hold'


class Requests:
    """
    Commands that elements of the page ask for, and that wait to be given.

    Of several by the same element the last counts. Elements ask in threads of the page's server.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: dict[object, tuple[str, dict[str, Any]]] = {}
        self._last = 0.0

    def add(self, element: object | None, name: str, /, **values: Any) -> None:
        """Ask for a command; `element` is None for one of which every command counts."""
        with self._lock:
            # The elements of viser cannot be hashed, and live as long as the page.
            self._waiting[object() if element is None else id(element)] = name, values
            self._last = time.monotonic()

    def take(self) -> tuple[str, dict[str, Any]] | None:
        """Return the command that has waited longest, if any waits."""
        with self._lock:
            return (
                self._waiting.pop(next(iter(self._waiting))) if self._waiting else None
            )

    @property
    def waiting(self) -> bool:
        """Whether a command has been asked for, and not been given."""
        return bool(self._waiting)

    def quiet_for(self) -> float:
        """Return for how long nothing has been asked for [s]."""
        return time.monotonic() - self._last


class Controls:
    """Elements of `gui` that add to `requests` what a source can do; `scene_view` has a handle."""

    def __init__(
        self, gui: Any, scene: Scene, requests: Requests, scene_view: Any
    ) -> None:
        self._gui, self._requests, self._scene_view = gui, requests, scene_view
        self._forces: dict[str, Any] = {}
        self._surfaces: dict[str, tuple[Any, Any, Any]] = {}
        self._gains: dict[str, Any] = {}
        self._shown_gains: Mapping[str, float] = {}
        self._hold: Any = None
        self._play: Any = None
        self._begun = False
        self._time: Any = None
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
                self._add_world(scene)
            else:
                gui.add_markdown('*needs a simulated plant*')

    def _button(
        self,
        text: str,
        name: str,
        hint: str = '',
        values: Callable[[], dict[str, Any]] = dict,
    ) -> Any:
        """Add a button that gives a command."""
        button = self._gui.add_button(text, hint=hint or None)
        button.on_click(lambda _: self._requests.add(button, name, **values()))
        return button

    def _axes(
        self, text: str, name: str, values: Callable[[list[float]], dict[str, Any]]
    ) -> None:
        """Add buttons along the axes, which give a command with the values of a direction."""
        for number, axis in enumerate('xyz'):
            group = self._gui.add_button_group(
                f'{text} {axis}', (f'-{axis}', f'+{axis}')
            )

            def click(event: Any, number: int = number) -> None:
                direction = [0.0, 0.0, 0.0]
                direction[number] = SIGNS[event.target.value[0]]
                self._requests.add(None, name, **values(direction))

            group.on_click(click)

    def _on_change(
        self,
        handle: Any,
        name: str,
        values: Callable[[Any], dict[str, Any]],
    ) -> None:
        """Let an element give a command when a user changes it, not when the page does."""

        async def changed(
            event: Any,
        ) -> None:  # in viser's thread, with the value it was told
            if event.client_id is not None:
                self._requests.add(handle, name, **values(event.target.value))

        handle.on_update(changed)

    def _add_forces(self, scene: Scene) -> None:
        gui, config, largest = self._gui, scene.config, scene.largest_force
        for column in config.columns:
            couple = column.half_length > 0.0
            slider = gui.add_slider(
                f'{column.name} [N]',
                min=-largest if couple else 0.0,
                max=largest,
                step=0.5,
                initial_value=0.0,
                hint='couple, as a force at its end'
                if couple
                else f'0, or {config.contact_state.smallest_force:g} to {largest:g} N',
            )
            self._on_change(
                slider,
                source.FORCES,
                partial(lambda name, value: {name: value}, column.name),
            )
            self._forces[column.name] = slider
        self._button(
            f'Press with {PRESS:g} N',
            source.FORCES,
            'every contact',
            values=lambda: dict.fromkeys(config.contact_names, PRESS),
        )
        self._button(
            'Let go',
            source.FORCES,
            'of every contact',
            values=lambda: dict.fromkeys(config.column_names, 0.0),
        )
        self._hold = self._button(
            HOLD, source.HOLD, values=lambda: {'on': self._hold.label == HOLD}
        )
        self._button('Seek given-up contacts again', source.RETRY)

    def _add_motion(self) -> None:
        gui = self._gui
        drag = gui.add_checkbox('drag handle', False, hint='at the operational point')

        def dragged(position: Vector) -> None:
            self._requests.add(drag, source.GO_TO, position=position.tolist())

        handle = self._scene_view.add_handle(dragged)

        async def offered(event: Any) -> None:
            handle.visible = event.target.value

        drag.on_update(offered)
        step = gui.add_slider('jog step [mm]', min=1, max=50, step=1, initial_value=10)
        self._axes(
            'jog',
            source.JOG,
            lambda direction: {'offset': [1e-3 * step.value * x for x in direction]},
        )
        with gui.add_folder('Pattern'):
            axis = gui.add_dropdown('sine along', ('x', 'y', 'z'))
            amplitude = gui.add_slider(
                'amplitude [mm]', min=5, max=150, step=5, initial_value=80
            )
            period = gui.add_slider(
                'period [s]', min=2.0, max=16.0, step=0.5, initial_value=6.0
            )
            self._button(
                'Start the sine',
                source.PATTERN,
                values=lambda: {
                    'axis': axis.value,
                    'amplitude': 1e-3 * amplitude.value,
                    'period': float(period.value),
                },
            )
        self._button('Stop every motion', source.STOP)

    def _add_tuning(self) -> None:
        gui = self._gui
        for name, (unit, low, high, step) in GAINS.items():
            self._gains[name] = gui.add_slider(
                f'{name} [{unit}]', min=low, max=high, step=step, initial_value=low
            )
        self._button(
            'Set these gains',
            source.GAINS,
            'the torque goes over smoothly',
            lambda: {name: float(slider.value) for name, slider in self._gains.items()},
        )
        with gui.add_folder('Wrist sensor'):
            self._button('Tare the sensor', source.TARE, 'nothing may touch the tool')
            self._button(
                'Start the push test', source.PUSH_TEST, 'proves sign, frame, scale'
            )
            self._button(
                'Cancel the push test',
                source.CANCEL_PUSH_TEST,
                'also one that has ended because nothing pushed',
            )

    def _add_world(self, scene: Scene) -> None:
        gui = self._gui
        for name, state in scene.simulated.items():
            with gui.add_folder(f'surfaces.{name}'):
                low, high = (pick(*STIFFNESS, state.stiffness) for pick in (min, max))
                stiffness, scale, friction = self._surfaces[name] = (
                    gui.add_number('stiffness [N/m]', state.stiffness),
                    gui.add_multi_slider(
                        'log scale',
                        min=math.log10(low),
                        max=math.log10(high),
                        step=0.01,
                        initial_value=_exponent(state.stiffness),
                        marks=tuple(
                            (math.log10(value), text) for value, text in MARKED.items()
                        ),
                    ),
                    gui.add_slider(
                        'friction',
                        min=min(FRICTION[0], state.friction),
                        max=max(FRICTION[1], state.friction),
                        step=0.01,
                        initial_value=state.friction,
                    ),
                )
            self._on_change(scale, source.SURFACE, partial(self._scaled_surface, name))
            for number in (stiffness, friction):
                self._on_change(number, source.SURFACE, partial(self._surface, name))
        with gui.add_folder('Push'):
            where = gui.add_dropdown('push at', ('operational point', 'tool'))
            force = gui.add_slider(
                'force [N]', min=1.0, max=20.0, step=1.0, initial_value=5.0
            )
            self._axes(
                'push along',
                source.PUSH,
                lambda direction: {
                    'force': [force.value * x for x in direction],
                    'tool': where.value == 'tool',
                },
            )

    def _scaled_surface(self, name: str, exponents: tuple[float]) -> dict[str, Any]:
        self._surfaces[name][0].value = float(f'{10.0 ** exponents[0]:.2g}')
        return self._surface(name)

    def _surface(self, name: str, _changed: object = None) -> dict[str, Any]:
        """Return what the elements of a surface show."""
        stiffness, _, friction = self._surfaces[name]
        return {
            'name': name,
            'stiffness': float(stiffness.value),
            'friction': float(friction.value),
        }

    def _add_replay(self, duration: float, marks: Sequence[tuple[float, str]]) -> None:
        gui = self._gui
        self._play = self._button(
            PLAY, source.PLAY, values=lambda: {'on': self._play.label != PAUSE}
        )
        speed = gui.add_dropdown('speed', tuple(SPEEDS), initial_value='1 x')
        self._on_change(speed, source.SPEED, lambda value: {'factor': SPEEDS[value]})
        self._time = gui.add_slider(
            'time [s]', min=0.0, max=max(duration, 0.1), step=0.02, initial_value=0.0
        )
        self._on_change(self._time, source.SEEK, lambda value: {'time': value})
        jumps = {
            '0 s: start': 0.0,
            **{f'{moment:.2f} s: {text}': moment for moment, text in marks[:MAX_MARKS]},
        }
        jump = gui.add_dropdown('jump to', tuple(jumps))
        self._on_change(jump, source.SEEK, lambda value: {'time': jumps[value]})

    def show(self, snapshot: Snapshot) -> None:
        """Show what is in force, unless a command that changes it waits."""
        if self._time is not None:
            if not self._begun:  # with the first browser
                self._begun = True
                self._requests.add(self._play, source.PLAY, on=True)
            if self._requests.quiet_for() > SCRUBBED:
                _show(self._time, round(min(snapshot.time, self._time.max), 2))
            _show(
                self._play,
                PAUSE
                if snapshot.playing
                else PLAY_AGAIN
                if snapshot.time >= self._time.max
                else PLAY,
                'label',
            )
        if (
            snapshot.gains != self._shown_gains
        ):  # at the start, and when they have been changed
            self._shown_gains = snapshot.gains
            for name, value in snapshot.gains.items():
                slider = self._gains[name]
                _show(slider, min(max(value, slider.min), slider.max))
        if self._requests.waiting:
            return
        for name in self._forces.keys() & snapshot.commanded.keys():
            _show(self._forces[name], snapshot.commanded[name])
        _show(self._hold, RELEASE if snapshot.held else HOLD, 'label')
        for name, (stiffness, scale, friction) in self._surfaces.items():
            state = snapshot.surfaces[name]
            _show(stiffness, state.stiffness)
            _show(scale, _exponent(state.stiffness))
            _show(friction, state.friction)


def _exponent(stiffness: float) -> tuple[float]:
    """Return what the logarithmic scale shows of a stiffness [N/m]."""
    return (round(math.log10(stiffness), 2),)


def _show(handle: Any, value: Any, part: str = 'value') -> None:
    """Let an element show a value, if it is there."""
    if handle is not None and getattr(handle, part) != value:
        setattr(handle, part, value)
