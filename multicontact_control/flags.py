"""
What a tick finds, one bit each; a kernel returns the sum of what it finds.

The bits are grouped by the part that finds them; their order has no effect. Which cause is said
first is in `supervision.causes`. Compiled code reads the bits as
plain integers.
"""

# The arm (`control.arm`): its model gives numbers that are not finite, and no record has changed;
# a speed is beyond its alarm; the columns of N depend on each other, so that the contacts' forces
# are unknown; a residual is beyond its threshold; all are small again after one was beyond it.
MODEL_NOT_FINITE = 1 << 0
OPERATIONAL_SPEED = 1 << 1
JOINT_SPEED = 1 << 2
FORCES_AMBIGUOUS = 1 << 3
RESIDUAL_EXCEEDED = 1 << 4
RESIDUAL_CLEARED = 1 << 5

# The task (`supervision.contact_task`): the reference differs from what is wanted.
REFERENCE_LIMITED = 1 << 6

# The law (`control.law`) has no answer: a singular posture, or dependent columns of N.
POSTURE_SINGULAR = 1 << 7
COLUMNS_DEPENDENT = 1 << 8

# The answer (`supervision.checks`): numbers that are not finite, a surface that pulls, a force
# across the normals, a force on a free contact, the operational point beyond its box; and whether
# the answer is refused for any of them.
ANSWER_NOT_FINITE = 1 << 9
SURFACE_PULLS = 1 << 10
FORCE_SIDEWAYS = 1 << 11
FORCE_STRAY = 1 << 12
OUTSIDE_WORKSPACE = 1 << 13
ANSWER_REFUSED = 1 << 14

# The gate (`supervision.gate`) has changed the torque: it was not finite, led beyond a stop or
# speed of a joint, was beyond its own limit or changed too fast, or led to a singular posture.
TORQUE_REPLACED = 1 << 15
JOINT_BOUNDED = 1 << 16
TORQUE_LIMITED = 1 << 17
TORQUE_RATE_LIMITED = 1 << 18
SINGULARITY_BOUNDED = 1 << 19

# There is no answer of the law: for one of these, or as the arm or its contacts are not known.
NO_ANSWER = 1 << 20

BOUNDING_LIMITS = JOINT_BOUNDED | SINGULARITY_BOUNDED  # of the motion of the arm
LASTING_LIMITS = BOUNDING_LIMITS | TORQUE_LIMITED  # of which the force laws are told
LIMITS = LASTING_LIMITS | TORQUE_REPLACED | TORQUE_RATE_LIMITED
