"""A configuration that is accepted is safe, whatever its numbers make of the control."""

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from multicontact_control.config import ControllerConfig
from multicontact_control.errors import ConfigError
from multicontact_control.faults.outcomes import find_violations, Observation
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest

SECTIONS = (
    'motion',
    'force',
    'contact_state',
    'watchdog',
    'limits',
    'transition',
    'friction',
)
FACTOR = 30.0  # times the default, either way; what is beyond a bound is refused
TICKS = 700

PARAMETERS = {
    (section, name): field.default
    for section in SECTIONS
    for name, field in type(
        ControllerConfig.model_fields[section].default
    ).model_fields.items()
    if type(field.default) in (int, float) and field.default > 0
}


@pytest.mark.slow
@settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
@given(
    powers=st.dictionaries(
        st.sampled_from(sorted(PARAMETERS)),
        st.floats(-1.0, 1.0),
        min_size=1,
        max_size=6,
    ),
    plant=st.sampled_from(['rigid', 'puma']),
)
def test_accepted_configuration_is_safe(powers, plant):
    changes = {}
    for (section, name), power in powers.items():
        default = PARAMETERS[section, name]
        changes.setdefault(section, {})[name] = type(default)(default * FACTOR**power)
    try:
        loop = ClosedLoop(
            resolve('quick', plant=plant, controller=changes), commanded=True
        )
    except ConfigError:
        return
    config, torques, forces = loop.setup.controller, [], []
    loop.advance()
    loop.control.set_forces(
        dict.fromkeys(
            config.contact_names, max(10.0, config.contact_state.smallest_force)
        )
    )
    for _ in range(TICKS):
        loop.advance()
        torques.append(loop.command.copy())
        forces.append(loop.sample.contact_force.max())
    loop.close()
    problems, _ = find_violations(
        Observation(
            np.array(torques),
            config.period * np.arange(TICKS),
            np.array(forces),
            'none',
        ),
        loop.setup,
    )
    assert problems == set()
