"""
An arm whose terms are known as numbers: what a pinocchio must find before it may control.

Its joints turn about axes that are askew, one link has its frame elsewhere, and the rotors have
inertia. The numbers come from Lagrange's equations, without pinocchio.
"""

from __future__ import annotations

from collections.abc import Mapping

from multicontact_control.arrays import Matrix, Vector
import numpy as np

URDF = """
<robot name="known">
  <link name="base"/>
  <joint name="first" type="revolute">
    <origin xyz="0.1 -0.2 0.3" rpy="0.2 -0.1 0.4"/>
    <parent link="base"/> <child link="upper"/> <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1" effort="100"/>
  </joint>
  <link name="upper">
    <inertial>
      <origin xyz="0.2 0.1 0.05" rpy="0.1 0.2 0.3"/> <mass value="3"/>
      <inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0.01" ixz="0.02" iyz="0.03"/>
    </inertial>
  </link>
  <joint name="second" type="revolute">
    <origin xyz="0.4 0 0.1" rpy="0.3 0 0"/>
    <parent link="upper"/> <child link="lower"/> <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="1" effort="100"/>
  </joint>
  <link name="lower">
    <inertial>
      <origin xyz="0.1 0 0.2"/> <mass value="2"/>
      <inertia ixx="0.1" iyy="0.15" izz="0.12" ixy="0.01" ixz="0.02" iyz="0.03"/>
    </inertial>
  </link>
  <joint name="mount" type="fixed">
    <origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/>
    <parent link="lower"/> <child link="tip"/>
  </joint>
  <link name="tip"/>
</robot>
"""
TIP = 'tip'
ARMATURE = (0.7, 0.4)  # kg m^2
GRAVITY = (0.0, 0.0, -9.81)  # m/s^2
POSITIONS = np.array([0.3, 0.7])  # rad
VELOCITIES = np.array([0.5, -1.1])  # rad/s
ROUNDING = 1e-9

# As `ModelTerms`: M is its upper triangle, J and dJ/dt are those of the tip, in world axes.
TERMS: dict[str, Matrix] = {
    'M': np.array(
        [
            [1.931775465650, 0.138188855279],
            [0.000000000000, 0.650000000000],
        ]
    ),
    'C v + g': np.array([2.358124188648, -3.317237825569]),
    'J': np.array(
        [
            [-0.545043384408, 0.076225132039],
            [0.405639413205, 0.220741777441],
            [0.084837099572, -0.213220066921],
            [-0.012754253196, -0.627502956403],
            [-0.221088583990, 0.642089129644],
            [0.975170327202, 0.440410705250],
        ]
    ),
    'dJ/dt': np.array(
        [
            [-0.022229677231, 0.173475507650],
            [-0.343988377487, 0.146054956134],
            [-0.078279069912, 0.213223946291],
            [0.000000000000, -0.361758022923],
            [0.000000000000, -0.303152576835],
            [0.000000000000, -0.073461553707],
        ]
    ),
}


def list_differences(found: Mapping[str, Vector]) -> list[str]:
    """
    Return the terms that differ from `TERMS`, each with its element that differs most.

    Parameters
    ----------
    found
        The terms by their names in `TERMS`, in the same shapes.

    """
    differences = []
    for name, known in TERMS.items():
        error = np.nan_to_num(np.abs(found[name] - known), nan=np.inf)
        worst = np.unravel_index(np.argmax(error), error.shape)
        if error[worst] > ROUNDING:
            place = ', '.join(map(str, worst))
            differences.append(
                f'{name}[{place}] = {found[name][worst]:.6g}, not {known[worst]:.6g}'
            )
    return differences
