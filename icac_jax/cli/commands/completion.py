"""`icac completion`: a script with which a shell completes commands, options and values."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class CompletionOptions:
    """What `icac completion` takes."""

    shell: parsing.Positional[Literal["bash", "zsh", "fish"] | None] = common.flag(None, "bash, zsh or fish")


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("completion SHELL", CompletionOptions, args)
    if given is None:
        return 0
    if given.shell is None:
        raise ConfigError('shell: must be one of bash, zsh, fish; as in: eval "$(icac completion bash)"')
    from icac_jax.cli import completion
    from icac_jax.cli.main import COMMANDS

    print(completion.script(given.shell, COMMANDS))
    return 0
