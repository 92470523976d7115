"""What `multicontact study map` draws: the grid, and boundaries of loops of `force.margins`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
import math
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from multicontact_control.arrays import Matrix
from multicontact_control.commissioning.law_report import closed_loop_matrix
from multicontact_control.config import ToolConfig
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel, RobotState
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

RATIO = 'true / model stiffness'
DELAY = 'plant.actuator_delay_ticks'


class LinearLoop(NamedTuple):
    """
    A linear loop whose boundary of stability is drawn beside the simulated runs.

    The observer's gain goes with R, so the boundary does: it is drawn for an R as at rest and one
    as in motion.
    """

    name: str
    noise_variance: float  # R that is held, as at rest or in motion [N^2]
    of_paper: bool = False  # the plant of P04 eq. 32 alone, and not the arm's

    @property
    def label(self) -> str:
        """
        Return what sentences and the figure call it.

        Name and R [N^2] together: two of the `LINEAR_LOOPS` have one name. It is also the key of
        the loop's boundaries.
        """
        return f'{self.name} (R = {self.noise_variance:g} N²)'


LINEAR_LOOPS = (
    LinearLoop('The linear loop of the arm', 0.6),
    LinearLoop('The linear loop of the arm', 100.0),
    LinearLoop('The plant of eq. 32 alone', 0.6, of_paper=True),
)
STYLES = ('-', '--', ':')
LARGEST_OVERSHOOT = 300.0  # %, of the colour scale
# Where boundaries are looked for, upwards.
RATIOS = tuple(np.geomspace(0.1, 100.0, 73).tolist())
Boundaries = Mapping[str, Mapping[int, float]]  # largest stable ratio by line and delay


class MapStudy(Study):
    """
    Overshoots over true by modelled stiffness, and delay of the actuator.

    Beside the simulated runs stand the boundaries at which the linear loops become unstable; these
    have neither noise nor friction, torque limits or a supervisor.
    """

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return where runs settle, and the boundaries of the linear loops.

        A loop that is stable over the whole range is given with the range's end, a ratio of 100.
        """
        sentences = super().describe_findings(results)
        for plant, boundaries in linear_boundaries(results).items():
            for name, ratios in boundaries.items():
                limits = []
                for delay, ratio in ratios.items():
                    limit = min(ratio, RATIOS[-1])
                    limits.append(f'{limit:.2f} with {delay}')
                sentences.append(
                    f'{name} is stable on {plant} up to {RATIO} = '
                    f'{", ".join(limits)} periods of delay.'
                )
        return sentences

    def draw_figure(self, results: Results) -> Figure:
        """
        Return the map of overshoots, a panel for each plant and estimator.

        Colours are logarithmic from 1 to 300 %; a cross marks a run that did not settle, and steps
        of lines are the boundaries, one for each delay.
        """
        groups = list(results.frame.groupby(['plant', 'estimator'], sort=False))
        columns = min(results.frame['estimator'].nunique(), 4)
        rows = math.ceil(len(groups) / columns)
        figure = Figure(
            figsize=(3.2 * columns + 1.2, 2.0 * rows + 1.0), layout='constrained'
        )
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        mesh: Any = None
        for axes in grid.flat[len(groups) :]:
            axes.set_axis_off()
        for axes, ((plant, label), runs) in zip(grid.flat, groups):
            mesh = _draw_overshoots(axes, runs, linear_boundaries(results)[plant])
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
    """
    Return the boundaries of the `LINEAR_LOOPS` by plant, label and delay of the actuator.

    A boundary is the largest ratio of true and modelled stiffness at which the loop is stable. One
    cell of each plant and delay is enough, since no other factor enters the loop. The last answer
    is kept.
    """
    by_plant: dict[str, dict[str, dict[int, float]]] = {}
    cells = {}
    for cell in results.cells:
        cells[cell.factors['plant'], cell.factors[DELAY]] = cell
    for (plant, delay), cell in cells.items():
        arm_loop = ArmLoop(cell.job.setup())
        boundaries = by_plant.setdefault(plant, {})
        for linear in LINEAR_LOOPS:
            ratios = boundaries.setdefault(linear.label, {})
            ratios[delay] = arm_loop.largest_stable_ratio(
                linear.noise_variance, of_paper=linear.of_paper
            )
    return by_plant


def _draw_overshoots(axes: Axes, runs: pd.DataFrame, boundaries: Boundaries) -> Any:
    """Draw the overshoots of settled runs and the boundaries; return the coloured mesh."""
    overshoot = runs['overshoot_percent'].where(runs['settled']).astype(float)
    table = runs.assign(shown=overshoot.clip(lower=1.0)).pivot(
        index=DELAY, columns=RATIO, values='shown'
    )
    ratios = table.columns.to_numpy(float)
    delays = table.index.to_numpy(float)
    middles = np.sqrt(ratios[:-1] * ratios[1:])
    first_edge = ratios[0] ** 2 / middles[0]
    last_edge = ratios[-1] ** 2 / middles[-1]
    levels = np.append(delays, delays[-1] + 1.0) - 0.5
    edges = np.concatenate([[first_edge], middles, [last_edge]])
    mesh = axes.pcolormesh(
        edges,
        levels,
        table.to_numpy(),
        cmap='viridis_r',
        norm=LogNorm(1.0, LARGEST_OVERSHOOT),
    )
    unsettled = runs[~runs['settled']]
    axes.plot(
        unsettled[RATIO],
        unsettled[DELAY],
        'x',
        color='#c0262d',
        markersize=4,
        label='simulated: not settled',
    )
    for (name, largest), style in zip(boundaries.items(), STYLES):
        limits = [largest[int(delay)] for delay in delays]
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
    """
    The linear force loops of a setup's arm at its plant's home, with its tool and surfaces.

    Its plant is the mobility N^T J M^-1 J^T N [1/kg] with springs and dampers at the contacts, and
    the mass that hangs beyond the sensor. Friction, limits and the motion are not in it.

    Raises
    ------
    ConfigError
        If the force law is another than the active observer.

    """

    def __init__(self, setup: Setup) -> None:
        config = setup.controller
        names = config.contact_names
        robot = RobotModel(config.robot, setup.urdf_dir)
        state = robot.update(np.array(setup.plant.home), np.zeros(robot.joint_count))
        N = normal_space(Controller(config, robot).contacts, state.pose.rotation_world)
        first = names[0]
        model = make_loop_model(config, config.contacts[first].stiffness)
        observer = design_law(config.force_law_of(first), config.force, model)
        if not isinstance(observer, ObserverDesign):
            raise ConfigError(
                'force.law', 'aob, for the linear loops', config.force.law
            )
        self.observer = observer
        self.config = config
        pushed = state.jacobian.T @ N
        self.mobility = pushed.T @ np.linalg.solve(state.mass_matrix, pushed)
        inertia = _tool_inertia(config.tool, state)
        self.tool_inertia = np.linalg.pinv(N) @ inertia @ N @ np.linalg.inv(N.T @ N)
        self.stiffness = np.array([config.contacts[name].stiffness for name in names])
        self.damping = np.array([setup.plant.surfaces[name].damping for name in names])
        # What the loop really has: of actuators and sensor's low-pass [s].
        self.delay = (
            setup.plant.actuator_delay_ticks * config.period
            + config.sensor.filter_delay(config.rate)
        )

    def _find_fed_share(self) -> float:
        """Return the share of the desired force in what is fed forward, of the first contact."""
        force = self.config.force
        if force.fed_forward == 'desired':
            return 1.0
        if force.fed_forward == 'mixed':
            stiffest = 2.0 * self.stiffness[0] * self.mobility[0, 0]
            return float(min(force.damping_rate**2 / stiffest, 1.0))
        return 0.0

    def largest_stable_ratio(
        self, noise_variance: float, *, of_paper: bool = False
    ) -> float:
        """
        Return the largest stable ratio of true and modelled stiffness, 0 for none or infinity.

        With R held at `noise_variance` [N^2], on the arm, or on the plant of P04 eq. 32 if
        `of_paper`.
        """
        gain = solve_steady_gain(self.observer, noise_variance)
        law = make_steady_law(self.observer, gain)
        period = self.config.period
        K_2 = self.config.force.damping_rate
        model = LoopModel(float(self.stiffness[0]), K_2, self.delay, period)
        whole_delay = round(self.delay / period) * period

        def is_stable(ratio: float) -> bool:
            """Return whether all eigenvalues of the closed loop lie within the unit circle."""
            if of_paper:
                loop = closed_loop_matrix(law, model, ratio)
            else:
                arm = margins.LinearArmPlant(
                    self.mobility,
                    ratio * self.stiffness,
                    self.damping,
                    self.tool_inertia,
                    whole_delay,
                )
                loop = margins.closed_loop(
                    arm, law, K_2, period, fed_share=self._find_fed_share()
                )
            return margins.spectral_radius(loop) < 1.0

        low, high = margins.find_last_stable(is_stable, RATIOS, 1e-7)
        return math.sqrt(low * high)


def _tool_inertia(tool: ToolConfig, state: RobotState) -> Matrix:
    """Return the inertia of the tool, a point mass at its centre, about the point, (6, 6)."""
    sensor = state.sensor_pose
    centre = sensor.rotation_world @ np.array(tool.com_sensor) + sensor.position_world
    x, y, z = centre - state.pose.position_world
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return tool.mass * np.block([[np.eye(3), -cross], [cross, -cross @ cross]])
