"""Array types and the shape check used across the core."""

from multicontact_control.errors import ShapeError
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Bytes = NDArray[np.uint8]  # 0 or 1: what a record holds of yes and no


def require_shape(
    name: str, array: NDArray[np.generic], expected: tuple[int, ...]
) -> None:
    """Raise a ShapeError, with both shapes, if a named array has another than expected."""
    if array.shape != expected:
        raise ShapeError(name, f'shape {expected}', array.shape)


def find_true_stretches(mask: Mask) -> list[tuple[int, int]]:
    """Return the first index of every run of True in a mask, shape (k,), and one past its last."""
    bordered = np.concatenate([[False], mask, [False]])
    edges = np.flatnonzero(bordered[1:] != bordered[:-1])
    begins = edges[::2].tolist()
    ends = edges[1::2].tolist()
    return list(zip(begins, ends))
