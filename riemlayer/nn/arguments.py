"""What the layers accept: sizes and feature shapes."""

from __future__ import annotations

from torch import Tensor

from riemlayer.checks import check_shapes, check_tensor
from riemlayer.ops import LocalGeometry


def check_sizes(**sizes: int) -> None:
    """Every size is at least 1.

    Raises:
        ValueError: naming the argument.

    >>> check_sizes(rings=0)
    Traceback (most recent call last):
    ValueError: rings must be at least 1, got 0
    """
    for name, size in sizes.items():
        if size < 1:
            raise ValueError(f"{name} must be at least 1, got {size}")


def check_features(x: Tensor, geometry: LocalGeometry, *channels: int) -> None:
    """`x` is real and has a row for each point of the geometry: (N, *channels).

    As in torch's own layers NaN is not looked for: mixed-precision training relies on that.

    Raises:
        TypeError, ValueError: naming `x`.
    """
    check_tensor("x", x)
    check_shapes(x=(x, " ".join(map(str, (geometry.points, *channels)))))


def check_coordinates(x: Tensor, geometry: LocalGeometry) -> None:
    """`x` holds tangent vectors (N, C, 2) in the frames of the geometry.

    Raises:
        TypeError, ValueError: naming `x`.
    """
    check_tensor("x", x)
    check_shapes(x=(x, f"{geometry.points} C 2"))


def check_streams(x: Tensor, orders: int, channels: int) -> None:
    """`x` is complex, (N, orders, channels).

    Raises:
        ValueError: naming `x`.
    """
    if not isinstance(x, Tensor):
        check_tensor("x", x)
    if not x.is_complex():
        raise ValueError(f"x must be complex, got {x.dtype}; make it with to_streams(x, orders)")
    check_shapes(x=(x, f"N {orders} {channels}"))
