"""The plant: arm, drives, contacts and sensor, advanced one control period at a time."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.config import ToolConfig
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.records import Records
from multicontact_control.sensor.tool import predict_weight_reading
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, OPERATIONAL_FRAME, SENSOR_FRAME, TOOL_LINK
from sim_bridge.config import PlantConfig
from sim_bridge.contacts import act_on_arm, Contacts, HAND, Hand, Pushes
from sim_bridge.drives import DRIVE, Drive, flexible_drives, joint_friction, RigidDrives
from sim_bridge.engine_arm import EngineArm
from sim_bridge.kinematics import link_records
from sim_bridge.robots import find_robot
from sim_bridge.wrench_sensor import WrenchSensor

PICK_UP_RATE = 6.0  # kg/s, at which a payload is taken over from what has carried it


class Sample(NamedTuple):
    """What can be known of the plant at the end of a control period."""

    q: Vector  # joint angles as the encoders see them, shape (n,) [rad]
    qd: Vector  # joint speeds, likewise, shape (n,) [rad/s]
    effort: Vector  # torque applied over the period, shape (n,) [N m]
    wrench: Vector  # the arm's on the tool, as the sensor reads it, its frame, shape (6,) [N, N m]
    wrench_filtered: Vector  # the same behind the sensor's low-passes
    # True forces of robot on surface over the last substep, the one the sensor's reading belongs
    # to, and couples of edges and planes, shape (r,) [N].
    contact_force: Vector


class Plant:
    """
    A simulated arm that touches surfaces, at a control rate [Hz], with a seed of its noise.

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
        What the tool is to carry besides, at its centre of mass [kg]; set it to pick up, lay down.

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
        still = np.zeros(self.model.nv)
        self.initial_torque: Vector = pin.rnea(
            self.model, self.model.createData(), self._home, still, still
        ).copy()
        self.model.armature = np.array(self.description.armature)
        self._bare = pin.Inertia(self.model.inertias[self.model.nv])
        self._limit = np.array(config.torque_limit or self.description.torque_limit)
        self.arm = make_engine_arm(config, self.description)
        self._hands: Records[Hand] = np.zeros(2, dtype=HAND)
        frame = self.model.frames[self.model.getFrameId(OPERATIONAL_FRAME)]
        self._hands['local'][0] = frame.placement.translation
        pushed = self.model.frames[
            self.model.getFrameId(config.tool_push_link)
        ].placement
        self._hands['local'][1] = pushed.translation
        self._torques = np.zeros((4, len(self._home)))
        self._motor, _, self._sum, self._link_side = self._torques
        self._pushes = np.zeros((len(config.met) + len(self._hands), 7))
        self._drives: Records[Drive] = np.zeros(0, dtype=DRIVE)
        self._rigid: RigidDrives | None = None
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
        elif config.contact == 'compliant':  # otherwise the engine has the rotors
            self._rigid = RigidDrives(self.model, friction, config.substep)
        self._q, self._qd = self.arm.motion
        if config.drives == 'flexible' and config.joint_sensing == 'motor':
            self._q, self._qd = self._drives['q'], self._drives['qd']
        self.reset()

    def reset(self) -> Sample:
        """
        Start afresh at home, at rest, at time 0, and return sample 0.

        The same seed and torques give the same samples again, bit for bit.
        """
        config = self.config
        sources = np.random.SeedSequence(self._seed).spawn(1 + len(config.met))
        generators = [np.random.default_rng(source) for source in sources]
        self._sensor = WrenchSensor(config.sensor, config.substep, generators[0])
        self.contacts = Contacts(config, self.description, self.model, generators[1:])
        self._hands['force'] = 0.0
        self._wrist_push, self._tool_push = (Pushes(hand) for hand in self._hands)
        for i, (begin, length) in enumerate(
            zip(config.push_start, config.push_duration)
        ):
            self._wrist_push.add(
                round(begin * self._rate),
                round((begin + length) * self._rate),
                config.push_force_world[3 * i : 3 * i + 3],
            )
        contacts = self.contacts
        acting = (
            self.arm.motion,
            self._torques,
            self._limit,
            link_records(self.model),
            self._drives,
            contacts.surfaces,
            contacts.profiles,
            self._hands,
            self._pushes,
            config.substep,
        )
        self._act = partial(act_on_arm, *acting)
        self._tick = 0
        self.arm.reset(self._home)
        self.payload = 0.0
        self._carry(0.0)
        if len(self._drives):  # springs wound up
            self._drives['q'] = (
                self._home + self.initial_torque / self._drives['stiffness']
            )
            self._drives['qd'] = 0.0
        self._sensor.read(self._static_wrench()[np.newaxis])
        self._motor[:] = self.initial_torque
        return self._sample()

    def step(self, torque: Vector) -> Sample:
        """
        Apply torques for one control period, shape (n,) [N m]; return the sample at its end.

        They are clipped to the limits. Raises RunError if a torque is not finite, ShapeError if
        there is not one per joint.
        """
        require_shape('torque', torque, self._limit.shape)
        self._motor[:] = torque
        if self._carried != self.payload:
            most = PICK_UP_RATE / self._rate
            self._carry(
                min(max(self.payload, self._carried - most), self._carried + most)
            )
        self._wrist_push.start_period(self._tick)
        self._tool_push.start_period(self._tick)
        self._sensor.read(np.array(self._advance()).reshape(-1, 6))
        self._tick += 1
        return self._sample()

    def _carry(self, payload: float) -> None:
        """Let the tool weigh so much more than its own mass [kg]."""
        self._carried, tool = payload, self.description.tool
        self.arm.set_tool_mass(tool.mass + payload)
        frame = self.model.frames[self.model.getFrameId(TOOL_LINK)]
        load = pin.Inertia(
            payload, frame.placement.act(np.array(tool.com.position)), np.zeros((3, 3))
        )
        self.model.inertias[frame.parentJoint] = (
            self._bare + load if payload else self._bare
        )

    def scale_torque_limit(self, factor: float) -> None:
        """Multiply the torque limits of the drives, unknown to the controller."""
        self._limit *= factor

    def push(self, force_world: Vector, duration: float, *, tool: bool = False) -> None:
        """
        Push the arm with a force, shape (3,) [N], from the next control period on, for a time [s].

        At the operational point, or at `tool_push_link`, beyond the wrist sensor, which reads it.
        """
        pushes = self._tool_push if tool else self._wrist_push
        pushes.add(
            self._tick, self._tick + max(1, round(duration * self._rate)), force_world
        )

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
                raise RunError(
                    f'joint torque at tick {self._tick}: expected finite numbers, '
                    f'got {self._motor.tolist()}'
                )
            if rigid is not None:
                rigid.advance(self._motor, self._sum, arm.q, arm.qd, link_side)
            if count:
                arm.apply_pushes(self._pushes.tolist()[:count])
            wrenches += arm.step(link_side)
            if arm.native_forces is not None:
                self.contacts.pressed[:] = arm.native_forces
        return wrenches

    def _static_wrench(self) -> Vector:
        """Return what the sensor reads at rest at home: the weight it carries, held."""
        model, data, arm = self.model, self.model.createData(), self.description
        pin.framesForwardKinematics(model, data, self._home)
        rotation = data.oMf[model.getFrameId(SENSOR_FRAME)].rotation
        carried = ToolConfig(mass=arm.carried_mass, com_sensor=arm.carried_com)
        return predict_weight_reading(
            rotation, carried, np.array(self.config.gravity_world)
        )

    def _sample(self) -> Sample:
        return Sample(
            self._q.copy(),
            self._qd.copy(),
            self._motor.copy(),
            self._sensor.reading.copy(),
            self._sensor.filtered.copy(),
            self.contacts.alpha,
        )


def make_engine_arm(config: PlantConfig, arm: Arm) -> EngineArm:
    """Return the engine of a plant, loaded here alone; ConfigError if it is not installed."""
    if config.engine == 'pybullet':
        from sim_bridge.bullet_arm import BulletArm

        return BulletArm(arm, config.gravity_world, config.substep)
    try:
        from sim_bridge.mujoco_arm import MujocoArm
    except ImportError as error:
        raise ConfigError(
            'engine', 'pybullet, or mujoco, by pip install mujoco', f'mujoco ({error})'
        ) from None
    return MujocoArm(arm, config)


def _require_fit(config: PlantConfig, model: pin.Model) -> None:
    if len(config.home) != model.nv:
        raise ConfigError('home', f'{model.nv} values, one per joint', len(config.home))
    carriers = {
        frame.name: frame.parentJoint
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint > 0
    }
    tool = [name for name, joint in carriers.items() if joint == carriers[SENSOR_FRAME]]
    links = {
        f'surfaces.{name}.tip_link': (config.surfaces[name].tip_link, carriers)
        for name in config.met
    }
    for field, (link, known) in {
        **links,
        'tool_push_link': (config.tool_push_link, tool),
    }.items():
        if link not in known:
            raise ConfigError(field, f'one of {", ".join(sorted(known))}', f"'{link}'")
