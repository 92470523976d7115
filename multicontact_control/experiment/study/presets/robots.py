"""What `multicontact study robots` says beside its table, and which robots and engines it has."""

from __future__ import annotations

from importlib.util import find_spec

from multicontact_control.experiment.study.config import FactorConfig, StudyConfig
from multicontact_control.experiment.study.study import Results, Study
from multicontact_control.experiment.study.table import columns_of
from sim_bridge.robots import find_robot, has_urdf

MOVING = 'contacts.*.moving.true_error_rms_n'
SURFACES = ['robot', 'scenario', 'seed']


class RobotsStudy(Study):
    """Robots, engines and scenarios: those whose URDF, or engine, is installed."""

    def __init__(self, config: StudyConfig) -> None:
        self.left_out: list[str] = []
        super().__init__(config.model_copy(update={'parts': {
            title: part.model_copy(update={'factors': {
                name: self._installed(name, factor) for name, factor in part.factors.items()}})
            for title, part in config.parts.items()}}))

    def _installed(self, name: str, factor: FactorConfig) -> FactorConfig:
        """Return a factor with what is installed of its robots and engines."""
        here = [value for value, sets in factor.settings(name)
                if (name != 'robot' or has_urdf(find_robot(value)))
                and find_spec(sets.get('plant.engine', 'pybullet'))]
        self.left_out += [str(value) for value, _ in factor.settings(name) if value not in here]
        return factor.choose(FactorConfig(values=tuple(here)))

    def findings(self, results: Results) -> list[str]:
        """Return how many are stable, and how far apart engines with the same surfaces are."""
        frame, apart = results.frame, []
        for name in columns_of(frame, MOVING):
            errors = frame.pivot_table(index=SURFACES, columns='engine', values=name)
            if {'pybullet', 'mujoco'} <= set(errors.columns):
                apart.append((errors['pybullet'] - errors['mujoco']).abs().max())
        without = ', '.join(dict.fromkeys(self.left_out))
        return [*super().findings(results),
                *([f'Left out, as they are not installed: {without}.'] if without else []),
                *([f'With the same surfaces, the moving force errors of the engines differ by '
                   f'{max(apart):.2g} N at most.'] if apart else [])]
