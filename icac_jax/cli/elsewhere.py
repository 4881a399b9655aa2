"""What other libraries call an option: for whoever types a name from there, and for the page on coming from them."""

from collections.abc import Iterable

# Stable-Baselines3 and its zoo, CleanRL, rejax, PureJaxRL, gymnax: their name, with underscores, and the ones here.
NAMES: dict[str, tuple[str, ...]] = {
    "agent": ("algo",),
    "algorithm": ("algo",),
    "discount": ("gamma",),
    "env": ("arm", "task"),
    "env_id": ("arm", "task"),
    "env_name": ("arm", "task"),
    "eval_freq": ("evaluate_every",),
    "exploration_noise": ("sigma",),
    "learning_rate": ("actor_rate", "critic_rate"),
    "learning_starts": ("warm_up",),
    "log_dir": ("out",),
    "log_folder": ("out",),
    "lr": ("actor_rate", "critic_rate"),
    "max_episode_steps": ("horizon",),
    "n_envs": ("seeds",),
    "n_seeds": ("seeds",),
    "n_timesteps": ("episodes",),
    "num_envs": ("seeds",),
    "num_timesteps": ("episodes",),
    "polyak": ("tau",),
    "save_dir": ("out",),
    "save_freq": ("checkpoint_every",),
    "target_policy_noise": ("target_noise",),
    "tensorboard_log": ("track",),
    "timesteps": ("episodes",),
    "total_timesteps": ("episodes",),
    "wandb": ("track",),
}


def hint(name: str, known: Iterable[str]) -> str:
    """What an option of another library is called here, as the end of a message; empty where nothing is.

    Args:
      name: as typed, without its dashes.
      known: names of options that there are, with underscores.
    """
    known = set(known)
    here = [f"--{one.replace('_', '-')}" for one in NAMES.get(name.replace("-", "_"), ()) if one in known]
    return f"here it is {' and '.join(here)}" if here else ""
