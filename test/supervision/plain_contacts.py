"""Contacts, observers and reference in plain Python: what the compiled ones must equal."""

import math

from equations import rotation_error
from multicontact_control.control.reference import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.supervision.contacts import ContactState
import numpy as np

LEVEL_TIME, TOUCH_SHARE, POSITION_RATE, RETURN_RATE = 0.1, 0.5, 20.0, 2.0
ACTIVE = (ContactState.IMPACT, ContactState.HOLDING)


class PlainMachine:

    def __init__(self, config, period, stiffness=math.inf):
        self._config = config
        self._period, self._stiffness = period, stiffness
        self.reset()

    def reset(self):
        self.state = ContactState.FREE
        self.displacement = self.speed = self.acceleration = 0.0
        self.force_limit = 0.0
        self.losses = 0
        self._in_state = 0.0
        self._below = self._level = self._shaken = 0.0
        self.searches, self.left, self.again = 0, False, False
        self._origin = None  # where the surface was, if it was ever met
        self._start = 0.0
        self._target = 0.0

    @property
    def active(self):
        return self.state in ACTIVE

    @property
    def approach_speed(self):
        return self._config.approach_speed

    def let_go(self, place, speed=0.0):
        if self.active:
            self.losses += 1
            self._leave_surface(place, speed)
            self._enter(ContactState.LOST)
        else:
            self.displacement, self.speed = place, 0.0

    def update(self, wanted, alpha, alpha_des, place, speed, escape):
        self._in_state += self._period
        self.again = self.again and self.state is ContactState.GIVEN_UP
        self._switch(wanted, alpha, alpha_des, place, speed, escape)
        if self.active:
            self.acceleration = 0.0
            self._raise_force_limit(alpha_des)
        else:
            self._move()

    def _switch(self, wanted, alpha, alpha_des, place, speed, escape):
        config, state = self._config, self.state
        if alpha > config.force_ceiling and state is not ContactState.RETRACTING:
            self._retract(place, speed)
        elif not wanted and not self._stays_away():
            self._stop_wanting(place, speed)
        elif state is ContactState.FREE:
            self._approach(self.displacement)
        elif self.active:
            self._watch_hold(alpha, alpha_des, place, speed, escape)
        elif state is ContactState.RETRACTING:
            if abs(self._target - self.displacement) < 1e-4:
                self._enter(ContactState.GIVEN_UP)
        elif state is ContactState.GIVEN_UP:
            wait = config.retry_time * 2.0 ** min(max(self.searches - 1, 0), 4)
            due = config.retry_time > 0.0 and not self.left and self._in_state >= wait
            if due or self.again:
                self.left = False
                self._approach(self._target if self._origin is None else self._origin)
        else:
            self._watch_search(alpha)

    def _watch_search(self, alpha):
        config, threshold = self._config, self._config.contact_threshold
        if self.state is ContactState.LOST:  # a tool that is being braked reads its own inertia
            threshold = max(2.0 * threshold, TOUCH_SHARE * self._level)
        if alpha > threshold:
            again = self._origin is not None
            self.force_limit = max(alpha, config.preload) if again else config.preload
            self._below = self._level = 0.0
            self._enter(ContactState.IMPACT)
        elif self.state is ContactState.LOST:
            if self._in_state >= config.lost_time and (
                    abs(self._target - self.displacement) < 2e-4 and abs(self.speed) < 2e-3):
                self._approach(self.displacement)
        elif self.displacement - self._start > (
                config.approach_distance if self._origin is None else config.search_distance):
            self._target = self._start
            self.searches += 1
            self._enter(ContactState.GIVEN_UP)

    def _watch_hold(self, alpha, alpha_des, place, speed, escape):
        config, h = self._config, self._period
        threshold = max(config.release_threshold,
                        config.release_fraction * min(self._level, alpha_des, self.force_limit))
        if alpha >= threshold:
            self._below = 0.0
            self._origin = place - alpha / self._stiffness
            self._level += h / (LEVEL_TIME + h) * (alpha - self._level)
        else:
            if self._below == 0.0 and self.state is ContactState.HOLDING and (
                    speed < -0.002 and self._shaken <= 0.0):
                self._below = min(0.0, config.loss_time - config.rebound_time)
                self._shaken = 0.5
            self._below += h
        self._shaken = max(0.0, self._shaken - h)
        patience = config.loss_time if self.state is ContactState.HOLDING else max(
            config.loss_time, config.bounce_time)
        step = abs(min(alpha_des, self.force_limit) - self._level)
        fastest = config.escape_speed + step / (self._stiffness * 0.02)
        if self._below > patience + 1e-9 or escape > fastest:
            self.losses += 1
            self._leave_surface(place, speed)
            self._enter(ContactState.LOST)
        elif self.state is ContactState.IMPACT and self._below == 0.0 and (
                self._in_state >= config.impact_time):
            self.searches = 0
            self._enter(ContactState.HOLDING)

    def _stays_away(self):
        if self.state is ContactState.RETRACTING:
            return self._origin is None or abs(self._target - self.displacement) >= 1e-4
        return self.state is ContactState.GIVEN_UP and (
            self.left and self._origin is None and not self.again)

    def _stop_wanting(self, place, speed):
        if self.active:
            self._leave_surface(place, speed)
        if self.state is not ContactState.FREE:
            self._enter(ContactState.FREE)
        self.left, self.searches, self.losses = False, 0, 0
        self._origin = None
        self._target = 0.0

    def _leave_surface(self, place, speed):
        self.displacement, self.speed = place, speed
        self._target = self._start = place if self._origin is None else self._origin

    def _approach(self, start):
        self._start = start
        self._enter(ContactState.APPROACHING)

    def retreat(self):
        self._retract(self.displacement if self._origin is None else self._origin, 0.0)

    def _retract(self, place, speed):
        self.displacement, self.speed = place, speed
        self._target = place - self._config.retract_distance
        self.left = True
        self._enter(ContactState.RETRACTING)

    def _enter(self, state: ContactState):
        self.state = state
        self._in_state = 0.0

    def _raise_force_limit(self, alpha_des):
        if self.state is ContactState.HOLDING and self.losses == 0:
            self.force_limit = max(self.force_limit, alpha_des)
        elif self.state is ContactState.HOLDING or self._origin is not None and self.losses:
            step = self._config.force_rate * self._period
            self.force_limit += min(max(alpha_des - self.force_limit, -step), step)

    def _move(self):
        config, h = self._config, self._period
        if self.state is ContactState.APPROACHING:
            wanted = config.approach_speed
            change = config.approach_speed / config.approach_ramp_time
        else:
            limit = config.retract_speed if self.state is ContactState.RETRACTING else (
                config.approach_speed)
            wanted = min(max(POSITION_RATE * (self._target - self.displacement), -limit), limit)
            change = config.braking
        if abs(self.speed) > config.approach_speed:
            change = max(change, config.braking)
        self.acceleration = min(max((wanted - self.speed) / h, -change), change)
        self.speed += self.acceleration * h
        self.displacement += self.speed * h


class PlainObserver:

    def __init__(self, config, stiffness, period):
        self._stiffness, self._period = stiffness, period
        self._keep = math.exp(-period / config.energy_memory)
        self._damping = config.injected_damping
        self._share = config.energy_share
        self._least = config.preload + config.contact_threshold
        self.limit = 0.0
        self.reset()

    def reset(self):
        self.energy = 0.0
        self._stored = 0.0

    @property
    def passive(self):
        return self.energy <= self.limit

    def update(self, alpha, speed, asked=0.0, holding=True):
        stored = max(alpha, 0.0) ** 2 / (2.0 * self._stiffness)
        work = alpha * speed * self._period
        self.energy = self._keep * self.energy + work - (stored - self._stored)
        self._stored = stored
        if not holding:
            self.energy = 0.0
        self.limit = self._share * max(asked, self._least) ** 2 / (2.0 * self._stiffness)
        return 0.0 if self.passive else self._damping * speed


class PlainReference:

    def __init__(self, config, task):
        contact_state = task.contact_state(config.contact_state)
        self._config, self._task = config, task
        self.machines = [
            PlainMachine(contact_state, config.period, config.contacts[name].stiffness)
            for name in config.contact_names]
        self.observers = [
            PlainObserver(contact_state, config.contacts[name].stiffness, config.period)
            for name in config.contact_names]
        self._points = np.array(
            [config.contacts[name].point_operational for name in config.contact_names])
        motion, limits = config.motion, config.limits
        self._lead = lead = 2.0 * motion.damping_ratio / motion.natural_frequency  # k_v / k_p [s]
        self._before = np.full(3, np.nan)
        self._reach = lead * limits.operational_speed
        self._turn = lead * limits.operational_turn
        self._box = (np.array(limits.workspace_lower), np.array(limits.workspace_upper))
        self._pose = None
        self._twist = np.zeros(6)
        self._offset = np.zeros(3)
        self._turned, self._rotation_before = np.zeros(3), np.eye(3)
        self._catching_up = False
        self._felt = np.zeros(len(config.contact_names))
        self._threshold = contact_state.contact_threshold
        self.limited = False

    @property
    def states(self):
        return tuple(machine.state for machine in self.machines)

    def start(self, pose, normals_world):
        self._task.start(pose, normals_world)
        self._normals = normals_world
        self._normal_lists = normals_world.tolist()
        self._overlap = (normals_world @ normals_world.T).tolist()
        for machine, observer in zip(self.machines, self.observers):
            machine.reset()
            observer.reset()
        self._offset, self._turned = np.zeros(3), np.zeros(3)
        self._catching_up = False
        if self._pose is None:
            self._pose = pose

    def observe(self, pose, twist_world):
        self._pose, self._twist = pose, twist_world

    def lead_back(self):
        for machine in self.machines:
            if machine.active:
                machine.retreat()

    def resume(self):
        self._offset, self._turned = np.full(3, np.nan), None  # set at the next update
        self._catching_up = True
        self._kept = [machine.active and force > self._threshold
                      for machine, force in zip(self.machines, self._felt)]

    def update(self, time, alpha_meas):
        self._felt = alpha_meas
        task = self._task.task(time)
        pose = task.pose_des if self._pose is None else self._pose
        gap = pose.position_world - task.pose_des.position_world
        if self._catching_up:
            wanted = task.pose_des.position_world
            self._return(gap, wanted - self._before - self._config.period * task.twist_des[:3])
            gap = gap - self._offset
            self._turn_back(task, pose)
            self._catching_up = self._offset.any() or self._turned.any() or any(
                abs(machine.displacement) > 2e-4 for machine in self.machines
                if machine.state is ContactState.FREE)
        self._before = task.pose_des.position_world
        self._rotation_before = task.pose_des.rotation_world
        damping = self._follow_contacts(task, gap, alpha_meas, pose)
        self.damping = np.zeros(len(self.machines))
        shift, velocity, change = self._offset.tolist(), [0.0] * 3, [0.0] * 3
        alpha_des, active = np.zeros(len(self.machines)), np.zeros(len(self.machines), dtype=bool)
        for i, machine in enumerate(self.machines):
            held = machine.active
            if held:
                active[i] = True
                alpha_des[i] = min(float(task.alpha_des[i]), machine.force_limit)
                self.damping[i] = damping[i]
            for axis, component in enumerate(self._normal_lists[i]):
                shift[axis] += machine.displacement * component
                if not held:
                    velocity[axis] += machine.speed * component
                    change[axis] += machine.acceleration * component
        return self._bounded(Reference(
            Pose(task.pose_des.position_world + np.array(shift),
                 rotation_of(self._turned) @ task.pose_des.rotation_world),
            task.twist_des + np.array(velocity + [0.0] * 3),
            task.acceleration_des + np.array(change + [0.0] * 3), active, alpha_des), pose)

    def _return(self, gap, jump):
        if np.isnan(self._offset[0]):
            # What lies along the normals belongs to the contacts, only the rest is caught up.
            along = np.linalg.lstsq(self._normals.T, gap, rcond=None)[0]
            for machine, place, kept in zip(self.machines, along, self._kept):
                if kept:
                    machine.displacement = float(place)
                else:
                    machine.let_go(float(place))
            self._offset = gap - along @ self._normals
            jump = np.zeros(3)
        across = jump - jump @ np.linalg.pinv(self._normals) @ self._normals
        for machine, step in zip(self.machines, jump @ np.linalg.pinv(self._normals)):
            if machine.state is ContactState.FREE:
                machine.displacement = self._closer(machine.displacement, float(step))
        length = float(np.sqrt(self._offset @ self._offset))
        if length > 0.0:
            left = self._closer(length, float(across @ self._offset) / length)
            speed = min(RETURN_RATE * left, 0.2 * self._config.limits.operational_speed)
            self._offset *= max(left - speed * self._config.period, 0.0) / length
        if length < 1e-6:
            self._offset = np.zeros(3)

    def _turn_back(self, task, pose):
        rotation, period = task.pose_des.rotation_world, self._config.period
        jump = rotation_error(rotation, self._rotation_before) - period * task.twist_des[3:]
        if self._turned is None or self._turned.any() and np.abs(jump).max() > 1e-3:
            self._turned = rotation_error(pose.rotation_world, rotation)
        angle = np.linalg.norm(self._turned)
        if angle < 1e-5:
            self._turned = np.zeros(3)
        else:
            speed = min(RETURN_RATE * angle, 0.2 * self._config.limits.operational_turn)
            self._turned = self._turned * (max(angle - speed * period, 0.0) / angle)

    @staticmethod
    def _closer(gap, step):
        if gap * step <= 0.0:
            return gap
        return math.copysign(max(abs(gap) - abs(step), 0.0), gap)

    def _follow_contacts(
        self, task, gap, alpha_meas, pose,
    ):
        displacements = [machine.displacement for machine in self.machines]
        places = (self._normals @ gap).tolist()
        speeds = (self._normals @ (self._twist[:3] - task.twist_des[:3])).tolist()
        levers = (self._points @ pose.rotation_world.T).tolist()
        vx, vy, vz, wx, wy, wz = self._twist.tolist()
        wanted, forces, desired = task.active.tolist(), alpha_meas.tolist(), (
            task.alpha_des.tolist())
        damping = []
        for i, machine in enumerate(self.machines):
            nx, ny, nz = self._normal_lists[i]
            lx, ly, lz = levers[i]
            speed = (nx * (vx + wy * lz - wz * ly) + ny * (vy + wz * lx - wx * lz)
                     + nz * (vz + wx * ly - wy * lx))
            damping.append(self.observers[i].update(
                forces[i], speed, desired[i], machine.state is ContactState.HOLDING))
            others = sum(self._overlap[i][j] * other for j, other in enumerate(displacements)
                         if j != i)
            machine.update(wanted[i], forces[i], desired[i], places[i] - others, speeds[i],
                           min(speeds[i], speed))
        return damping

    def _bounded(self, reference, pose):
        position = reference.pose_des.position_world
        rotation = reference.pose_des.rotation_world
        twist, acceleration = reference.twist_des, reference.acceleration_des
        self.limited = False
        if self._box[0].size:
            inside = np.minimum(np.maximum(position, self._box[0]), self._box[1])
            outward = inside != position
            if outward.any():
                twist, acceleration = twist.copy(), acceleration.copy()
                twist[:3][outward] = acceleration[:3][outward] = 0.0
                position, self.limited = inside, True
        N = self._normals[np.array(reference.active, dtype=bool)].T
        across = np.eye(3) - N @ np.linalg.pinv(N) if N.size else np.eye(3)
        error = across @ (position - pose.position_world)
        length = float(np.sqrt(error @ error))
        if max(length, np.linalg.norm(error + self._lead * (across @ twist[:3]))) > self._reach:
            twist, acceleration = np.zeros(6), np.zeros(6)
            self.limited = True
        if length > self._reach:
            position = position - error * (1.0 - self._reach / length)
        turn = rotation_error(rotation, pose.rotation_world)
        angle = float(np.sqrt(turn @ turn))
        if np.linalg.norm(turn + self._lead * twist[3:]) > self._turn:
            twist, acceleration = twist.copy(), acceleration.copy()
            twist[3:] = acceleration[3:] = 0.0
            self.limited = True
        if angle > self._turn:
            rotation = rotation_of(turn * (self._turn / angle)) @ pose.rotation_world
            self.limited = True
        if not self.limited:
            return reference
        return Reference(Pose(position, rotation), twist, acceleration, reference.active,
                         reference.alpha_des)


def rotation_of(vector):
    angle = float(np.sqrt(vector @ vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return rotation
