"""`multicontact simulate`."""

from __future__ import annotations

from multicontact_control.cli.exits import end_by_verdict, errors_in_one_line
from multicontact_control.cli.options import (
    Bare,
    Duration,
    Engine,
    Estimator,
    Law,
    Out,
    Overwrite,
    Plant,
    prepare,
    Preset,
    Robot,
    Scenario,
    Seed,
    Settings,
)


def simulate(
    scenario: Scenario = 'paper', robot: Robot = '', plant: Plant = '', seed: Seed = 0,
    duration: Duration = None, noise_estimator: Estimator = None, out: Out = None,
    overwrite: Overwrite = False, bare: Bare = False, preset: Preset = 'best',
    law: Law = None, settings: Settings = None, engine: Engine = '',
) -> None:
    """
    Run a scenario in one process, without ROS, as fast as it goes.

    The same seed gives the same run, bit for bit. Exit code 0: stable, or not judged, as
    nothing was ever pressed; 1: not stable, or held by the supervisor; 2: bad input.
    """
    with errors_in_one_line():
        setup, folder = prepare(
            scenario, plant, seed, duration, noise_estimator, out, overwrite, preset=preset,
            law=law, settings=settings, robot=robot, engine=engine)
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_simulate

        summary = run_simulate(setup, folder, supervised=not bare)
    end_by_verdict(summary)
