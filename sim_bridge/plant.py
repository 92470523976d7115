"""The plant: arm, drives, contacts and sensor, advanced one control period at a time."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.config import ToolConfig, Vector3
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.sensor.tool import weight_reading
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, OPERATIONAL_FRAME, SENSOR_FRAME
from sim_bridge.config import PlantConfig
from sim_bridge.contacts import act_on_arm, Contacts
from sim_bridge.drives import DRIVE, flexible_drives, joint_friction, RigidDrives
from sim_bridge.engine_arm import EngineArm
from sim_bridge.kinematics import chain_of
from sim_bridge.pushes import HAND, Pushes, tool_push_point
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
        self._home = np.array(config.home)
        still = np.zeros(self._model.nv)
        self.initial_torque: Vector = pin.rnea(
            self._model, self._model.createData(), self._home, still, still).copy()
        self._model.armature = np.array(self.description.armature)
        self._native = config.contact == 'native'
        self._limit = np.array(config.torque_limit or self.description.torque_limit)
        self.arm = make_engine(config, self.description)
        self._hands: Any = np.zeros(2, dtype=HAND)
        frame = self._model.frames[self._model.getFrameId(OPERATIONAL_FRAME)]
        self._hands['local'][0] = frame.placement.translation
        self._hands['local'][1], self._tool_push_point = tool_push_point(config, self._model)
        self._torques = np.zeros((4, len(self._home)))
        self._motor, self.load, self._sum, self._link_side = self._torques
        self._pushes = np.zeros((len(config.met) + len(self._hands), 7))
        self._drives: Any = np.zeros(0, dtype=DRIVE)
        self._rigid: RigidDrives | None = None
        friction = joint_friction(
            self.description, config.joint_friction_scale, config.joint_friction_speed)
        if config.drives == 'flexible':
            self._drives = flexible_drives(
                np.array(self._model.armature), np.array(config.drive_stiffness),
                np.array(config.drive_damping), friction)
        elif config.contact == 'compliant':  # otherwise the engine has the rotors
            self._rigid = RigidDrives(self._model, friction, config.substep)
        motor_side = config.drives == 'flexible' and config.joint_sensing == 'motor'
        self._q, self._qd = (
            self._drives['q'], self._drives['qd']) if motor_side else self.arm.motion
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
        self.contacts = Contacts(config, self.description, self._model, generators[1:])
        self._hands['force'] = 0.0
        self._wrist_push = Pushes(self._hands[0], self._rate, config.push_start,
                                  config.push_duration, config.push_force_world)
        self._tool_push = Pushes(self._hands[1], self._rate, config.tool_push_start,
                                 config.tool_push_duration, config.tool_push_force_world)
        contacts = self.contacts
        acting = (
            self.arm.motion, self._torques, self._limit, chain_of(self._model), self._drives,
            contacts.surfaces, contacts.profiles, self._hands, self._pushes, config.substep)
        self._act = partial(act_on_arm, *acting)
        self._tick = 0
        self.arm.reset(self._home)
        if len(self._drives):  # springs wound up
            self._drives['q'] = self._home + self.initial_torque / self._drives['stiffness']
            self._drives['qd'] = 0.0
        self._sensor.read(self._static_wrench()[np.newaxis])
        self._motor[:] = self.initial_torque
        return self._sample(False)

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
        self._motor[:] = torque
        self._wrist_push.start_period(self._tick)
        self._tool_push.start_period(self._tick)
        self._sensor.read(np.array(self._advance()).reshape(-1, 6))
        self._tick += 1
        return self._sample(self._motor.tolist() != torque.tolist())

    @property
    def model(self) -> pin.Model:
        """Return the arm's rigid-body model, as it is simulated."""
        return self._model

    @property
    def tool_push_point(self) -> Vector3:
        """Return where the tool is pushed, in the sensor's frame [m]."""
        x, y, z = self._tool_push_point.tolist()
        return x, y, z

    def scale_torque_limit(self, factor: float) -> None:
        """Multiply what the drives can do, unknown to whoever commands them."""
        self._limit *= factor

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

    def _advance(self) -> list[float]:
        """Take the integration steps of a period; return the true wrenches, one after another."""
        act, arm, rigid, link_side = self._act, self.arm, self._rigid, self._link_side
        wrenches: list[float] = []
        for _ in range(self._substeps):
            count = act()
            if count < 0:
                raise RunError(f'joint torque at tick {self._tick}: expected finite numbers, '
                               f'found {self._motor.tolist()}')
            if rigid is not None:
                rigid.advance(self._motor, self._sum, arm.q, arm.qd, link_side)
            if count:
                arm.push(self._pushes.tolist()[:count])
            wrenches += arm.step(link_side)
            if self._native:
                self.contacts.pressed[:] = arm.native_forces()
        return wrenches

    def _static_wrench(self) -> Vector:
        """Return what the sensor reads at rest at home: the weight it carries, held."""
        model, data, arm = self._model, self._model.createData(), self.description
        pin.framesForwardKinematics(model, data, self._home)
        rotation = data.oMf[model.getFrameId(SENSOR_FRAME)].rotation
        carried = ToolConfig(mass=arm.carried_mass, com_sensor=arm.carried_com)
        return weight_reading(rotation, carried, np.array(self.config.gravity_world))

    def _sample(self, saturated: bool) -> Sample:
        return Sample(
            self._q.copy(), self._qd.copy(), self._motor.copy(), self._sensor.reading.copy(),
            self._sensor.filtered.copy(), self.contacts.alpha, saturated,
            self._tool_push.force_world.copy())


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
