"""An arm of seven joints above a springy floor, without this package: pinocchio alone."""

import numpy as np
import pinocchio as pin

HEIGHT = 0.007  # of the tip above the floor at home [m]
STIFFNESS = 6000.0  # N/m
NOISE = np.array([0.05] * 3 + [0.005] * 3)  # N, N m
SUBSTEPS = 8


class Arm:
    """An arm whose tip meets a floor."""

    def __init__(self, urdf, armature, home):
        self._model = pin.buildModelFromUrdf(str(urdf))
        self._model.armature = np.array(armature)
        self._data = self._model.createData()
        self._tip = self._model.getFrameId('tip')
        self._random = np.random.default_rng(0)
        self.q = np.array(home)
        self.v = np.zeros(self._model.nv)
        self._floor = self.tip.translation[2] - HEIGHT

    @property
    def tip(self):
        pin.framesForwardKinematics(self._model, self._data, self.q)
        return self._data.oMf[self._tip]

    @property
    def weight(self):
        return pin.computeGeneralizedGravity(self._model, self._data, self.q).copy()

    @property
    def force(self):
        """Return what the tip presses with, shape (3,), world axes [N]."""
        depth = max(self._floor - self.tip.translation[2], 0.0)
        return np.array([0.0, 0.0, -STIFFNESS * depth])

    def wrench_sensor(self):
        pressing = self.tip.rotation.T @ self.force
        return np.append(pressing, np.zeros(3)) + NOISE * self._random.normal(size=6)

    def jacobian(self):
        axes = pin.LOCAL_WORLD_ALIGNED
        where = (self._model, self._data, self.q, self._tip)
        return pin.computeFrameJacobian(*where, axes)[:3]

    def step(self, torque, period):
        """Advance by a period."""
        for _ in range(SUBSTEPS):
            load = -self.jacobian().T @ self.force
            a = pin.aba(self._model, self._data, self.q, self.v, torque + load)
            self.v = self.v + a * period / SUBSTEPS
            self.q = self.q + self.v * period / SUBSTEPS
