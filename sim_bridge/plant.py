"""The plant: arm, drives, contacts and sensor, advanced one control period at a time."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.config import ToolConfig, Vector3
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.sensor.weight import weight_reading
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, SENSOR_FRAME, TOOL_LINK
from sim_bridge.config import PlantConfig
from sim_bridge.contacts import Contacts
from sim_bridge.drives import (
    clip_torque,
    EngineDrives,
    FlexibleDrives,
    joint_friction,
    RigidDrives,
)
from sim_bridge.engine_arm import EngineArm
from sim_bridge.pushes import Pushes, ToolPush
from sim_bridge.robots import find_robot
from sim_bridge.wrench_sensor import WrenchSensor


class Sample(NamedTuple):
    """What can be known of the plant at the end of a control period."""

    q: Vector  # joint angles as the encoders see them, shape (n,) [rad]
    qd: Vector  # joint speeds, likewise, shape (n,) [rad/s]
    effort: Vector  # torque applied over the period, shape (n,) [N m]
    wrench: Vector  # the arm's on the tool, as the sensor reads it, its frame, shape (6,) [N, N m]
    wrench_filtered: Vector  # the same behind the sensor's low-passes
    # True forces of robot on surface over the last substep, the one the sensor's reading belongs
    # to, and couples of edges and planes, shape (nc,) [N].
    contact_force: Vector
    saturated: bool  # whether a torque was clipped
    # True force of a hand on the tool over the period that ended, world axes, shape (3,) [N]: the
    # sensor reads its opposite; it is not in `contact_force`.
    tool_push_world: Vector


class Plant:
    """
    A simulated arm that touches surfaces.

    Parameters
    ----------
    config
        The plant.
    rate
        Control rate [Hz].
    seed
        Of roughness and sensor noise.

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
        self._model = self.description.model()
        _require_fit(config, self._model)
        # What touches the tool is felt by the wrist sensor, what touches a link is not.
        self._sensed_tips = [
            config.surfaces[name].tip_link in (TOOL_LINK, *self.description.tips)
            for name in config.met]
        self._model.gravity.linear = np.array(config.gravity_world)
        self._home = np.array(config.home)
        still = np.zeros(self._model.nv)
        self.initial_torque: Vector = pin.rnea(
            self._model, self._model.createData(), self._home, still, still).copy()
        self._model.armature = np.array(self.description.armature)
        self._limit = np.array(config.torque_limit or self.description.torque_limit)
        self._drives = self._build_drives()
        self.arm = make_engine(config, self.description)
        self._native = config.contact == 'native'
        self._sensed: EngineArm | FlexibleDrives = self.arm
        if isinstance(self._drives, FlexibleDrives) and config.joint_sensing == 'motor':
            self._sensed = self._drives
        self.reset()

    def reset(self) -> Sample:
        """
        Start afresh at home, at rest, at time 0.

        Returns
        -------
        Sample
            Sample 0; the same seed and torques give the same samples again, bit for bit.

        """
        config = self.config
        sources = np.random.SeedSequence(self._seed).spawn(1 + len(config.met))
        generators = [np.random.default_rng(source) for source in sources]
        self._sensor = WrenchSensor(config.sensor, config.substep, generators[0])
        self.contacts = Contacts(config, self._model, generators[1:])
        self._wrist_push = Pushes(
            self._rate, config.push_start, config.push_duration, config.push_force_world)
        self._tool_push = ToolPush(config, self._model, self._rate)
        self._tick = 0
        self._drives.reset(self._home, self.initial_torque)
        self.arm.reset(self._home)
        self._sensor.read(self._static_wrench()[np.newaxis])
        return self._sample(self.initial_torque.copy(), False)

    def step(self, torque: Vector) -> Sample:
        """
        Apply joint torques for one control period.

        Parameters
        ----------
        torque
            Shape (n,) [N m], clipped to the limits.

        Returns
        -------
        Sample
            The sample at the period's end.

        Raises
        ------
        RunError
            If a torque is not finite.
        ShapeError
            If there is not one torque per joint.

        """
        require_shape('torque', torque, self._limit.shape)
        applied = np.array(torque, dtype=float)
        finite, saturated = clip_torque(applied, self._limit)
        if not finite:
            raise RunError(f'joint torque at tick {self._tick}: expected finite numbers, '
                           f'found {torque.tolist()}')
        self._wrist_push.start_period(self._tick)
        self._tool_push.start_period(self._tick)
        wrenches = [self._substep(applied) for _ in range(self._substeps)]
        self._sensor.read(np.array(wrenches))
        self._tick += 1
        return self._sample(applied, saturated)

    @property
    def model(self) -> pin.Model:
        """Return the arm's rigid-body model, as it is simulated."""
        return self._model

    @property
    def tool_push_point(self) -> Vector3:
        """Return where the tool is pushed, in the sensor's frame [m]."""
        x, y, z = self._tool_push.point_sensor.tolist()
        return x, y, z

    def scale_torque_limit(self, factor: float) -> None:
        """Multiply what the drives can do, unknown to whoever commands them."""
        self._limit = factor * self._limit

    def push(self, force_world: Vector, duration: float, *, tool: bool = False) -> None:
        """
        Push the arm from the next control period on, at the operational point or at the tool.

        Parameters
        ----------
        force_world
            Shape (3,) [N].
        duration
            How long [s].
        tool
            Whether at `tool_push_link`, beyond the wrist sensor, which then reads it.

        """
        pushes = self._tool_push if tool else self._wrist_push
        pushes.add(self._tick, max(1, round(duration * self._rate)), force_world)

    def close(self) -> None:
        """Give the simulator's memory back."""
        self.arm.close()

    def _build_drives(self) -> RigidDrives | FlexibleDrives | EngineDrives:
        config = self.config
        friction = joint_friction(
            self.description, config.joint_friction_scale, config.joint_friction_speed)
        if config.drives == 'rigid' and config.contact == 'native':
            return EngineDrives()
        if config.drives == 'rigid':
            return RigidDrives(self._model, friction, config.substep)
        return FlexibleDrives(
            np.array(self._model.armature), np.array(config.drive_stiffness),
            np.array(config.drive_damping), friction, config.substep)

    def _substep(self, torque: Vector) -> tuple[float, ...]:
        """Take one integration step and return the true wrench at the sensor."""
        contacts, arm, wrist, tool = self.contacts, self.arm, self._wrist_push, self._tool_push
        q, qd = arm.q, arm.qd
        contacts.move(self.config.substep)
        pressed = contacts.update(q, qd, wrist.force_world)
        if tool.add_load(q, contacts.load):
            arm.push_tool(tool.force_world.tolist(), tool.point_world.tolist())
        link_torque = self._drives.advance(torque, contacts.load, q, qd)
        if pressed:
            for alpha, force, point, joint, sensed in zip(
                    contacts.pressed.tolist(), (-contacts.forces_world).tolist(),
                    contacts.points_world.tolist(), contacts.carriers, self._sensed_tips):
                if alpha > 0.0 and sensed:
                    arm.push_tool(force, point)
                elif alpha > 0.0:
                    arm.push_link(joint, force, point)
        if wrist.acting:
            arm.push_link(-1, wrist.force_world.tolist(), contacts.wrist_world.tolist())
        wrench = arm.step(link_torque)
        if self._native:
            contacts.pressed[:] = arm.native_forces()
        return wrench

    def _static_wrench(self) -> Vector:
        """Return what the sensor reads at rest at home: the weight it carries, held."""
        model, data, arm = self._model, self._model.createData(), self.description
        pin.framesForwardKinematics(model, data, self._home)
        rotation = data.oMf[model.getFrameId(SENSOR_FRAME)].rotation
        carried = ToolConfig(mass=arm.carried_mass, com_sensor=arm.carried_com)
        return weight_reading(rotation, carried, np.array(self.config.gravity_world))

    def _sample(self, effort: Vector, saturated: bool) -> Sample:
        return Sample(
            q=self._sensed.q.copy(), qd=self._sensed.qd.copy(), effort=effort,
            wrench=self._sensor.reading.copy(), wrench_filtered=self._sensor.filtered.copy(),
            contact_force=self.contacts.alpha, saturated=saturated,
            tool_push_world=self._tool_push.force_world)


def make_engine(config: PlantConfig, arm: Arm) -> EngineArm:
    """
    Return the engine of a plant, which is loaded only where one asks for it.

    Raises
    ------
    ConfigError
        If it is not installed.

    """
    if config.engine == 'pybullet':
        from sim_bridge.bullet_arm import BulletArm

        return BulletArm(arm, config.gravity_world, config.substep)
    try:
        from sim_bridge.mujoco_arm import MujocoArm
    except ImportError as error:
        raise ConfigError(
            'engine', 'pybullet, or what pip install "multicontact_control[mujoco]" brings',
            f'mujoco ({error})') from None
    return MujocoArm(arm, config)


def _require_fit(config: PlantConfig, model: pin.Model) -> None:
    if len(config.home) != model.nv:
        raise ConfigError('home', f'{model.nv} values, one per joint', len(config.home))
    links = [frame.name for frame in model.frames
             if frame.type == pin.FrameType.BODY and frame.parentJoint > 0]
    for name in config.met:
        tip = config.surfaces[name].tip_link
        if tip not in links:
            raise ConfigError(
                f'surfaces.{name}.tip_link', f'one of {", ".join(sorted(links))}', f"'{tip}'")
