"""Stable-Baselines3 on the arms: workers in processes, hindsight, recorded video, all without a display.

Marked slow, and skipped where Stable-Baselines3 is missing: `make test-sb3` makes an environment that has it.
"""

import contextlib
import os
import subprocess
import sys

import pytest

pytest.importorskip("stable_baselines3", reason="needs Stable-Baselines3: make test-sb3")
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]  # warnings of other packages are no failures

PPO_PROGRAM = """
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv
import icac_jax.envs.gymnasium

if __name__ == "__main__":
    worlds = make_vec_env("icac_jax/Planar2Reach-v0", n_envs=2, seed=0, vec_env_cls=SubprocVecEnv)
    agent = PPO("MlpPolicy", worlds, n_steps=64, batch_size=64, device="cpu", seed=0)
    before = agent.policy.mlp_extractor.policy_net[0].weight.detach().numpy().copy()
    agent.learn(512)
    assert agent.num_timesteps == 512
    assert not np.array_equal(before, agent.policy.mlp_extractor.policy_net[0].weight.detach().numpy())
    pictures = worlds.get_images()
    assert len(pictures) == 2 and pictures[0].std() > 1, "workers draw nothing"
    worlds.close()
"""

VIDEO_PROGRAM = """
import sys
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecVideoRecorder
import icac_jax.envs.gymnasium

worlds = make_vec_env("icac_jax/Nico4ReachGoal-v0", n_envs=1, seed=0)
worlds = VecVideoRecorder(worlds, sys.argv[1], record_video_trigger=lambda step: step == 0, video_length=30)
agent = SAC("MultiInputPolicy", worlds, replay_buffer_class=HerReplayBuffer, learning_starts=60, device="cpu", seed=0)
agent.learn(120)
worlds.close()
"""


def run(program, *args):
    """What a user without a display does: a program of its own, which must end well and say nothing of a display."""
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"MUJOCO_GL": "egl"}
    done = subprocess.run([sys.executable, *map(str, program), *map(str, args)], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    return done.stdout.decode()


@pytest.fixture
def program(tmp_path):
    def written(text):
        path = tmp_path / "program.py"
        path.write_text(text)
        return [path]

    return written


def test_ppo_learns_with_workers_in_processes(program):
    run(program(PPO_PROGRAM))


def test_sac_with_hindsight_learns_and_its_video_is_recorded(program, tmp_path):
    run(program(VIDEO_PROGRAM), tmp_path / "video")
    (film,) = (tmp_path / "video").glob("*.mp4")
    import imageio_ffmpeg

    with contextlib.closing(imageio_ffmpeg.read_frames(str(film))) as frames:
        assert next(frames)["size"] == (640, 480)
        pictures = list(frames)
    assert len(pictures) >= 30
    assert pictures[0] != pictures[-1], "the arm does not move"


def test_the_example_reaches_half_of_the_goals(request, tmp_path):
    example = request.config.rootpath / "examples" / "sb3_her" / "train.py"
    said = run([example], "--steps", 2500, "--seeds", 1, "--evaluate-every", 2500, "--out", tmp_path)
    last = said.strip().splitlines()[-1]
    success = float(last.split("success ")[1].split()[0])
    assert success >= 0.5, last
    assert (tmp_path / "sb3_her.png").stat().st_size > 10_000


def test_both_checkers_with_pictures(monkeypatch):
    import gymnasium
    from gymnasium.utils.env_checker import check_env as checked_by_gymnasium
    from stable_baselines3.common.env_checker import check_env as checked_by_sb3

    for name in ("Planar2Reach-v0", "Planar2ReachGoal-v0", "Nico4Reach-v0", "Nico4ReachGoal-v0"):
        world = gymnasium.make(f"icac_jax.envs.gymnasium:icac_jax/{name}", render_mode="rgb_array")
        checked_by_sb3(world.unwrapped)
        pictures = world.unwrapped.metadata | {"render_modes": ["rgb_array"]}  # a window needs a display
        monkeypatch.setattr(type(world.unwrapped), "metadata", pictures)
        checked_by_gymnasium(world.unwrapped)
        world.close()
