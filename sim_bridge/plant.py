"""The plant: arm, drives, contacts and sensor, advanced one control period at a time."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import NamedTuple

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.config import ToolConfig
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.records import Records
from multicontact_control.sensor.tool import predict_weight_reading
import numpy as np
import pinocchio as pin
from sim_bridge.actuation import ActuationErrors
from sim_bridge.arm import Arm, OPERATIONAL_FRAME, SENSOR_FRAME, TOOL_LINK
from sim_bridge.config import ActuationConfig, PlantConfig
from sim_bridge.contacts import (
    act_on_arm,
    Contacts,
    HAND,
    Hand,
    PushSchedule,
    Surroundings,
)
from sim_bridge.drives import DRIVE, Drive, flexible_drives, joint_friction, RigidDrives
from sim_bridge.engine_arm import EngineArm
from sim_bridge.kinematics import link_records
from sim_bridge.posture import frame_pose
from sim_bridge.robots import find_robot
from sim_bridge.wrench_sensor import WrenchSensor

PICK_UP_RATE = 6.0  # kg/s, at which a payload is taken over from what has carried it


class Sample(NamedTuple):
    """What can be known of the plant at the end of a control period."""

    q: Vector  # joint angles as the encoders see them, shape (n,) [rad]
    qd: Vector  # joint speeds, likewise, shape (n,) [rad/s]
    effort: Vector  # torque that acted, its mean over the period, shape (n,) [N m]
    wrench: Vector  # the arm's on the tool, as the sensor reads it, its frame, shape (6,) [N, N m]
    wrench_filtered: Vector  # the same behind the sensor's low-passes
    # True forces of robot on surface over the last substep, the one the sensor's reading belongs
    # to, and couples of edges and planes, shape (r,) [N].
    contact_force: Vector


class Plant:
    """
    A simulated arm that touches surfaces, in the place of a real one.

    Torques go in, samples come out: the control loop and the ROS node both drive it so.

    Parameters
    ----------
    config
        Arm, drives, sensor and surfaces.
    rate
        Samples per second [Hz].
    seed
        Of roughness, sensor noise and torque noise.

    Attributes
    ----------
    contact_names, joint_names
        Order of the contact and joint vectors.
    initial_torque
        Holds the arm at its home, tool included, shape (n,) [N m].
    contacts, arm
        What really goes on, for evaluation: a controller must not look.
    description
        The arm as it is simulated.
    model
        Its rigid-body model, with armature and what is carried of the payload.
    payload
        Mass that the tool is to carry besides, at its centre of mass [kg]; set it to pick up and
        to lay down.

    Raises
    ------
    ConfigError
        If the configuration does not fit the arm or the rate.

    """

    def __init__(self, config: PlantConfig, *, rate: float, seed: int) -> None:
        self.config = config
        self.description = find_robot(config.robot).arm
        self._seed = seed
        self._rate = rate
        self._substeps = config.substeps(rate)
        self.contact_names = config.column_names
        self.joint_names = self.description.joint_names
        self.model = self.description.model()
        _require_fit(config, self.model)
        self._home = np.array(config.home)
        self.initial_torque: Vector = pin.computeGeneralizedGravity(
            self.model, self.model.createData(), self._home
        ).copy()
        self.model.armature = np.array(self.description.armature)
        self._last_link = pin.Inertia(self.model.inertias[self.model.nv])
        self.arm = make_engine_arm(config, self.description)
        self._hands: Records[Hand] = np.zeros(2, dtype=HAND)
        for hand, link in zip(self._hands, (OPERATIONAL_FRAME, config.tool_push_link)):
            frame = self.model.frames[self.model.getFrameId(link)]
            hand['local'] = frame.placement.translation
        self._torques = np.zeros((5, len(self._home)))
        self._limit, self._motor, _, self._sum, self._link_side = self._torques
        self._limit[:] = config.torque_limit or self.description.torque_limit
        self._pushes = np.zeros((len(config.met) + len(self._hands), 7))
        self._drives: Records[Drive] = np.zeros(0, dtype=DRIVE)
        self._rigid: RigidDrives | None = None
        self._actuation: ActuationErrors | None = None
        if config.actuation != ActuationConfig():
            self._actuation = ActuationErrors(config)
        self._q, self._qd = self.arm.motion
        self._make_drives()
        self.reset()

    def _make_drives(self) -> None:
        """Make rotors behind springs, or rotors that turn with the links."""
        config = self.config
        friction = joint_friction(
            self.description, config.joint_friction_scale, config.joint_friction_speed
        )
        if config.drives == 'flexible':
            self._drives = flexible_drives(
                self.description.armature,
                config.drive_stiffness,
                config.drive_damping,
                friction,
            )
            if config.joint_sensing == 'motor':
                self._q = self._drives['q']
                self._qd = self._drives['qd']
        elif (
            config.contact == 'compliant'
        ):  # with native contacts the engine has the rotors
            self._rigid = RigidDrives(self.model, friction, config.substep)

    def reset(self) -> Sample:
        """
        Start afresh at home, at rest, at time 0, and return sample 0.

        The same seed and torques give the same samples again, bit for bit.
        """
        config = self.config
        seeds = np.random.SeedSequence(self._seed).spawn(2 + len(config.met))
        generators = [np.random.default_rng(seed) for seed in seeds]
        sensor_noise, *roughness, torque_noise = generators
        self._sensor = WrenchSensor(config.sensor, config.substep, sensor_noise)
        self.contacts = Contacts(config, self.description, self.model, roughness)
        self._hands['force'] = 0.0
        self._wrist_pushes, self._tool_pushes = map(PushSchedule, self._hands)
        forces = np.reshape(config.push_force_world, (-1, 3))
        for begin, length, force in zip(
            config.push_start, config.push_duration, forces
        ):
            first = round(begin * self._rate)
            end = round((begin + length) * self._rate)
            self._wrist_pushes.schedule_push(first, end, force)
        self._act_on_arm = partial(
            act_on_arm,
            self.arm.motion,
            self._torques,
            link_records(self.model),
            self._drives,
            Surroundings(
                surfaces=self.contacts.surfaces,
                profiles=self.contacts.profiles,
                hands=self._hands,
                pushes=self._pushes,
            ),
            config.substep,
        )
        self._tick = 0
        self.arm.reset(self._home)
        self.payload = 0.0
        self._carry_payload(0.0)
        if len(self._drives):  # springs wound up
            wound = self.initial_torque / self._drives['stiffness']
            self._drives['q'] = self._home + wound
            self._drives['qd'] = 0.0
        self._sensor.read_wrenches(self._static_wrench()[np.newaxis])
        self._motor[:] = self.initial_torque
        if self._actuation is not None:
            self._actuation.reset(self.initial_torque, torque_noise)
        return self._take_sample()

    def step(self, torque: Vector) -> Sample:
        """
        Apply torques for one control period and return the sample at its end.

        Parameters
        ----------
        torque
            Of the motors, shape (n,) [N m]; they are clipped to the limits.

        Raises
        ------
        ShapeError
            If there is not one torque per joint.
        RunError
            If a torque is not finite.

        """
        require_shape('torque', torque, self._limit.shape)
        self._motor[:] = torque
        if self._actuation is not None:
            self._actuation.begin_period(torque)
        if self._carried != self.payload:
            most = PICK_UP_RATE / self._rate
            bounded = max(self.payload, self._carried - most)
            self._carry_payload(min(bounded, self._carried + most))
        self._wrist_pushes.begin_period(self._tick)
        self._tool_pushes.begin_period(self._tick)
        self._sensor.read_wrenches(np.array(self._integrate_period()).reshape(-1, 6))
        self._tick += 1
        return self._take_sample()

    def _carry_payload(self, payload: float) -> None:
        """Let the tool weigh so much more than its own mass [kg]."""
        self._carried = payload
        tool = self.description.tool
        self.arm.set_tool_mass(tool.mass + payload)
        frame = self.model.frames[self.model.getFrameId(TOOL_LINK)]
        inertia = self._last_link
        if payload:
            com = frame.placement.act(np.array(tool.com.position))
            inertia = inertia + pin.Inertia(payload, com, np.zeros((3, 3)))
        self.model.inertias[frame.parentJoint] = inertia

    def scale_torque_limit(self, factor: float) -> None:
        """Multiply the torque limits of the drives by a factor, unknown to the controller."""
        self._limit *= factor

    def push(self, force_world: Vector, duration: float, *, tool: bool = False) -> None:
        """
        Push the arm with a constant force, as a hand does, from the next control period on.

        Parameters
        ----------
        force_world
            World axes, shape (3,) [N].
        duration
            [s].
        tool
            Whether to push at `tool_push_link`, beyond the wrist sensor, which reads it; else at
            the operational point, before the sensor.

        """
        pushes = self._wrist_pushes
        if tool:
            pushes = self._tool_pushes
        end = self._tick + max(1, round(duration * self._rate))
        pushes.schedule_push(self._tick, end, force_world)

    def close(self) -> None:
        """Free what the engine holds outside Python's memory."""
        self.arm.close()

    def _integrate_period(self) -> list[float]:
        """Take the integration steps of a period; return the true wrenches, one after another."""
        arm = self.arm
        actuation = self._actuation
        wrenches: list[float] = []
        for _ in range(self._substeps):
            if actuation is not None:
                actuation.find_acting_torque(arm.qd, self._drives, self._motor)
            push_count = self._act_on_arm()
            if push_count < 0:
                raise RunError(
                    f'joint torque at tick {self._tick}: expected finite numbers, '
                    f'got {self._motor.tolist()}'
                )
            if actuation is not None:
                actuation.torque_sum += self._motor
            if self._rigid is not None:
                self._rigid.find_link_torque(
                    self._motor, self._sum, arm.q, arm.qd, self._link_side
                )
            if push_count:
                arm.apply_pushes(self._pushes.tolist()[:push_count])
            wrenches += arm.step(self._link_side)
            if arm.native_forces is not None:
                self.contacts.pressed[:] = arm.native_forces
        if actuation is not None:
            self._motor[:] = actuation.torque_sum / self._substeps
        return wrenches

    def _static_wrench(self) -> Vector:
        """Return what the sensor reads at rest at home: the weight it carries, held."""
        rotation = frame_pose(self.model, self._home, SENSOR_FRAME).rotation
        arm = self.description
        carried = ToolConfig(mass=arm.carried_mass, com_sensor=arm.carried_com)
        return predict_weight_reading(
            rotation, carried, np.array(self.config.gravity_world)
        )

    def _take_sample(self) -> Sample:
        return Sample(
            self._q.copy(),
            self._qd.copy(),
            self._motor.copy(),
            self._sensor.reading.copy(),
            self._sensor.filtered.copy(),
            self.contacts.alpha,
        )


def make_engine_arm(config: PlantConfig, arm: Arm) -> EngineArm:
    """
    Return the arm of a plant in its engine, whose library is imported here alone.

    ConfigError if that cannot be loaded.
    """
    try:
        if config.engine == 'pybullet':
            from sim_bridge.bullet_arm import BulletArm
        else:
            from sim_bridge.mujoco_arm import MujocoArm
    except ImportError as error:
        raise ConfigError(
            'engine',
            f'an engine that can be loaded, by pip install {config.engine}',
            f'{config.engine} ({error})',
        ) from None
    if config.engine == 'pybullet':
        return BulletArm(arm, config.gravity_world, config.substep)
    return MujocoArm(arm, config)


def _require_fit(config: PlantConfig, model: pin.Model) -> None:
    """Require one home angle per joint, tips on moving links, and a push on the last of these."""
    if len(config.home) != model.nv:
        raise ConfigError('home', f'{model.nv} values, one per joint', len(config.home))
    carriers = {}  # numbers of the joints that move the links
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint > 0:
            carriers[frame.name] = frame.parentJoint
    for name in config.met:
        field = f'surfaces.{name}.tip_link'
        _require_link(field, config.surfaces[name].tip_link, carriers)
    last = carriers[SENSOR_FRAME]
    pushable = [name for name, joint in carriers.items() if joint == last]
    _require_link('tool_push_link', config.tool_push_link, pushable)


def _require_link(field: str, link: str, known: Collection[str]) -> None:
    if link not in known:
        raise ConfigError(field, f'one of {", ".join(sorted(known))}', f"'{link}'")
