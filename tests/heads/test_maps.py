"""The two heads in the cube: anchored by construction, or the paper's plain decoders."""

import pytest
import torch
from references import encoded, fibonacci_sphere, lumpy, shaken

from riemlayer import ExpLogField
from riemlayer.config import SCALES, FieldConfig, HeadConfig
from riemlayer.geometry.shell import HIGH as HIGHEST
from riemlayer.heads import MapOutput
from riemlayer.heads.branch import SITE, TRAINED, Gate, at_sources, read_narrow, sites
from riemlayer.heads.fans import BEYOND, MIDDLE, NEAR, fan_share

HEADS = {
    "walked": HeadConfig(resolution=8, channels=4, hidden=32, narrow=8, walks=1, walk_steps=4),
    "walked twice": HeadConfig(
        resolution=8, channels=4, hidden=32, narrow=8, walks=2, walk_steps=6
    ),
    "three": HeadConfig(resolution=8, channels=4, hidden=32, narrow=8, walks=3, walk_steps=5),
    "on shells": HeadConfig(resolution=8, channels=4, hidden=32, narrow=8, walks=4, walk_steps=5),
    "straight": HeadConfig(resolution=8, channels=4, hidden=32, narrow=8, walks=0),
    "told nothing": HeadConfig(resolution=8, channels=4, hidden=32, narrow=0, walks=0),
}


def field_with(head: HeadConfig) -> ExpLogField:
    field = ExpLogField(FieldConfig(FieldConfig.tiny().backbone, head)).double()
    with torch.no_grad():
        for parameter in field.parameters():
            parameter.add_(torch.randn_like(parameter), alpha=0.2)
    return field


def answers(field: ExpLogField, which: str, x: torch.Tensor) -> MapOutput:
    points = lumpy(300)
    with torch.no_grad():
        embedding = field.embed(points, torch.zeros(300, dtype=torch.long))
        head = getattr(field, f"{which}_head")
        base = points[: len(x)]
        query = x if which == "exp" else base[:, None] + x
        return head(embedding, base, query, torch.zeros(len(x), dtype=torch.long))


@pytest.mark.parametrize("which", ["exp", "log"])
@pytest.mark.parametrize("name", HEADS)
def test_anchored_heads_move_by_x_to_first_order(name, which):
    """|answer - x| falls with |x|^2 or faster, whatever the weights."""
    field = field_with(HEADS[name])
    direction = torch.nn.functional.normalize(torch.randn(5, 20, 3).double(), dim=-1)
    departure = [
        float((answers(field, which, t * direction).vector / t - direction).norm(dim=-1).max())
        for t in (1e-2, 1e-3, 1e-4)
    ]
    assert departure[1] < departure[0] / 3 and departure[2] < departure[1] / 3, departure
    assert float(answers(field, which, 0 * direction).vector.abs().max()) < 1e-15
    far = answers(field, which, 0.4 * direction).vector - 0.4 * direction
    assert far.norm(dim=-1).mean() > 0.01  # the weights do have a say


def test_the_gate_goes_from_the_first_prior_to_the_others_and_trusts_from_0_to_1():
    gate = Gate(told=5, others=1).double()
    priors = [torch.randn(2, 7, 3).double() for _ in range(2)]
    told, site = [torch.randn(2, 7, 2).double() for _ in range(2)], torch.randn(2, 1).double()
    prior, trust = (x.detach() for x in gate(priors, told, site))
    share = (prior - priors[0]) / (priors[1] - priors[0])
    torch.testing.assert_close(share, share[..., :1].expand_as(share))
    for x in (share, trust):
        assert (x > 0).all() and (x < 1).all() and x.std() > 0
    for bias, expected in ((-1e3, priors[0]), (1e3, priors[1])):
        torch.nn.init.constant_(gate.body[-1].bias, bias)
        prior, trust = gate(priors, told, site)
        torch.testing.assert_close(prior, expected)
        torch.testing.assert_close(trust, torch.full_like(trust, bias > 0))


def test_a_gate_lifts_wherever_it_went():
    gate = Gate(told=5, others=2, ways=(1,)).double()
    first, other, way = (torch.randn(2, 7, 3).double() for _ in range(3))
    told, site = [torch.randn(2, 7, 4).double()], torch.randn(2, 1).double()
    torch.nn.init.constant_(gate.body[-1].bias, 1e3)
    torch.testing.assert_close(gate([first, other, way], told, site)[0], other + way)
    torch.nn.init.constant_(gate.body[-1].bias[:1], -1e3)
    torch.testing.assert_close(gate([first, other, way], told, site)[0], first + way)


@pytest.mark.parametrize("which", ["exp", "log"])
def test_a_correction_that_is_not_trusted_leaves_the_prior(which):
    field = field_with(HEADS["walked"])
    head = getattr(field, f"{which}_head")
    torch.nn.init.constant_(head.gate.body[-1].bias[-1:], -1e3)
    points, shape = lumpy(300), torch.zeros(5, dtype=torch.long)
    with torch.no_grad():
        embedding = field.embed(points, torch.zeros(300, dtype=torch.long))
        found = head.prepare(embedding, points[:5], points[:5, None] + 0.1, shape)
        torch.testing.assert_close(head.answer(*found).vector, found.prior)


def test_what_is_told_of_sources_says_how_high_they_are_and_how_dense_the_cloud_is():
    """Nothing on the points of a sphere; more the higher; on either side; more of more points."""
    field, shape = field_with(HEADS["three"]), torch.zeros(20, dtype=torch.long)
    dense = []
    for n in (1000, 4000):
        points = 0.9 * fibonacci_sphere(n)
        embedding = field.embed(points, torch.zeros(n, dtype=torch.long))
        seen = []
        for height in (0.001, 0.01, 0.05, -0.05):
            p = points[:: n // 20] * (1 + height / 0.9)
            at_p = at_sources(embedding.planes, p, shape)
            site = sites(embedding, p, shape, at_p)
            assert site.shape[-1] == 3 * SITE + 1
            seen.append(site[:, -4:-1])
            dense.append(float(site[:, -1].detach().mean()))
        low, middle, high, below = (x.detach()[:, ::2] for x in seen)  # fine planes have gaps
        assert (low < middle).all() and (middle < high).all() and (high < 1).all()
        assert (high[:, 0] > high[:, 1]).all()  # in cells the same height is less
        assert (below > middle).all()
    assert min(dense[4:]) > max(dense[:4])


@pytest.mark.parametrize("height", [-0.02, 0.02])
def test_exp_can_keep_the_height_of_the_source(height):
    """p beside a lumpy sphere: walks end on the planes, and as far off as p is where lifted."""
    field = field_with(HEADS["walked twice"])
    points, shape = lumpy(3000), torch.zeros(20, dtype=torch.long)
    p = points[:20] * (1 + height / points[:20].norm(dim=-1, keepdim=True))
    outwards = torch.nn.functional.normalize(p, dim=-1)[:, None]
    v = torch.linalg.cross(torch.randn(20, 30, 3).double(), outwards.expand(20, 30, 3))
    v = 0.3 * torch.nn.functional.normalize(v, dim=-1)
    seen = []
    field.exp_head.gate.register_forward_hook(lambda _, given, __: seen.extend(given[0]))
    with torch.no_grad():
        embedding = field.embed(points, torch.zeros(3000, dtype=torch.long))
        field.exp_head.prepare(embedding, p, v, shape)
        first, *_, lift = (x[:, 1:] for x in seen)
        off = []
        for end in (first, first + lift):
            x = (p[:, None] + end).flatten(0, 1)
            plane = embedding.planes.plane(x, shape.new_zeros(len(x)))
            off.append(float(plane[1].abs().median()) / abs(height))
    assert off[0] < 0.2 and 0.7 < off[1] < 1.3, off
    torch.testing.assert_close(seen[-1][:, 0], torch.zeros_like(p), rtol=0, atol=0)


@pytest.mark.parametrize("which", ["exp", "log"])
def test_shells_are_for_sources_beside_the_cloud(which):
    """Whatever the gate says, sources on it are answered as if there were none."""
    field, shape = field_with(HEADS["on shells"]), torch.zeros(20, dtype=torch.long)
    head, n = getattr(field, f"{which}_head"), fibonacci_sphere(20)
    points = 0.8 * fibonacci_sphere(4000)
    embedding = field.embed(points, torch.zeros(4000, dtype=torch.long))
    cell = embedding.planes.fine.level.cell_size
    v = torch.linalg.cross(torch.randn(20, 30, 3).double(), n[:, None].expand(20, 30, 3))
    v = 0.3 * torch.nn.functional.normalize(v, dim=-1)
    change = []
    for height in (0.0, 0.5 * HIGHEST * cell, 3 * HIGHEST * cell):
        p = (0.8 + height) * n
        x = v if which == "exp" else p[:, None] + v
        priors = []
        for bias in (-1e3, 1e3):
            torch.nn.init.constant_(head.gate.body[-1].bias[:1], bias)
            with torch.no_grad():
                priors.append(head.prepare(embedding, p, x, shape).prior)
        change.append((priors[1] - priors[0]).norm(dim=-1))
    assert (change[0] == 0).all()
    assert (change[1][:, 1:].mean() > 0) and (change[2][:, 1:] > 0).all()
    assert (change[2][:, 0] == 0).all()


def test_the_straight_and_untold_configuration_is_possible():
    out = answers(field_with(HEADS["told nothing"]), "exp", torch.randn(3, 4, 3).double() * 0.1)
    assert out.vector.shape == (3, 4, 3) and out.validity.shape == (3, 4)


@pytest.mark.parametrize("which", ["exp", "log"])
def test_the_papers_heads_are_plain_decoders(which):
    """Not anchored: the answer at x = 0 is what the decoder says."""
    field = shaken("paper", strength=0.3)
    out = answers(field, which, torch.zeros(4, 2, 3).double())
    assert (out.vector[:, 0].norm(dim=-1) > 1e-3).all()
    torch.testing.assert_close(out.vector[:, 0], out.vector[:, 1])


def test_queries_of_a_source_do_not_see_each_other():
    field = field_with(HEADS["walked"])
    x = 0.3 * torch.randn(4, 10, 3).double()
    for which in ("exp", "log"):
        whole = answers(field, which, x)
        part = answers(field, which, x[:, 3:4])
        torch.testing.assert_close(part.vector, whole.vector[:, 3:4], rtol=0, atol=1e-12)
        torch.testing.assert_close(part.validity, whole.validity[:, 3:4], rtol=0, atol=1e-12)


def test_near_queries_do_not_depend_on_who_else_is_asked():
    """No fan is walked for a source whose queries are all near; their answers are the same."""
    field = field_with(HEADS["walked twice"])
    x = 0.1 * torch.nn.functional.normalize(torch.randn(4, 10, 3).double(), dim=-1)
    x[:, 5:8] *= 4
    x[:, 8:] *= 30
    whole, part = answers(field, "log", x), answers(field, "log", x[:, :5])
    torch.testing.assert_close(part.vector, whole.vector[:, :5], rtol=0, atol=1e-12)


def test_an_untrained_log_leans_to_what_its_fans_say():
    """Of a flat chord, a way from shells, fans and a bent chord, told anything at all."""
    torch.manual_seed(3)
    gate = ExpLogField.from_preset("base").log_head.gate
    assert gate is not None
    site = torch.rand(4, SITE * SCALES + 1)
    told = torch.randn(4, 50, gate.first.in_features - site.shape[1])
    flat, fans, bent = (x.expand(4, 50, 3) for x in torch.eye(3))
    with torch.no_grad():
        prior, _ = gate([flat, torch.zeros_like(flat), fans, bent], [told], site)
    of_flat, of_fans, of_bent = prior.mean((0, 1))
    assert of_fans > 0.65 and of_flat < 0.25 and of_bent < 0.25


def test_the_share_of_fans_changes_smoothly_with_the_chord():
    x = torch.linspace(0, 2, 2001).double()[:, None] * torch.tensor([[0.6, 0, 0.8]]).double()
    share, length = fan_share(x).squeeze(-1), x.norm(dim=-1)
    assert (share[(length <= NEAR) | (length >= BEYOND)] == 0).all()
    assert (share[(length >= MIDDLE) & (length <= TRAINED)] == 1).all()
    steepest = 6 / (MIDDLE - NEAR) ** 2  # second derivative of a cubic from 0 to 1
    assert (share >= 0).all() and share.diff().diff().abs().max() < 1.1 * steepest * 1e-6


def test_validity_does_not_disturb_the_maps():
    field = field_with(HEADS["walked"])
    points, zero = lumpy(300), torch.zeros(300, dtype=torch.long)
    for head in (field.exp_head, field.log_head):
        field.zero_grad()
        out = head(field.embed(points, zero), points[:4], points[:4, None] * 0.9, zero[:4])
        out.validity.sum().backward()
        touched = {
            name for name, x in field.named_parameters() if x.grad is not None and x.grad.any()
        }
        assert touched == {name for name in touched if ".valid." in name} and touched


@pytest.mark.parametrize("sure", [0.0, 1e3])
@pytest.mark.parametrize("which", ["exp", "log"])
def test_validity_is_low_beyond_the_trained_radius(which, sure):
    """Whatever the weights say, of vectors or chords of 1.5 radii it is under one in a thousand."""
    field = field_with(HEADS["walked"])
    for head in (field.exp_head, field.log_head):
        head.valid.bias.data += sure
    direction = torch.nn.functional.normalize(torch.randn(5, 20, 3).double(), dim=-1)
    out = answers(field, which, 1.5 * field.config.radius * direction)
    assert (out.validity.sigmoid() < 1e-3).all()


def test_narrow_embedding_is_zero_off_the_support():
    embedding = encoded().embedding
    far = torch.tensor([[[0.0, 0, 0], [1.05, 1.05, 1.05]]]).double()
    assert (read_narrow(embedding, far, torch.zeros(1, dtype=torch.long)) == 0).all()
    none = embedding._replace(narrow=None)
    assert read_narrow(none, far, torch.zeros(1, dtype=torch.long)).shape == (1, 2, 0)
