"""
TSID's tick on samples of ours: a script for the Python in whose environment TSID is.

It imports nothing of this package. Its argument is the file that `bench.py` writes; its last line
is a JSON object. The pose wanted is the one at each sample, so that no limit is met which ours
does not meet. Motion of the contacts is a cost: two points of one rigid tool, both held, are a
constraint too many. Torque limits and friction cones are constraints.
"""

import gc
import json
import sys
from time import perf_counter_ns

import numpy as np
import pinocchio as pin
from tsid import tsid_pywrap as tsid

PERIOD = 0.002  # s
LAPS = 4  # over the samples, the first to warm up
FREQUENCY = 30.0  # rad/s, of the motion tasks, critically damped
FRICTION = 0.3  # coefficient of the contacts
FORCE_WANTED = 10.0  # N
LARGEST_FORCE = 100.0  # N
# Weights of the costs: motion before posture, forces near what is wanted.
MOTION_WEIGHT = 1.0
POSTURE_WEIGHT = 1e-3
CONTACT_WEIGHT = 1e-1
FORCE_WEIGHT = 1e-3


def main():
    """Time a tick on each sample."""
    with np.load(sys.argv[1]) as file:
        problem = dict(file)
    robot = tsid.RobotWrapper(str(problem['urdf']), pin.StdVec_StdString(), False)
    dynamics = tsid.InverseDynamicsFormulationAccForce('tick', robot, False)
    home = problem['q'][0]
    frame = str(problem['frame'])
    dynamics.computeProblemData(0.0, home, np.zeros_like(home))
    data = dynamics.data()

    def pose_of(name):
        return robot.framePosition(data, robot.model().getFrameId(name))

    pose = tsid.TaskSE3Equality('pose', robot, frame)
    posture = tsid.TaskJointPosture('posture', robot)
    posture.setReference(
        tsid.TrajectoryEuclidianConstant('posture_wanted', home).computeNext()
    )
    for task, size, weight in (
        (pose, 6, MOTION_WEIGHT),
        (posture, len(home), POSTURE_WEIGHT),
    ):
        task.setKp(FREQUENCY**2 * np.ones(size))
        task.setKd(2.0 * FREQUENCY * np.ones(size))
        dynamics.addMotionTask(task, weight, 1, 0.0)
    contacts = []  # TSID itself keeps references only
    for tip, normal in zip(problem['tips'].tolist(), -problem['normals']):
        contact = tsid.ContactPoint(
            tip, robot, tip, normal, FRICTION, 0.0, LARGEST_FORCE
        )
        contact.setKp(np.zeros(3))
        contact.setKd(2.0 * FREQUENCY * np.ones(3))
        contact.useLocalFrame(False)
        contact.setReference(pose_of(tip))
        contact.setForceReference(FORCE_WANTED * normal)
        contact.setRegularizationTaskWeightVector(np.ones(3))
        dynamics.addRigidContact(contact, FORCE_WEIGHT, CONTACT_WEIGHT, 1)
        contacts.append(contact)
    limit = tsid.TaskActuationBounds('torque_limit', robot)
    limit.setBounds(-problem['torque_limit'], problem['torque_limit'])
    dynamics.addActuationTask(limit, 1.0, 0, 0.0)
    solver = tsid.SolverHQuadProgFast('solver')
    solver.resize(dynamics.nVar, dynamics.nEq, dynamics.nIn)
    samples = []
    for q, v in zip(problem['q'], problem['qd']):
        robot.computeAllTerms(data, q, v)
        wanted = tsid.TrajectorySE3Constant('pose_wanted', pose_of(frame)).computeNext()
        samples.append((q, v, wanted))
    gc.collect()
    gc.freeze()
    gc.disable()
    for _ in range(LAPS):
        times = []
        unsolved = 0
        for k, (q, v, wanted) in enumerate(samples):
            start = perf_counter_ns()
            pose.setReference(wanted)
            solution = solver.solve(dynamics.computeProblemData(PERIOD * k, q, v))
            if solution.status == 0:
                dynamics.getActuatorForces(solution)
            else:
                unsolved += 1
            times.append((perf_counter_ns() - start) / 1e3)
    answer = {
        'tick_us': times,
        'unsolved': unsolved,
        'pinocchio': pin.__version__,
        'variables': dynamics.nVar,
    }
    print(json.dumps(answer))


if __name__ == '__main__':
    main()
