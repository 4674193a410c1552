"""Fans of several scales that answer as one: a softmax over the points of all of them."""

from collections.abc import Sequence

import pytest
import torch
from references import lumpy, planes_of
from torch import Tensor

from riemlayer import ExpLogField
from riemlayer.geometry import Fan, LocalPlanes, fan_of, log_on_fan
from riemlayer.heads.fans import JointFan

FANS, SOURCES, RAYS, SITE = 3, 4, 6, 5


def fans_of(planes: Sequence[LocalPlanes], p: Tensor, normal: Tensor) -> Fan:
    """One fan over each of the planes at every source, those of a source in turn."""
    place = torch.zeros(1, dtype=torch.long)
    every = [
        fan_of(on, at[None], place, RAYS, 0.5, tangent=n[None])
        for at, n in zip(p, normal, strict=True)
        for on in planes
    ]
    return Fan(*(torch.cat(y) for y in zip(*every, strict=True)))


@pytest.fixture
def fan() -> Fan:
    """Fans over planes of three depths at four sources."""
    points = lumpy(2000)
    planes = [planes_of(points, depth) for depth in (3, 4, 5)]
    p, place = points[:SOURCES], torch.zeros(SOURCES, dtype=torch.long)
    return fans_of(planes, p, planes[1].normal(p, place))


@pytest.fixture
def x() -> Tensor:
    return 0.3 * torch.randn(SOURCES, 7, 3, dtype=torch.float64)


def shaken_joint() -> JointFan:
    joint = JointFan(FANS, SITE).double()
    with torch.no_grad():
        for weight in joint.parameters():
            weight.normal_()
    return joint


def own(fan: Fan, s: int) -> Fan:
    """The fans of one source."""
    return Fan(*(y[FANS * s : FANS * (s + 1)] for y in fan))


def side_by_side(fan: Fan) -> Fan:
    """The points of all fans as those of one."""
    *parts, axes = fan
    return Fan(*(torch.cat(tuple(y))[None] for y in parts), axes[:1])


def test_untrained_all_points_count_alike(fan, x):
    site = torch.randn(SOURCES, SITE, dtype=torch.float64)
    read = log_on_fan(JointFan(FANS, SITE).double()(fan, site), x)
    for s in range(SOURCES):
        every = log_on_fan(side_by_side(own(fan, s)), x[s : s + 1])
        for a, b in zip(read, every, strict=True):
            torch.testing.assert_close(a[s : s + 1], b, rtol=0, atol=1e-9)


def test_a_point_counts_as_often_as_it_is_told(fan, x):
    """Twice is as if it were there twice; next to nothing, as if it were not there."""
    one = Fan(*(y[:1] for y in fan))
    some = torch.arange(one.key.shape[1]) % 3 == 0
    *parts, axes = one
    twice = Fan(*(torch.cat((y, y[:, some]), 1) for y in parts), axes)
    counts = torch.where(some, torch.tensor(2.0).double().log(), 0.0)[None, :, None]
    for a, b in zip(log_on_fan(one.counting(counts), x[:1]), log_on_fan(twice, x[:1]), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-9)
    rest = Fan(*(y[:, ~some] for y in parts), axes)
    gone = torch.where(some, -1e4, 0.0)[None, :, None].double()
    for a, b in zip(log_on_fan(one.counting(gone), x[:1]), log_on_fan(rest, x[:1]), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-9)


def test_sources_do_not_see_each_other(fan, x):
    joint, site = shaken_joint(), torch.randn(SOURCES, SITE, dtype=torch.float64)
    whole = log_on_fan(joint(fan, site), x)
    for s in range(SOURCES):
        part = log_on_fan(joint(own(fan, s), site[s : s + 1]), x[s : s + 1])
        for a, b in zip(whole, part, strict=True):
            torch.testing.assert_close(a[s : s + 1], b, rtol=0, atol=1e-9)


def test_counts_have_gradients_and_keep_full_precision(fan, x):
    joint, site = shaken_joint(), torch.randn(SOURCES, SITE, dtype=torch.float64)
    names, weights = zip(*joint.named_parameters(), strict=True)

    def read(*weights):
        named = dict(zip(names, weights, strict=True))
        return log_on_fan(torch.func.functional_call(joint, named, (fan, site)), x).vector

    assert torch.autograd.gradcheck(read, weights, fast_mode=True)
    with torch.autocast("cpu", torch.bfloat16):
        half = read(*weights)
    assert torch.equal(half, read(*weights))


@torch.no_grad()
def test_log_reads_the_fans_of_every_scale_at_each_source():
    cloud = 0.9 * lumpy(5000).float()
    field = ExpLogField.from_preset("base").eval()
    head = field.log_head
    assert head.joint is not None
    embedding = field.embed(cloud, torch.zeros(len(cloud), dtype=torch.long))
    p, place = cloud[:3], torch.zeros(3, dtype=torch.long)
    normal = embedding.planes.normal(p, place)
    q = cloud[torch.cdist(p, cloud).argsort(-1)[:, 300:340]]
    x = q - p[:, None]
    share = torch.ones(*x.shape[:2], 1)
    site = torch.zeros(3, head.joint.at_source.in_features)
    places = embedding.planes.places(place, 3)
    log, _ = head.on_fan(embedding.planes, places, 16, p, x, x, share, normal, site)
    for i in range(3):
        at = places[i::3]
        fan = fan_of(embedding.planes, p[i].expand(3, 3), at, 48, 0.5, 16, normal[i].expand(3, 3))
        own = log_on_fan(side_by_side(fan), x[i : i + 1]).vector
        torch.testing.assert_close(log[i : i + 1], own, rtol=0, atol=1e-5)
