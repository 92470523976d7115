"""An arm of seven joints and a wall, without this package: pinocchio alone."""

import numpy as np
import pinocchio as pin


class Arm:
    """An arm whose wrist, or another link, meets a springy wall."""

    def __init__(
        self,
        urdf,
        armature,
        normal,
        distance,
        stiffness,
        home=(0.3, 0.7, -0.4, 0.9, 0.5, -0.8, 0.6),
        tip='wrist',
    ):
        self._model = pin.buildModelFromUrdf(str(urdf))
        self._model.armature = np.array(armature)
        self._data = self._model.createData()
        self._wrist = self._model.getFrameId(tip)
        self._random = np.random.default_rng(0)
        self._normal = np.array(normal)
        self._stiffness = stiffness
        self.q = np.array(home)
        self.v = np.zeros(7)
        self._wall = self._normal @ self.wrist.translation + distance

    @property
    def wrist(self):
        pin.framesForwardKinematics(self._model, self._data, self.q)
        return self._data.oMf[self._wrist]

    @property
    def weight(self):
        return pin.computeGeneralizedGravity(self._model, self._data, self.q).copy()

    @property
    def force(self):
        """Return what the wrist presses with, 0 beside the wall [N]."""
        depth = self._normal @ self.wrist.translation - self._wall
        return self._stiffness * max(depth, 0.0)

    def wrench_sensor(self):
        pressing = self.wrist.rotation.T @ (self.force * self._normal)
        noise = self._random.normal(size=6) * ([0.05] * 3 + [0.005] * 3)
        return np.concatenate([pressing, np.zeros(3)]) + noise

    def jacobian(self):
        axes = pin.LOCAL_WORLD_ALIGNED
        where = (self._model, self._data, self.q, self._wrist)
        return pin.computeFrameJacobian(*where, axes)[:3]

    def step(self, torque, period, substeps=8):
        """Advance by a period."""
        for _ in range(substeps):
            load = self.jacobian().T @ (-self.force * self._normal)
            a = pin.aba(self._model, self._data, self.q, self.v, torque + load)
            self.v = self.v + a * period / substeps
            self.q = self.q + self.v * period / substeps
