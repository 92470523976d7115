"""The environment in the hands of stable-baselines3, in a venv of its own."""

import pytest
from test_packaging import keywords  # noqa: F401 - a fixture
from test_versions import install, registry, run_here, venv_python  # noqa: F401

pytestmark = pytest.mark.nightly
PROGRAM = """
import warnings
warnings.simplefilter('error')
import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
for actions in (['force', 'motion'], ['force', 'motion', 'stiffness']):
    env = gymnasium.make(
        'multicontact_control:MultiContact-v0',
        plant='rigid',
        actions=actions,
        duration=1.0,
        render_mode='rgb_array',
    )
    check_env(env.unwrapped)
warnings.simplefilter('default')  # what torch itself warns of
model = PPO('MultiInputPolicy', env, n_steps=64, batch_size=32, n_epochs=1, seed=0)
model.learn(64)
print('learnt', model.num_timesteps)
"""


def test_checker_of_stable_baselines_warns_of_nothing_and_its_ppo_learns(
    venv_python,  # noqa: F811
    keywords,  # noqa: F811
    tmp_path,
):
    extras = keywords['extras_require']
    wanted = [*extras['pin'], *extras['pybullet'], *extras['learning']]
    library = 'stable-baselines3>=2.4,<3'
    install(venv_python, [*keywords['install_requires'], *wanted, library])
    done = run_here(venv_python, '-c', PROGRAM, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == 'learnt 64'
