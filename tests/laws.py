"""The laws of Exp and Log, stated once: for closed forms, for traces and for the field.

`exp(p, v)` and `log(p, q)` are functions of tensors (..., 3). What does not hold raises
AssertionError with the largest departure.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd.functional import jacobian, jvp

Map = Callable[[Tensor, Tensor], Tensor]


def close(actual: Tensor, expected: Tensor, atol: float, law: str) -> None:
    """Every entry within `atol`."""
    worst = float((actual - expected).detach().abs().max())
    assert worst <= atol, f"{law}: off by {worst:.3g}, allowed {atol:.3g}"


def check_anchored(exp: Map, log: Map, p: Tensor, atol: float) -> None:
    """Exp_p(0) = p and Log_p(p) = 0."""
    zero = torch.zeros_like(p)
    close(exp(p, zero), p, atol, "Exp_p(0) = p")
    close(log(p, p.clone()), zero, atol, "Log_p(p) = 0")


def check_differentials(exp: Map, log: Map, p: Tensor, direction: Tensor, atol: float) -> None:
    """d(Exp_p)_0 and d(Log_p)_p take `direction` (..., 3) to itself."""
    _, moved = jvp(lambda v: exp(p, v), torch.zeros_like(p), direction)
    close(moved, direction, atol, "d(Exp_p)_0 = I")
    _, moved = jvp(lambda q: log(p, q), p.clone(), direction)
    close(moved, direction, atol, "d(Log_p)_p = I")


def exp_log_errors(exp: Map, log: Map, p: Tensor, v: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """|Log_p(Exp_p(v)) - v| and |Exp_p(Log_p(q)) - q| (...)."""
    return (log(p, exp(p, v)) - v).norm(dim=-1), (exp(p, log(p, q)) - q).norm(dim=-1)


def check_exp_log(exp: Map, log: Map, p: Tensor, v: Tensor, atol: float) -> None:
    """Log undoes Exp, and Exp undoes Log, along vectors short of the cut locus."""
    q = exp(p, v)
    close(log(p, q), v, atol, "Log_p(Exp_p(v)) = v")
    close(exp(p, log(p, q)), q, atol, "Exp_p(Log_p(q)) = q")


def check_broadcast(f: Map, p: Tensor, x: Tensor, atol: float) -> None:
    """f(p[:, None], x) with p (S, 3) and x (S, K, 3) is f of every single pair."""
    together = f(p[:, None], x)
    one_by_one = torch.stack(
        [torch.stack([f(a, y) for y in ys]) for a, ys in zip(p, x, strict=True)]
    )
    assert together.shape == x.shape
    close(together, one_by_one, atol, "broadcasting is a loop")


def check_pure(f: Callable[..., Tensor], *inputs: Tensor) -> None:
    """A call leaves its inputs as they were, and a second call gives the same bits."""
    before = [x.clone() for x in inputs]
    first = f(*inputs).detach().clone()
    for x, old in zip(inputs, before, strict=True):
        assert torch.equal(x, old), "an input was written to"
    assert torch.equal(f(*inputs).detach(), first), "a second call differs"


def autograd_jacobians(f: Callable[[Tensor, Tensor], Tensor], p: Tensor, x: Tensor) -> Tensor:
    """Jacobians (n, 3, 3) of f(p_i, x_i) in x_i, one query at a time, by backward passes."""
    rows = [jacobian(lambda y, a=a: f(a, y), b) for a, b in zip(p, x, strict=True)]
    return torch.stack([row for row in rows if isinstance(row, Tensor)])
