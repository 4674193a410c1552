"""Fans of learned radii: where they land, what is read there, and where gradients go."""

import pytest
import torch
from nn.geometry import Case, plane, sphere

from riemlayer.nn import AdaptiveGeodesicConv
from riemlayer.nn.adaptive import read


def reach(layer: AdaptiveGeodesicConv, case: Case) -> torch.Tensor:
    points = case.cloud.points
    q = case.cloud.decode_exp(points[:, None], layer.fan(case.geometry))[0]
    return case.cloud.dist(points[:, None], q)


def test_the_fan_lies_at_its_radii_in_all_directions():
    case, layer = sphere(), AdaptiveGeodesicConv(3, 4, rings=2, angles=6).double()
    with torch.no_grad():
        layer.logit.copy_(torch.logit(torch.tensor([0.2, 0.7])))
    share = reach(layer, case).view(40, 2, 6) / case.geometry.radius[:, None, None]
    expected = torch.tensor([0.2, 0.7], dtype=torch.float64)[:, None].expand(40, 2, 6)
    torch.testing.assert_close(share, expected, rtol=1e-6, atol=1e-7)
    v = layer.fan(case.geometry).view(40, 2, 6, 3)
    torch.testing.assert_close(v.sum(2), torch.zeros(40, 2, 3, dtype=torch.float64))


def test_reading_is_the_mean_of_a_loop():
    case = sphere(12, 4)
    g, points = case.geometry, case.cloud.points
    x, q = torch.randn(12, 3, dtype=torch.float64), torch.randn(12, 2, 3, dtype=torch.float64)
    q = points[:, None] + 0.2 * q
    y = read(x, q, points, g)
    for i in range(12):
        near = [i, *g.edge_index[0, g.edge_index[1] == i].tolist()]
        for f in range(2):
            d = (q[i, f] - points[near]).norm(dim=-1) / g.radius[i]
            w = (1 - d**2).clamp_min(0) ** 2
            w[0] += 1e-6
            torch.testing.assert_close(y[i, f], (w[:, None] * x[near]).sum(0) / w.sum())


def test_constant_features_stay_constant():
    case, layer = sphere(), AdaptiveGeodesicConv(3, 4).double()
    y = layer(torch.ones(40, 3, dtype=torch.float64), case.geometry, case.cloud)
    torch.testing.assert_close(y, y[:1].expand(40, 4))


def test_radii_learn_where_the_features_are():
    """The task: the mean over a ring of radius 0.8; a learner that starts at 0.3 finds it."""
    torch.manual_seed(1)
    case = plane(40, 8)
    teacher, learner = (AdaptiveGeodesicConv(2, 2, rings=1, angles=6).double() for _ in range(2))
    with torch.no_grad():
        teacher.logit.fill_(torch.logit(torch.tensor(0.8)))
        learner.load_state_dict(teacher.state_dict() | {"logit": torch.logit(torch.tensor([0.3]))})
    x = torch.randn(40, 2, dtype=torch.float64)
    target = teacher(x, case.geometry, case.cloud).detach()
    optimiser = torch.optim.Adam([learner.logit], lr=0.1)
    for _ in range(50):
        loss = (learner(x, case.geometry, case.cloud) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert float(learner.radii.detach()) == pytest.approx(0.8, abs=0.05)


def test_another_surface_is_refused():
    case, other = sphere(), sphere(30)
    with pytest.raises(ValueError, match=r"surface must be the one .* of 40 points .* of 30"):
        AdaptiveGeodesicConv(3, 4).double()(case.cloud.points, case.geometry, other.cloud)
