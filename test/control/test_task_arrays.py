"""A task in records: copied when it is another one."""

from multicontact_control.control.reference import Reference, TaskArrays
from multicontact_control.dynamics.pose import Pose
from multicontact_control.records import CONTACT, TASK
import numpy as np


def make():
    tasks, contacts = np.zeros(1, dtype=TASK), np.zeros(2, dtype=CONTACT)
    return TaskArrays(tasks, contacts['active'], contacts['alpha_des']), tasks, contacts


def some_task(seed):
    random = np.random.default_rng(seed)
    return Reference(Pose(*(random.normal(size=size) for size in (3, (3, 3)))),
                     *random.normal(size=(2, 6)), random.random(2) > 0.5, random.random(2))


def test_task_is_copied_into_the_records():
    arrays, tasks, contacts = make()
    np.testing.assert_array_equal(arrays.reference().pose_des.rotation_world, np.eye(3))
    for seed in range(3):
        task = some_task(seed)
        arrays.take(task)
        for name, value in zip(('position', 'rotation', 'twist', 'acceleration'),
                               (*task.pose_des, *task[1:3])):
            np.testing.assert_array_equal(tasks[name][0], value)
        np.testing.assert_array_equal(contacts['active'], task.active)
        np.testing.assert_array_equal(contacts['alpha_des'], task.alpha_des)
        for found, value in zip(arrays.reference(), task):
            np.testing.assert_equal(found, value)


def test_same_task_again_is_copied_only_if_the_last_one_is_forgotten():
    arrays, tasks, contacts = make()
    task = some_task(0)
    arrays.take(task)
    tasks['twist'], contacts['alpha_des'] = 0.0, 0.0
    arrays.take(task)
    assert not tasks['twist'].any() and not contacts['alpha_des'].any()
    arrays.take(task._replace(alpha_des=np.full(2, 3.0)))
    np.testing.assert_array_equal(contacts['alpha_des'], 3.0)
    tasks['rotation'] = 0.0
    arrays.take(task)
    assert not tasks['rotation'].any()
    arrays.forget()
    arrays.take(task)
    np.testing.assert_array_equal(tasks['rotation'][0], task.pose_des.rotation_world)
    np.testing.assert_array_equal(tasks['twist'][0], task.twist_des)
    np.testing.assert_array_equal(contacts['alpha_des'], task.alpha_des)


def test_pose_stays_as_it_is_when_the_next_task_comes():
    arrays, *_ = make()
    arrays.take(some_task(0))
    pose = arrays.reference().pose_des
    arrays.take(some_task(1))
    np.testing.assert_equal(pose, some_task(0).pose_des)
