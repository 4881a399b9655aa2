"""`python -m icac_jax` is the command `icac`."""

from icac_jax.cli.main import entry

if __name__ == "__main__":
    entry()
