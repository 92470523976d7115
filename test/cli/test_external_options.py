"""What the command line says of a robot that is not this package's."""

import pytest


@pytest.mark.parametrize(('arguments', 'message'), [
    (('run', '--external'), '--controller: expected the parameter file of your controller'),
    (('run', '--external', '--lockstep'), '--lockstep: expected nothing with --external'),
    (('run', '--external', '--plant', 'rigid'), '--plant: expected nothing with --external'),
    (('run', '--controller', 'x'), '--controller: expected nothing with a simulated plant'),
    (('run', '--external', '--controller', 'x'), 'x: expected a readable file'),
    (('calibrate', '--from-bag', 'x'), '--controller: expected the parameter file'),
    (('calibrate', '--external'), '--controller: expected the parameter file'),
    (('calibrate', '--controller', 'x'), '--controller: expected nothing with a simulated plant'),
    (('calibrate', '--tilt', '30'), '--tilt: expected nothing with a simulated plant'),
    (('calibrate', '--external', '--robot', 'panda'), '--robot: expected nothing with --external'),
    (('calibrate', '--from-bag', 'x', '--external'), '--external: expected nothing with --from-b'),
    (('push-test', '--namespace', 'left'),
     '--namespace: expected nothing with a simulated plant'),
    (('push-test', '--external', '--fault', 'sign'), '--fault: expected nothing with --external')])
def test_command_line_says_what_is_missing(multicontact, tmp_path, arguments, message):
    done = multicontact(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr and done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []
