"""`python -m icac_jax` is the command `icac`."""

from icac_jax.experiment.cli import entry

entry()
