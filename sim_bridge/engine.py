"""What an engine does for a plant: an arm without surroundings, advanced step by step."""

from __future__ import annotations

from typing import Protocol, TYPE_CHECKING

from multicontact_control.arrays import Vector
from multicontact_control.errors import ConfigError

if TYPE_CHECKING:
    from sim_bridge.arm import Arm
    from sim_bridge.config import PlantConfig


class EngineArm(Protocol):
    """
    One arm alone in a world of its own; `reset` puts it there.

    Attributes
    ----------
    q, qd
        Joint angles and speeds now, shape (n,) [rad], [rad/s].

    """

    q: Vector
    qd: Vector

    def reset(self, q: Vector) -> None:
        """Start afresh from rest at joint angles `q`; nothing of the past is left."""

    def push_tool(self, force: list[float], point: list[float]) -> None:
        """Apply a force [N] at a point [m] of the tool for one step, world axes."""

    def push_link(self, joint: int, force: list[float], point: list[float]) -> None:
        """Apply a force [N] at a point [m] of the link behind a joint for one step, world axes."""

    def step(self, torque: Vector) -> tuple[float, ...]:
        """
        Advance `q` and `qd` by one step under joint torques, shape (n,) [N m].

        Symplectic Euler: the speeds with the acceleration at the start, then the angles with the
        new speeds.

        Returns
        -------
        tuple of float
            What the arm exerts on the tool at the start of the step, in the sensor's frame, six
            numbers [N, N m].

        """
        ...

    def native_forces(self) -> Vector:
        """Return the normal forces of the engine's own contacts in that step, shape (no,) [N]."""
        ...

    def close(self) -> None:
        """Give the world back."""


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
