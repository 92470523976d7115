"""Passes along paths that are made to have known ones, of simulated runs, and on the page."""

from dataclasses import replace
import re

from canonical_runs import run_of
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.files import replace_json_file
from multicontact_control.judging import figure_files, report
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.passes import RunPasses, write_passes
from multicontact_control.judging.path_maps import draw_maps
from multicontact_control.judging.results import load_run
from multicontact_control.judging.run_folders import prepare_run_folder
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.scenario import NO_PLANT, resolve
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from synthetic_run import perfect_run

START = 3.0  # s, of the paths below
SPEED = 0.1  # m/s
MU = 0.3
WORK = 'friction_work_all_contacts_j'


@pytest.fixture(scope='module')
def setup():
    """Return a table that is pressed, with 15 N from 4 s on, in a run of 12 s."""
    return resolve('circle', plant='rigid', duration=12.0)


def along(corners, speed=SPEED):
    """Return the path along straight lines with sharp corners, over the way [m]."""
    corners = np.array(corners)
    ways = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))

    def place(time):
        x, y = (np.interp(speed * time, ways, column) for column in corners.T)
        return x, y

    return place


def circle(radius, frequency, turns):
    """Return the path round a circle."""

    def place(time):
        angle = 2.0 * np.pi * np.clip(frequency * time, 0.0, turns)
        return radius * (1.0 - np.cos(angle)), radius * np.sin(angle)

    return place


def sine(time):
    return 0.1 * np.sin(np.pi * np.clip(time, 0.0, 4.5)), 0.0 * time


def set_points(time):
    """Return places on a line that is commanded 20 times a second, and held in between."""
    return SPEED * np.floor(np.clip(time, 0.0, 3.0) * 20.0) / 20.0, 0.0 * time


def along_path(data, path, height=None):
    """Return a run whose commanded and measured place follows a path on the table."""
    position = data.position_des.copy()
    position[:, 0], position[:, 1] = path(data.time - START)
    if height is not None:
        position[:, 2] = height
    return replace(data, position=position, position_des=position.copy())


def table_of(data, setup):
    return RunPasses(RunMetrics(data, setup)).tabulate()


ZIGZAG = along([(0.0, 0.0), (0.2, 0.0), (0.0, 0.0), (0.2, 0.0), (0.1, 0.0)])
RASTER = along([(0.0, 0.0), (0.2, 0.0), (0.2, 0.1), (0.0, 0.1)])
OBLIQUE = along([(0.0, 0.0), (0.2, 0.0), (0.3, 0.1), (0.3, 0.3)])
TURN = 2.0 * np.pi * 0.05


@pytest.mark.parametrize(
    ('path', 'lengths'),
    [
        (ZIGZAG, [0.2, 0.2, 0.2, 0.1]),
        (RASTER, [0.2, 0.1, 0.2]),
        # 45 degrees are no corner.
        (OBLIQUE, [0.4 + 0.1 * np.sqrt(2.0)]),
        (sine, [0.1, 0.2, 0.2, 0.2, 0.2]),
        (circle(0.05, 0.4, 2.0), [TURN, TURN]),
        # It turns as fast as a corner does.
        (circle(0.01, 2.0, 3.0), [0.2 * TURN] * 3),
        (set_points, [0.3]),
        (along([(0.0, 0.0), (0.004, 0.0)]), []),
    ],
)
def test_path_is_cut_into_passes_of_known_lengths(setup, path, lengths):
    data = along_path(perfect_run(setup), path)
    found = RunPasses(RunMetrics(data, setup)).passes
    assert [each.length for each in found] == pytest.approx(lengths, abs=3e-3)
    for before, after in zip(found, found[1:]):
        assert before.end <= after.begin


def test_motion_along_the_normal_and_without_a_force_is_no_path(setup):
    """A tool that follows a surface goes along its normal; one without contact is on its way."""
    data = perfect_run(setup)
    sinking = along_path(data, lambda time: (0.0, 0.0), 0.02 * data.time)
    assert table_of(sinking, setup).empty
    by_topic = replace(setup, commanded_by_topic=True)
    command = np.zeros_like(data.command)
    free = replace(along_path(data, ZIGZAG), command=command)
    assert table_of(free, by_topic).empty
    command[data.time >= START + 3.0] = 12.0
    pressed = table_of(free, by_topic)
    assert pressed['length_m'].to_list() == pytest.approx([0.1, 0.2, 0.1], abs=3e-3)
    assert pressed['command_mean_n'].to_list() == [12.0] * 3


def test_contact_has_rows_only_where_a_force_is_asked_of_it():
    two = resolve('quick', plant='rigid', duration=12.0)
    data = along_path(perfect_run(two), ZIGZAG)
    data.command[:] = 12.0
    data.command[data.time < START + 4.0, 1] = 0.0
    table = table_of(data, replace(two, commanded_by_topic=True))
    rows = list(zip(table['pass'], table['contact']))
    alone = [(1, 'table'), (2, 'table')]
    both = [(3, 'table'), (3, 'board'), (4, 'table'), (4, 'board')]
    assert rows == alone + both


def test_times_and_forces_of_a_pass_are_those_that_it_was_made_with(setup):
    """On each leg of 2 s a quarter 2 N too high, and one too low; a tenth without contact."""
    data = along_path(perfect_run(setup), ZIGZAG)
    data.alpha_true[:] = 15.0
    since_leg = (data.time - START) % 2.0
    data.alpha_true[since_leg < 1.0] = 17.0
    data.alpha_true[since_leg < 0.5] = 13.0
    third = (data.time >= START + 4.0) & (data.time < START + 6.0)
    data.alpha_true[third & (since_leg >= 1.8)] = 0.0
    command = setup.commanded(data.time)
    assert (command[data.time > 4.0] == 15.0).all()
    table = table_of(data, setup)
    second, last = table.iloc[1], table.iloc[2]
    assert second['begin_s'] == pytest.approx(START + 2.0, abs=0.02)
    assert second['end_s'] == pytest.approx(START + 4.0, abs=0.02)
    assert second['mean_speed_m_s'] == pytest.approx(SPEED, rel=0.02)
    assert second['command_mean_n'] == 15.0
    assert second['force_mean_n'] == pytest.approx(15.0, abs=0.03)
    assert second['force_std_n'] == pytest.approx(2.0 * np.sqrt(0.5), abs=0.02)
    assert second['force_min_n'] == 13.0
    assert second['force_max_n'] == 17.0
    assert second['outside_band_share'] == pytest.approx(0.5, abs=0.01)
    assert second['no_contact_share'] == 0.0
    assert last['no_contact_share'] == pytest.approx(0.1, abs=0.01)
    assert last['outside_band_share'] == pytest.approx(0.6, abs=0.01)


def test_samples_that_were_not_recorded_are_left_out(setup):
    """Also 0.3 s of them, and single ones: a pass goes on across them."""
    data = along_path(perfect_run(setup), ZIGZAG)
    data.alpha_true[:] = 15.0
    lost = (data.time > START + 2.5) & (data.time < START + 2.8)
    lost[::7] = True
    data.alpha_true[lost] = 99.0
    for values in vars(data).values():
        if isinstance(values, np.ndarray) and values.ndim == 2:
            values[lost] = np.nan
    table = table_of(data, setup)
    assert table['length_m'].to_list() == pytest.approx([0.2, 0.2, 0.2, 0.1], abs=3e-3)
    assert table['force_max_n'].max() == 15.0
    assert (table['outside_band_share'].iloc[1:] == 0.0).all()


def sensed(data, setup, force_world, torque_world):
    """Return a run whose sensor reads a wrench at the operational point, (m, 3) each."""
    config = setup.controller
    posture = np.random.default_rng(0).uniform(-1.0, 1.0, len(data.joint_names))
    robot = RobotModel(config.robot, setup.urdf_dir)
    robot.compute(posture, np.zeros_like(posture))
    terms = robot.terms
    in_operational = terms.rotation.T @ terms.sensor_rotation
    lever = terms.rotation.T @ (terms.sensor_position - terms.position)
    operational = Rotation.from_quat(data.quaternion)
    axes = operational * Rotation.from_matrix(in_operational)
    weight = config.tool.mass * np.array(config.robot.gravity_world)
    at_com = np.cross(axes.apply(config.tool.com_sensor), weight)
    forces = force_world - weight
    torques = torque_world - np.cross(operational.apply(lever), force_world) - at_com
    read = np.hstack([axes.inv().apply(forces), axes.inv().apply(torques)])
    return replace(data, wrench=read + np.array(config.tool.bias_sensor))


@pytest.mark.parametrize(('robot', 'tilt'), [('puma', 0.0), ('panda', 0.2)])
def test_work_of_friction_is_mu_times_force_times_way(robot, tilt):
    """Also on a surface that lies otherwise than the controller is told."""
    setup = resolve('circle', robot=robot, plant='rigid', duration=12.0)
    data = along_path(perfect_run(setup), ZIGZAG)
    bias = (0.4, -0.3, 0.2, 0.01, 0.02, -0.03)
    tool = setup.controller.tool.model_copy(update={'bias_sensor': bias})
    controller = setup.controller.model_copy(update={'tool': tool})
    arm = replace(setup, controller=controller)
    x = data.position[:, 0]
    data.position[:, 2] = np.tan(tilt) * x
    quaternion = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_quat()
    data.quaternion[:] = quaternion
    tangent = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    direction = np.sign(np.gradient(x))[:, None]
    force = 15.0 * (normal + MU * direction * tangent)
    table = table_of(sensed(data, arm, force, np.zeros_like(force)), arm)
    ways = np.array([0.2, 0.2, 0.2, 0.1]) / np.cos(tilt)
    assert table[WORK].to_list() == pytest.approx(list(MU * 15.0 * ways), rel=0.03)


def test_work_counts_the_turning_of_the_tool():
    """2 N m about x, while the tool turns by 0.1 rad on each leg, and 10 N across the motion."""
    setup = resolve('circle', robot='panda', plant='rigid', duration=12.0)
    data = along_path(perfect_run(setup), ZIGZAG)
    angle = 0.05 * np.clip(data.time - START, 0.0, 7.0)
    turn = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    data.quaternion[:] = turn.as_quat()
    force = np.tile([0.0, 10.0, 0.0], (data.ticks, 1))
    torque = np.tile([2.0, 0.0, 0.0], (data.ticks, 1))
    table = table_of(sensed(data, setup, force, torque), setup)
    assert table[WORK].to_list() == pytest.approx([0.2, 0.2, 0.2, 0.1], rel=0.05)


def test_recording_without_truth_or_model_has_passes_of_measured_forces(setup):
    """No normals are known, nor how the sensor is mounted: the work of friction is not, either."""
    data = along_path(perfect_run(setup), RASTER)
    data.alpha_true[:] = np.nan
    data.alpha_meas[:] = 9.0
    data.command[:] = 10.0
    robot = setup.controller.robot.model_copy(update={'urdf': ''})
    controller = setup.controller.model_copy(update={'robot': robot})
    known = {'controller': controller, 'plant': NO_PLANT, 'commanded_by_topic': True}
    recorded = replace(setup, **known)
    table = table_of(data, recorded)
    assert table['length_m'].to_list() == pytest.approx([0.2, 0.1, 0.2], abs=3e-3)
    assert not table['force_is_true'].any()
    assert table['force_mean_n'].to_list() == [9.0] * 3
    assert table['command_mean_n'].to_list() == [10.0] * 3
    assert table[WORK].isna().all()
    ((name, sheet),) = draw_maps(RunMetrics(data, recorded), 'a recording')
    assert name == 'map_table'
    assert [axes.get_aspect() for axes in sheet.axes[:1]] == [1.0]
    unseen = replace(data, position=np.full_like(data.position, np.nan))
    assert list(draw_maps(RunMetrics(unseen, recorded), 'a recording')) == []


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ('scenario', 'plant', 'lengths'),
    [
        ('quick', 'rigid', [0.15, 0.3, 0.207]),
        pytest.param('circle', 'puma', [0.44, 0.44], marks=SLOW),
        # The way to the first of the waypoints, and five legs of 0.18 m with half of each bend.
        pytest.param(
            'waypoints', 'puma', [0.098, 0.19, 0.203, 0.203, 0.203, 0.19], marks=SLOW
        ),
    ],
)
def test_simulated_surfaces_take_the_work_of_their_friction(scenario, plant, lengths):
    """The normal of `waypoints` is 10 degrees off that of the controller; mu is 0.1 everywhere."""
    setup = resolve(scenario, plant=plant)
    run = RunMetrics(run_of(setup).data, setup)
    table = table_of(run.data, setup)
    names = setup.controller.contact_names
    assert table['contact'].to_list() == list(names) * len(lengths)
    of_first = table[table['contact'] == names[0]]
    assert of_first['length_m'].to_list() == pytest.approx(lengths, abs=5e-3)
    assert table['pass'].max() == len(lengths)
    assert table['force_is_true'].all()
    assert (table['no_contact_share'] == 0.0).all()
    assert (table['outside_band_share'] < 0.25).all()
    assert table['force_mean_n'].to_numpy() == pytest.approx(
        table['command_mean_n'].to_numpy(), abs=0.2
    )
    forces = table.groupby('pass')['force_mean_n'].sum().to_numpy()
    friction = 0.1 * forces * of_first['length_m'].to_numpy()
    assert of_first[WORK].to_numpy() == pytest.approx(friction, rel=0.08)
    assert of_first[WORK].sum() == pytest.approx(friction.sum(), rel=0.02)


@pytest.fixture
def folder(tmp_path):
    """Return the folder of a run along a path, without the files of its passes."""
    setup = resolve('quick', plant='rigid')
    data = run_of(setup).data
    folder = tmp_path / 'run'
    setup.write(folder / 'config')
    data.save(folder)
    summary = summarise_run(RunMetrics(data, setup), mode='in_process', timing={})
    replace_json_file(folder / 'summary.json', summary)
    return folder


def test_report_has_table_and_maps_of_the_passes(folder, monkeypatch):
    monkeypatch.setattr(figure_files, 'FIGURE_FORMATS', ('png',))
    run = load_run(folder)
    paths = report.write_report([run], folder)
    table = pd.read_csv(folder / 'passes.csv')
    pd.testing.assert_frame_equal(table, pd.read_parquet(folder / 'passes.parquet'))
    assert len(table) == 6
    maps = [path.name for path in paths if path.name.startswith('map_')]
    assert maps == ['map_table.png', 'map_board.png']
    page = paths[0].read_text(encoding='utf-8')
    assert page.count('<img') == 2
    (shown,) = re.findall('<div class=scroll>.*?</div>', page)
    cells = re.findall('<td.*?>(.*?)</td>', shown)
    assert len(cells) == 6 * shown.count('<th')
    for force in table['force_max_n']:
        assert f'{force:.2f}' in cells
    assert not list(folder.glob('*.partial'))
    # What it left is what may be replaced by another run.
    prepare_run_folder(folder, 'quick', overwrite=True, now=None)
    assert list(folder.iterdir()) == []


@SLOW
def test_reports_of_several_runs_have_the_passes_of_each(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(figure_files, 'FIGURE_FORMATS', ('png',))
    run = load_run(folder)
    runs = [run._replace(folder=tmp_path / name) for name in 'ab']
    report.write_report(runs, tmp_path / 'out')
    for name in 'ab':
        assert (tmp_path / 'out' / 'figures' / name / 'passes.csv').is_file()
    assert not (tmp_path / 'out' / 'passes.csv').exists()


def test_run_without_a_path_leaves_no_table(tmp_path):
    still = resolve('step', plant='rigid')
    assert still.scenario.reference.motion is None
    run = RunMetrics(run_of(still).data, still)
    assert write_passes(run, tmp_path).empty
    assert list(tmp_path.iterdir()) == []
    assert list(draw_maps(run, 'at rest')) == []
