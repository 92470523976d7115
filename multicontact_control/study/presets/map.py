"""What `multicontact study map` draws: the grid, and boundaries of loops of `force.margins`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from multicontact_control.commissioning.law_report import closed_loop_matrix
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.force import margins
from multicontact_control.force.force_law import design_law, make_loop_model
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.laws.design import LoopModel
from multicontact_control.force.observer import ObserverDesign, solve_steady_gain
from multicontact_control.runs.scenario import Setup
from multicontact_control.study.study import Results, Study
import numpy as np
import pandas as pd

RATIO, DELAY = 'true / model stiffness', 'plant.actuator_delay_ticks'
LINEAR_LOOPS = (  # name, R [N^2] at rest or in motion, whether it is that of eq. 32
    ('The linear loop of the arm', 0.6, False),
    ('The linear loop of the arm', 100.0, False),
    ('The plant of eq. 32 alone', 0.6, True),
)
STYLES = ('-', '--', ':')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale
RATIOS = tuple(
    np.geomspace(0.1, 100.0, 73).tolist()
)  # where boundaries are looked for, upwards
Boundaries = Mapping[str, Mapping[int, float]]  # largest stable ratio by line and delay


class MapStudy(Study):
    """True stiffness over that of the model, and delay of the actuator."""

    def findings(self, results: Results) -> list[str]:
        """Return where runs settle, and the boundaries of the linear loops."""
        return [
            *super().findings(results),
            *(
                f'{name} is stable on {plant} up to {RATIO} = '
                + ', '.join(
                    f'{min(ratio, RATIOS[-1]):.2f} with {delay}'
                    for delay, ratio in line.items()
                )
                + ' periods of delay.'
                for plant, lines in linear_boundaries(results).items()
                for name, line in lines.items()
            ),
        ]

    def figure(self, results: Results) -> Figure:
        """Return the map of overshoots, a panel for each plant and estimator."""
        groups = list(results.frame.groupby(['plant', 'estimator'], sort=False))
        columns = min(results.frame['estimator'].nunique(), 4)
        lines = math.ceil(len(groups) / columns)
        figure = Figure(
            figsize=(3.2 * columns + 1.2, 2.0 * lines + 1.0), layout='constrained'
        )
        grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
        mesh: Any = None
        for axes in grid.flat[len(groups) :]:
            axes.set_axis_off()
        for axes, ((plant, label), frame) in zip(grid.flat, groups):
            mesh = _panel(axes, frame, linear_boundaries(results)[plant])
            axes.set_title(f'{plant}: {label}', fontsize=9)
        figure.supylabel('delay [periods]', fontsize=8)
        figure.supxlabel(RATIO, fontsize=8)
        figure.colorbar(
            mesh, ax=grid, label='overshoot [%]', extend='max', format='{x:g}'
        )
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, names, loc='outside lower left', ncols=columns, fontsize=8
        )
        return figure


@lru_cache(maxsize=1)  # sentences and figure of a study show the same
def linear_boundaries(results: Results) -> Mapping[str, Boundaries]:
    """Return the boundaries of the linear loops by plant: with R held, and of eq. 32 alone."""
    by_plant: dict[str, dict[str, dict[int, float]]] = {}
    setups = {
        (cell.factors['plant'], cell.factors[DELAY]): cell for cell in results.cells
    }
    for (plant, delay), cell in setups.items():
        loop, lines = ArmLoop(cell.job.setup()), by_plant.setdefault(plant, {})
        for name, variance, paper in LINEAR_LOOPS:
            lines.setdefault(f'{name} (R = {variance:g} N²)', {})[delay] = (
                loop.boundary(variance, paper=paper)
            )
    return by_plant


def _panel(axes: Axes, frame: pd.DataFrame, boundaries: Boundaries) -> Any:
    worst = (
        frame['overshoot_percent'].where(frame['settled']).astype(float).clip(lower=1.0)
    )
    table = frame.assign(worst=worst).pivot(index=DELAY, columns=RATIO, values='worst')
    ratios, delays = table.columns.to_numpy(float), table.index.to_numpy(float)
    edges = np.sqrt(ratios[:-1] * ratios[1:])
    edges = np.concatenate(
        [[ratios[0] ** 2 / edges[0]], edges, [ratios[-1] ** 2 / edges[-1]]]
    )
    levels = np.append(delays, delays[-1] + 1.0) - 0.5
    mesh = axes.pcolormesh(
        edges,
        levels,
        table.to_numpy(),
        cmap='viridis_r',
        norm=LogNorm(1.0, LARGEST_OVERSHOOT),
    )
    unstable = frame[~frame['settled']]
    axes.plot(
        unstable[RATIO],
        unstable[DELAY],
        'x',
        color='#c0262d',
        markersize=4,
        label='simulated: not settled',
    )
    for (name, line), style in zip(boundaries.items(), STYLES):
        limits = [line[int(delay)] for delay in delays]
        axes.plot(
            np.repeat(limits, 2),
            np.repeat(levels, 2)[1:-1],
            style,
            color='black',
            linewidth=1.6,
            label=name,
        )
    axes.set_xscale('log')
    axes.xaxis.set_major_formatter('{x:g}')
    axes.set_yticks(delays)
    return mesh


class ArmLoop:
    """The linear force loops of a setup at its plant's home; ConfigError for a law but aob."""

    def __init__(self, setup: Setup) -> None:
        config, names = setup.controller, setup.controller.contact_names
        robot = RobotModel(config.robot, setup.urdf_dir)
        state = robot.update(np.array(setup.plant.home), np.zeros(robot.joint_count))
        rotation = state.pose.rotation_world
        N = normal_space(Controller(config, robot).contacts, rotation)
        x, y, z = (
            state.sensor_pose.rotation_world @ np.array(config.tool.com_sensor)
            + state.sensor_pose.position_world
            - state.pose.position_world
        )
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        inertia = config.tool.mass * np.block(
            [[np.eye(3), -cross], [cross, -cross @ cross]]
        )  # of a point mass at its centre
        observer = design_law(
            config.law_of(names[0]),
            config.force,
            make_loop_model(config, config.contacts[names[0]].stiffness),
        )
        if not isinstance(observer, ObserverDesign):
            raise ConfigError(
                'force.law', 'aob, for the linear loops', config.force.law
            )
        self.observer, self.config = observer, config
        pushed = state.jacobian.T @ N
        self.mobility = pushed.T @ np.linalg.solve(state.mass_matrix, pushed)
        self.tool_inertia = np.linalg.pinv(N) @ inertia @ N @ np.linalg.inv(N.T @ N)
        self.stiffness = np.array([config.contacts[name].stiffness for name in names])
        self.damping = np.array([setup.plant.surfaces[name].damping for name in names])
        # What the loop really has: of actuators and sensor's low-pass [s].
        self.delay = (
            setup.plant.actuator_delay_ticks * config.period
            + config.sensor.filter_delay(config.rate)
        )
        self.fed_share = {  # of the desired force in what is fed forward, of the first contact
            'mixed': min(
                config.force.damping_rate**2
                / (2.0 * self.stiffness[0] * self.mobility[0, 0]),
                1.0,
            ),
            'desired': 1.0,
        }.get(config.force.fed_forward, 0.0)

    def boundary(self, noise_variance: float, *, paper: bool = False) -> float:
        """
        Return the largest stable stiffness ratio, 0 for none or infinity.

        With R held at `noise_variance` [N^2], on the arm, or on the plant of eq. 32 if `paper`.
        """
        law = make_steady_law(
            self.observer, solve_steady_gain(self.observer, noise_variance)
        )
        period, K_2 = self.config.period, self.config.force.damping_rate
        model = LoopModel(float(self.stiffness[0]), K_2, self.delay, period)

        def is_stable(ratio: float) -> bool:
            loop = (
                closed_loop_matrix(law, model, ratio)
                if paper
                else margins.closed_loop(
                    margins.LinearArmPlant(  # where the real delay counts in whole periods
                        self.mobility,
                        ratio * self.stiffness,
                        self.damping,
                        self.tool_inertia,
                        round(self.delay / period) * period,
                    ),
                    law,
                    K_2,
                    period,
                    fed_share=self.fed_share,
                )
            )
            return margins.spectral_radius(loop) < 1.0

        return math.sqrt(math.prod(margins.find_last_stable(is_stable, RATIOS, 1e-7)))
