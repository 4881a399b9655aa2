"""Operations that only move entries about, on NumPy arrays of anything: known numbers and unknown ones alike.

Each is (params of the primitive, operands) -> results, as `scalars` meets it in a traced function.
"""

from collections.abc import Callable
from typing import Any

import numpy as np


def _broadcast_in_dim(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    shape = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], array.shape, strict=True):
        shape[axis] = size
    return [np.broadcast_to(array.reshape(shape), params["shape"])]


def _slice(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    strides = params["strides"] or (1,) * array.ndim
    return [array[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]]


def _concatenate(params: dict[str, Any], *arrays: np.ndarray) -> list[np.ndarray]:
    return [np.concatenate([array.astype(object) for array in arrays], axis=params["dimension"])]


def _gather(params: dict[str, Any], array: np.ndarray, starts: np.ndarray) -> list[np.ndarray]:
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    if numbers.operand_batching_dims or starts.dtype == object:
        raise NotImplementedError("gather over batches, or from places that are not known beforehand")
    kept = [size for axis, size in enumerate(sizes) if axis not in numbers.collapsed_slice_dims]
    result = np.empty((*starts.shape[:-1], *kept), array.dtype)
    for index in np.ndindex(*starts.shape[:-1]):
        begin = np.zeros(array.ndim, int)
        begin[list(numbers.start_index_map)] = starts[index]
        if np.any(begin < 0) or np.any(begin + sizes > array.shape):
            raise NotImplementedError("gather from beyond an array")
        part = array[tuple(slice(at, at + size) for at, size in zip(begin, sizes, strict=True))]
        result[(*index, ...)] = part.reshape(kept)
    offset = range(starts.ndim - 1, result.ndim)
    return [np.moveaxis(result, list(offset), list(numbers.offset_dims))]


# By the name of the primitive.
MOVES: dict[str, Callable[..., list[np.ndarray]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "slice": _slice,
    "concatenate": _concatenate,
    "gather": _gather,
    "reshape": lambda params, array: [array.reshape(params["new_sizes"])],
    "squeeze": lambda params, array: [np.squeeze(array, params["dimensions"])],
    "transpose": lambda params, array: [array.transpose(params["permutation"])],
    "stack": lambda params, *arrays: [np.stack([a.astype(object) for a in arrays], axis=params["axis"])],
}
