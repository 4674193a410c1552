"""Training losses, Eqs (1)-(4), and ours: Sobolev pairs, relative weighting, validity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from riemlayer.heads.branch import MapHead
from riemlayer.numerics import product, safe_norm
from riemlayer.surface import EncodedSurface

WILD = 5.0
"""Norm of a Jacobian, 1.7 of an isometry, from which on a map jumps, as walks do at rims: there
Eq. (3) says nothing of the network, and one query would outweigh all others (ours)."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms; the defaults of the first three are the paper's."""

    rec: float = 1.0
    """Eq. (2), reconstruction of Exp and Log."""
    geo: float = 0.01
    """Eq. (3), isometric and conformal."""
    cyc: float = 0.01
    """Eq. (4), cycle consistency."""
    pairs: float = 0.0
    """Sobolev pairs of Log (ours), whose distances and angles Eqs (5) and (6) measure. Of Exp they
    would favour the smoother of two walks before the nearer one."""
    validity: float = 0.1
    """Cross entropy of the validity (ours); touches nothing but the validity's own layer."""
    prior: float = 0.0
    """Reconstruction of Exp and Log by their priors alone (ours): it teaches gates."""
    relative: bool = False
    """Weight reconstruction by 1 / (|v| + 0.1) (ours), so that small radii count."""

    def __post_init__(self) -> None:
        for name in ("rec", "geo", "cyc", "pairs", "validity", "prior"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")

    def weigh(self, length: Tensor, labels: tuple[Tensor, Tensor]) -> Tensor:
        """What queries (...) of a length in the cube count: 0 where not valid and known."""
        good = torch.logical_and(*labels).to(length.dtype)
        return good / (length + 0.1) if self.relative else good


def reconstruction_loss(predicted: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
    """Eq. (2): L1 distance |predicted - truth|_1, averaged with `weight`.

    Args:
        predicted, truth: (..., 3).
        weight: (...) non-negative; 0 leaves a query out.

    >>> reconstruction_loss(torch.ones(2, 3), torch.zeros(2, 3), torch.tensor([1.0, 0.0]))
    tensor(3.)
    """
    return weighted_mean((predicted - truth).abs().sum(-1), weight)


def weighted_mean(x: Tensor, weight: Tensor) -> Tensor:
    """Mean of `x` with `weight` of the same shape; 0 where every weight is 0."""
    return (x * weight).sum() / weight.sum().clamp_min(torch.finfo(x.dtype).tiny)


def isometric_loss(J: Tensor) -> Tensor:
    """Eq. (3), left: sum_i |M_ii - 1| with M = J^T J, averaged over queries.

    For the tangent form (ours) pass `J @ frame`: directions off the tangent plane have no meaning.

    Args:
        J: (..., 3, 3) Jacobians, or (..., 3, 2) restricted to the tangent plane.

    >>> isometric_loss(2 * torch.eye(3))
    tensor(9.)
    """
    M = product(J.mT, J)
    return (M.diagonal(dim1=-2, dim2=-1) - 1).abs().sum(-1).mean()


def conformal_loss(J: Tensor) -> Tensor:
    """Eq. (3), right: sum_{i != j} |M_ij| with M = J^T J, averaged over queries; J as above.

    >>> conformal_loss(2 * torch.eye(3))
    tensor(0.)
    """
    M = product(J.mT, J)
    return (M - torch.diag_embed(M.diagonal(dim1=-2, dim2=-1))).abs().sum((-2, -1)).mean()


def cycle_loss(back: Tensor, v: Tensor, weight: Tensor) -> Tensor:
    """Eq. (4): |h(g(v)) - v|_1 for `back` = h(g(v)), averaged with `weight`."""
    return reconstruction_loss(back, v, weight)


def pair_loss(error: Tensor, apart: Tensor, weight: Tensor) -> Tensor:
    """Sobolev pairs (ours): L1 change of the error between two neighbours, over their distance.

    Args:
        error: (..., K, 3) predicted minus true; query i pairs with query i + K/2.
        apart: (..., K, 3) where the queries are: v for Exp, q for Log.
        weight: (..., K).

    >>> pair_loss(torch.ones(1, 4, 3), torch.rand(1, 4, 3), torch.ones(1, 4))
    tensor(0.)
    """
    a, b = error.chunk(2, -2)
    x, y = apart.chunk(2, -2)
    distance = safe_norm(x - y).squeeze(-1).clamp_min(0.005)
    both = torch.minimum(*weight.chunk(2, -1))
    return weighted_mean((a - b).abs().sum(-1) / distance, both)


def validity_loss(logit: Tensor, valid: Tensor, known: Tensor) -> Tensor:
    """Cross entropy of the validity against the filter's labels, Eq. (8) (ours).

    Args:
        logit, valid, known: (...) logits, labels, and which labels count.
    """
    entropy = F.binary_cross_entropy_with_logits(logit, valid.to(logit.dtype), reduction="none")
    return weighted_mean(entropy, known.to(logit.dtype))


@dataclass(frozen=True)
class Truth:
    """Traced ground truth for S sources with K queries each, in the units of the cloud."""

    p: Tensor
    """(S, 3)"""
    v: Tensor
    """(S, K, 3); query i pairs with query i + K/2."""
    q: Tensor
    """(S, K, 3)"""
    valid: Tensor
    """(S, K) bool, kept by the filter of Eq. (8)."""
    known: Tensor
    """(S, K) bool: the trace is complete and lies in the cloud."""
    shape: Tensor
    """(S,) int64, cloud of each source."""


class Asked(NamedTuple):
    """K queries at each of S sources, and what a map answered, in the cube."""

    vector: Tensor
    """(S, K, 3) q - p for Exp, v for Log."""
    logit: Tensor
    """(S, K) of the validity."""
    prior: Tensor | None
    """(S, K, 3) the answer without the decoder's correction; None of a head without one."""
    truth: Tensor
    """(S, K, 3)"""
    labels: tuple[Tensor, Tensor]
    """(S, K) bool, valid and known, see `Truth`."""
    weight: Tensor
    """(S, K) what each query counts, see `LossWeights.weigh`."""
    at: Tensor | None
    """(S, K, 3) where the queries are; None: no pairs."""


def map_losses(
    of: Asked, weights: LossWeights, mean: Callable[..., Tensor] = lambda loss, *of: loss(*of)
) -> dict[str, Tensor]:
    """Terms of Eq. (1) that ask one map alone, and their sum, `total`; `mean` applies a loss."""
    terms = {"rec": mean(reconstruction_loss, of.vector, of.truth, of.weight)}
    if weights.prior and of.prior is not None:
        terms["prior"] = mean(reconstruction_loss, of.prior, of.truth, of.weight)
    if weights.pairs and of.at is not None:
        terms["pairs"] = mean(pair_loss, of.vector - of.truth, of.at, of.weight)
    if weights.validity:
        terms["validity"] = mean(validity_loss, of.logit, *of.labels)
    total = torch.stack([getattr(weights, name) * loss for name, loss in terms.items()]).sum()
    return {"total": total, **terms}


def explog_losses(surface: EncodedSurface, truth: Truth, weights: LossWeights) -> dict[str, Tensor]:
    """Eq. (1) and its terms, by name; lengths in the normalised cube.

    Each term is the mean over the shapes of its means over one shape's queries: every shape counts
    alike (ours). So the gradient of a packed batch is the mean of those of its shapes, whether they
    are packed, accumulated, or on several ranks.

    Eq. (3) needs Jacobians, the costly part: it is averaged over every eighth query, and Eq. (4)
    over every fourth, where the paper takes all, and Eq. (3) where the map does not jump (`WILD`).
    """
    p, v, q, shape = truth.p[:, None], truth.v, truth.q, truth.shape[:, None]
    scale = surface.scale[shape][..., None]
    moved, v_cube = (q - p) / scale, v / scale
    labels = truth.valid, truth.known
    weight = weights.weigh(v_cube.norm(dim=-1), labels)
    mean = partial(mean_over_shapes, truth.shape, len(surface.scale))
    exp = Asked(*_answer(surface, "exp", truth), moved, labels, weight, None)
    log = Asked(*_answer(surface, "log", truth), v_cube, labels, weight, q / scale)
    own = [map_losses(of, weights, mean) for of in (exp, log)]
    terms = {"exp": own[0]["rec"], "log": own[1]["rec"]}
    for name in ("prior", "pairs", "validity"):
        if found := [losses[name] for losses in own if name in losses]:
            terms[name] = torch.stack(found).sum()
    total = own[0]["total"] + own[1]["total"]
    if weights.cyc:
        again, _ = surface.decode_log(p, p + scale * exp.vector[:, ::4], shape)
        terms["cycle"] = mean(cycle_loss, again / scale, v_cube[:, ::4], weight[:, ::4])
        total = total + weights.cyc * terms["cycle"]
    if weights.geo:
        _, J_exp = surface.jacobian_exp(p, v[:, ::8], shape=shape)
        _, J_log = surface.jacobian_log(p, q[:, ::8], shape=shape)
        chosen = torch.logical_and(*labels)[:, ::8]
        for name, loss in (("isometric", isometric_loss), ("conformal", conformal_loss)):
            tame = partial(_where_tame, loss)
            terms[name] = mean(tame, J_exp, chosen) + mean(tame, J_log, chosen)
            total = total + weights.geo * terms[name]
    return {"total": total, **terms}


def _answer(
    surface: EncodedSurface, which: Literal["exp", "log"], truth: Truth
) -> tuple[Tensor, Tensor, Tensor | None]:
    """What a head answers in the cube: `vector`, `logit` and `prior` of `Asked`."""
    head: MapHead = getattr(surface.field, f"{which}_head")
    scale, centre = surface.scale[truth.shape][:, None], surface.centre[truth.shape]
    x = truth.v if which == "exp" else truth.q - centre[:, None]
    with surface.field.half_precision():
        found = head.prepare(
            surface.embedding, (truth.p - centre) / scale, x / scale[..., None], truth.shape
        )
        vector, logit = head.answer(*found)
    prior = None if found.prior is None else found.prior[:, found.first :]
    return vector[:, found.first :], logit[:, found.first :], prior


def mean_over_shapes(
    shape: Tensor, shapes: int, loss: Callable[..., Tensor], *of: Tensor
) -> Tensor:
    """Mean over the shapes of `loss` of each one's own rows.

    Args:
        shape: (S,) int64, shape of each row.
        shapes: number of shapes; one without rows gives `loss` empty tensors.
        loss: from tensors of some rows to a scalar.
        of: (S, ...) what `loss` takes.

    >>> x = torch.tensor([[1.0], [3.0], [8.0]])
    >>> mean_over_shapes(torch.tensor([0, 0, 1]), 2, torch.mean, x)
    tensor(5.)
    """
    rows = [(shape == i).nonzero().squeeze(-1) for i in range(shapes)]
    return torch.stack([loss(*(x[row] for x in of)) for row in rows]).mean()


def _where_tame(loss: Callable[[Tensor], Tensor], J: Tensor, chosen: Tensor | bool) -> Tensor:
    """Eq. (3) over the chosen queries where the map does not jump; 0 without any."""
    chosen = (J.detach().square().sum((-2, -1)) < WILD**2) & chosen
    return loss(J[chosen]) if chosen.any() else J.new_zeros(())


def self_supervised_losses(
    surface: EncodedSurface, weights: LossWeights, sources: int = 16, vectors: int = 64
) -> dict[str, Tensor]:
    """Eqs (3) and (4) alone, for clouds without ground truth (ours), by name.

    Each cloud gives `sources` of its points, each with `vectors` random tangent vectors up to the
    trained radius. Eq. (3) is averaged over every eighth vector, in its tangent form.

    Args:
        surface: encoded clouds, in the normalised cube.
        weights: those of `cyc` and `geo` count.
        sources, vectors: S of a cloud, and K.
    """
    counts = surface.batch.bincount()
    first = (counts.cumsum(0) - counts).repeat_interleave(sources)
    shape = torch.arange(len(counts), device=counts.device).repeat_interleave(sources)
    drawn = torch.rand(len(shape), device=counts.device) * counts[shape]
    p = surface.points[first + drawn.long()].detach()[:, None]  # (S, 1, 3)
    shape = shape[:, None]
    axes = surface.frame(p, shape=shape)[..., :2].detach()
    flat = F.normalize(torch.randn(len(p), vectors, 2, device=p.device, dtype=p.dtype), dim=-1)
    length = torch.rand(len(p), vectors, 1, device=p.device, dtype=p.dtype)
    v = product(axes, flat[..., None]).squeeze(-1) * length * surface.radius_at(p, shape)[..., None]
    scale = surface.scale[shape][..., None]
    terms, total = {}, v.new_zeros(())
    if weights.cyc:
        end, _ = surface.decode_exp(p, v, shape)
        back, _ = surface.decode_log(p, end, shape)
        terms["cycle"] = cycle_loss(back / scale, v / scale, torch.ones_like(length[..., 0]))
        total = total + weights.cyc * terms["cycle"]
    if weights.geo:
        end, J_exp = surface.jacobian_exp(p, v[:, ::8], shape=shape)
        _, J_log = surface.jacobian_log(p, end.detach(), shape=shape)
        there = surface.frame(end.detach(), shape=shape)[..., :2].detach()
        J_exp, J_log = product(J_exp, axes), product(J_log, there)
        for name, loss in (("isometric", isometric_loss), ("conformal", conformal_loss)):
            terms[name] = _where_tame(loss, J_exp, True) + _where_tame(loss, J_log, True)
            total = total + weights.geo * terms[name]
    return {"total": total, **terms}
