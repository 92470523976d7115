"""What surfaces look like is what is felt of them."""

from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest
from sim_bridge.config import SurfaceConfig
from sim_bridge.surface import build_surfaces, mean_depth
from sim_bridge.surface_patch import half_size, SIZE, surface_patch, SurfaceMarkers, THICKNESS

PLACE = np.array([0.3, -0.2, 0.5])
NORMALS = [(1.0, 0.0, 0.0), (0.6, 0.0, -0.8)]


@pytest.mark.parametrize('normal', NORMALS)
@pytest.mark.parametrize(('shape', 'radius'), [
    ('plane', 0.0), ('cylinder', 1.0), ('cylinder', -0.5), ('sphere', 0.2), ('sphere', -1.0)])
def test_patch_is_a_closed_slab_on_the_mean_surface(normal, shape, radius):
    patch = surface_patch(np.array(normal), radius, ball=shape == 'sphere')
    front = patch.vertices[:len(patch.vertices) // 2]
    config = SurfaceConfig(
        tip_link='tip', point_world=tuple(PLACE), normal_world=normal, shape=shape, radius=radius)
    surface = build_surfaces([config], [np.random.default_rng(0)])[0]
    for vertex in front:
        surface['point'][0] = PLACE + vertex
        assert mean_depth(surface[0]) == pytest.approx(0.0, abs=1e-12)
    # Every edge belongs to two faces, which run along it in opposite directions.
    edges = {(int(f[k]), int(f[(k + 1) % 3])) for f in patch.faces for k in range(3)}
    assert len(edges) == 3 * len(patch.faces) and {(b, a) for a, b in edges} == edges
    corners = patch.vertices[patch.faces]
    volume = np.einsum('ij,ij->', corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    area = 4.0 * np.prod(half_size(radius, ball=shape == 'sphere'))
    assert volume == pytest.approx(THICKNESS * area, rel=1e-9)
    assert area <= np.prod(SIZE) and (abs(radius) < 0.5 or area == np.prod(SIZE))


@pytest.mark.parametrize(('scenario', 'names', 'shown'), [
    ('plane', ['face'], 0), ('moving_surface', ['table', 'board'], 25)])
def test_markers_show_a_slab_for_each_contact_where_it_is(scenario, names, shown):
    config = resolve(scenario, plant='rigid').plant
    markers = SurfaceMarkers(config, rate=500.0)
    assert sum(markers.due(tick) for tick in range(1, 501)) == shown
    places = np.arange(3.0 * len(config.met)).reshape(-1, 3)
    message = markers.message(1_500_000_000, places)
    assert [marker.ns.rpartition('/')[2] for marker in message.markers][:len(names)] == names
    for marker, name in zip(message.markers, config.drawn.values()):
        at = marker.pose.position
        assert [at.x, at.y, at.z] == places[config.met.index(name)].tolist()
