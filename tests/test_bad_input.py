"""Bad arguments of the operators are named, and what is far away has a finite answer."""

import math

import pytest
import torch
from references import finite, lumpy, packed, shaken

from riemlayer.ops import (
    decal,
    farthest_points,
    frechet_mean,
    kmeans,
    local_geometry,
    stitch_log,
    tangent_pca,
)

POINTS = lumpy(120)
P, Q, V = POINTS[:4], POINTS[4:8], 0.2 * torch.randn(4, 3, dtype=torch.float64)
T = torch.full((4,), 0.5, dtype=torch.float64)
UP = torch.tensor([0.3, 0.5, 0.7], dtype=torch.float64)


@pytest.fixture(scope="module")
def surface():
    torch.manual_seed(0)
    with torch.no_grad():
        return shaken("tiny", strength=0.3).encode(POINTS)


VECTORS = {
    "dist": {"p": P, "q": Q},
    "cdist": {"p": P, "q": Q},
    "inner": {"p": P, "u": V, "v": V},
    "norm": {"p": P, "u": V},
    "normal": {"p": P},
    "frame": {"p": P},
    "snap": {"p": P},
    "in_support": {"p": P},
    "project": {"p": P, "v": V},
    "to_2d": {"p": P, "v": V},
    "from_2d": {"p": P, "x": V[:, :2]},
    "geodesic": {"p": P, "q": Q, "t": T},
    "advance": {"p": P, "v": V},
    "shoot": {"p": P, "v": V},
    "transport": {"p": P, "q": Q, "v": V},
    "log_refined": {"p": P, "q": Q},
    "valid_mask": {"p": P, "q": Q},
    "injectivity_radius": {"p": P},
}
"""Operators of a surface, and good arguments."""
WHOLE = {
    "frechet_mean": (frechet_mean, {"points": POINTS}),
    "tangent_pca": (tangent_pca, {"points": POINTS}),
    "kmeans": (kmeans, {"points": POINTS, "k": 3}),
    "farthest_points": (farthest_points, {"points": POINTS, "k": 3}),
    "stitch_log": (stitch_log, {"p": POINTS[0], "points": POINTS}),
    "decal": (decal, {"p": POINTS[0], "up": UP, "size": 0.3, "points": POINTS}),
}
CASES = [(name, None, good, key) for name, good in VECTORS.items() for key in good]
CASES += [
    (name, call, good, key)
    for name, (call, good) in WHOLE.items()
    for key in good
    if isinstance(good[key], torch.Tensor)
]


def with_nan(x):
    return x.clone().index_fill_(0, torch.tensor([x.shape[0] - 1]), torch.nan)


BAD = {
    "NaN": (with_nan, ValueError, "must be finite"),
    "infinity": (lambda x: x / torch.zeros_like(x), ValueError, "must be finite"),
    "float32": (lambda x: x.float(), ValueError, "must have dtype torch.float64"),
    "integers": (lambda x: x.long(), TypeError, "must have a floating-point dtype"),
    "array": (lambda x: x.numpy(), TypeError, "torch.from_numpy"),
    "list": (lambda x: x.tolist(), TypeError, "must be a torch.Tensor, got list"),
    "a coordinate too many": (
        lambda x: torch.cat((x, x[..., :1]), -1),
        ValueError,
        r"must (have shape|broadcast)",
    ),
}


def ask(surface, name, call, arguments):
    if call is None:
        return getattr(surface, name)(**arguments)
    return call(surface, **arguments)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name, call, good, key", CASES, ids=[f"{c[0]}-{c[3]}" for c in CASES])
def test_bad_arguments_are_named(surface, name, call, good, key, bad):
    change, error, words = BAD[bad]
    with pytest.raises(error, match=words) as raised:
        ask(surface, name, call, good | {key: change(good[key])})
    assert f"`{key}`" in str(raised.value) or bad == "float32"  # or the other, if it is first


@pytest.mark.parametrize("name", [n for n, good in VECTORS.items() if len(good) > 1])
def test_arguments_that_do_not_broadcast_are_named(surface, name):
    if name == "cdist":
        return
    good = VECTORS[name]
    key = list(good)[-1]
    with pytest.raises(ValueError, match=f"`p` and .*`{key}`.* must broadcast"):
        getattr(surface, name)(**good | {key: good[key][:3]})


@pytest.mark.parametrize("name", VECTORS)
def test_no_points_have_no_answers(surface, name):
    answer = getattr(surface, name)(**{k: x[:0] for k, x in VECTORS[name].items()})
    for x in answer if isinstance(answer, tuple) else (answer,):
        assert x.numel() == 0


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda s: s.injectivity_radius(P, directions=0), "directions and steps must be at least"),
        (lambda s: s.injectivity_radius(P, steps=0), "directions and steps must be at least"),
        (lambda s: s.shoot(P, V, 0), "steps must be at least 1, got 0"),
        (lambda s: s.cdist(P[None], Q), r"`p` must have shape \(P, 3\), got \(1, 4, 3\)"),
        (lambda s: frechet_mean(s, POINTS[:0]), r"K >= 1, got \(0, 3\)"),
        (lambda s: frechet_mean(s, P, T * torch.nan), "`weights` must be finite"),
        (lambda s: frechet_mean(s, P, T[:3]), r"weights must expand to \(4,\).* got \(3,\)"),
        (lambda s: kmeans(s, POINTS, 0), r"k must lie in \[1, 120\] \(the points\), got 0"),
        (lambda s: kmeans(s, POINTS[:0], 1), r"points must hold at least 1 point"),
        (lambda s: farthest_points(s, POINTS, 0), r"k must lie in \[1, 120\]"),
        (lambda s: farthest_points(s, POINTS, 121), r"k must lie in \[1, 120\]"),
        (lambda s: stitch_log(s, P[0], POINTS[:0]), "points must hold at least 1 point"),
        (lambda s: stitch_log(s, P[0], P[0]), r"`points` must have shape \(N, 3\), got \(3,\)"),
        (lambda s: stitch_log(s, P[0], POINTS, radius=math.nan), "radius must be positive"),
        (lambda s: decal(s, P, UP, 0.3, POINTS), r"p must be one point \(3,\), got \(4, 3\)"),
        (lambda s: decal(s, P[0], 0 * UP, 0.3, POINTS), "up must have a part in the tangent"),
        (lambda s: decal(s, P[0], UP, math.nan, POINTS), "size must be positive, got nan"),
        (lambda s: local_geometry(s, k=0), "k must be at least 1, got 0"),
        (lambda s: local_geometry(s, k=120), "k must be less than .* got 120 where one has 120"),
        (lambda s: local_geometry(s, radius=0.0), "radius must be positive, got 0.0"),
        (lambda s: local_geometry(s, radius=math.nan), "radius must be positive, got nan"),
        (lambda s: local_geometry(s.at(torch.arange(0))), "k must be less than .* one has 0"),
        (lambda s: local_geometry(s.at(torch.arange(1))), "k must be less than .* one has 1"),
        (lambda s: local_geometry(s, k=4).turned(T), r"`angle` must have shape \(120\)"),
    ],
)
def test_sizes_that_make_no_sense_are_named(surface, call, words):
    with pytest.raises(ValueError, match=words):
        call(surface)


def test_k_is_held_against_the_smallest_cloud():
    surface = shaken("tiny").encode(*packed(lumpy(60), lumpy(9)))
    with pytest.raises(ValueError, match="got 9 where one has 9"):
        local_geometry(surface, k=9)
    assert local_geometry(surface, k=8).edge_index.shape == (2, 69 * 8)


@pytest.mark.parametrize("size", [1e3, 1e9, 1e18])
@pytest.mark.parametrize("name", [n for n in VECTORS if n != "shoot"])
@pytest.mark.parametrize("which", ["first", "last"])
def test_far_away_answers_are_finite(name, which, size):
    """In float32, where the square of 1e20 is no number any more."""
    single = shaken("tiny", torch.float32, 0.3).encode(POINTS.float()).detach()
    good = {k: x.float() for k, x in VECTORS[name].items()}
    key = list(good)[0 if which == "first" else -1]
    if key == "t":
        key = "q"
    assert finite(getattr(single, name)(**good | {key: size * good[key]}))
