"""The plant: arm, drives, contacts and sensor, advanced one control period at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.errors import ConfigError, RunError
import numpy as np
import pinocchio as pin
from sim_bridge.bullet_arm import BulletArm
from sim_bridge.config import PlantConfig
from sim_bridge.contacts import Contacts
from sim_bridge.drives import FlexibleDrives, RigidDrives
from sim_bridge.joint_friction import joint_friction
from sim_bridge.puma560 import load_robot, RobotData, SENSOR_FRAME, urdf_text
from sim_bridge.pushes import push_at, ToolPush
from sim_bridge.wrench_sensor import WrenchSensor


@dataclass(frozen=True, slots=True)
class Sample:
    """
    What can be known of the plant at the end of a control period.

    Attributes
    ----------
    q, qd
        Joint angles and speeds as the encoders see them, shape (n,) [rad], [rad/s].
    effort
        Torque applied over the period, shape (n,) [N m].
    wrench
        Reading of the wrist sensor: what the arm exerts on the tool, sensor frame,
        shape (6,) [N, N m].
    wrench_filtered
        The same behind the sensor's low-passes.
    contact_force
        True normal forces of robot on surface over the last substep, the one the sensor's reading
        belongs to, shape (nc,) [N], >= 0.
    saturated
        Whether a torque was clipped.
    tool_push_world
        True force of a hand on the tool over the period that ended, world axes, shape (3,) [N]:
        like any contact in what the sensor reads (its opposite), but not in `contact_force`.

    """

    q: Vector
    qd: Vector
    effort: Vector
    wrench: Vector
    wrench_filtered: Vector
    contact_force: Vector
    saturated: bool
    tool_push_world: Vector = field(default_factory=lambda: np.zeros(3))


class PybulletPlant:
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

    Raises
    ------
    ConfigError
        If the configuration does not fit the arm or the rate.

    """

    def __init__(self, config: PlantConfig, *, rate: float, seed: int) -> None:
        self.config = config
        self._robot = load_robot()
        self._seed = seed
        self._rate = rate
        self._substeps = config.substeps(rate)
        self.contact_names = config.contact_names
        self.joint_names = self._robot.joint_names
        require_fit(config, self._robot)
        self._model = pin.buildModelFromXML(urdf_text(self._robot))
        self._model.gravity.linear = np.array(config.gravity_world)
        self._home = np.array(config.home)
        still = np.zeros(self._model.nv)
        self.initial_torque: Vector = pin.rnea(
            self._model, self._model.createData(), self._home, still, still).copy()
        self._model.armature = np.array(self._robot.exact_armature)
        self._limit = np.array(config.torque_limit or self._robot.torque_limit)
        self._drives = self._build_drives()
        self.arm = BulletArm(self._robot, config.gravity_world, config.substep)
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
        sources = np.random.SeedSequence(self._seed).spawn(1 + len(self.contact_names))
        generators = [np.random.default_rng(source) for source in sources]
        self._sensor = WrenchSensor(config.sensor, config.substep, generators[0])
        self.contacts = Contacts(config, self._model, generators[1:])
        self._tool_push = ToolPush(config, self._model, self._rate)
        self._tick = 0
        self._q, self._qd = self._home.copy(), np.zeros(self._model.nv)
        self._drives.reset(self._home, self.initial_torque)
        self._wrench = self._static_wrench()
        self._joint_torque = np.zeros(self._model.nv)
        self.arm.reset(self._home)
        self._sensor.read(self._wrench)
        return self._sample(self.initial_torque, False)

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
        if not np.isfinite(torque).all():
            raise RunError(f'joint torque at tick {self._tick}: expected finite numbers, '
                           f'found {torque.tolist()}')
        applied = np.minimum(np.maximum(torque, -self._limit), self._limit)
        config = self.config
        push = push_at(
            self._tick, self._rate, config.push_start, config.push_duration,
            config.push_force_world)
        self._tool_push.start_period(self._tick)
        for _ in range(self._substeps):
            self._substep(applied, push)
        self._tick += 1
        return self._sample(applied, bool((applied != torque).any()))

    @property
    def model(self) -> pin.Model:
        """Return the arm's rigid-body model, as it is simulated."""
        return self._model

    def scale_torque_limit(self, factor: float) -> None:
        """Multiply what the drives can do, unknown to whoever commands them."""
        self._limit = factor * self._limit

    def close(self) -> None:
        """Give the simulator's memory back."""
        self.arm.close()

    def _build_drives(self) -> RigidDrives | FlexibleDrives:
        config = self.config
        friction = joint_friction(
            self._robot, config.joint_friction_scale, config.joint_friction_speed)
        if config.drives == 'rigid':
            return RigidDrives(self._model, friction, config.substep)
        return FlexibleDrives(
            np.array(self._model.armature), np.array(config.drive_stiffness),
            np.array(config.drive_damping), friction, config.substep)

    def _substep(self, torque: Vector, push: Vector) -> None:
        contacts, arm, joint_torque = self.contacts, self.arm, self._joint_torque
        contacts.update(self._q, self._qd, push)
        if self._tool_push.add_load(self._q, contacts.load):
            hand = self._tool_push
            arm.push_tool(hand.force_world.tolist(), hand.point_world.tolist())
        self._drives.advance(torque, contacts.load, self._q, self._qd, joint_torque)
        for i, alpha in enumerate(contacts.alpha.tolist()):
            if alpha > 0.0:
                arm.push_tool((-contacts.forces_world[i]).tolist(),
                              contacts.points_world[i].tolist())
        if push.any():
            arm.push_wrist(push.tolist(), contacts.wrist_world.tolist())
        arm.step(joint_torque.tolist())
        arm.read(self._q, self._qd, self._wrench)
        self._sensor.read(self._wrench)

    def _static_wrench(self) -> Vector:
        """Return what the sensor reads at rest at home: the weight it carries, held."""
        model, data, tool = self._model, self._model.createData(), self._robot.tool
        pin.framesForwardKinematics(model, data, self._home)
        rotation = data.oMf[model.getFrameId(SENSOR_FRAME)].rotation
        weight_held = -(tool.mass + tool.face_mass) * (
            rotation.T @ np.array(self.config.gravity_world))
        lever = tool.mass / (tool.mass + tool.face_mass) * np.array(tool.com)
        return np.concatenate((weight_held, np.cross(lever, weight_held)))

    def _sample(self, effort: Vector, saturated: bool) -> Sample:
        q, qd = self._q, self._qd
        if isinstance(self._drives, FlexibleDrives) and self.config.joint_sensing == 'motor':
            q, qd = self._drives.q, self._drives.qd
        return Sample(
            q=q.copy(), qd=qd.copy(), effort=effort.copy(), wrench=self._sensor.reading.copy(),
            wrench_filtered=self._sensor.filtered.copy(),
            contact_force=self.contacts.alpha.copy(), saturated=saturated,
            tool_push_world=self._tool_push.force_world.copy())


def require_fit(config: PlantConfig, robot: RobotData) -> None:
    """
    Check a plant against its arm.

    Raises
    ------
    ConfigError
        If the number of joints or the name of a tip does not match.

    """
    joints = len(robot.joint_names)
    if len(config.home) != joints:
        raise ConfigError('home', f'{joints} values, one per joint', len(config.home))
    for name in config.contact_names:
        tip = config.surfaces[name].tip_link
        if tip not in robot.tool.tips:
            raise ConfigError(
                f'surfaces.{name}.tip_link', f'one of {", ".join(sorted(robot.tool.tips))}',
                f"'{tip}'")
