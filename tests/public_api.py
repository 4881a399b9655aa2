"""A program that uses the public names, for `mypy --strict`: it is type-checked, not run."""

from pathlib import Path

import jax
import numpy as np

import icac_jax as icac


def sweep(out: Path) -> float:
    run: icac.Trained = icac.train("planar2", "icac", seeds=range(3), sigma=[[0.1], [0.5]], episodes=20)
    action: np.ndarray = run.policy(0, 1)(np.zeros(4))
    icac.train("nico4", "cacla", out=out, progress=False)
    return float(run.success.mean() + action.sum())


def rewarded(spec: icac.CuriositySpec, hyper: icac.CuriosityHyper, key: jax.Array) -> jax.Array:
    state = icac.curiosity.init(spec, key, hyper)
    state, info = icac.curiosity.update(spec, state, jax.numpy.zeros(2), jax.numpy.zeros(2), jax.numpy.ones(2), hyper)
    return info.reward


def wrapped(agent: icac.Agent, spec: icac.CuriositySpec) -> icac.Agent:
    return icac.curious(agent, spec)
