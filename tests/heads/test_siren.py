"""The SIREN decoder: its formula, and that maps on it keep every law they have on triplanes."""

from dataclasses import replace

import pytest
import torch
from references import lumpy
from torch import Tensor
from torch.autograd import gradcheck

from riemlayer import EncodedSurface, ExpLogField, FieldConfig, HeadConfig
from riemlayer.heads import SirenDecoder

TINY = FieldConfig.tiny()
HEADS = {
    "anchored": replace(TINY.head, decoder="siren"),
    "straight": replace(TINY.head, decoder="siren", narrow=0, walks=0),
    "plain": replace(TINY.head, decoder="siren", narrow=0, walks=0, anchored=False),
}
MAPS = ["exp", "log"]


def surface_with(head: HeadConfig) -> EncodedSurface:
    """An encoded cloud; the last layers are far from their small start."""
    field = ExpLogField(replace(TINY, head=head)).double()
    for one in (field.exp_head, field.log_head):
        torch.nn.init.normal_(one.decoder.out.weight, std=0.2)
    return field.encode(lumpy(250)).detach()


def queries(s: int = 5, k: int = 6) -> tuple[Tensor, Tensor]:
    return lumpy(250)[:s, None], 0.2 * torch.randn(s, k, 3).double()


def ask(surface: EncodedSurface, which: str, p: Tensor, x: Tensor) -> Tensor:
    """Exp_p(x), or Log_p(p + x)."""
    return surface.exp(p, x) if which == "exp" else surface.log(p, p + x)


def test_decoder_is_chosen_by_its_name():
    field = ExpLogField(replace(TINY, head=HEADS["anchored"]))
    assert type(field.exp_head.decoder) is type(field.log_head.decoder) is SirenDecoder
    assert not any("planes" in name for name in field.state_dict())
    with pytest.raises(ValueError, match=r"decoder must be one of .*'siren'.*got 'relu'"):
        HeadConfig(decoder="relu")


def test_values_are_those_of_the_formula():
    """Layer by layer, query by query; what is read comes from the last hidden features."""
    decoder = SirenDecoder(6, inputs=5, config=HEADS["plain"], layers=4).double()
    z, x, told = (torch.randn(*n).double() for n in [(2, 6), (2, 3, 3), (2, 3, 2)])
    answer, read = decoder(z, x, (told,), z[:, :0], lambda hidden: hidden.sum(-1))
    film = (z @ decoder.film.weight.T + decoder.film.bias).view(2, 2, 3, -1)
    for s in range(2):
        for k in range(3):
            h = torch.cat((x[s, k], told[s, k]))
            for i, layer in enumerate(decoder.layers):
                gamma, beta = film[s, :, i]
                h = torch.sin(30 * (1 + gamma) * (layer.weight @ h + layer.bias) + beta)
            torch.testing.assert_close(answer[s, k], decoder.out.weight @ h + decoder.out.bias)
            torch.testing.assert_close(read[s, k], h.sum())


def test_it_starts_as_sitzmann_et_al_start_it():
    """Uniform up to 1 / n, then sqrt(6 / n) / w0: the phases keep a standard deviation near 1."""
    config = replace(HEADS["plain"], hidden=256)
    decoder = SirenDecoder(6, inputs=5, config=config, layers=5)
    bounds = [1 / 5, *[(6 / 256) ** 0.5 / 30] * 4]
    for layer, bound in zip([*decoder.layers, decoder.out], bounds, strict=True):
        assert 0.95 * bound < layer.weight.abs().max() <= bound
    phases = []
    for layer in decoder.layers:
        layer.register_forward_hook(lambda module, _, y: phases.append(30 * (y - module.bias)))
    torch.nn.init.zeros_(decoder.film.weight)
    x = 2 * torch.rand(1, 500, 5) - 1
    with torch.no_grad():
        decoder(
            torch.zeros(1, 6), x[..., :3], (x[..., 3:],), x[:, 0, :0], lambda hidden: hidden.sum(-1)
        )
    assert all(0.7 < float(phase.std()) < 1.4 for phase in phases[1:])


@pytest.mark.parametrize("which", MAPS)
@pytest.mark.parametrize("name", ["anchored", "straight"])
def test_anchoring_is_exact(which, name):
    """Zero stays zero to the bit, and d(Exp_p)_0 = d(Log_p)_p = I whatever the weights say."""
    surface = surface_with(HEADS[name])
    p, x = queries()
    zero = torch.zeros_like(x)
    expected = p.expand_as(x) if which == "exp" else zero
    with torch.no_grad():
        assert torch.equal(ask(surface, which, p, zero), expected)
        far = ask(surface, which, p, x) - (p + x if which == "exp" else x)
    assert far.norm(dim=-1).mean() > 0.01  # the weights do have a say
    jacobian = surface.jacobian_exp(p, zero) if which == "exp" else surface.jacobian_log(p, p)
    eye = torch.eye(3).double().expand_as(jacobian[1])
    torch.testing.assert_close(jacobian[1], eye, rtol=0, atol=1e-9)


@pytest.mark.parametrize("which", MAPS)
@pytest.mark.parametrize("name", HEADS)
def test_jacobian_is_that_of_autograd(which, name):
    """Forward mode under vmap, S sources with K queries each."""
    surface = surface_with(HEADS[name])
    p, x = queries(3, 4)
    if which == "exp":
        value, jacobian = surface.jacobian_exp(p, x)
    else:
        value, jacobian = surface.jacobian_log(p, p + x)
    torch.testing.assert_close(value, ask(surface, which, p, x), rtol=0, atol=1e-12)
    whole = torch.autograd.functional.jacobian(lambda x: ask(surface, which, p, x), x)
    own = torch.einsum("skiskj->skij", whole)
    torch.testing.assert_close(jacobian, own, rtol=1e-8, atol=1e-8)
    assert whole.abs().sum() - own.abs().sum() < 1e-9  # a query depends on itself alone


@pytest.mark.parametrize("which", MAPS)
def test_sources_with_queries_are_their_queries_one_by_one(which):
    surface = surface_with(HEADS["anchored"])
    p, x = queries(3, 4)
    with torch.no_grad():
        together = ask(surface, which, p, x)
        for s in range(3):
            for k in range(4):
                one = ask(surface, which, p[s, 0], x[s, k])
                torch.testing.assert_close(one, together[s, k], rtol=0, atol=1e-12)


def test_the_embedding_modulates():
    """Without its linear map of z, all sources decode alike; with it they do not."""
    decoder = SirenDecoder(6, inputs=3, config=HEADS["plain"]).double()
    z, x = torch.randn(2, 6).double(), torch.randn(1, 9, 3).double().expand(2, -1, -1)

    def apart() -> float:
        one, other = decoder(z, x, (), z[:, :0], lambda hidden: hidden.sum(-1))[0].detach()
        return float((one - other).abs().max())

    assert apart() > 1e-3
    torch.nn.init.zeros_(decoder.film.weight)
    assert apart() < 1e-12


def test_it_learns_a_surface_for_each_embedding():
    """Four embeddings, four quadrics: two hundred steps take away most of the error."""
    decoder = SirenDecoder(6, inputs=3, config=HEADS["plain"])
    z, x = torch.randn(4, 6), 2 * torch.rand(4, 200, 3) - 1
    bent = torch.einsum("skij,ski->skj", x[..., :, None] * torch.randn(4, 1, 3, 3), x)
    optimiser = torch.optim.AdamW(decoder.parameters(), 1e-3)
    errors = []
    for _ in range(200):
        error = (decoder(z, x, (), z[:, :0], lambda hidden: hidden.sum(-1))[0] - bent).abs().mean()
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        errors.append(float(error.detach()))
    assert errors[-1] < 0.2 * errors[0]


def test_gradcheck_backward_and_forward():
    decoder = SirenDecoder(4, inputs=3, config=replace(HEADS["plain"], hidden=6)).double()
    inputs = torch.randn(2, 4).double(), torch.randn(2, 3, 3).double()
    assert gradcheck(
        lambda z, x: decoder(z, x, (), z[:, :0], lambda hidden: hidden.sum(-1)),
        tuple(y.requires_grad_() for y in inputs),
        check_forward_ad=True,
    )


def test_half_precision_is_not_for_phases():
    """Under autocast the answers are those of float32, to the bit."""
    decoder = SirenDecoder(6, inputs=3, config=HEADS["plain"])
    z, x = torch.randn(2, 6), torch.randn(2, 9, 3)
    expected, _ = decoder(z, x, (), z[:, :0], lambda hidden: hidden.sum(-1))
    with torch.autocast("cpu", torch.bfloat16):
        answer, _ = decoder(z, x, (), z[:, :0], lambda hidden: hidden.sum(-1))
    assert answer.dtype == torch.float32 and torch.equal(answer, expected)


def test_saved_and_loaded_it_answers_the_same_bits(tmp_path):
    field = ExpLogField(replace(TINY, head=HEADS["anchored"]))
    field.save_pretrained(tmp_path)
    loaded = ExpLogField.from_pretrained(tmp_path)
    points = lumpy(100, torch.float32)
    p, v = points[:5], 0.2 * points[5:10]
    assert loaded.config == field.config
    assert torch.equal(loaded.encode(points).exp(p, v), field.encode(points).exp(p, v))
