"""
Simulate the FR3 of config/robots with its tool before table and board, behind libfranka's port.

`python docs/fr3_simulator.py` runs franky-sim (extra `[franka]`) with a scene made from
config/robots/fr3.yaml, and is the driver of its wrist sensor: the wrench goes to the topic
`franka_bridge/wrench` at 1 kHz. The forces between tips and surfaces, which no robot knows, go to
`fr3_simulator/contact_forces` at 50 Hz. SIGUSR1 presses the user stop, or releases it. Ctrl-C
ends it.

franka-sim, which also aborts at the limits of the real arm, needs an environment of its own. It
gets the scene as a file: `--write FILE` here, `--read FILE` there.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import sys
from typing import Any
import xml.etree.ElementTree as ElementTree

from geometry_msgs.msg import WrenchStamped
import mujoco
import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

IMPEDANCE = 0.01  # of the contacts, as in sim_bridge/mujoco_arm.py
TIP_RADIUS = 0.005  # m
PROFILE = Path(__file__).resolve().parents[1] / 'config' / 'fastdds.xml'
NOISE = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])  # N, N m, of the sensor, rms
FORCE_DIVIDER = 20  # steps for each message of contact forces


def numbers(values: Any) -> str:
    """Return numbers as MJCF has them."""
    return ' '.join(f'{value:.9g}' for value in values)


def write_scene(simulator: Any, prefix: str, robot: Any) -> None:
    """Put sensor and tool in the place of the hand, and a surface before each tip at home."""
    from sim_bridge.arm import SENSOR_FRAME
    from sim_bridge.posture import frame_pose

    arm, plant = robot.arm, robot.plant_values('')
    elements = {element.get('name'): element for element in simulator.worldbody.iter()}
    hand, face = (
        elements[f'{prefix}hand'],
        np.array([0.0, 0.0, robot.file.tool.face_offset]),
    )
    for element in list(hand):
        if element.tag in ('geom', 'inertial'):
            hand.remove(element)
    for finger in hand:  # its joints are asked for
        for element in list(finger):
            if element.tag == 'geom':
                finger.remove(element)
        finger.find('inertial').attrib.update(mass='1e-5', diaginertia='1e-9 1e-9 1e-9')
    ElementTree.SubElement(
        hand,
        'inertial',
        mass=str(arm.carried_mass),
        pos=numbers(face + arm.carried_com),
        diaginertia=numbers(arm.tool.inertia),
    )
    ElementTree.SubElement(hand, 'site', name=SENSOR_FRAME, pos=numbers(face))
    simulator.scene.find('option').set('cone', 'elliptic')  # a pyramid would be stiffer
    pairs = simulator.scene.find('contact')
    turn = frame_pose(arm.model(), np.array(plant['home']), SENSOR_FRAME).rotation
    for name in plant['contact_names']:
        surface = plant['surfaces'][name]
        tip, normal = (
            np.array(arm.tips[surface['tip_link']]),
            np.array(surface['normal_world']),
        )
        free = {'contype': '0', 'conaffinity': '0'}
        ElementTree.SubElement(
            hand,
            'geom',
            type='capsule',
            size='0.004',
            mass='0',
            fromto=numbers([*face, *(face + tip)]),
            **free,
        )
        ElementTree.SubElement(
            hand,
            'geom',
            name=surface['tip_link'],
            type='sphere',
            size=str(TIP_RADIUS),
            mass='0',
            pos=numbers(face + tip - TIP_RADIUS * turn.T @ normal),
            **free,
        )
        ElementTree.SubElement(
            simulator.worldbody,
            'geom',
            name=name,
            type='plane',
            size='0.2 0.2 0.01',
            pos=numbers(surface['point_world']),
            zaxis=numbers(-normal),
            **free,
        )
        ElementTree.SubElement(
            pairs,
            'pair',
            name=name,
            geom1=name,
            geom2=surface['tip_link'],
            condim='3',
            friction='0.1 0.1 0 0 0',
            solimp=f'{IMPEDANCE} {IMPEDANCE} 0.001 0.5 1',
        )
    sensors = ElementTree.SubElement(simulator.scene, 'sensor')
    for kind in ('force', 'torque'):
        ElementTree.SubElement(sensors, kind, site=SENSOR_FRAME)
    custom = ElementTree.SubElement(
        simulator.scene, 'custom'
    )  # what MJCF has no words for
    for key, values in (
        ('home', plant['home']),
        (
            'stiffness',
            [plant['surfaces'][name]['stiffness'] for name in plant['contact_names']],
        ),
    ):
        ElementTree.SubElement(custom, 'numeric', name=key, data=numbers(values))


class Sensor:
    """The driver of the simulated sensor; called after each step of the physics."""

    def __init__(self, model: Any) -> None:
        os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE))
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('fr3_simulator', start_parameter_services=False)
        self._wrench = self._node.create_publisher(
            WrenchStamped, 'franka_bridge/wrench', 10
        )
        self._forces = self._node.create_publisher(
            JointState, 'fr3_simulator/contact_forces', 10
        )
        self._message = WrenchStamped()
        self._names = [model.pair(i).name for i in range(model.npair)]
        self._steps, self._random = 0, np.random.default_rng(0)
        # The force of a pair is (-b v - k r) / R, R = A (1 - d) / d; solref is (-k d, -b d).
        for i, stiffness in enumerate(model.numeric('stiffness').data):
            body = model.geom_bodyid[model.pair_geom2[i]]
            scale = model.body_invweight0[body, 0] * (1.0 - IMPEDANCE)
            model.pair_solref[i] = (-stiffness * scale, -0.01 * stiffness * scale)

    def publish(self, model: Any, data: Any) -> None:
        """Publish what the arm does to the tool, and now and then the forces of the contacts."""
        message = self._message
        values = (data.sensordata + NOISE * self._random.normal(size=6)).tolist()
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = values
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._wrench.publish(message)
        self._steps += 1
        if self._steps % FORCE_DIVIDER == 0:
            touch, forces = np.zeros(6), dict.fromkeys(self._names, 0.0)
            for i in range(data.ncon):
                geom = model.geom(int(data.contact[i].geom1)).name
                if geom in forces:
                    mujoco.mj_contactForce(model, data, i, touch)
                    forces[geom] += float(touch[0])
            truth = JointState(name=self._names, effort=list(forces.values()))
            truth.header.stamp = message.header.stamp
            self._forces.publish(truth)


def run_franky_sim(address: str, output: Path | None) -> None:
    """Run franky-sim on a port of this machine, or write its scene to a file."""
    from franky_sim import franka_robot_server, simulation_server
    from franky_sim.base_simulator import RobotParameters
    from franky_sim.franka_robot_protocol import (
        BaseCommand,
        MoveStatus,
        RobotCommand,
        RobotMode,
    )
    from franky_sim.mujoco_simulator import MujocoSimulator
    from sim_bridge.robots import find_robot

    robot = find_robot('fr3')
    arm, stopped = robot.arm, [False]
    flange = (
        arm.operational.transform.rotation
    )  # of the vendor's flange, in which its load is given
    face = np.array([0.0, 0.0, robot.file.tool.face_offset])
    with MujocoSimulator() as simulator:
        simulated = simulator.add_robot(
            robot.file.home,
            robot_parameters=RobotParameters(
                ee_mass=arm.carried_mass,
                ee_com=tuple(flange @ (face + arm.carried_com)),
                ee_inertia=tuple(np.diag(arm.tool.inertia).ravel()),
            ),
        )
        write_scene(simulator, 'robot0_', robot)
        if output is not None:
            output.write_text(ElementTree.tostring(simulator.scene, encoding='unicode'))
            return

        class Server(franka_robot_server.FrankaRobotServer):
            """With a user stop, which franky-sim lacks."""

            @property
            def robot_state(self) -> Any:
                mode = {'robot_mode': RobotMode.kUserStopped} if stopped[0] else {}
                return super().robot_state.replace(**mode)

            def press(self) -> None:
                """Press the user stop or release it; the arm then holds its position."""
                stopped[0] = not stopped[0]
                motion = self.current_motion_id
                if stopped[0] and motion:
                    self.stop_motion(send_preemption_signal=False)
                    BaseCommand.send_response(
                        self._tcp_socket,
                        RobotCommand.kMove,
                        motion,
                        MoveStatus.kPreemptedDueToActivatedSafetyFunctions,
                    )
                    self.reset_current_motion_id()
                print(
                    f'user stop {"pressed" if stopped[0] else "released"}', flush=True
                )

        simulation_server.FrankaRobotServer = Server
        with simulation_server.SimulationServer(simulator, [address]) as server:
            sensor = Sensor(simulator.model)
            simulator.register_post_step_callback(
                lambda sim: sensor.publish(sim.model, sim.data)
            )
            pressed = []
            signal.signal(signal.SIGUSR1, lambda *_: pressed.append(True))
            print(f'FR3 at {simulated.hostname}; Ctrl-C ends it', flush=True)
            while True:
                server.run_once()
                if pressed:
                    pressed.clear()
                    server.robot_servers[0].press()


def run_franka_sim(address: str, scene: Path) -> None:
    """Run franka-sim with a scene from a file; it aborts motions as the arm does."""
    from franka_sim import FrankaSimServer, mujoco_franka_sim

    os.environ['FR3_MJCF'] = str(scene)
    model = mujoco.MjModel.from_xml_path(str(scene))
    mujoco_franka_sim.ARM_INITIAL_Q = np.array(model.numeric('home').data)

    class Simulation(mujoco_franka_sim.MujocoFrankaSim):
        """With a sensor."""

        sensor: Sensor | None = None

        def initialize_simulation(self) -> None:
            super().initialize_simulation()
            self.sensor = Sensor(self.model)

        def _read_and_publish_state(self) -> None:
            super()._read_and_publish_state()
            if self.sensor is not None:
                self.sensor.publish(self.model, self.data)

    server = FrankaSimServer(
        host=address,
        physics_sim=Simulation(),
        enable_gripper=False,
        enforce_comm_constraints=True,
        enforce_motion_limits=True,
    )
    print(f'FR3 at {address}; Ctrl-C ends it', flush=True)
    try:
        server.start()
    finally:
        server.stop()


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or '').strip().partition('\n')[0]
    )
    parser.add_argument(
        '--address', default='127.0.0.1', help='IP address of the robot'
    )
    files = parser.add_mutually_exclusive_group()
    files.add_argument(
        '--write', type=Path, metavar='FILE', help='write the scene, and end'
    )
    files.add_argument(
        '--read', type=Path, metavar='FILE', help='run franka-sim with a scene'
    )
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if arguments.read:
            run_franka_sim(arguments.address, arguments.read.resolve())
        else:
            run_franky_sim(arguments.address, arguments.write)
    except KeyboardInterrupt:
        sys.exit(0)
    except OSError as error:  # of the port, as a rule
        sys.exit(f'{arguments.address}: {error}; another simulator may be running')


if __name__ == '__main__':
    main()
