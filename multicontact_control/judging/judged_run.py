"""One run from its configuration to its folder: in process, or on the ROS 2 graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
import signal
from typing import Any, TYPE_CHECKING

from multicontact_control.arrays import Vector
from multicontact_control.compiled import count_compilations
from multicontact_control.config import validate
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.files import replace_json_file, replace_nonfinite_numbers
from multicontact_control.judging.claims import judge_claims_of_run
from multicontact_control.judging.display import print_summary, show_progress
from multicontact_control.judging.figure_files import draw_figures
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.passes import write_passes
from multicontact_control.judging.run_folders import (
    CONFIG_FOLDER,
    FIGURE_FOLDER,
    SUMMARY_FILE,
)
from multicontact_control.judging.run_modes import (
    EXTERNAL_RUN,
    IN_PROCESS,
    INTERRUPTED,
    LOCKSTEP,
    REAL_TIME,
)
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.closed_loop import run_in_process
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.recording import BagContent, read_bag
from multicontact_control.runs.scenario import flatten_parameters, Setup, SHORTEST
from rich.console import Console
from rich.markup import escape

if TYPE_CHECKING:
    from multicontact_control.runs.graph.run import GraphResult
    from multicontact_control.runs.graph.spec import GraphSpec

# Periods without a sample that are still no gap. A robot moves on while its samples are late; the
# simulated one has stood still, and a busy machine is no fault of its sensors.
SIMULATION_PATIENCE = 25.0
SIMULATOR_TIMING = ('deadline_misses', 'latency_us', 'latency_histogram')
Ending = tuple[dict[str, Any] | None, int | None]  # a summary, and a signal
CONSOLE = Console(highlight=False, soft_wrap=True)


def simulate_run(
    setup: Setup, folder: Path, *, supervised: bool = True
) -> dict[str, Any]:
    """
    Run a scenario in this process, leave its results in a folder, and return its summary.

    Without supervision there are no contact states, watchdogs and limits around the control law.
    Raises ConfigError if the scenario asks for a push test, RunError if it ends at once.
    """
    refuse_push_test(setup)
    ensure_compiled()
    setup.write(folder / CONFIG_FOLDER)
    names = setup.controller.contact_names
    duration = setup.scenario.duration
    title = f'simulate {setup.scenario.name}'
    with show_progress(title, duration, CONSOLE) as show:

        def show_forces(time: float, alpha: Vector) -> None:
            show(time, dict(zip(names, alpha)))

        result = run_in_process(setup, show_forces, supervised=supervised)
        show(duration, {})
    if not result.data.ticks:
        raise RunError(f'the run ended at once: {result.ended_early}')
    result.data.save(folder)
    run = RunMetrics(result.data, setup)
    events = None
    if supervised:
        events = result.events
    summary = summarise_run(
        run,
        mode=IN_PROCESS,
        timing={'kernels_compiled': count_compilations()},
        ended_early=result.ended_early,
        events=events,
    )
    return _leave_results(run, folder, summary)


def simulation_parameters(setup: Setup) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes of a simulated graph that belong to no file, by node."""
    from multicontact_control.runs.graph.spec import CONTROLLER, ESTIMATOR, SIM

    controller = setup.node_parameters('controller')
    return {
        CONTROLLER: {'patience': SIMULATION_PATIENCE, **controller},
        ESTIMATOR: setup.node_parameters('noise_estimator'),
        SIM: setup.node_parameters('plant'),
    }


def run_on_graph(
    setup: Setup,
    folder: Path,
    *,
    supervised: bool = True,
    **options: Any,
) -> Ending:
    """
    Run a scenario, or commands, on the ROS 2 graph, and leave recording and results in a folder.

    Parameters
    ----------
    setup
        What to run, and with what; a signal ends the run if it is `endless`. Where it is not
        `simulated`, the user's own robot is behind the topics.
    folder
        Where to leave the results.
    supervised
        Whether the supervisor surrounds the control law.
    options
        Fields of `GraphSpec`.

    Returns
    -------
    summary, signal
        The summary, None if no sample was answered or a Ctrl-C skipped the report; and the signal
        that ended the run early, if one did.

    Raises
    ------
    ConfigError
        If the scenario cannot begin by itself or a parameter of the node is not acceptable.
    RunError
        If ROS cannot be loaded or a node dies.

    """
    from multicontact_control.nodes.controller_node import ControllerNodeConfig
    from multicontact_control.runs.graph.robot import ExpectedRobot
    from multicontact_control.runs.graph.spec import CONTROLLER, GraphSpec

    config = folder / CONFIG_FOLDER
    ticks = 0
    duration = None
    if not setup.endless:
        ticks = setup.ticks
        duration = setup.scenario.duration
    reference_file = None
    if not setup.commanded_by_topic:
        reference_file = config / 'reference.yaml'
    if setup.simulated or not setup.commanded_by_topic:
        refuse_push_test(setup)
    parameters = simulation_parameters(setup)
    if not setup.simulated:
        of_node = setup.nodes.get('controller', {})
        parameters[CONTROLLER] = flatten_parameters(of_node)
        node = validate(ControllerNodeConfig, of_node, 'controller_node')
        options['domain_id'] = options.get('domain_id') or 0
        options['robot'] = ExpectedRobot(
            setup.controller.robot.joint_names,
            setup.controller.wrench_input,
            node.effort_output_topic,
            duration=duration,
        )
    parameters[CONTROLLER]['supervised'] = supervised
    ensure_compiled()
    spec = GraphSpec(
        out=folder,
        ticks=ticks,
        rate=setup.controller.rate,
        seed=setup.seed,
        parameter_files=setup.write(config),
        reference_file=reference_file,
        extra_parameters=parameters,
        **options,
    )
    result = _run_graph_with_progress(spec, f'run {setup.scenario.name}', duration)
    if not result.controlled:
        CONSOLE.print(
            'ended before any sample was answered: there is nothing to report'
        )
        return None, _find_first_signal(result)
    try:
        if len(result.signals) > 1:
            raise KeyboardInterrupt
        return _report_graph(result, spec, setup)
    except (KeyboardInterrupt, SystemExit):
        CONSOLE.print(
            f'report skipped; to write it: multicontact report {escape(str(folder))}'
        )
        return None, signal.SIGINT


def _find_first_signal(result: GraphResult) -> int | None:
    if result.signals:
        return result.signals[0]
    return None


def _report_graph(result: GraphResult, spec: GraphSpec, setup: Setup) -> Ending:
    """Return the summary of a run on the graph, and the signal that ended it early."""
    from multicontact_control.runs.graph.spec import CONTROLLER

    content = read_bag(
        result.bag,
        setup.controller,
        namespace=spec.namespace,
        answered=spec.robot is not None,
    )
    data = content.data
    interrupted = None
    if spec.ticks:
        interrupted = _find_first_signal(result)
    else:  # it lasts as long as it has, in the files, too
        duration = max(SHORTEST, data.ticks / data.rate)
        scenario = setup.scenario.model_copy(update={'duration': duration})
        setup = replace(setup, scenario=scenario)
        setup.write(spec.out / CONFIG_FOLDER)
    if spec.robot:
        mode = EXTERNAL_RUN
    elif spec.free_running:
        mode = REAL_TIME
    else:
        mode = LOCKSTEP
    ended_early = result.ended
    if interrupted and not ended_early:
        ended_early = INTERRUPTED
    events = None
    if spec.extra_parameters[CONTROLLER]['supervised']:
        events = result.timing[CONTROLLER].get('events', [])
    run = RunMetrics(data, setup, content.missing)
    summary = summarise_run(
        run,
        mode=mode,
        timing=_collect_timing(result.timing, content),
        ended_early=ended_early,
        events=events,
        remarks=content.remarks,
    )
    return _leave_results(run, spec.out, summary), interrupted


def _run_graph_with_progress(
    spec: GraphSpec, title: str, duration: float | None
) -> GraphResult:
    """Run the graph and show how far it is; `duration` is None for a run without an end [s]."""
    from multicontact_control.runs.graph.run import run_graph

    tell = partial(CONSOLE.print, markup=False)
    with show_progress(title, duration, CONSOLE, 'starting the nodes') as show:
        result = run_graph(spec, lambda progress: show(*progress), tell)
        if duration is not None and not result.signals:
            show(duration, {})
    if result.ended:
        tell(f'ended: {result.ended}')
    return result


def refuse_push_test(setup: Setup) -> None:
    """Check that the scenario can begin without a push test; ConfigError if it cannot."""
    if setup.controller.sensor.require_push_test:
        raise ConfigError(
            'sensor.require_push_test',
            'false in a scenario, which begins without a push on the tool',
            True,
        )


def _collect_timing(
    timing: Mapping[str, Mapping[str, Any]], content: BagContent
) -> dict[str, Any]:
    """Return the `timing` of ``summary.json`` from what the nodes and the bag say."""
    compiled = [node.get('kernels_compiled', 0) for node in timing.values()]
    result = {
        'lost_messages': timing.get('recorder_node', {}).get('lost'),
        'unanswered_samples': content.unanswered,
        'kernels_compiled': sum(compiled),
        'tick_us': timing.get('controller_node', {}).get('tick_us'),
    }
    simulator = timing.get('sim_node')
    if simulator:
        for name in SIMULATOR_TIMING:
            result[name] = simulator[name]
        result['realtime_factor'] = None
        if simulator['wall_s']:
            duration = content.data.ticks / content.data.rate
            result['realtime_factor'] = duration / simulator['wall_s']
    return result


def _leave_results(
    run: RunMetrics, folder: Path, summary: dict[str, Any]
) -> dict[str, Any]:
    """Judge the claims, write figures, passes and summary, show the table; return the summary."""
    claims = judge_claims_of_run(run, summary)
    summary['claims'] = [claim._asdict() for claim in claims]
    draw_figures(run, summary, folder / FIGURE_FOLDER)
    write_passes(run, folder)
    replace_json_file(folder / SUMMARY_FILE, replace_nonfinite_numbers(summary))
    print_summary(CONSOLE, summary, folder)
    return summary
