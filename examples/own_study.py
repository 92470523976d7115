"""
A study over a factor of your own: the pace of the force loop, on a soft and a stiff board.

``python examples/own_study.py runs/pace`` runs every combination of the factors with two seeds,
prints how fast the worse contact follows a step, and leaves table, figure and page in the folder.
A second start runs nothing that is finished there.
"""

from pathlib import Path
import sys

from multicontact_control.study.config import FactorConfig, StudyConfig
from multicontact_control.study.study import run_study, Study
from rich.console import Console

# A level of a factor sets any parameters, each by the name that `--set` takes.
PACES = {
    'calm': {'controller.force.time_constant': 0.04},
    'usual': {'controller.force.time_constant': 0.02},
    'hasty': {'controller.force.time_constant': 0.01},
}
SOFT_AND_STIFF = (1500.0, 6000.0)  # N/m, of the board


def make_study(duration: float = 15.0, seeds: int = 2) -> Study:
    """Return the study, whose runs last for a duration [s]."""
    config = StudyConfig(
        name='pace',
        description='Steps of force by the pace of the loop and the stiffness of the board.',
        scenario='quick',
        plants=('rigid',),
        preset='best',
        duration=duration,
        seeds=tuple(range(seeds)),
        factors={
            'pace': FactorConfig(levels=PACES),
            'plant.surfaces.board.stiffness': FactorConfig(values=SOFT_AND_STIFF),
        },
    )
    return Study(config.model_copy(update={'parts': config.whole_parts()}))


def main(folder: Path, study: Study) -> None:
    """Run a study on all cores, and print the medians over its seeds."""
    frame = run_study(study, folder, Console()).frame
    columns = ['rise_s', 'overshoot_percent']
    factors = ['pace', 'plant.surfaces.board.stiffness']
    print(frame.groupby(factors, sort=False)[columns].median().round(3))


if __name__ == '__main__':
    main(Path(sys.argv[1]), make_study())
