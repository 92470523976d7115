"""The arm in PyBullet: links and joints only, everything else is applied to it from outside."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from multicontact_control.arrays import Vector
from multicontact_control.config import Vector3
from sim_bridge.arm import Arm, compose_urdf, SENSOR_FRAME, TOOL_LINK
from sim_bridge.engine_arm import EngineArm

# PyBullet prints when it was built, as soon as it is imported.
_output = os.dup(2)
_nowhere = os.open(os.devnull, os.O_WRONLY)
os.dup2(_nowhere, 2)
try:
    import pybullet as bullet
finally:
    os.dup2(_output, 2)

MAX_JOINT_SPEED = 1e4  # rad/s, in the place of the engine's own 100 rad/s


class BulletArm(EngineArm):
    """
    The arm in a PyBullet world of its own; see `EngineArm`.

    Parameters
    ----------
    arm
        Links, sensor and tool.
    gravity_world
        Gravity, world axes [m/s^2].
    step
        Integration step [s].

    Attributes
    ----------
    client, body
        PyBullet's numbers of the world and of the arm in it.

    """

    def __init__(self, arm: Arm, gravity_world: Vector3, step: float) -> None:
        super().__init__(len(arm.links))
        self._arm = arm
        self._gravity = gravity_world
        self._step = step
        self._joint_numbers = range(len(arm.links))
        self.client: int = bullet.connect(bullet.DIRECT)

    def reset(self, q: Vector) -> None:
        """Make the world anew, with the arm at rest; see `EngineArm`."""
        super().reset(q)
        bullet.resetSimulation(physicsClientId=self.client)
        self._load_world()
        for joint, angle in zip(self._joints, q.tolist(), strict=True):
            bullet.resetJointState(
                self.body, joint, angle, 0.0, physicsClientId=self.client
            )

    def apply_pushes(self, pushes: list[list[float]]) -> None:
        """Apply forces at points for one step; see `EngineArm`."""
        for fx, fy, fz, x, y, z, number in pushes:
            bullet.applyExternalForce(
                self.body,
                self._pushed_links[int(number)],
                (fx, fy, fz),
                (x, y, z),
                bullet.WORLD_FRAME,
                self.client,
            )

    def step(self, torque: Vector) -> tuple[float, ...]:
        """Advance by one step and return what the arm exerts on the tool; see `EngineArm`."""
        unused = self._unused
        bullet.setJointMotorControlArray(  # keywords would take as long again
            self.body,
            self._joints,
            bullet.TORQUE_CONTROL,
            unused,
            unused,
            torque.tolist(),
            unused,
            unused,
            self.client,
        )
        bullet.stepSimulation(self.client)
        states = bullet.getJointStates(self.body, self._read_joints, self.client)
        for joint in self._joint_numbers:
            self.q[joint], self.qd[joint], _, _ = states[joint]
        # At the child's centre of mass, which in the sensor's face is its origin.
        wrench: tuple[float, ...] = states[-1][2]
        return wrench

    def set_tool_mass(self, mass: float) -> None:
        """Change the mass of the tool; see `EngineArm`."""
        tool = self._pushed_links[-1]
        bullet.changeDynamics(self.body, tool, mass=mass, physicsClientId=self.client)
        # The engine works out an inertia of its own with every mass.
        self._set_inertia(tool, self._arm.tool.inertia)

    def close(self) -> None:
        """Disconnect from the world, which frees it."""
        if bullet.isConnected(physicsClientId=self.client):
            bullet.disconnect(physicsClientId=self.client)

    def _load_world(self) -> None:
        client = self.client
        bullet.setGravity(*self._gravity, physicsClientId=client)
        bullet.setTimeStep(self._step, physicsClientId=client)
        # A world without contacts: nothing to iterate for.
        bullet.setPhysicsEngineParameter(
            numSubSteps=0,
            numSolverIterations=1,
            enableFileCaching=0,
            physicsClientId=client,
        )
        with TemporaryDirectory() as folder:
            path = Path(folder) / 'arm.urdf'
            path.write_text(compose_urdf(self._arm, for_bullet=True), encoding='utf-8')
            self.body: int = bullet.loadURDF(
                str(path),
                useFixedBase=True,
                flags=bullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        numbers = {}
        for joint in range(bullet.getNumJoints(self.body, physicsClientId=client)):
            information = bullet.getJointInfo(self.body, joint, physicsClientId=client)
            numbers[information[1].decode()] = joint
        sensor = numbers[f'{SENSOR_FRAME}_joint']
        tool = numbers[f'{TOOL_LINK}_joint']
        self._joints = [numbers[name] for name in self._arm.joint_names]
        self._pushed_links = [*self._joints, tool]
        self._read_joints = [*self._joints, sensor]
        self._unused = [0.0] * len(self._joints)
        self._undo_defaults(sensor, tool)

    def _undo_defaults(self, sensor: int, tool: int) -> None:
        """Undo the damping, motors and inertias that the importer adds or changes unasked."""
        client = self.client
        bullet.changeDynamics(
            self.body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client
        )
        links = [*self._joints, sensor, tool]
        for link, body in zip(links, self._arm.bodies, strict=True):
            # A call of its own: beside a damping, the value would go to the base unnoticed.
            self._set_inertia(link, body.inertia)
            bullet.changeDynamics(
                self.body,
                link,
                jointDamping=0.0,
                maxJointVelocity=MAX_JOINT_SPEED,
                physicsClientId=client,
            )
        # Every joint is born with a motor that holds its speed at zero.
        bullet.setJointMotorControlArray(
            self.body,
            self._joints,
            bullet.VELOCITY_CONTROL,
            forces=self._unused,
            physicsClientId=client,
        )
        bullet.enableJointForceTorqueSensor(
            self.body, sensor, True, physicsClientId=client
        )

    def _set_inertia(self, link: int, moments: Vector3) -> None:
        bullet.changeDynamics(
            self.body, link, localInertiaDiagonal=moments, physicsClientId=self.client
        )
