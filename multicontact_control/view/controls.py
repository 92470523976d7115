"""The elements of the page that steer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.force.noise import ESTIMATORS
from multicontact_control.view import source
from multicontact_control.view.commander import Commander
from multicontact_control.view.source import Scene, Snapshot, Source

SETTLED = 0.8  # s without a command, after which elements show what is
PRESS = 10.0  # N
DIRECTIONS = {'-x': (-1.0, 0.0, 0.0), '+x': (1.0, 0.0, 0.0), '-y': (0.0, -1.0, 0.0),
              '+y': (0.0, 1.0, 0.0), '-z': (0.0, 0.0, -1.0), '+z': (0.0, 0.0, 1.0)}
PUSH = 5.0  # N
SPEEDS = {'0.1 x': 0.1, '0.5 x': 0.5, '1 x': 1.0, '2 x': 2.0, '5 x': 5.0}
MAX_MARKS = 200  # that can be jumped to


class Controls:
    """
    Elements for whatever a source can be asked to do; for the rest it is said why not.

    Parameters
    ----------
    gui
        The page's elements.
    shown
        What is steered.
    commander
        Who gives the commands.
    scene_view
        Whose handle is dragged.

    """

    def __init__(self, gui: Any, shown: Source, commander: Commander, scene_view: Any) -> None:
        self._gui, self._scene, self._commander = gui, shown.scene, commander
        self._refusals: Mapping[str, str] = shown.refusals
        self._scene_view = scene_view
        self._forces: dict[str, Any] = {}
        self._surfaces: dict[str, tuple[Any, Any]] = {}
        self._gains: tuple[Any, ...] = ()
        self._hold: Any = None
        self._estimator: Any = None
        self._instruction: Any = None
        self._hand: Any = None
        self._play: Any = None
        self._time: Any = None
        tabs = gui.add_tab_group()
        if self._can(source.PLAY):
            with tabs.add_tab('Replay'):
                self._add_replay(self._scene)
        if self._can(source.FORCES):
            with tabs.add_tab('Press'):
                self._add_forces(self._scene)
            with tabs.add_tab('Move'):
                self._add_motion()
            with tabs.add_tab('Tune'):
                self._add_tuning()
            with tabs.add_tab('World'):
                self._add_world(self._scene)

    def _can(self, name: str) -> bool:
        return name not in self._refusals

    def _give(self, element: Any, name: str, /, **values: Any) -> None:
        self._commander.give(element, name, **values)

    def _on(self, handle: Any, name: str, /, **values: Any) -> Any:
        """Let a button give a command."""
        handle.on_click(lambda _: self._give(handle, name, **values))
        return handle

    def _on_change(
        self, handle: Any, name: str, values: Callable[[Any], dict[str, Any]],
    ) -> None:
        """Let an element give a command when a user changes it, not when the page does."""
        def changed(event: Any) -> None:
            if event.client_id is not None:
                self._give(handle, name, **values(event.target.value))

        handle.on_update(changed)

    def _why_not(self, *names: str) -> None:
        for name in names:
            if not self._can(name):
                self._gui.add_markdown(f'*{name.replace("_", " ")}: needs {self._refusals[name]}*')

    # -------------------------------------------------------------------------------- press

    def _add_forces(self, scene: Scene) -> None:
        gui, config = self._gui, scene.config
        for column in config.columns:
            couple = column.half_length > 0.0
            slider = gui.add_slider(
                f'{column.name} [N]', min=-scene.largest_force if couple else 0.0,
                max=scene.largest_force, step=0.5, initial_value=0.0,
                hint=f'0, or {config.contact_state.smallest_force:g} to '
                f'{scene.largest_force:g} N' if not couple else 'couple, as a force at its end')

            self._on_change(slider, source.FORCES, partial(_force, column.name))
            self._forces[column.name] = slider
        names = config.contact_names
        self._on(gui.add_button(f'Press with {PRESS:g} N', color='blue'), source.FORCES,
                 **dict.fromkeys(names, PRESS))
        self._on(gui.add_button('Let go', color='gray'), source.FORCES, **dict.fromkeys(
            config.column_names, 0.0))
        self._hold = gui.add_checkbox('hold', False, hint='pose and forces')
        self._on_change(self._hold, source.HOLD, lambda value: {'on': bool(value)})
        self._on(gui.add_button('Try again', color='gray',
                                hint='seek contacts that were given up'), source.RETRY)

    # --------------------------------------------------------------------------------- move

    def _add_motion(self) -> None:
        gui = self._gui
        drag = gui.add_checkbox('drag', False, hint='shows a handle at the operational point')
        drag.on_update(lambda event: self._scene_view.show_handle(bool(event.target.value)))

        def dragged(position: Vector) -> None:
            self._give(drag, source.GO_TO, position=position.tolist())

        self._scene_view.add_handle(dragged)
        step = gui.add_slider('jog step [mm]', min=1, max=50, step=1, initial_value=10)
        for name in 'xyz':
            group = gui.add_button_group(f'jog {name}', (f'-{name}', f'+{name}'))

            def jog(event: Any) -> None:
                self._give(None, source.JOG, offset=[
                    1e-3 * step.value * x for x in DIRECTIONS[event.target.value]])

            group.on_click(jog)
        with gui.add_folder('Pattern'):
            axis = gui.add_dropdown('sine along', ('x', 'y', 'z'))
            amplitude = gui.add_slider('amplitude [mm]', min=5, max=150, step=5, initial_value=80)
            period = gui.add_slider('period [s]', min=2.0, max=16.0, step=0.5, initial_value=6.0)
            start = gui.add_button('Start', color='blue')

            def begin(_: Any) -> None:
                self._give(start, source.PATTERN, axis=axis.value,
                           amplitude=1e-3 * amplitude.value, period=float(period.value))

            start.on_click(begin)
            self._on(gui.add_button('Stop', color='gray'), source.STOP)

    # --------------------------------------------------------------------------------- tune

    def _add_tuning(self) -> None:
        gui = self._gui
        with gui.add_folder('Gains'):
            self._gains = (
                gui.add_slider('natural frequency [rad/s]', min=5.0, max=60.0, step=1.0,
                               initial_value=30.0),
                gui.add_slider('time constant [ms]', min=10.0, max=100.0, step=1.0,
                               initial_value=20.0),
                gui.add_slider('K_2 [1/s]', min=0.0, max=200.0, step=5.0, initial_value=100.0))
            apply = gui.add_button('Apply', color='blue', hint='the torque goes over smoothly')

            def use(_: Any) -> None:
                frequency, constant, damping = (slider.value for slider in self._gains)
                self._give(apply, source.GAINS, natural_frequency=float(frequency),
                           time_constant=1e-3 * constant, damping_rate=float(damping))

            apply.on_click(use)
        with gui.add_folder('Noise estimator'):
            self._why_not(source.ESTIMATOR)
            if self._can(source.ESTIMATOR):
                self._estimator = gui.add_dropdown('R by', tuple(ESTIMATORS))
                self._on_change(
                    self._estimator, source.ESTIMATOR, lambda value: {'name': value})
        with gui.add_folder('Wrist sensor'):
            self._on(gui.add_button('Tare', color='gray', hint='nothing may touch the tool'),
                     source.TARE)
            self._on(gui.add_button('Push test', color='gray', hint='proves sign, frame, scale'),
                     source.PUSH_TEST)
            self._instruction = gui.add_markdown('')
            if self._can(source.HAND):
                self._hand = self._on(gui.add_button(
                    'Push as asked', color='blue', visible=False), source.HAND)

    # -------------------------------------------------------------------------------- world

    def _add_world(self, scene: Scene) -> None:
        gui = self._gui
        if not self._can(source.SURFACE):
            self._why_not(source.SURFACE, source.PUSH, source.RESET)
            return
        from multicontact_control.view.simulation import FRICTION, STIFFNESS

        for surface in scene.surfaces:
            with gui.add_folder(f'Surface {surface.name}'):
                stiffness = gui.add_slider(
                    'stiffness [N/mm]', min=1e-3 * STIFFNESS[0], max=1e-3 * STIFFNESS[1],
                    step=0.2, initial_value=6.0)
                friction = gui.add_slider('friction', min=FRICTION[0], max=FRICTION[1], step=0.01,
                                          initial_value=0.1)
            self._surfaces[surface.name] = stiffness, friction
            for slider in (stiffness, friction):
                self._on_change(slider, source.SURFACE, partial(self._surface, surface.name))
        with gui.add_folder(f'Push the wrist with {PUSH:g} N'):
            for axis in 'xyz':
                group = gui.add_button_group(f'along {axis}', (f'-{axis}', f'+{axis}'))
                group.on_click(lambda event: self._give(None, source.PUSH, force=[
                    PUSH * x for x in DIRECTIONS[event.target.value]]))
        self._on(gui.add_button('Start anew', color='red'), source.RESET)

    def _surface(self, name: str, _: float) -> dict[str, Any]:
        stiffness, friction = self._surfaces[name]
        return {'name': name, 'stiffness': round(1e3 * stiffness.value, 3),
                'friction': float(friction.value)}

    # ------------------------------------------------------------------------------- replay

    def _add_replay(self, scene: Scene) -> None:
        gui = self._gui
        self._play = gui.add_checkbox('play', True)
        self._on_change(self._play, source.PLAY, lambda value: {'on': bool(value)})
        speed = gui.add_dropdown('speed', tuple(SPEEDS), initial_value='1 x')
        self._on_change(speed, source.SPEED, lambda value: {'factor': SPEEDS[value]})
        self._time = gui.add_slider('time [s]', min=0.0, max=max(scene.duration, 0.1), step=0.02,
                                    initial_value=0.0)
        self._on_change(self._time, source.SEEK, lambda value: {'time': float(value)})
        marks = {f'{moment:.2f} s: {what}': moment for moment, what in scene.marks[:MAX_MARKS]}
        jumps = {'0 s: start': 0.0, **marks}
        jump = gui.add_dropdown('jump to', tuple(jumps))
        self._on_change(jump, source.SEEK, lambda value: {'time': jumps[value]})
        gui.add_markdown('*A recording is shown: it cannot be steered.*')

    # --------------------------------------------------------------------------------- show

    def show(self, snapshot: Snapshot) -> None:
        """Show what is in force, unless the user is just about to change it."""
        if self._instruction is not None:
            said = snapshot.push_test
            content = f'**{said}**' if said else ''
            if self._instruction.content != content:
                self._instruction.content = content
        if self._hand is not None:
            asked = bool(len(snapshot.asked_push))
            if self._hand.visible != asked:
                self._hand.visible = asked
        if self._time is not None and snapshot.playing and self._commander.quiet_for() > 0.3:
            self._set(self._time, round(min(snapshot.time, self._time.max), 2))
        if self._commander.quiet_for() < SETTLED:
            return
        for name, slider in self._forces.items():
            if name in snapshot.commanded:
                self._set(slider, snapshot.commanded[name])
        if self._hold is not None:
            self._set(self._hold, snapshot.held)
        if self._play is not None:
            self._set(self._play, snapshot.playing)
        if self._estimator is not None and snapshot.estimator:
            self._set(self._estimator, snapshot.estimator)
        for name, state in snapshot.surfaces.items():
            if name in self._surfaces:
                stiffness, friction = self._surfaces[name]
                self._set(stiffness, round(1e-3 * state.stiffness, 3))
                self._set(friction, state.friction)

    def show_gains(self, snapshot: Snapshot) -> None:
        """Show the gains in force: at the start, and when they have been changed."""
        for slider, value, scale in zip(self._gains, snapshot.gains, (1.0, 1e3, 1.0)):
            if value == value:
                self._set(slider, min(max(scale * value, slider.min), slider.max))

    @staticmethod
    def _set(handle: Any, value: Any) -> None:
        if handle.value != value:
            handle.value = value


def _force(name: str, value: float) -> dict[str, float]:
    return {name: float(value)}
