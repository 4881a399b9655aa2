"""A policy as an ONNX model: float32 observations [b, O] to actions [b, A]. Optional extra `onnx`."""

import json
from typing import Any

import numpy as np

from icac_jax.agents.base import Layers
from icac_jax.fields import ConfigError

_OPSET, _IR = 13, 8  # old enough for runtimes on robots
_OPERATORS = {"tanh": "Tanh", "relu": "Relu", "linear": "Identity"}


def model(layers: Layers, header: dict[str, Any]) -> bytes:
    """The model's file.

    Args:
      layers: of the policy.
      header: what its reader must know; goes into the model's metadata as JSON, under `icac_jax`.

    Raises:
      ConfigError: the extra is missing.
    """
    try:
        import onnx  # pyright: ignore[reportMissingImports]
        from onnx import TensorProto, helper, numpy_helper  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ConfigError("format: onnx needs the extra, pip install 'icac_jax[onnx]'; npz does not") from error
    nodes, arrays = [], {}
    seen, last = "observation", len(layers.weights) - 1
    for layer, (weights, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        arrays |= {f"weights_{layer}": weights, f"bias_{layer}": bias}
        parts = [seen, f"weights_{layer}", f"bias_{layer}"]
        nodes.append(helper.make_node("Gemm", parts, [f"sum_{layer}"], transB=1))
        kind = _OPERATORS[layers.output if layer == last else layers.hidden]
        seen = f"layer_{layer}"
        nodes.append(helper.make_node(kind, [f"sum_{layer}"], [seen]))
    arrays |= dict(zip(("low", "high"), header["action"]["clip"], strict=True))
    nodes.append(helper.make_node("Clip", [seen, "low", "high"], ["action"]))
    sizes = header["network"]["sizes"]
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", sizes[0]])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", sizes[-1]])],
        [numpy_helper.from_array(np.asarray(array, np.float32), name) for name, array in arrays.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], producer_name="icac_jax")
    made.ir_version = _IR
    helper.set_model_props(made, {"icac_jax": json.dumps(header)})
    onnx.checker.check_model(made)
    return made.SerializeToString()
