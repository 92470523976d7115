"""`multicontact design --certify` as users start it: bad options, a design, a region."""

import pytest

NARROW = ('--preset', 'paper', '--delay', '0.0068', '0.007')


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (('pi', '--certify'), 'LAW: expected aob'),
        (
            ('aob', '--certify', '--delay', '0.008', '0.004'),
            '--delay: expected a range of rising values, 0 or more',
        ),
        (
            ('aob', '--certify', '--mobility', '0', '1'),
            '--mobility: expected a range of rising values, above 0',
        ),
        (
            ('aob', '--certify', '--out', 'nowhere/region.png'),
            '--out: expected a .png or .pdf in a folder that is there',
        ),
        (
            ('aob', '--certify', '--stiffness', '5000', '6000', '--attacks', '10'),
            '--stiffness: expected none with --out or --attacks',
        ),
    ],
)
def test_certify_refuses_bad_options_before_it_computes(
    multicontact, arguments, message
):
    pytest.importorskip('clarabel', reason='the extra [certify] is not installed')
    done = multicontact('design', *arguments)
    assert done.exit_code == 2
    assert message in done.stderr


@pytest.mark.nightly
@pytest.mark.parametrize('parameter', ['time_constant', 'damping_rate'])
def test_design_prints_settings_that_are_certified(multicontact, parameter):
    asked = ('--stiffness', '5900', '6100', '--fastest', parameter)
    done = multicontact('design', 'aob', '--certify', *NARROW, *asked)
    assert done.exit_code == 0
    last = done.stdout.splitlines()[-1]
    assert "--set 'controller.contacts.*.stiffness=5999'" in last
    assert f"--set 'controller.force.{parameter}=" in last


@pytest.mark.nightly
def test_certified_region_withstands_attacks_and_is_drawn(multicontact, tmp_path):
    picture = tmp_path / 'region.png'
    asked = ('--attacks', '1000', '--out', picture)
    done = multicontact('design', 'aob', '--certify', *NARROW, *asked)
    assert done.exit_code == 0
    assert ' attacks: 0 with less than the certified fall of V' in done.stdout
    assert picture.stat().st_size > 0
