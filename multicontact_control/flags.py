"""
What a tick finds, one bit each; a kernel returns the sum of what it finds.

See `tick` for the order in which they are found.
"""

# Of the arm that is seen. NO_NUMBERS: its model gives none, and nothing else has changed;
# AMBIGUOUS: the contacts depend on each other, and what they bear is not known; TOUCHED: a
# residual is beyond its threshold; PASSED: none has been for a while, after one was.
NO_NUMBERS, OPERATIONAL_SPEED, JOINT_SPEED, AMBIGUOUS, TOUCHED, PASSED = (
    1 << bit for bit in range(6)
)
# Of the task: the reference is not what is wanted.
REFERENCE = 1 << 6
# Of the law, which has no answer: a singular posture, or columns of N that depend on each other.
SINGULAR, DEPENDENT = 1 << 7, 1 << 8
# Of its answer: no finite numbers; a surface that pulls, a force across the normals, or on a free
# contact; the operational point beyond its box; and that the answer is refused for any of them.
NOT_FINITE, PULL, SIDEWAYS, STRAY, OUTSIDE, REFUSED = (1 << bit for bit in range(9, 15))
# Of the limits that change a torque: it was not finite; a stop or speed of a joint; the torque
# itself; its rate; a singular posture.
REPLACED, JOINT_STOP, TORQUE, TORQUE_RATE, REACH = (1 << bit for bit in range(15, 20))

# After which the law is not asked before it is decided whether it answers at all.
ALARMS = NO_NUMBERS | OPERATIONAL_SPEED | JOINT_SPEED | AMBIGUOUS | TOUCHED
NO_ANSWER = SINGULAR | DEPENDENT | REFUSED
LIMITS = REPLACED | JOINT_STOP | TORQUE | TORQUE_RATE | REACH
BOUNDING_LIMITS = JOINT_STOP | REACH  # of the motion of the arm
LASTING_LIMITS = (
    BOUNDING_LIMITS | TORQUE
)  # that may last: the force laws are told of them
