"""The kinds of studies: what each has beside its file, such as findings or jobs of its own."""

from multicontact_control.study.config import StudyConfig
from multicontact_control.study.presets.compare import CompareStudy
from multicontact_control.study.presets.faults import FaultsStudy
from multicontact_control.study.presets.map import MapStudy
from multicontact_control.study.presets.sanding import SandingStudy
from multicontact_control.study.presets.situations import SituationsStudy
from multicontact_control.study.presets.tune import TuneStudy
from multicontact_control.study.study import Study

KINDS = {
    'sweep': Study,
    'compare': CompareStudy,
    'map': MapStudy,
    'tune': TuneStudy,
    'faults': FaultsStudy,
    'situations': SituationsStudy,
    'sanding': SandingStudy,
}


def make_study(config: StudyConfig) -> Study:
    """
    Return the study of a configuration, with what its kind has beside the file.

    Kinds without code of their own are plain sweeps. Importing this module imports every kind,
    with matplotlib and the commissioning tools that some of them draw on.
    """
    return KINDS[config.kind](config)
