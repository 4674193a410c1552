"""Which traced vectors are good training samples for Log: the filter of appendix E, Eq. (8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree


def divergence(q: ArrayLike, v: ArrayLike, k: int = 5) -> NDArray[np.float64]:
    """Local divergence delta_i = max_j |v_i - v_j| over the k nearest end points q_j, Eq. (8).

    Args:
        q: end points on the surface, (..., K, 3); each leading index is one source.
        v: their tangent vectors, (..., K, 3).
        k: neighbours in surface space.

    Returns:
        delta, (..., K), in the unit of `v`. K = 0 gives an empty array.

    Raises:
        ValueError: `q` and `v` differ in shape, or K does not exceed k (and is not 0).

    Example:
        >>> v = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
        >>> divergence(v, v, k=1)
        array([1., 1., 2.])
    """
    q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
    if q.shape != v.shape or q.ndim < 2 or q.shape[-1] != 3:
        raise ValueError(f"q and v must both have shape (..., K, 3), got {q.shape} and {v.shape}")
    count = q.shape[-2]
    if count == 0:
        return np.zeros(q.shape[:-1])
    if count <= k:
        raise ValueError(f"q must hold more than k = {k} points a source, got {count}")
    delta = np.empty(q.shape[:-1])
    for index in np.ndindex(q.shape[:-2]):
        near = KDTree(q[index]).query(q[index], k + 1)[1]  # (K, k + 1), itself included: adds 0
        delta[index] = np.linalg.norm(v[index][:, None] - v[index][near], axis=-1).max(-1)
    return delta


def filter_cut_locus(q: ArrayLike, v: ArrayLike, k: int = 5, tau: float = 0.5) -> NDArray[np.bool_]:
    """True where a sample lies before the cut locus: delta_i <= tau, Eq. (8) and appendix E.

    Args:
        q: end points, (..., K, 3).
        v: tangent vectors, (..., K, 3).
        k: neighbours in surface space.
        tau: largest allowed divergence, in the unit of `v`.

    Returns:
        Mask, (..., K).

    Example:
        >>> v = np.stack([np.linspace(0, 1, 20), np.zeros(20), np.zeros(20)], -1)
        >>> bool(filter_cut_locus(v, v).all())
        True
    """
    return divergence(q, v, k) <= tau
