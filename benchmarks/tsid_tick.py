"""
TSID's tick on samples of ours: a script for the Python in whose environment TSID is.

It imports nothing of this package. Its argument is the file that `bench.py` writes; its last line
is a JSON object.
"""

from __future__ import annotations

import gc
import json
import sys
from time import perf_counter_ns
from typing import Any

import numpy as np
import pinocchio as pin
from tsid import tsid_pywrap as tsid

PERIOD = 0.002  # s
LAPS = 3
FREQUENCY = 30.0  # of the motion tasks, critically damped [rad/s]
FRICTION = 0.3  # of the contacts
FORCE_WANTED, LARGEST_FORCE = 10.0, 100.0  # N
# Weights of the costs: motion before posture, forces near what is wanted.
MOTION, POSTURE, CONTACT, FORCE = 1.0, 1e-3, 1e-1, 1e-3


class Tick:
    """
    TSID's inverse dynamics of a fixed-base arm: one pose, one posture, point contacts.

    The pose wanted is the one at each sample, so that no limit is met which ours does not meet.
    Motion of the contacts is a cost: two points of one rigid tool, both held, are a constraint
    too many. Torque limits and friction cones are constraints.
    """

    def __init__(self, problem: dict[str, Any]) -> None:
        self.robot = tsid.RobotWrapper(str(problem['urdf']), pin.StdVec_StdString(), False)
        self.dynamics = tsid.InverseDynamicsFormulationAccForce('tick', self.robot, False)
        home = problem['q'][0]
        self.dynamics.computeProblemData(0.0, home, np.zeros_like(home))
        self.data = self.dynamics.data()
        self.pose = tsid.TaskSE3Equality('pose', self.robot, str(problem['frame']))
        self.posture = tsid.TaskJointPosture('posture', self.robot)
        self._add_motions(home)
        self.contacts = [  # TSID itself keeps references only
            self._add_contact(str(tip), -normal)
            for tip, normal in zip(problem['tips'], problem['normals'])]
        self.limit = tsid.TaskActuationBounds('torque_limit', self.robot)
        self.limit.setBounds(-problem['torque_limit'], problem['torque_limit'])
        self.dynamics.addActuationTask(self.limit, 1.0, 0, 0.0)
        self.solver = tsid.SolverHQuadProgFast('solver')
        self.solver.resize(self.dynamics.nVar, self.dynamics.nEq, self.dynamics.nIn)
        self.samples = [
            (q, v, self._pose_wanted(q, v, str(problem['frame'])))
            for q, v in zip(problem['q'], problem['qd'])]
        self.unsolved = 0

    def _pose_of(self, frame: str) -> Any:
        return self.robot.framePosition(self.data, self.robot.model().getFrameId(frame))

    def _pose_wanted(self, q: Any, v: Any, frame: str) -> Any:
        self.robot.computeAllTerms(self.data, q, v)
        return tsid.TrajectorySE3Constant('pose_wanted', self._pose_of(frame)).computeNext()

    def _add_motions(self, home: Any) -> None:
        self.posture.setReference(
            tsid.TrajectoryEuclidianConstant('posture_wanted', home).computeNext())
        for task, size, weight in ((self.pose, 6, MOTION), (self.posture, len(home), POSTURE)):
            task.setKp(FREQUENCY ** 2 * np.ones(size))
            task.setKd(2.0 * FREQUENCY * np.ones(size))
            self.dynamics.addMotionTask(task, weight, 1, 0.0)

    def _add_contact(self, frame: str, normal: Any) -> Any:
        contact = tsid.ContactPoint(
            frame, self.robot, frame, normal, FRICTION, 0.0, LARGEST_FORCE)
        contact.setKp(np.zeros(3))
        contact.setKd(2.0 * FREQUENCY * np.ones(3))
        contact.useLocalFrame(False)
        contact.setReference(self._pose_of(frame))
        contact.setForceReference(FORCE_WANTED * normal)
        contact.setRegularizationTaskWeightVector(np.ones(3))
        self.dynamics.addRigidContact(contact, FORCE, CONTACT, 1)
        return contact

    def step(self, time: float, q: Any, v: Any, wanted: Any) -> Any:
        """Return the torque for a sample, None where there is no solution."""
        self.pose.setReference(wanted)
        solution = self.solver.solve(self.dynamics.computeProblemData(time, q, v))
        if solution.status != 0:
            self.unsolved += 1
            return None
        return self.dynamics.getActuatorForces(solution)


def main() -> None:
    """Time a tick on each sample, after one lap to warm up, and print what was found."""
    with np.load(sys.argv[1]) as file:
        tick = Tick(dict(file))
    gc.collect()
    gc.freeze()
    gc.disable()
    for _ in range(1 + LAPS):
        times, tick.unsolved = [], 0
        for k, (q, v, wanted) in enumerate(tick.samples):
            start = perf_counter_ns()
            tick.step(PERIOD * k, q, v, wanted)
            times.append((perf_counter_ns() - start) / 1e3)
    print(json.dumps({'tick_us': times, 'unsolved': tick.unsolved, 'pinocchio': pin.__version__,
                      'variables': tick.dynamics.nVar}))


if __name__ == '__main__':
    main()
