"""One training in a folder: the host loop, records, checkpoints, resuming. Importing this loads nothing."""

from icac_jax.errors import ConfigError

try:
    import fcntl
except ImportError as error:  # Windows
    raise ConfigError("icac runs on Linux and macOS; on Windows, use it inside WSL") from error

__all__ = ["CHECKPOINT_EVERY", "fcntl"]

# Default of functions and commands; here, so that a help page need not load the functions.
CHECKPOINT_EVERY = 60.0  # seconds
