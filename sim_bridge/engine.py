"""The engines, of which each is loaded only where a plant asks for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicontact_control.errors import ConfigError
from sim_bridge.engine_arm import EngineArm

if TYPE_CHECKING:
    from sim_bridge.arm import Arm
    from sim_bridge.config import PlantConfig


def make_engine(config: PlantConfig, arm: Arm) -> EngineArm:
    """
    Return the engine of a plant.

    Raises
    ------
    ConfigError
        If it is not installed.

    """
    if config.engine == 'pybullet':
        from sim_bridge.bullet_arm import BulletArm

        return BulletArm(arm, config.gravity_world, config.substep)
    try:
        from sim_bridge.mujoco_arm import MujocoArm, NativeContacts
    except ImportError as error:
        raise ConfigError(
            'engine', 'pybullet, or what pip install "multicontact_control[mujoco]" brings',
            f'mujoco ({error})') from None
    native = NativeContacts.of(config, arm) if config.contact == 'native' else None
    return MujocoArm(arm, config.gravity_world, config.substep, native)
