"""
What an answer of the control law is checked for; which residual is a collision, and of what.

Causes of the checks, as those of the inputs in `inputs`, are named `<part>_<what>`: `motion`
(`operational_speed`, `joint_speed`), `wrench` (`pull`, `sideways`, `stray`), `law` (`not_finite`,
or the error it raises), `collision` (the joint that it loads last), `start` (`outside`) and
`internal` (an error of the supervision itself).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product
from typing import Any

from multicontact_control.algebra import add_scaled, length
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control import arm
from multicontact_control.control.arm import DIRECTION, WRENCH
from multicontact_control.control.controller import Controller
from multicontact_control.flags import (
    JOINT_SPEED,
    NOT_FINITE,
    OPERATIONAL_SPEED,
    OUTSIDE,
    PULL,
    REFUSED,
    SIDEWAYS,
    STRAY,
)
from multicontact_control.records import B, F, I, Records
from multicontact_control.supervision.contacts import FREE, LOST
from multicontact_control.supervision.reactions import NONE, SEVERITY
import numpy as np

WRONG_WRENCH = {PULL: 'wrench_pull', STRAY: 'wrench_stray', SIDEWAYS: 'wrench_sideways'}
CONTRADICTING = PULL | STRAY | SIDEWAYS
CONTRADICTIONS = 2  # samples in a row that contradict the contacts, for the wrench to be refused
COLLISION, CONTRADICTED = 'collision', 'joints_velocity'
TOO_FAST = {OPERATIONAL_SPEED: 'motion_operational_speed', JOINT_SPEED: 'motion_joint_speed'}

PULL_LIMIT = 4.0  # N, measured pull of a surface that is accepted
READ_PULL_LIMIT = 8.0  # N, pull that is read and accepted with what is taken off as no force
LOSS_ACCELERATION = 20.0  # m/s^2, of a tool that is braked after a contact is lost
SIDEWAYS_LIMIT = 5.0  # N of sideways force that is always accepted
SPEED_EXCESS = 1.1  # times a speed limit, beyond which gate and reference have failed
BOX_EXCESS = 0.01  # m beyond the workspace, where the reference has failed
# The smallest threshold [N m], and the largest share of the limit that friction adds to it.
LEAST_THRESHOLD, LEARNT_SHARE = 1.0, 0.1
EXPLAINED = 0.7  # share of the residual's power, from which on what it follows is its cause
MULTIPLE = 0.95  # the same over the joints at rest, from which on it is a multiple of gravity
# Of gravity that is another than configured: the least mass that tells it [kg], m/s^2 by which it
# leans, cosine of the angle between two leans, share of its strength, and smallest singular value
# that counts over the largest.
SMALLEST_MASS, SMALLEST_LEAN, SAME_SIDE, SAME_STRENGTH, SMALLEST_SHARE = 0.2, 0.5, 0.9, 0.05, 0.03
# Of a wrench that comes late: how much of what passed is alike over the joints, the least change
# of J^T f over a threshold, and the least lag [s].
LAG_LIKENESS, LAG_CHANGE, LEAST_LAG = 0.95, 0.2, 0.01
# Of a sensor whose axes are others: the least force that tells it [N], how far off what is read
# may be from what the torques show in other axes, and must be in its own, over its size.
AXES_FORCE, AXES_LIKE, AXES_UNLIKE = 3.0, 0.2, 0.5
# Every exchange of axes, each of them in either direction, shape (48, 3, 3).
EXCHANGES = np.array([np.diag(signs)[:, order] for order in map(list, permutations(range(3)))
                      for signs in product((1.0, -1.0), repeat=3)])
EXCHANGED = (EXCHANGES != np.eye(3)).any(axis=2).sum(axis=1)  # how many axes are others in each
# What to say of a residual that follows each of `REGRESSORS`.
FOLLOWED = (
    'follows the sign of the speed: {} N m of friction that friction.coulomb does not declare',
    'is {} N m s/rad times the speed: check friction.viscous and the scale of the velocities',
    'is {} kg m^2 times the acceleration: check robot.armature and the scale of the effort',
    'follows the wrench, of which the torques show {} times: check its sign, unit and frame '
    '(robot.sensor_frame), and the scale of the effort')

# What an answer of the law must be like; one.
PLAUSIBILITY = np.dtype([
    ('inertia', F),  # what a lost contact may read more: the tool's inertia [N]
    ('friction_bound', F),  # force across the normals, per force along them
    ('force_ceiling', F),  # along them, of contacts that are not commanded [N]
    ('box', F, (2, 3)),  # where the operational point may be [m]
], align=True)

# How answers have been judged; one.
JUDGEMENT = np.dtype([
    ('plausibility', PLAUSIBILITY),
    ('refuses', B),  # whether a wrench that contradicts the contacts is refused
    ('resumes', B),  # whether the law has not been in control, so that one sample is enough
    ('contradictions', I),  # in a row
    ('wrench', F, 6),  # at the operational point, less what the contacts explain [N, N m]
], align=True)


def reaction_to(causes: tuple[str, ...], config: ControllerConfig) -> str:
    """Return the severest reaction that causes call for, each by its name or its part's."""
    to = {
        'joints': 'float', CONTRADICTED: 'hold', 'wrench': 'hold', 'variance': 'inflate',
        'clock': 'hold', 'motion': 'hold', 'law': 'hold', 'start': 'hold',
        COLLISION: config.collision.reaction}
    called_for = [to.get(cause, to[cause.split('_')[0]]) for cause in causes]
    return max(called_for, key=SEVERITY.index, default=NONE)


@compiled
def check_plausibility(
    bounds: Any, control: Any, joints: Any, contacts: Any, states: Any, wrench: Vector,
) -> int:
    """
    Check the answer of the control law that is in the joints.

    `wrench`, shape (6,), is overwritten. Returns the sum of NOT_FINITE, PULL (a surface pulls,
    beyond what was read before; after the loss of a contact the inertia of the tool that is braked
    is allowed for), SIDEWAYS (more than friction can explain), STRAY (a contact that is free is
    beyond the force ceiling) and OUTSIDE (the operational point is out of its box).
    """
    flags, pressed, sideways = 0, 0.0, wrench[:3]
    for j in range(joints.shape[0]):
        if not np.isfinite(joints[j].torque):
            flags = NOT_FINITE
    operational_wrench(control, wrench)
    for i in range(contacts.shape[0]):
        contact, answer = contacts[i], contacts[i].answer
        if not np.isfinite(
                contact.alpha_meas + answer.alpha_des + answer.alpha_est + answer.alpha_rate_est
                + answer.innovation + answer.prior_variance + answer.variance_used):
            flags |= NOT_FINITE
        if contact.config.leader != i:
            continue
        pressed += abs(contact.alpha_meas)
        add_scaled(sideways, -(contact.alpha_meas + contact.untared), contact.normal)
        allowance = known = 0.0
        if states[i].state == LOST:
            allowance = bounds.inertia
        if states[i].state == FREE:  # what it is read with is what its search begins with
            known = min(states[i].baseline, 0.0)
        if contact.alpha_meas - known < -(PULL_LIMIT + allowance) or (
                contact.alpha_meas + contact.untared < -(READ_PULL_LIMIT + allowance)):
            flags |= PULL
        if contact.alpha_meas > bounds.force_ceiling and states[i].state == FREE:
            flags |= STRAY
    if length(sideways) > SIDEWAYS_LIMIT + bounds.friction_bound * pressed:
        flags |= SIDEWAYS
    place, box = control.frame.position, bounds.box
    for k in range(3):
        if place[k] < box[0, k] or place[k] > box[1, k]:
            flags |= OUTSIDE
    return flags


@compiled
def judge_answer(judgement: Any, control: Any, joints: Any, contacts: Any, states: Any) -> int:
    """
    Judge the answer of the control law that is in the joints; see `check_plausibility`.

    REFUSED is added to what that returns if the answer is not to be commanded: it is not finite,
    or contradicts the contacts for the second time in a row. What leads out of the box are the
    contacts that are pressed: they are left.
    """
    doubts = check_plausibility(judgement.plausibility, control, joints, contacts, states,
                                judgement.wrench)
    if doubts & NOT_FINITE:
        return doubts | REFUSED
    contradicts = judgement.refuses and doubts & CONTRADICTING
    judgement.contradictions = judgement.contradictions + 1 if contradicts else 0
    if contradicts and (
            judgement.contradictions >= CONTRADICTIONS or judgement.resumes):
        return doubts | REFUSED
    if doubts & OUTSIDE:
        for i in range(contacts.shape[0]):
            states[i].left = states[i].left or contacts[i].answer.active
    return doubts


def cause_to_refuse(found: int) -> str:
    """Return the cause by which an answer is refused."""
    if found & NOT_FINITE:
        return 'law_not_finite'
    return next(cause for flag, cause in WRONG_WRENCH.items() if found & flag)


def plausibility_limits(config: ControllerConfig) -> Records:
    """Return what an answer must be like as one record of `PLAUSIBILITY`."""
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    bounds['friction_bound'] = config.watchdog.friction_bound
    bounds['force_ceiling'] = config.contact_state.force_ceiling
    bounds['inertia'] = config.tool.mass * LOSS_ACCELERATION
    limits = config.limits
    bounds['box'] = (np.array(limits.workspace_lower or [-np.inf] * 3) - BOX_EXCESS,
                     np.array(limits.workspace_upper or [np.inf] * 3) + BOX_EXCESS)
    return bounds


def watch_arm(config: ControllerConfig, controller: Controller) -> None:
    """Set the speeds beyond which an arm is too fast, and the residuals that are a collision."""
    limits, collision, joints = config.limits, config.collision, controller.arm.joints
    momentum, frame = controller.controls['momentum'], controller.controls['frame']
    joints['speed_limit'] = SPEED_EXCESS * np.array(limits.joint_speed or np.inf)
    frame['speed_limit'] = SPEED_EXCESS * limits.operational_speed
    frame['turn_limit'] = SPEED_EXCESS * limits.operational_turn
    joints['evidence'] = joints['allowance'] = joints['learnt_limit'] = 0
    least = np.inf if config.wrench_input == 'momentum' else np.array(collision.threshold)
    if not np.size(least):
        limit = np.array(config.torque_limit or controller.robot.torque_limit)
        least = np.maximum(collision.limit_share * limit, LEAST_THRESHOLD)
        joints['allowance'] = collision.friction_share * np.array(config.friction.coulomb or 0.0)
        joints['learnt_limit'] = LEARNT_SHARE * limit
    joints['least_threshold'], joints['threshold'] = least, least + joints['allowance']
    momentum['bandwidth'] = config.momentum_bandwidth
    momentum['dynamic_share'] = collision.dynamic_share


@np.errstate(all='ignore')  # of impossible efforts
def explain_collision(joints: Any, momentum: Any, names: Sequence[str]) -> str:
    """Return what speaks for which cause of a collision, from the records of the observer."""
    residual = joints['residual']
    shares = np.abs(residual) / (joints['threshold'] + joints['slack'])
    worst = int(np.argmax(shares))
    name, evidence = names[worst], joints['evidence'][worst]
    loaded = [joint for joint, share in zip(names, shares) if share > arm.RELEASE] or [name]
    if evidence['rested'] < 0.5 * arm.REST_TIME or evidence['at_rest'] / residual[worst] > 0.5:
        settled = 1.0 - np.exp(-momentum['bandwidth'] * evidence['rested'])
        return (f'{name}: the residual is there from the first sample on'
                + _explain_rest(residual / settled, joints['bias_torque'], len(loaded)))
    squares = np.maximum(evidence['square'], np.finfo(float).tiny)
    share, slope = evidence['product'] ** 2 / squares, evidence['product'] / squares
    share[:WRENCH][slope[:WRENCH] < 0.0] = 0.0  # what pushes a joint moves it that way, too
    best = int(np.argmax(share))
    if share[best] > EXPLAINED * evidence['power']:
        factor = f'{slope[best] + (best == WRENCH):.2g}' if best != DIRECTION else (
            f'at least {max(abs(residual[worst]), evidence["friction"]):.2g}')
        return f'{name}: the residual {FOLLOWED[best].format(factor)}'
    return (f'the residual grew in {", ".join(loaded)}: something touches the arm at or before '
            f'the link that {loaded[-1]} moves; if not, check robot.armature and the effort of '
            f'{name}, the frame of the wrench, and that no other node commands the arm')


def _explain_rest(residual: Any, gravity: Any, loaded: int) -> str:
    product, square = residual @ gravity, gravity @ gravity
    factor = product / square
    if product ** 2 > MULTIPLE * square * (residual @ residual) and (
            abs(factor + 1.0) < 0.2 or abs(factor) > 1.5):
        return (f', {factor:.2g} times the torque of gravity: check unit and sign of the effort, '
                'and whether it lacks gravity (robot.adds_gravity)')
    if loaded == 1:
        return ', in this joint alone: check scale, sign and offset of its effort'
    return (': check the masses of tool and links, sign and offset of the wrench, the offsets of '
            'the effort, and that no other node commands the arm')


@np.errstate(all='ignore')  # of impossible efforts
def explain_gravity(
    joints: Any, shares: Matrix, force_world: Vector, mass: float, gravity_world: Vector,
) -> str:
    """
    Return what says that gravity is another than configured on an arm that stands; else empty.

    What the sensor carries, of a mass m [kg], then reads -m times the change of gravity, which
    must leave its strength as it is; and so must the residuals, of which `shares` are those of
    `RobotModel.gravity_shares`, lean to the same side. A push does neither.
    """
    strength = np.linalg.norm(gravity_world)
    down = gravity_world / strength
    if mass < SMALLEST_MASS:
        return ''
    read = -force_world / mass
    true = gravity_world + read
    weights = 1.0 / joints['threshold']
    fitted = np.linalg.lstsq(
        shares * weights[:, None], joints['residual'] * weights, rcond=SMALLEST_SHARE)[0]
    leans = [change - (change @ down) * down for change in (read, fitted)]
    sizes = [float(np.linalg.norm(lean)) for lean in leans]
    if min(sizes) < SMALLEST_LEAN or leans[0] @ leans[1] < SAME_SIDE * sizes[0] * sizes[1] or (
            abs(np.linalg.norm(true) - strength) > SAME_STRENGTH * strength):
        return ''
    angle = np.degrees(np.arctan2(sizes[0], true @ down))
    x, y, z = true
    return (f'arm and tool weigh as if gravity were [{x:.1f}, {y:.1f}, {z:.1f}] m/s^2, '
            f'{angle:.0f} deg off robot.gravity_world: check how the base is mounted')


def explain_lag(joints: Any) -> str:
    """
    Return what says that the wrench comes late, once a collision has passed; else empty.

    A residual is then J^T (f(t) - f(t - tau)), which passes when the force stays; the integral of
    it is tau times the change of J^T f, with the same tau in every joint.
    """
    evidence, weights = joints['evidence'], 1.0 / joints['threshold']
    areas = evidence['area'] * weights
    changes = (evidence['regressor'][:, WRENCH] - evidence['felt_before']) * weights
    if not np.abs(changes).max() > LAG_CHANGE:
        return ''
    lag = (areas @ changes) / (changes @ changes)
    likeness = lag * (areas @ changes) / (areas @ areas)
    if lag < LEAST_LAG or likeness < LAG_LIKENESS:
        return ''
    return (f'the wrench reads what the torques have shown about {1e3 * lag:.0f} ms before: check '
            'what delays or filters it on its way, and what its stamps are of')


@np.errstate(all='ignore')  # of impossible efforts
def explain_axes(
    joints: Any, momentum: Any, jacobian: Matrix, rotation_world: Matrix, weight: Vector,
) -> str:
    """
    Return what says that axes of the sensor are exchanged or turned round; else empty.

    `rotation_world` has the sensor's axes as columns, `weight` is what hangs on it, m g, world
    axes [N]. What the torques show is compared with what is read in all other axes.
    """
    felt, weights = joints['evidence']['regressor'][:, WRENCH], 1.0 / joints['threshold']
    settled = 1.0 - np.exp(-momentum['bandwidth'] * joints['evidence']['rested'].max())
    torques = np.column_stack([felt, felt + joints['residual']]) / settled
    wrenches = np.linalg.lstsq(
        jacobian.T * weights[:, None], torques * weights[:, None], rcond=SMALLEST_SHARE)[0]
    read, shown = (rotation_world.T @ (wrenches[:3].T - weight).T).T
    size = np.linalg.norm(shown)
    if not size > AXES_FORCE or not np.linalg.norm(read - shown) > AXES_UNLIKE * size:
        return ''
    errors = np.linalg.norm(EXCHANGES @ shown - read, axis=1)
    if errors.min() > AXES_LIKE * size:
        return ''
    # Of exchanges that are alike, as of two equal forces, the least.
    exchange = EXCHANGES[np.argmin(errors + 0.5 * AXES_LIKE * size * EXCHANGED)]
    told = []
    for i, row in enumerate(exchange):
        axis = int(np.argmax(np.abs(row)))
        if abs(read[i]) > 0.5 * AXES_UNLIKE * size and row[i] != 1.0:
            told.append(f'its {"xyz"[i]} is {"-" if row[axis] < 0.0 else ""}{"xyz"[axis]}')
    x, y, z = shown
    return (f'the wrench sensor reads [{read[0]:.1f}, {read[1]:.1f}, {read[2]:.1f}] N where the '
            f'torques show [{x:.1f}, {y:.1f}, {z:.1f}] N: {", ".join(told)}; check '
            'robot.sensor_frame and the axes of its driver')


def undeclared_friction(joints: Any, names: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each joint that has shown friction which is not declared."""
    for joint, name in zip(joints, names):
        friction = joint['evidence']['friction']
        if joint['evidence']['moved'] > 0.5 * arm.LEARNING_TIME and (
                friction > arm.RELEASE * joint['least_threshold']):
            yield f'{name}: the residual {FOLLOWED[DIRECTION].format(f"{friction:.2g}")}'
