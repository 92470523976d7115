"""Checks of the law's answer, and what they make of one that contradicts the contacts."""

from arms import controller_config
from multicontact_control.config.contact import ALONG, FORCE
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.flags import (
    ANSWER_NOT_FINITE,
    ANSWER_REFUSED,
    FORCE_SIDEWAYS,
    FORCE_STRAY,
    OUTSIDE_WORKSPACE,
    SURFACE_PULLS,
)
from multicontact_control.paths import find_config_folder
from multicontact_control.records import CONTACT, CONTROL, JOINT
from multicontact_control.supervision.causes import (
    BITS,
    choose_severest_reaction,
    SEVERITY,
)
from multicontact_control.supervision.checks import (
    check_plausibility,
    configure_monitors,
    judge_answer,
    JUDGEMENT,
    plausibility_limits,
)
from multicontact_control.supervision.contacts import (
    APPROACHING,
    FREE,
    FREE_CONTACT,
    HOLDING,
    LOST,
)
import numpy as np
import pytest

CONFIG = controller_config(
    tool={'mass': 0.1},  # 2 N of inertia at 20 m/s^2
    watchdog={'friction_bound': 0.5},
    limits={
        'workspace_lower': [-1.0, -1.0, -1.0],
        'workspace_upper': [1.0, 1.0, 1.0],
    },
)
DOWN = np.array([0.0, 0.0, -1.0])
CEILING = CONFIG.contact_state.force_ceiling


class Answer:
    """An answer of the law with a force contact that presses down and its couple."""

    def __init__(self, force=0.0, state=HOLDING, sideways=0.0):
        self.judgement = np.zeros(1, dtype=JUDGEMENT)[0]
        self.judgement['plausibility'] = plausibility_limits(CONFIG)[0]
        self.control = np.zeros(1, dtype=CONTROL)[0]
        self.control['frame']['sensor_rotation'] = np.eye(3)
        self.joints = np.zeros(2, dtype=JOINT)
        self.contacts = np.zeros(2, dtype=CONTACT)
        self.contacts['config']['kind'] = FORCE, ALONG
        self.contacts['normal'][0] = DOWN
        self.states = np.array([FREE_CONTACT] * 2)
        self.states['state'] = state
        self.contacts['alpha_meas'][0] = force
        self.control['wrench'][:3] = force * DOWN
        self.control['wrench'][0] = sideways

    def check(self):
        return check_plausibility(
            self.judgement['plausibility'],
            self.control,
            self.joints,
            self.contacts,
            self.states,
            np.empty(6),
        )

    def judge(self, *, strict=True):
        return judge_answer(
            self.judgement,
            self.control,
            self.joints,
            self.contacts,
            self.states,
            strict,
        )


@pytest.mark.parametrize(
    ('state', 'force', 'found'),
    [
        (HOLDING, -3.9, 0),
        (HOLDING, -4.1, SURFACE_PULLS),
        (LOST, -5.9, 0),
        (LOST, -6.1, SURFACE_PULLS),
        (FREE, CEILING - 0.1, 0),
        (FREE, CEILING + 0.1, FORCE_STRAY),
        (APPROACHING, CEILING + 0.1, 0),
    ],
)
def test_force_is_plausible_up_to_the_bound_of_its_state(state, force, found):
    """4 N of pull, and 2 N more of the inertia of a tool that is braked after a loss."""
    assert Answer(force, state).check() == found


@pytest.mark.parametrize(
    ('baseline', 'force', 'found'),
    [
        (-3.0, -6.9, 0),
        (-3.0, -7.1, SURFACE_PULLS),
        (3.0, -3.9, 0),
        (-9.0, -8.1, SURFACE_PULLS),
    ],
)
def test_pull_of_a_free_contact_counts_from_its_baseline(baseline, force, found):
    """A baseline that presses takes nothing off, and 8 N are too much whatever was read."""
    answer = Answer(force, FREE)
    answer.states['baseline'] = baseline
    assert answer.check() == found


@pytest.mark.parametrize(
    ('force', 'sideways', 'found'),
    [
        (0.0, 4.9, 0),
        (0.0, 5.1, FORCE_SIDEWAYS),
        (10.0, 9.9, 0),
        (10.0, 10.1, FORCE_SIDEWAYS),
        (-3.0, 6.4, 0),
    ],
)
def test_sideways_force_is_plausible_up_to_what_friction_explains(
    force, sideways, found
):
    """5 N, and half of what presses or pulls."""
    assert Answer(force, sideways=sideways).check() == found


def test_force_that_is_taken_off_explains_the_wrench():
    answer = Answer(force=7.0)
    answer.contacts['alpha_meas'][0] = 0.0
    assert answer.check() == FORCE_SIDEWAYS
    answer.contacts['untared'][0] = 7.0
    assert answer.check() == 0


def test_couple_is_no_force_of_a_surface():
    answer = Answer()
    answer.contacts['alpha_meas'][1] = -20.0
    assert answer.check() == 0


@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_place_is_plausible_up_to_a_centimetre_beyond_the_workspace(axis, side):
    answer = Answer()
    answer.control['frame']['position'][axis] = 1.009 * side
    assert answer.check() == 0
    answer.control['frame']['position'][axis] = 1.011 * side
    assert answer.check() == OUTSIDE_WORKSPACE


def test_contacts_that_are_pressed_retract_from_outside_the_workspace():
    answer = Answer()
    answer.control['frame']['position'][0] = 2.0
    answer.contacts['answer']['active'] = True, False
    assert answer.judge() == OUTSIDE_WORKSPACE
    assert answer.states['retract_requested'].tolist() == [True, False]
    answer.contacts['answer']['active'] = False  # the request stays
    answer.judge()
    assert answer.states['retract_requested'].tolist() == [True, False]


def test_answer_is_refused_for_the_second_contradiction_in_a_row():
    pulled = Answer(force=-5.0)
    right = Answer()
    right.judgement = pulled.judgement
    refused = [bool(answer.judge() & ANSWER_REFUSED) for answer in (pulled, right) * 2]
    assert refused == [False] * 4
    assert pulled.judge() == SURFACE_PULLS
    assert pulled.judge() == SURFACE_PULLS + ANSWER_REFUSED


def test_one_contradiction_is_enough_before_control_resumes():
    answer = Answer(force=-5.0)
    answer.judgement['resumes'] = True
    assert answer.judge() & ANSWER_REFUSED


def test_contradictions_refuse_nothing_without_guards_but_numbers_that_are_none_do():
    answer = Answer(force=-5.0)
    assert [answer.judge(strict=False) for _ in range(3)] == [SURFACE_PULLS] * 3
    answer.joints['answer']['torque'][1] = np.nan
    assert answer.judge(strict=False) & ANSWER_REFUSED
    assert answer.judge(strict=False) & ANSWER_NOT_FINITE


@pytest.mark.parametrize(
    ('causes', 'reaction'),
    [
        ((), 'none'),
        (('variance_stale',), 'inflate'),
        (('joints_velocity',), 'hold'),
        (('joints_stale',), 'float'),
        (('wrench_pull', 'variance_stale'), 'hold'),
        (('joints_invalid', 'wrench_stale'), 'float'),
        (('joints_invalid', 'collision'), 'damp'),
    ],
)
def test_severest_reaction_of_several_causes_is_chosen(causes, reaction):
    bits = sum(BITS[cause] for cause in causes)
    damp = SEVERITY.index('damp')
    assert SEVERITY[choose_severest_reaction(bits, damp)] == reaction


def monitored(**changes):
    """Return configuration, joints and momentum observer of a controller with its monitors set."""
    config = controller_config(**changes)
    controller = Controller(config, RobotModel(config.robot, find_config_folder()))
    configure_monitors(config, controller)
    return config, controller.arm.joints, controller.controls['momentum'][0]


def test_thresholds_of_collisions_are_shares_of_the_torque_limits():
    """At least 1 N m; friction that is learnt adds a tenth of the limit at most."""
    limit = np.array([60.0, 100.0, 50.0, 5.0, 20.0, 10.0])
    config, joints, momentum = monitored(
        torque_limit=limit.tolist(), collision={'dynamic_share': 0.07}
    )
    share = config.collision.limit_share * limit
    assert (share < 1.0).any() and (share > 1.0).any()
    np.testing.assert_allclose(
        joints['config']['least_threshold'], np.where(share > 1.0, share, 1.0)
    )
    np.testing.assert_allclose(joints['config']['learnt_friction_limit'], 0.1 * limit)
    np.testing.assert_allclose(
        joints['watch']['threshold'],
        joints['config']['least_threshold'] + joints['config']['declared_friction'],
    )
    assert momentum['config']['dynamic_share'] == 0.07


def test_thresholds_that_are_declared_learn_no_friction():
    declared = [3.0, 4.0, 5.0, 1.0, 2.0, 6.0]
    _, joints, _ = monitored(collision={'threshold': declared})
    assert joints['watch']['threshold'].tolist() == declared
    assert not joints['config']['learnt_friction_limit'].any()
