"""How a chunk is compiled for a CPU."""

from typing import Any

import jax

_Options = dict[str, Any]
# Where each core has a device no operation is split over threads, which are busy already: XLA splits loops that seem
# long, and takes a look-up of one row for a reading of the whole array.
APART: _Options = {"xla_disable_hlo_passes": "cpu-parallel-task-assigner"}
# With lanes last each loop is over lanes: the widest vectors that there are, where XLA prefers half of that.
WIDE: _Options = {"xla_cpu_prefer_vector_width": 512}
_UNKNOWN = "No such compile option"


def compiled(lowered: jax.stages.Lowered, options: _Options) -> Any:
    """Compiles a program under options that change its speed, not its results.

    A version of XLA that does not know one of them compiles without them.

    Args:
      lowered: the program, as `jax.jit(...).lower(...)` gives it.
      options: none, or `APART`, `WIDE`, or both.
    """
    try:
        return lowered.compile(compiler_options=options)
    except jax.errors.JaxRuntimeError as error:
        if _UNKNOWN not in str(error):
            raise
        return lowered.compile()
