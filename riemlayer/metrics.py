"""The paper's measures of quality: Eqs. (5), (6), E_MDD, (10)-(12), and ours beside them.

Every function takes tensors or numpy arrays and returns a tensor.
Vertices V (n, 3), faces F (m, 3); `log` holds one tangent vector a vertex, (n, 2) in a frame
or (n, 3) ambient: lengths and angles are the same in both. Ambient vectors must lie in one plane,
as tangent vectors do (Log_p(q) = q - p would score a perfect 0); `in_plane` sees to that.
`valid` (n,) bool picks the vertices that count; a triangle or an edge counts when all of its
vertices do.
No function returns NaN: what is undefined raises a ValueError that says so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from riemlayer.checks import check_finite

Values = Tensor | np.ndarray
Map = Callable[[Any, Any], Any]


def angle_error(vertices: Values, faces: Values, log: Values, valid: Values) -> Tensor:
    """Eq. (5): mean |angle in space - angle in the tangent plane| over valid triangles, degrees.

    Degenerate: a corner with a side of zero length has angle 0, so a triangle that the log map
    collapses to a point costs 60 degrees. Raises ValueError where no triangle is valid, or `log`
    is not finite on one.

    Example:
        >>> V = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> log = torch.tensor([[0.0, 0], [1, 0], [1, 1]])  # a right angle moves to a neighbour
        >>> valid = torch.ones(3, dtype=torch.bool)
        >>> angle_error(V, torch.tensor([[0, 1, 2]]), log, valid).round().item()
        30.0
    """
    faces, log = torch.as_tensor(faces).long(), torch.as_tensor(log)
    faces = faces[torch.as_tensor(valid)[faces].all(-1)]
    _demand(len(faces) > 0, "valid leaves no triangle to measure; widen the mask or the radius")
    check_finite("log", log[faces])
    return triangle_distortion(vertices, faces, log).mean()


def triangle_distortion(vertices: Values, faces: Values, log: Values) -> Tensor:
    """Mean |angle in space - angle in the tangent plane| of each triangle (m,), degrees, Eq. (5).

    Arguments and degenerate cases as for `angle_error`.
    """
    faces = torch.as_tensor(faces).long()
    true, tangent = (_corner_angles(_space(x)[faces]) for x in (vertices, log))
    return (true - tangent).abs().mean(-1).rad2deg()


def distance_distortion(
    vertices: Values, faces: Values, log: Values, valid: Values, clip: float | None = None
) -> Tensor:
    """E_MDD (section 4): mean |L_3D / L_tan - 1| over valid edges; ours: each edge clipped.

    As printed the ratio has no upper bound and a few collapsed edges decide the mean; `clip=1`
    counts such an edge as completely wrong and no more. Degenerate edges: see `edge_distortion`.

    Args:
        vertices: (n, 3) positions.
        faces: (m, 3) vertex indices; every edge counts once.
        log: (n, 2) or (n, 3) tangent vectors.
        valid: (n,) bool.
        clip: upper bound of one edge's distortion.

    Raises:
        ValueError: no edge is valid, or `log` is not finite on one.

    Example:
        >>> V = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
        >>> valid = torch.tensor([True, True, False])
        >>> log = torch.tensor([[0.0, 0], [0.25, 0], [0, 2]])
        >>> distance_distortion(V, torch.tensor([[0, 1, 2]]), log, valid).item()  # |1 / 0.25 - 1|
        3.0
    """
    edges, log = mesh_edges(faces), torch.as_tensor(log)
    edges = edges[torch.as_tensor(valid)[edges].all(-1)]
    _demand(len(edges) > 0, "valid leaves no edge to measure; widen the mask or the radius")
    check_finite("log", log[edges])
    distortion = edge_distortion(vertices, edges, log)
    return (distortion if clip is None else distortion.clamp(max=clip)).mean()


def edge_distortion(vertices: Values, edges: Values, log: Values) -> Tensor:
    """|L_3D / L_tan - 1| of each edge (E,) of edges (E, 2), the terms of E_MDD (section 4).

    Degenerate: an edge that the log map collapses to zero costs infinity; an edge of zero length
    that stays so costs 0, one that does not costs 1.
    """
    first, second = torch.as_tensor(edges).long().unbind(-1)
    vertices, log = torch.as_tensor(vertices), _space(log)
    length = (vertices[second] - vertices[first]).norm(dim=-1)
    tangent = (log[second] - log[first]).norm(dim=-1)
    unchanged = length == tangent
    return (length / torch.where(unchanged, 1, tangent) - 1).abs().masked_fill(unchanged, 0)


def mesh_edges(faces: Values) -> Tensor:
    """The undirected edges (E, 2) of faces (m, 3), each once."""
    faces = torch.as_tensor(faces).long()
    pairs = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = pairs.sort(dim=-1).values.unbind(-1)
    stride = int(faces.max()) + 1 if len(faces) else 1
    keys = torch.unique(low * stride + high)
    return torch.stack([keys // stride, keys % stride], -1)


def in_plane(log: Values, valid: Values, normal: Values | None = None) -> Tensor:
    """Ambient vectors (n, 3) of one source without their part along the plane's normal (ours).

    Args:
        log: (n, 3) ambient tangent vectors.
        valid: (n,) bool, the rows that decide about the plane; they must be finite.
        normal: (3,) unit normal at the source; by default that of the plane which holds most of
            the vectors themselves, so that planar answers stay as they are.

    Example:
        >>> log = torch.tensor([[1.0, 0, 0.1], [0, 1, 0], [0, 0, 0]])
        >>> in_plane(log, torch.ones(3, dtype=torch.bool), torch.tensor([0.0, 0, 1]))[0]
        tensor([1., 0., 0.])
    """
    log = torch.as_tensor(log)
    if normal is None:
        rows = log[torch.as_tensor(valid)]
        check_finite("log", rows)
        normal = torch.linalg.eigh(rows.mT @ rows).eigenvectors[:, 0]
    normal = torch.as_tensor(normal, dtype=log.dtype)
    return log - (log @ normal)[:, None] * normal


def exp_error(q: Values, prediction: Values, valid: Values | None = None) -> Tensor:
    """Eq. (6): mean |q - prediction| over the valid end points.

    Args:
        q: (..., 3) true end points.
        prediction: (..., 3) predicted end points.
        valid: (...) bool; all when None.

    Raises:
        ValueError: nothing is valid, or a valid prediction is not finite.

    Example:
        >>> exp_error(torch.zeros(2, 3), torch.tensor([[3.0, 4, 0], [0, 0, 0]])).item()
        2.5
    """
    return _mean_distance(q, prediction, valid)


def log_end_error(v: Values, prediction: Values, valid: Values | None = None) -> Tensor:
    """Mean |Log_p(Exp_p(v)) - v|, the Log error at traced end points (ours).

    Unlike Eq. (5) and E_MDD a perfect method reaches 0 on every surface. `v` and `prediction` are
    (..., 3); `valid` and what is raised are as for `exp_error`.

    Example:
        >>> log_end_error(torch.tensor([[1.0, 0, 0]]), torch.tensor([[0.0, 0, 0]])).item()
        1.0
    """
    return _mean_distance(v, prediction, valid)


def mean_by_length(error: Values, length: Values, bounds: Values) -> tuple[Tensor, Tensor]:
    """Mean error in bins of the geodesic length (ours).

    Degenerate: an empty bin has mean 0 and count 0; read the counts.

    Args:
        error: (K,) errors.
        length: (K,) lengths of the vectors they belong to.
        bounds: (B + 1,) increasing; bin i holds bounds[i] <= length < bounds[i + 1].

    Returns:
        (B,) means and (B,) counts.

    Raises:
        ValueError: an error is not finite.

    Example:
        >>> error, length = torch.tensor([0.1, 0.3]), torch.tensor([0.2, 0.4])
        >>> mean_by_length(error, length, torch.tensor([0.0, 0.5, 1.0]))
        (tensor([0.2000, 0.0000]), tensor([2, 0]))
    """
    error, length, bounds = map(torch.as_tensor, (error, length, bounds))
    check_finite("error", error)
    inside = (bounds[:-1, None] <= length) & (length < bounds[1:, None])
    counts = inside.sum(-1)
    return torch.where(inside, error, 0).sum(-1) / counts.clamp_min(1), counts


def zero_point_errors(exp: Map, log: Map, p: Values) -> tuple[Tensor, Tensor]:
    """Eq. (11): |Exp_p(0) - p| and |Log_p(p)| at one source.

    `exp` maps p (3,), v (K, 3) to end points (K, 3), `log` p (3,), q (K, 3) to vectors (K, 3).

    Example:
        >>> zero_point_errors(lambda p, v: p + v, lambda p, q: q - p, torch.ones(3))
        (tensor(0.), tensor(0.))
    """
    return exp_zero_error(exp, p), log_zero_error(log, p)


def exp_zero_error(exp: Map, p: Values) -> Tensor:
    """Eq. (11), left: |Exp_p(0) - p|; arguments as in `zero_point_errors`."""
    p = torch.as_tensor(p)
    return _mean_distance(p[None], exp(p, p.new_zeros(1, 3)), None)


def log_zero_error(log: Map, p: Values) -> Tensor:
    """Eq. (11), right: |Log_p(p)|; arguments as in `zero_point_errors`."""
    p = torch.as_tensor(p)
    return _mean_distance(p.new_zeros(1, 3), log(p, p[None]), None)


def differential_errors(
    exp: Map, log: Map, p: Values, frame: Values, step: float = 0.02
) -> tuple[Tensor, Tensor]:
    """Eqs. (10), (12): |d(Exp_p)_0 - I|_F and |d(Log_p)_p - I|_F, 2x2 in a tangent frame.

    Differentials are central differences, so any callable will do. Log is asked at the points
    p +- step * axis of the tangent plane, which leave the surface by curvature * step^2 / 2 only:
    in a central difference the two departures cancel.

    Args:
        exp, log, p: as for `zero_point_errors`.
        frame: (3, 2) orthonormal tangent axes at p, as columns.
        step: length of the difference, in the unit of p.

    Example:
        >>> frame, p = torch.eye(3)[:, :2], torch.zeros(3)
        >>> differential_errors(lambda p, v: p + v, lambda p, q: 2 * (q - p), p, frame)
        (tensor(0.), tensor(1.4142))
    """
    return (
        exp_differential_error(exp, p, frame, step),
        log_differential_error(log, p, frame, step),
    )


def exp_differential_error(exp: Map, p: Values, frame: Values, step: float = 0.02) -> Tensor:
    """Eq. (12), left: |d(Exp_p)_0 - I|_F; arguments as in `differential_errors`."""
    p, frame = torch.as_tensor(p), torch.as_tensor(frame)
    return _distance_to_identity(exp(p, step * torch.cat([frame.T, -frame.T])), frame, step)


def log_differential_error(log: Map, p: Values, frame: Values, step: float = 0.02) -> Tensor:
    """Eq. (12), right: |d(Log_p)_p - I|_F; arguments as in `differential_errors`."""
    p, frame = torch.as_tensor(p), torch.as_tensor(frame)
    return _distance_to_identity(log(p, p + step * torch.cat([frame.T, -frame.T])), frame, step)


def _distance_to_identity(values: Values, frame: Tensor, step: float) -> Tensor:
    """|D - I|_F of the 2x2 central difference D of the values at +axes, -axes (4, 3)."""
    values = torch.as_tensor(values, dtype=frame.dtype)
    check_finite("values", values)
    differential = frame.T @ ((values[:2] - values[2:]) / (2 * step)).T
    return (differential - torch.eye(2, dtype=frame.dtype, device=frame.device)).norm()


def _mean_distance(truth: Values, prediction: Values, valid: Values | None) -> Tensor:
    """Mean |truth - prediction| over valid rows."""
    truth, prediction = torch.as_tensor(truth), torch.as_tensor(prediction)
    got, expected = tuple(prediction.shape), tuple(truth.shape)
    _demand(got == expected, f"prediction must have shape {expected}, got {got}")
    if valid is not None:
        truth, prediction = truth[torch.as_tensor(valid)], prediction[torch.as_tensor(valid)]
    _demand(truth.numel() > 0, "valid leaves no row to measure; widen the mask or the radius")
    check_finite("prediction", prediction)
    return (truth - prediction).norm(dim=-1).mean()


def _corner_angles(corners: Tensor) -> Tensor:
    """Interior angles (m, 3) in radians of triangles (m, 3, 3)."""
    ahead, behind = corners.roll(-1, 1) - corners, corners.roll(1, 1) - corners
    return torch.atan2(torch.linalg.cross(ahead, behind).norm(dim=-1), (ahead * behind).sum(-1))


def _space(log: Values) -> Tensor:
    """Tangent vectors of 2 coordinates padded to 3."""
    log = torch.as_tensor(log)
    good = log.ndim == 2 and log.shape[1] in (2, 3)
    _demand(good, f"log must have shape (n, 2) or (n, 3), got {tuple(log.shape)}")
    return torch.nn.functional.pad(log, (0, 3 - log.shape[1]))


def _demand(holds: bool, message: str) -> None:
    if not holds:
        raise ValueError(message)
