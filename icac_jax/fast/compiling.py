"""How a chunk is compiled where each core has a device of its own."""

from typing import Any

import jax

# XLA splits loops that seem long over threads; it takes a look-up of one row for a reading of the whole array.
_NO_SPLITS: dict[str, str | bool] = {"xla_disable_hlo_passes": "cpu-parallel-task-assigner"}
_UNKNOWN = "No such compile option"


def compiled_apart(lowered: jax.stages.Lowered) -> Any:
    """Compiles a program whose devices are the cores: no operation is split over threads, which are busy already.

    The results are the same to the bit. A version of XLA that does not know the option compiles without it.

    Args:
      lowered: the program, as `jax.jit(...).lower(...)` gives it.
    """
    try:
        return lowered.compile(compiler_options=_NO_SPLITS)
    except jax.errors.JaxRuntimeError as error:
        if _UNKNOWN not in str(error):
            raise
        return lowered.compile()
