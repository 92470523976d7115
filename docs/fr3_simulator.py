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
from xml.etree.ElementTree import SubElement as add_element
from xml.etree.ElementTree import tostring

from geometry_msgs.msg import Vector3, WrenchStamped
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
UNTOUCHED = {'contype': '0', 'conaffinity': '0'}  # touches in its pairs alone


def format_numbers(values: Any) -> str:
    """
    Return numbers as MJCF has them, with blanks between and nine digits each.

    Nine digits leave a nanometre of a metre.
    """
    return ' '.join(f'{value:.9g}' for value in values)


def write_scene(simulator: Any, prefix: str, robot: Any) -> None:
    """
    Put sensor and tool in the place of the hand, and a surface before each tip at home.

    `simulator` is franky-sim's, whose MJCF is changed; `prefix` begins the names of its arm;
    `robot` is that of config/robots.
    """
    from sim_bridge.arm import SENSOR_FRAME
    from sim_bridge.posture import frame_pose

    arm = robot.arm
    plant = robot.plant_values('')
    face = np.array([0.0, 0.0, robot.file.tool.face_offset])
    hand = simulator.worldbody.find(f".//*[@name='{prefix}hand']")
    replace_hand(hand, arm, face)
    add_element(hand, 'site', name=SENSOR_FRAME, pos=format_numbers(face))
    simulator.scene.find('option').set('cone', 'elliptic')  # a pyramid would be stiffer
    turn = frame_pose(arm.model(), np.array(plant['home']), SENSOR_FRAME).rotation
    stiffnesses = []
    for name in plant['contact_names']:
        surface = plant['surfaces'][name]
        stiffnesses.append(surface['stiffness'])
        tip_name = surface['tip_link']
        tip = face + np.array(arm.tips[tip_name])
        normal = np.array(surface['normal_world'])
        add_tip(hand, tip_name, face, tip, turn.T @ normal)
        add_element(
            simulator.worldbody,
            'geom',
            name=name,
            type='plane',
            size='0.2 0.2 0.01',
            pos=format_numbers(surface['point_world']),
            zaxis=format_numbers(-normal),
            **UNTOUCHED,
        )
        add_element(
            simulator.scene.find('contact'),
            'pair',
            name=name,
            geom1=name,
            geom2=tip_name,
            condim='3',
            friction='0.1 0.1 0 0 0',
            solimp=f'{IMPEDANCE} {IMPEDANCE} 0.001 0.5 1',
        )
    sensors = add_element(simulator.scene, 'sensor')
    for kind in ('force', 'torque'):
        add_element(sensors, kind, site=SENSOR_FRAME)
    custom = add_element(simulator.scene, 'custom')  # what MJCF has no words for
    add_element(custom, 'numeric', name='home', data=format_numbers(plant['home']))
    add_element(custom, 'numeric', name='stiffness', data=format_numbers(stiffnesses))


def replace_hand(hand: Any, arm: Any, face: Any) -> None:
    """
    Take shapes and mass off hand and fingers, and give the hand the mass of the tool.

    `face` is where the tool begins, in the frame of the hand, shape (3,) [m]. The fingers stay,
    with next to no mass: franky-sim asks for their joints.
    """
    remove_elements(hand, 'geom', 'inertial')
    for finger in hand:  # their joints are asked for
        remove_elements(finger, 'geom')
        finger.find('inertial').attrib.update(mass='1e-5', diaginertia='1e-9 1e-9 1e-9')
    add_element(
        hand,
        'inertial',
        mass=str(arm.carried_mass),
        pos=format_numbers(face + arm.carried_com),
        diaginertia=format_numbers(arm.tool.inertia),
    )


def remove_elements(parent: Any, *tags: str) -> None:
    """
    Remove the children of an element that have one of some tags; theirs go with them.

    Elements further down whose parents stay are left alone.
    """
    for element in list(parent):
        if element.tag in tags:
            parent.remove(element)


def add_tip(hand: Any, name: str, face: Any, tip: Any, normal: Any) -> None:
    """
    Add a rod from the tool's face to a tip, and the ball that touches at its end.

    Places are in the frame of the hand, shape (3,) [m]; `normal` points into the surface, and the
    ball touches at the tip.
    """
    add_element(
        hand,
        'geom',
        type='capsule',
        size='0.004',
        mass='0',
        fromto=format_numbers([*face, *tip]),
        **UNTOUCHED,
    )
    add_element(
        hand,
        'geom',
        name=name,
        type='sphere',
        size=str(TIP_RADIUS),
        mass='0',
        pos=format_numbers(tip - TIP_RADIUS * normal),
        **UNTOUCHED,
    )


class Sensor:
    """
    The driver of the simulated sensor; called after each step of the physics.

    It is a node of its own, on this machine alone. Its constructor also gives the surfaces the
    stiffness of config/robots, which MJCF cannot say in newtons per metre.
    """

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
        self._steps = 0
        self._random = np.random.default_rng(0)
        # The force of a pair is (-b v - k r) / R, R = A (1 - d) / d; solref is (-k d, -b d).
        for i, stiffness in enumerate(model.numeric('stiffness').data):
            body = model.geom_bodyid[model.pair_geom2[i]]
            scale = model.body_invweight0[body, 0] * (1.0 - IMPEDANCE)
            model.pair_solref[i] = (-stiffness * scale, -0.01 * stiffness * scale)

    def publish(self, model: Any, data: Any) -> None:
        """
        Publish what the arm does to the tool, and now and then the forces of the contacts.

        The wrench has white noise from a fixed seed, and the wall clock's stamp; the true forces
        come at a twentieth of its rate.
        """
        message = self._message
        reading = data.sensordata + NOISE * self._random.normal(size=6)
        force, torque = reading.reshape(2, 3).tolist()
        message.wrench.force = Vector3(x=force[0], y=force[1], z=force[2])
        message.wrench.torque = Vector3(x=torque[0], y=torque[1], z=torque[2])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._wrench.publish(message)
        self._steps += 1
        if self._steps % FORCE_DIVIDER == 0:
            forces = self._contact_forces(model, data)
            truth = JointState(name=list(forces), effort=list(forces.values()))
            truth.header.stamp = message.header.stamp
            self._forces.publish(truth)

    def _contact_forces(self, model: Any, data: Any) -> dict[str, float]:
        """Return the normal force of each pair [N], by its name."""
        forces = dict.fromkeys(self._names, 0.0)
        wrench = np.zeros(
            6
        )  # of one contact, along its own axes: the first is the normal
        for i in range(data.ncon):
            name = model.geom(int(data.contact[i].geom1)).name
            if name in forces:
                mujoco.mj_contactForce(model, data, i, wrench)
                forces[name] += float(wrench[0])
        return forces


def run_franky_sim(address: str, output: Path | None) -> None:
    """
    Run franky-sim at an address of this machine, or write its scene to a file and return.

    SIGUSR1 presses the user stop, or releases it. Raises OSError if another simulator has the
    port.
    """
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
    arm = robot.arm
    flange = (
        arm.operational.transform.rotation
    )  # the vendor's, in which the load is given
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
            output.write_text(tostring(simulator.scene, encoding='unicode'))
            return

        class Server(franka_robot_server.FrankaRobotServer):
            """
            With a user stop, which franky-sim lacks.

            A driver has to see it as on the real arm: as a mode, and as the end of the motion that
            it runs.
            """

            stopped = False

            @property
            def robot_state(self) -> Any:
                """Return the state, whose mode is `kUserStopped` while the stop is pressed."""
                state = super().robot_state
                if self.stopped:
                    state = state.replace(robot_mode=RobotMode.kUserStopped)
                return state

            def press_stop(self) -> None:
                """
                Press the user stop or release it; the arm then holds its position.

                A motion that runs is ended with `kPreemptedDueToActivatedSafetyFunctions`, as its
                client is to be told.
                """
                self.stopped = not self.stopped
                motion = self.current_motion_id
                if self.stopped and motion:
                    self.stop_motion(send_preemption_signal=False)
                    BaseCommand.send_response(
                        self._tcp_socket,
                        RobotCommand.kMove,
                        motion,
                        MoveStatus.kPreemptedDueToActivatedSafetyFunctions,
                    )
                    self.reset_current_motion_id()
                change = 'pressed' if self.stopped else 'released'
                print(f'user stop {change}', flush=True)

        simulation_server.FrankaRobotServer = Server
        with simulation_server.SimulationServer(simulator, [address]) as server:
            sensor = Sensor(simulator.model)
            simulator.register_post_step_callback(
                lambda stepped: sensor.publish(stepped.model, stepped.data)
            )
            presses: list[int] = []
            signal.signal(signal.SIGUSR1, lambda number, frame: presses.append(number))
            print(f'FR3 at {simulated.hostname}; Ctrl-C ends it', flush=True)
            while True:
                server.run_once()
                if presses:
                    presses.clear()
                    server.robot_servers[0].press_stop()


def run_franka_sim(address: str, scene: Path) -> None:
    """
    Run franka-sim with a scene from a file; it aborts motions as the real arm does.

    It checks the limits of commands and their rate, and needs neither this package nor its
    robots.
    """
    from franka_sim import FrankaSimServer, mujoco_franka_sim

    os.environ['FR3_MJCF'] = str(scene)
    model = mujoco.MjModel.from_xml_path(str(scene))
    mujoco_franka_sim.ARM_INITIAL_Q = np.array(model.numeric('home').data)

    class Simulation(mujoco_franka_sim.MujocoFrankaSim):
        """With a sensor, whose driver runs after each step."""

        sensor: Sensor | None = None

        def initialize_simulation(self) -> None:
            """Load the model as franka-sim does, then give it the sensor."""
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
    """Run what the command line asks for: one of the two simulators, or the file of a scene."""
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
