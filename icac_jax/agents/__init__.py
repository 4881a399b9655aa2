"""Learners: what an agent is, the agents that come with the package, and their registry."""

from icac_jax.agents import base, cacla, curious, icac, registry

__all__ = ["base", "cacla", "curious", "icac", "registry"]
