"""Which robots and engines `multicontact study robots` has."""

from __future__ import annotations

from importlib.util import find_spec

from multicontact_control.experiment.study.config import FactorConfig, StudyConfig
from multicontact_control.experiment.study.study import Results, Study
from sim_bridge.robots import find_robot, has_urdf


class RobotsStudy(Study):
    """Robots, engines and scenarios: those whose URDF, or engine, is installed."""

    def __init__(self, config: StudyConfig) -> None:
        self.left_out: dict[str, None] = {}
        super().__init__(config.model_copy(update={'parts': {
            title: part.model_copy(update={'factors': {
                name: self._installed(name, factor) for name, factor in part.factors.items()}})
            for title, part in config.parts.items()}}))

    def _installed(self, name: str, factor: FactorConfig) -> FactorConfig:
        """Return a factor with what is installed of its robots and engines."""
        here = {value: (name != 'robot' or has_urdf(find_robot(value)))
                and bool(find_spec(sets.get('plant.engine', 'pybullet')))
                for value, sets in factor.settings(name)}
        self.left_out |= {str(value): None for value, installed in here.items() if not installed}
        return factor.choose([value for value, installed in here.items() if installed])

    def findings(self, results: Results) -> list[str]:
        """Return how many are stable, and what is left out."""
        sentences = super().findings(results)
        if self.left_out:
            sentences.append(f'Left out, as they are not installed: {", ".join(self.left_out)}.')
        return sentences
