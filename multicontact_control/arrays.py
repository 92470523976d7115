"""Array types and the shape check used across the core."""

from multicontact_control.errors import ShapeError
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]
Codes = NDArray[np.int64]


def require_shape(name: str, array: NDArray[np.generic], expected: tuple[int, ...]) -> None:
    """
    Check the shape of an array.

    Raises
    ------
    ShapeError
        Naming the array, the expected shape and the one found.

    """
    if array.shape != expected:
        raise ShapeError(name, expected, array.shape)
