"""The arm in PyBullet: links and joints only, everything else is applied to it from outside."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from multicontact_control.arrays import Vector
from sim_bridge.arm import Arm, SENSOR_FRAME, TOOL_LINK, urdf_text
from sim_bridge.engine_arm import EngineArm

# PyBullet prints when it was built, as soon as it is imported.
_output, _nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
os.dup2(_nowhere, 2)
try:
    import pybullet as bullet
finally:
    os.dup2(_output, 2)

MAX_JOINT_SPEED = 1e4


class BulletArm(EngineArm):
    """The arm in PyBullet, whose `client` and `body` it is; gravity [m/s^2] and step [s]."""

    def __init__(
        self,
        arm: Arm,
        gravity_world: tuple[float, float, float],
        step: float,
    ) -> None:
        super().__init__(len(arm.links))
        self._arm = arm
        self._gravity = gravity_world
        self._step = step
        self._numbers = range(len(arm.links))
        self._q, self._qd = memoryview(self.q), memoryview(self.qd)  # type: ignore[arg-type]
        self.client: int = bullet.connect(bullet.DIRECT)

    def reset(self, q: Vector) -> None:
        """Make the world anew, with the arm at rest; see `EngineArm`."""
        super().reset(q)
        bullet.resetSimulation(physicsClientId=self.client)
        self._load()
        for joint, angle in zip(self._links, q.tolist(), strict=True):
            bullet.resetJointState(
                self.body, joint, angle, 0.0, physicsClientId=self.client
            )

    def push(self, pushes: list[list[float]]) -> None:
        """Apply forces at points for one step; see `EngineArm`."""
        push, client, body, links = (
            bullet.applyExternalForce,
            self.client,
            self.body,
            self._bodies,
        )
        for fx, fy, fz, x, y, z, number in pushes:
            push(
                body,
                links[int(number)],
                (fx, fy, fz),
                (x, y, z),
                bullet.WORLD_FRAME,
                client,
            )

    def step(self, torque: Vector) -> tuple[float, ...]:
        """Advance by one step and return what the arm exerts on the tool; see `EngineArm`."""
        client, body, unused, q, qd = (
            self.client,
            self.body,
            self._unused,
            self._q,
            self._qd,
        )
        bullet.setJointMotorControlArray(  # keywords would take as long again
            body,
            self._links,
            bullet.TORQUE_CONTROL,
            unused,
            unused,
            torque.tolist(),
            unused,
            unused,
            client,
        )
        bullet.stepSimulation(client)
        states = bullet.getJointStates(body, self._read_joints, client)
        for i in self._numbers:
            q[i], qd[i], _, _ = states[i]
        # At the child's centre of mass, which in the sensor's face is its origin.
        wrench: tuple[float, ...] = states[-1][2]
        return wrench

    def set_tool_mass(self, mass: float) -> None:
        """Change the mass of the tool; see `EngineArm`."""
        for values in (
            {'mass': mass},
            {'localInertiaDiagonal': self._arm.tool.inertia},
        ):
            bullet.changeDynamics(
                self.body, self._bodies[-1], physicsClientId=self.client, **values
            )

    def close(self) -> None:
        """Give the world back."""
        if bullet.isConnected(physicsClientId=self.client):
            bullet.disconnect(physicsClientId=self.client)

    def _load(self) -> None:
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
            path.write_text(urdf_text(self._arm, for_bullet=True), encoding='utf-8')
            self.body: int = bullet.loadURDF(
                str(path),
                useFixedBase=True,
                flags=bullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        indices = {}
        for joint in range(bullet.getNumJoints(self.body, physicsClientId=client)):
            info = bullet.getJointInfo(self.body, joint, physicsClientId=client)
            indices[info[1].decode()] = joint
        self._links = [indices[name] for name in self._arm.joint_names]
        sensor = indices[f'{SENSOR_FRAME}_joint']
        self._bodies = [*self._links, indices[f'{TOOL_LINK}_joint']]
        self._read_joints = [*self._links, sensor]
        self._unused = [0.0] * len(self._links)
        self._remove_surprises(sensor)

    def _remove_surprises(self, sensor: int) -> None:
        """Set what the importer changes or adds unasked."""
        client = self.client
        bullet.changeDynamics(
            self.body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client
        )
        joints = [*self._links, sensor, self._bodies[-1]]
        for joint, body in zip(joints, self._arm.bodies, strict=True):
            # A call of its own: beside a damping, the value would go to the base unnoticed.
            bullet.changeDynamics(
                self.body,
                joint,
                localInertiaDiagonal=body.inertia,
                physicsClientId=client,
            )
            bullet.changeDynamics(
                self.body,
                joint,
                jointDamping=0.0,
                maxJointVelocity=MAX_JOINT_SPEED,
                physicsClientId=client,
            )
        # Every joint is born with a motor that holds its speed at zero.
        bullet.setJointMotorControlArray(
            self.body,
            self._links,
            bullet.VELOCITY_CONTROL,
            forces=[0.0] * len(self._links),
            physicsClientId=client,
        )
        bullet.enableJointForceTorqueSensor(
            self.body, sensor, True, physicsClientId=client
        )
