"""
The records that compiled code works on: every field with its shape and unit.

They are handed over as arrays, also of one element: numba takes a lone record ten times slower.
"""

from multicontact_control.config import MAX_DELAY_PERIODS
import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]

F, I, B = np.float64, np.int64, np.bool_

MAX_ORDER = 3  # of an observer's active state
MAX_STATES = 2 + MAX_DELAY_PERIODS + MAX_ORDER  # force, its rate, delayed inputs, active states
MAX_JOINTS = 12  # of an arm
MAX_COLUMNS = 6  # of N: more are always dependent
LIMITS = 8  # points of the curve of what stiffness a force loop is stable up to

# What is set for the control law and for taking the measured wrench apart; one.
LAW = np.dtype([
    ('k_p', F), ('k_v', F),  # position and velocity gain of the motion law [1/s^2], [1/s]
    ('K_2', F),  # damping of the force loops [1/s]
    ('friction_speed', F),  # v_0 of the joints' Coulomb friction [rad/s]
    ('nullspace_damping', F),  # d [1/s]
    ('posture_stiffness', F),  # k_q of the posture in the null space, 0 for none [1/s^2]
    ('stop_stiffness', F),  # k_s by which joints are kept off their stops there [1/s^2]
    ('least_share', F),  # s_0 of what goes beyond the priority, at a torque limit
    ('singular_mobility', F),  # eigenvalue up to which Lambda^-1 is damped, 0 for none [1/kg]
    ('inertia_metric', B),  # whether motion is kept off the contacts in the metric of Lambda
    ('decoupled', B),  # whether the contact points are driven, or the coordinates along N_i
    ('separated', B),  # whether friction is expected or allowed for in the measured wrench
    ('force_noise', F), ('torque_noise', F),  # of the wrist sensor, per axis [N], [N m]
    ('period', F),  # h [s]
], align=True)

# What the residual of a joint has followed: `REGRESSORS` of `control.arm`; sums fade within 1 s.
EVIDENCE = np.dtype([
    ('regressor', F, 4), ('square', F, 4),  # the newest, and the sum of their squares
    ('product', F, 4),  # sum of each times what the residual is beyond `at_rest`
    ('power', F),  # sum of the squares of that [N^2 m^2]
    ('at_rest', F), ('rested', F),  # its mean at rest in the first 0.2 s [N m], and of those [s]
    ('friction', F), ('moved', F),  # mean along the first 0.5 s of motion [N m], and of those [s]
    ('mean_square', F),  # along them [N^2 m^2]
    ('area', F),  # integral of the same since the arm was calm last [N m s]
    ('felt_before', F),  # J_i^T f when it was [N m]
], align=True)

# One joint: where it is, its terms of the arm's model, what is set for it, and its torque.
JOINT = np.dtype([
    ('q', F),  # position [rad]
    ('velocity', F),  # [rad/s]
    ('inertia', F),  # diagonal element of M [kg m^2]
    ('bias_torque', F),  # element of C v + g [N m]
    ('coulomb', F), ('viscous', F),  # friction to compensate [N m], [N m s/rad]
    ('lower', F), ('upper', F),  # stops [rad]
    ('posture', F),  # q_0, where the null space takes it [rad]
    ('torque_limit', F),  # of the command [N m]
    ('added', F),  # to the command by the drives themselves, 0 if they add nothing [N m]
    ('speed_limit', F),  # beyond which it is too fast [rad/s]
    ('torque', F),  # Gamma, what the law answers [N m]
    ('unlimited', F),  # the same before it is brought within its limits [N m]
    ('priority', F),  # of that, what goes before the rest at a limit: see `finish_torque` [N m]
    ('effort', F),  # torque that acted since the sample before [N m]
    ('effort_fault', I),  # why that is not measured; see `supervision.inputs`
    ('unwatched', B),  # whether it is not known, neither measured nor commanded
    ('last_velocity', F), ('last_bias', F),  # of that sample [rad/s], [N m]
    ('residual', F),  # of the torques: what neither model nor wrist sensor explains [N m]
    ('doubt', F),  # by how much the effort may be another [N m]
    ('threshold', F),  # of the residual, from which on it counts, at rest [N m]
    ('least_threshold', F),  # the same without friction [N m]
    ('allowance', F), ('learnt_limit', F),  # friction in it, at least and at most [N m]
    ('evidence', EVIDENCE),
    ('slack', F),  # added to that, as the arm accelerates or the effort is in doubt [N m]
], align=True)

# The operational frame and the wrist sensor's, world axes; one.
FRAME = np.dtype([
    ('position', F, 3),  # operational point [m]
    ('rotation', F, (3, 3)),  # axes of the operational frame as columns
    ('twist', F, 6),  # theta = J v [m/s, rad/s]
    ('sensor_position', F, 3),  # [m]
    ('sensor_rotation', F, (3, 3)),  # axes of the sensor as columns
    ('speed_limit', F), ('turn_limit', F),  # beyond which it is too fast [m/s], [rad/s]
    ('mobility', F),  # smallest eigenvalue of Lambda^-1 where the law was asked last [1/kg]
], align=True)

# What hangs on the wrist sensor; one.
TOOL = np.dtype([
    ('com_sensor', F, 3),  # centre of mass in the sensor frame [m]
    ('weight', F, 3),  # m g, world axes [N]
    ('bias', F, 6),  # the sensor's reading under no load, in its frame [N, N m]
    ('mass', F),  # m [kg]
], align=True)

# The generalised-momentum observer; one.
MOMENTUM = np.dtype([
    ('bandwidth', F),  # K [1/s], 0 for none
    ('dynamic_share', F),  # of what accelerates the arm, added to the thresholds
    ('elapsed', F),  # since the sample before; 0 if it is not known what acted since then [s]
    ('com_velocity', F, 3),  # of what hangs on the sensor, at the sample before [m/s]
    ('collided', B),  # whether a residual is beyond its threshold
    ('calm', F),  # for how long all of them have been small [s]
    ('touched', B),  # whether one has been beyond it since they were
    ('is_input', B),  # whether the residual is the wrench of the contacts: there is no sensor
], align=True)

# What the motion law is asked for, world axes; one.
TASK = np.dtype([
    ('position', F, 3),  # x_des [m]
    ('rotation', F, (3, 3)),  # desired axes of the operational frame as columns
    ('twist', F, 6),  # theta_des [m/s, rad/s]
    ('acceleration', F, 6),  # a_des [m/s^2, rad/s^2]
], align=True)

# All that the control law works on besides joints, contacts and observers; one.
CONTROL = np.dtype([
    ('law', LAW), ('frame', FRAME), ('tool', TOOL), ('task', TASK), ('momentum', MOMENTUM),
    ('wrench', F, 6),  # what the wrist sensor reads, in its frame [N, N m]
    ('measured', B),  # whether that is of this sample; if not, observers only predict
], align=True)

# What the force law answers for one contact, all 0 where no law controls it.
FORCE_ANSWER = np.dtype([
    ('active', B),  # whether its force is controlled
    ('alpha_des', F),  # desired force [N]
    ('alpha_fed', F),  # force fed forward [N]
    ('alpha_est', F), ('alpha_rate_est', F),  # estimated force and its rate [N], [N/s]
    ('innovation', F),  # alpha_meas - C x_1, 0 where nothing was predicted [N]
    ('prior_variance', F),  # C P_1 C^T, 0 there as well [N^2]
    ('variance_used', F),  # R the observer worked with, 0 there as well [N^2]
], align=True)

# What is configured of one column of N: the normal force of a contact, or one of its couples.
CONTACT_CONFIG = np.dtype([
    ('kind', I),  # FORCE, ALONG or ACROSS, see `config.contact`
    ('leader', I),  # index of the normal force of the same contact
    ('normal', F, 3),  # unit normal INTO the surface, world axes; 0 for couples
    ('point', F, 3),  # contact point, or centre, in the operational frame [m]
    ('direction', F, 3),  # of an edge, or of a plane's first side, in the operational frame
    ('half_length', F),  # unit of a couple's lever, 0 for a force [m]
    ('friction_std', F),  # of friction that is allowed for, 0 for couples [N]
    ('torsion_std', F),  # of its torque about the normal [N m]
    ('friction_coefficient', F),  # that is expected while sliding, 0 for couples
    ('normal_gain', F),  # share of the way that the estimated normal goes per period
    ('turn_limit', F),  # how far it goes per period at most, 0 where it is not estimated [rad]
    ('smallest_cosine', F),  # of the angle between it and the one configured
    ('surface_speed', F),  # of the surface along its normal [m/s]
    ('surface_gain', F),  # share of the way that its estimate goes per period
    ('surface_speed_limit', F),  # bound of that, 0 where it is not estimated [m/s]
], align=True)

# One column of N, couples in newtons: what is configured, measured and learnt, and answered.
CONTACT = np.dtype([
    ('config', CONTACT_CONFIG),
    ('N', F, 6),  # column of N: the wrench of a unit force, world axes
    ('alpha_meas', F),  # measured force, without `untared` [N]
    ('untared', F),  # what was read in free space, before a touch [N]
    ('speed_bound', F),  # into a surface that has not answered, 0 for none [m/s]
    ('borne', F),  # what such a surface was found to bear, as an acceleration [m/s^2]
    ('noise_variance', F),  # R_k [N^2]
    ('guarded', B),  # whether the measured force is fed forward, as the surface seems to be gone
    ('normal', F, 3),  # estimated unit normal, world axes
    ('surface_speed_est', F),  # what is added to the configured speed, estimated [m/s]
    ('friction', F, 3),  # found, world axes [N]
    ('stiffness', F),  # k of the model in use [N/m]
    ('mobility', F),  # N^T Lambda^-1 N of the newest answer, 0 before the first [1/kg]
    ('stiffness_est', F), ('stiffness_std', F),  # estimate of k, 0 for none; its error [N/m]
    ('ratio_bound', F),  # largest likely true stiffness over that of the model in use
    ('margin', F),  # largest ratio at which the force loop is stable, over that one
    ('answer', FORCE_ANSWER),
], align=True)

# The active observer of one contact. The first `states` rows and columns of matrices are used.
OBSERVER = np.dtype([
    ('states', I), ('order', I),  # n, and how many of them are active states
    ('Phi_c', F, (MAX_STATES, MAX_STATES)),  # transition of the closed loop
    ('Phi_n', F, (MAX_STATES, MAX_STATES)),  # transition of the open loop
    ('Gamma', F, MAX_STATES),  # input vector
    ('feedback', F, MAX_STATES),  # [L_r 1]
    ('Q', F, MAX_STATES),  # diagonal of the process noise's covariance
    ('P_0', F),  # initial variance of every state
    ('running', B),  # whether there was a sample before
    ('command', F),  # r = L_1 f_des of the sample before [m/s^2]
    ('damping_time', F),  # c / k of the surface, which the force reads with its rate [s]
    ('x_est', F, MAX_STATES),  # state estimate; the first is the force [N], then its rate [N/s]
    ('P', F, (MAX_STATES, MAX_STATES)),  # its covariance
    ('x_1', F, MAX_STATES),  # prediction of the state
], align=True)

# A linear force law, from alpha_meas, alpha_des and the contact's speed to u, alpha_est and p_est.
LINEAR_LAW = np.dtype([
    ('states', I),  # n
    ('A', F, (MAX_STATES, MAX_STATES)), ('B', F, (MAX_STATES, 3)),  # x_(k+1) = A x_k + B y_k
    ('C', F, (3, MAX_STATES)), ('D', F, (3, 3)),  # outputs = C x_k + D y_k
    ('E', F, MAX_STATES),  # added to x_(k+1) for 1 m/s^2 that acts beyond the answer
    ('start_force', F, MAX_STATES),  # state at touch, for 1 N that is felt
    ('start_disturbance', F, MAX_STATES),  # and for a known disturbance of 1 m/s^2
    ('extra', F),  # acceleration that acted beyond the answer of the sample before [m/s^2]
    ('running', B),  # whether there was a sample before
    ('x', F, MAX_STATES),  # state
    ('alpha', F),  # estimated force [N]
    ('p_est', F),  # disturbance that the law compensates [m/s^2]
], align=True)

# One frequency band of a stiffness estimator: filters of alpha, z, v and w, and sums over samples.
STIFFNESS_FIT = np.dtype([
    ('high', F), ('low', F),  # gains of the high-pass and of the three low-passes, per sample
    ('keep', F),  # by which the sums shrink with each accepted sample
    ('stages', F, (4, 4)),  # of z, v, w and alpha: the high-pass's memory, three low-passes
    ('speed', F),  # filtered v of the sample before [m/s]
    ('sums', F, (4, 4)),  # of the products of z, v, w and y; its upper triangle
    ('weight', F),  # of the samples in these sums
    ('k', F), ('c', F), ('mu', F),  # what fits them best [N/m], [N s/m], [-]
    ('k_std', F),  # standard error of k [N/m]
    ('share', F),  # r^2, of the variance of y that is explained
], align=True)

# The on-line stiffness of one contact.
STIFFNESS = np.dtype([
    ('adaptive', B),  # whether the observer follows it
    ('share', F),  # of a couple: its stiffness over that of its contact's normal force
    ('period', F),  # h [s]
    ('lowest', F), ('highest', F),  # k stays within [N/m]
    ('tool_mass', F),  # beyond the sensor [kg]
    ('fastest_pole', F), ('pole_ratio', F),  # 1 / tau [1/s], and of the second pole to it
    ('transition', F, 2),  # of the undelayed plant: of speed to force over k [s], and of speed
    ('ratio_limit', F, LIMITS),  # k over a model's at which the loop is stable, `lowest` on
    ('delay_gain', F, (MAX_STATES, 2)),  # E_j, what inputs under way add to the state, per k
    ('input_gain', F, 2),  # B of the undelayed plant, per k
    ('slow', STIFFNESS_FIT), ('fast', STIFFNESS_FIT),
    ('k', F), ('c', F),  # of the model in use [N/m], [N s/m]
    ('k_est', F), ('k_std', F),  # estimate and its standard error; 0 for none [N/m]
    ('alpha_ref', F),  # desired force as it is followed [N]
    ('alpha_des', F),  # of the sample before [N]
    ('since', F),  # a touch or a step [s]
    ('depth', F), ('speed', F),  # of the contact point since the touch [m], and now [m/s]
    ('felt', B),  # whether a surface is
], align=True)

# The force law of one contact, of which one part is at work.
FORCE_LAW = np.dtype([
    ('kind', I),  # number of the law in the registry, see `force.laws`
    ('is_linear', B),  # whether `linear` is at work, or `observer`
    ('fed', I),  # what is fed forward, see `force.force_law`
    ('observer', OBSERVER), ('linear', LINEAR_LAW), ('stiffness', STIFFNESS),
], align=True)

# What is set for an estimator over a window (P04 eqs 42-44); one.
NOISE_WINDOW = np.dtype([
    ('pole', F), ('zero', F), ('gain', F),  # a, c and b of the filter
    ('scale', F),  # of the variances
    ('count', I),  # samples so far
], align=True)

# What the filter of one contact remembers of the sample before.
FILTER_STATE = np.dtype([('alpha', F), ('filtered', F)])  # [N]

# The supervised state of one contact.
CONTACT_STATE = np.dtype([
    ('state', I),  # see `supervision.contacts`
    ('losses', I),  # how often it was lost since it was first wanted
    ('left', B),  # whether it is to be left, or was, for its force or for where it leads
    ('again', B),  # whether it is to be sought although it was given up
    ('wanted', B),  # whether the task asks for it
    ('asked', F),  # force the task asks for [N]
    ('asked_for', F),  # since when it is the same [s]
    ('displacement', F),  # of the reference along the normal, relative to the task [m]
    ('speed', F), ('acceleration', F),  # of that displacement [m/s], [m/s^2]
    ('force_limit', F),  # upper limit of the desired force [N]
    ('in_state', F),  # since when in this state [s]
    ('below', F),  # for how long less is felt than by one that holds; < 0 if thrown back [s]
    ('shaken', F),  # until it may be thrown back again without being lost [s]
    ('level', F),  # force it is held with, averaged [N]
    ('origin', F),  # displacement at which the surface is, NaN if it was never met [m]
    ('start', F),  # displacement at which the search began [m]
    ('fall', F),  # by which a surface may be lower where the tip has slid to since a loss [m]
    ('target', F),  # displacement to go to [m]
    ('stiffness', F),  # modelled, of the surface [N/m]
    ('surface_speed', F),  # along the normal, as far as it is known [m/s]
    ('approach_speed', F),  # largest one towards a surface that is not felt [m/s]
    ('averaged', F),  # samples in `baseline`, up to as many as are averaged
    ('baseline', F),  # what is read without a touch [N]
    ('untared', F),  # of that, what is taken off the measured force [N]
    ('free_way', F),  # of the search, on which nothing was felt [m]
    ('free_baseline', F),  # `baseline` at its end [N]
    ('answered', B),  # whether a force has risen with the way into the surface
    ('resumed', B),  # whether it was pressed before a pause, and has not answered since
    ('resting', F),  # force that the tip is said to rest on before a search, 0 if not [N]
    ('last_speed', F),  # of the tip along the normal, at the sample before [m/s]
    ('seen', F),  # for how long a force is seen that has not answered [s]
    ('felt', F),  # that force without the tool's inertia, smoothed [N]
    ('read', F), ('least_read', F),  # the same with it, and its minimum [N]
    ('unanswered', F),  # for how long clearly more than that is asked for [s]
    ('least', F), ('least_place', F),  # minimum of `felt`, and where the tip was then [N], [m]
    ('touch_place', F), ('flat_place', F),  # of the touch, and of the last force near that [m]
    ('calm', F),  # until it has more than the preload, of one that has answered late [s]
], align=True)

# What is set for all contacts: `ContactStateConfig`, h, times of at least some periods, and the
# mass whose inertia the wrench has in it [kg]; one.
CONTACT_SETTINGS = np.dtype([(name, F) for name in (
    'period', 'loss_time', 'bounce_time', 'approach_speed', 'approach_ramp_time',
    'approach_distance', 'contact_threshold', 'release_threshold', 'preload', 'force_ceiling',
    'retry_time', 'settling_time', 'tool_mass')])

# Bounds of a task, and the reference that follows it; one.
TASK_LIMITS = np.dtype([
    ('contacts', CONTACT_SETTINGS),
    ('lead', F),  # k_v / k_p: an error of v k_v / k_p makes the motion law move at v [s]
    ('reach', F), ('turn', F),  # greatest way and angle of the reference from the arm [m], [rad]
    ('ramp', F), ('turn_ramp', F),  # largest accelerations of the reference [m/s^2], [rad/s^2]
    ('box', F, (2, 3)),  # lower and upper corner of the workspace [m]
    ('bounded', B),  # whether stops, speeds or the reach of the arm have just bound its motion
    ('behind', B),  # whether the reference has still to catch up with the task
    ('position', F, 3), ('rotation', F, (3, 3)),  # the reference, before contacts move it [m]
    ('twist', F, 6),  # its velocity while it catches up [m/s, rad/s]
    ('reads_before', B),  # whether something is read that no touch explains
    ('ahead', F, 3), ('turned_ahead', F, 3),  # of the arm, a tick ago, off normals [m], [rad]
], align=True)

# What an answer of the law must be like; one.
PLAUSIBILITY = np.dtype([
    ('inertia', F),  # what a lost contact may read more: the tool's inertia [N]
    ('friction_bound', F),  # force across the normals, per force along them
    ('force_ceiling', F),  # along them, of contacts that are not commanded [N]
    ('box', F, (2, 3)),  # where the operational point may be [m]
])

# Limits of one joint at the last gate.
JOINT_LIMITS = np.dtype([
    ('step', F),  # of the torque, per period [N m]
    ('lower', F), ('upper', F),  # positions at which it comes to rest [rad]
    ('speed', F),  # [rad/s]
    ('last', F),  # what was commanded last and what was added [N m]
])

# What has come in at a tick, as Python writes it; one. What of it is valid, and where it goes, is
# in `supervision.inputs`.
INPUT = np.dtype([
    ('time', F),  # of the tick, NaN if it is not a number [s]
    # Whether what is asked for is there and has the right shape: FINE, ABSENT or INVALID, of
    # `supervision.inputs`. Joint states may come without velocities and without efforts.
    ('joints_came', I), ('velocity_came', I), ('effort_came', I),
    ('wrench_came', I), ('variance_came', I),
    ('command_came', B),  # whether there is one of the tick before
    ('joints_stamp', F), ('wrench_stamp', F), ('variance_stamp', F),  # when it was sampled [s]
    ('q', F, MAX_JOINTS), ('velocity', F, MAX_JOINTS),  # [rad], [rad/s]
    ('effort', F, MAX_JOINTS),  # torques measured over the period before [N m]
    ('command', F, MAX_JOINTS),  # torques commanded at the tick before [N m]
    ('wrench', F, 6),  # what the wrist sensor reads, in its frame [N, N m]
    ('variance', F, MAX_COLUMNS),  # R of each column of N [N^2]
], align=True)
