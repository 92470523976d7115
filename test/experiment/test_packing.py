"""Series packed for a page, and unpacked here by what the format says; and thinned out."""

import base64
import zlib

from multicontact_control.experiment.packing import envelope, LEVELS, pack, UNKNOWN
import numpy as np
import pytest


def unpacked(packed):
    """Return time and series."""
    n = packed['length']
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed['data'])), dtype=np.uint8)
    series = []
    for k, (step, logarithmic) in enumerate(zip(packed['steps'], packed['logarithmic'])):
        low = planes[4 * n * k:4 * n * (k + 1)].reshape(4, n).astype(np.int64)
        zigzag = low[0] + (low[1] << 8) + (low[2] << 16) + (low[3] << 24)
        change = np.where(zigzag % 2, -(zigzag + 1) // 2, zigzag // 2)
        codes = (np.cumsum(change) + (1 << 31)) % (1 << 32) - (1 << 31)
        values = 10.0 ** (step * codes) if logarithmic else step * codes
        series.append(np.where(codes == UNKNOWN, np.nan, values))
    return series


def test_series_come_back_to_a_part_of_what_they_span():
    rng = np.random.default_rng(1)
    time = np.arange(3000) / 500.0
    noise = 10.0 + rng.standard_normal(3000)
    spike = np.zeros(3000)
    spike[1234] = 50.0
    gaps = np.where(rng.random(3000) < 0.3, np.nan, noise)
    found = unpacked(pack(time, [noise, spike, gaps]))
    np.testing.assert_allclose(found[0], time, atol=1e-9)
    span = np.subtract(*np.percentile(noise, (99.5, 0.5)))
    assert np.abs(found[1] - noise).max() <= 0.5 * span / LEVELS
    assert found[2][1234] == pytest.approx(50.0, rel=1.0 / LEVELS)
    assert not np.delete(found[2], 1234).any()
    np.testing.assert_array_equal(np.isnan(found[3]), np.isnan(gaps))


def test_logarithmic_series_come_back_relative_to_their_size():
    values = np.array([1e-3, 0.6, 100.0, np.nan, 0.0, -1.0, 1e4])
    _, found = unpacked(pack(np.arange(7.0), [values], logarithmic=True))
    assert np.flatnonzero(np.isnan(found)).tolist() == [3, 4, 5]
    known = [0, 1, 2, 6]
    np.testing.assert_allclose(found[known], values[known], rtol=3e-3)


@pytest.mark.parametrize('values', [
    [np.nan, np.nan], [7.0, 7.0], [0.0, 0.0], [1e308, -1e308], [5e-324, 0.0],
    [np.inf, 1.0], [1e9, 1e9 + 1.0]])
def test_strange_series_are_packed(values):
    values = np.array(values)
    _, found = unpacked(pack(np.arange(2.0), [values]))
    known = np.isfinite(values)
    np.testing.assert_array_equal(np.isnan(found), ~known)
    np.testing.assert_allclose(found[known], np.clip(values, -1e100, 1e100)[known],
                               rtol=1e-3, atol=1e-6)


def test_packed_is_far_smaller_than_its_numbers():
    values = np.random.default_rng(2).standard_normal(20000)
    packed = pack(np.arange(20000) / 500.0, [values, np.repeat([2.0, 10.0], 10000)])
    assert len(packed['data']) < 2.5 * 20000  # as JSON, time and noise are 15 letters each


def test_envelope_keeps_every_peak_and_its_place():
    time = np.arange(10001) / 500.0
    values = np.sin(time)
    values[4321] = 50.0
    values[777] = -40.0
    x, (y,), size = envelope(time, [values], 200)
    assert len(x) == len(y) <= 202 and size == 101
    assert y.max() == 50.0 and y.min() == -40.0
    assert (np.diff(x) >= 0.0).all()
    assert abs(x[y.argmax()] - time[4321]) <= size / 500.0
    # In their order: what rises within a stretch rises in what is left of it.
    assert (np.diff(envelope(time, [time], 200)[1][0]) >= 0.0).all()


def test_envelope_leaves_short_series_and_what_is_known():
    values = np.array([np.nan, 1.0, np.inf, 2.0] + [np.nan] * 8)
    time = np.arange(12.0)
    x, (y,), size = envelope(time, [values], 12)
    assert size == 1 and x is time
    x, (y,), size = envelope(time, [values], 6)
    assert size == 4
    np.testing.assert_array_equal(y, [1.0, 2.0, np.nan, np.nan, np.nan, np.nan])
