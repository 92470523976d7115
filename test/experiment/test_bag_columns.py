"""Messages of a recording as columns: what is kept of them, and how much memory that takes."""

import tracemalloc
from types import SimpleNamespace

from foreign_bag import JOINTS, RATE, START, TOPICS, write_bag
from multicontact_control.experiment.bag import read_graph
from multicontact_control.experiment.bag_columns import (
    BagColumns,
    JOINT_STATE,
    MARKERS,
    POSE,
    WRENCH,
)
import numpy as np
import pytest

NAN = np.nan


def message(stamp=5, **fields):
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=stamp)),
                           **fields)


def joint_state(names, position=(), effort=(), **more):
    return message(name=list(names), position=position, velocity=(), effort=effort, **more)


def xyz(*values):
    return SimpleNamespace(**dict(zip('xyzw', values)))


def test_columns_are_those_asked_for_whoever_says_what_in_which_order():
    """Two nodes on one topic, and messages that lack names or numbers."""
    columns = BagColumns(JOINT_STATE)
    for k, (names, position) in enumerate([
            ((), ()), ('ab', (1.0, 2.0)), ('c', (3.0,)), ('ba', (4.0, 5.0)), ('ab', (6.0,)),
            ('a', (7.0, 8.0)), ('aa', (9.0, 10.0)), ('ab', (11.0, 12.0))]):
        columns.take(joint_state(names, position, stamp=k), 10 + k)
    assert len(columns) == 8 and columns.names == ('a', 'b')
    np.testing.assert_array_equal(columns.values('position', ('b', 'a', 'x')), [
        [NAN] * 3, [2.0, 1.0, NAN], [NAN] * 3, [4.0, 5.0, NAN], [NAN, 6.0, NAN],
        [NAN, 7.0, NAN], [NAN, 10.0, NAN], [12.0, 11.0, NAN]])
    assert np.isnan(columns.values('effort', ('a',))).all()
    assert columns.stamps.tolist() == [1_000_000_000 + k for k in range(8)]
    assert columns.published.tolist() == [10 + k for k in range(8)]


def test_wrenches_and_poses_have_names_of_their_own():
    felt, seen = BagColumns(WRENCH), BagColumns(POSE)
    felt.take(message(wrench=SimpleNamespace(force=xyz(1, 2, 3), torque=xyz(4, 5, 6))), 0)
    seen.take(message(pose=SimpleNamespace(
        position=xyz(1, 2, 3), orientation=xyz(4, 5, 6, 7))), 0)
    assert felt.values('wrench').tolist() == [[1, 2, 3, 4, 5, 6]]
    assert seen.values('point').tolist() == [[1, 2, 3]]
    assert seen.values('quaternion').tolist() == [[4, 5, 6, 7]]


def test_markers_are_where_they_are_by_the_end_of_their_names():
    columns = BagColumns(MARKERS)
    columns.take(SimpleNamespace(markers=[
        message(ns='surfaces/table', pose=SimpleNamespace(position=xyz(1, 2, 3)), stamp=7),
        message(ns='surfaces/board', pose=SimpleNamespace(position=xyz(4, 5, 6)))]), 0)
    assert columns.names == ('table', 'board') and columns.stamps.tolist() == [1_000_000_007]
    assert [columns.values(axis, ('board', 'table')).tolist() for axis in 'xyz'] == [
        [[4, 1]], [[5, 2]], [[6, 3]]]
    with pytest.raises(IndexError):
        columns.take(SimpleNamespace(markers=[]), 0)


@pytest.mark.parametrize(('damaged', 'published'), [
    (message(name=['a']), 0), (joint_state('a', ('x',)), 0), (joint_state('a', (1.0,)), 2 ** 64),
    (joint_state('a', (1.0,), stamp=2 ** 64), 0)])
def test_message_that_is_none_leaves_no_trace(damaged, published):
    columns = BagColumns(JOINT_STATE)
    columns.take(joint_state('a', (1.0,)), 0)
    with pytest.raises((AttributeError, TypeError, OverflowError)):
        columns.take(damaged, published)
    columns.take(joint_state('a', (2.0,)), 1)
    assert columns.values('position', ('a',)).tolist() == [[1.0], [2.0]]
    assert len(columns.stamps) == len(columns.published) == 2


@pytest.mark.ros
def test_memory_goes_with_the_numbers_that_are_kept(tmp_path):
    """Whole messages take more than 1 kB each; what is kept of one is 14 numbers or less."""
    bag = write_bag(tmp_path / 'bag', seconds=4.0)
    read_graph(bag)  # what is made of the definitions of messages is made once
    tracemalloc.start()
    try:
        found = read_graph(bag)
        held, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    count = sum(map(len, found.by_topic.values()))
    assert count == round(4.0 * RATE) * (len(TOPICS) - 1) + 1
    assert held / count < 250.0
    assert most / count < 1000.0  # with the definitions, and a chunk
    joints = found.by_topic['joint_states']
    assert joints.names == JOINTS and joints.stamps[0] == START
    np.testing.assert_array_equal(joints.values('position', JOINTS), 0.3)
