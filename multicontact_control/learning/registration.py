"""
The name of the environment for gymnasium, which importing this module registers.

The package does so by itself where gymnasium has been imported before it.
"""

import gymnasium

ENVIRONMENT_NAME = 'MultiContact-v0'

gymnasium.register(
    ENVIRONMENT_NAME,
    entry_point='multicontact_control.learning.environment:MultiContactEnv',
)
