"""The variants of the ablations: each trains, and differs in what its name says."""

import math
from dataclasses import replace

import pytest
import torch
from references import lumpy

from lightning_modules import ExpLogDataModule
from lightning_modules.ablation import VARIANTS, Variant
from riemlayer import ExpLogField, FieldConfig
from riemlayer.data.dataset import read_sample
from riemlayer.data.sample_file import write_sample
from riemlayer.losses import LossWeights, Truth, explog_losses

TINY = FieldConfig.tiny()


def shrunk(variant: Variant) -> Variant:
    """The variant's switches in the size of `tiny`."""
    backbone, head = variant.config.backbone, variant.config.head
    config = replace(
        TINY,
        backbone=replace(TINY.backbone, kind=backbone.kind, stem=16 if backbone.stem else 0),
        head=replace(
            TINY.head,
            decoder=head.decoder,
            anchored=head.anchored,
            narrow=8 if head.narrow else 0,
            walks=head.walks,
            fan_rays=TINY.head.fan_rays if head.fan_rays else 0,
        ),
    )
    return replace(variant, config=config)


def take_a_step(variant: Variant, points: int) -> None:
    """Finite losses, gradients and weights; no gradient is 0 but those that cancel."""
    field = ExpLogField(variant.config)
    for parameter in field.parameters():  # away from a start at which gradients vanish
        parameter.data.add_(torch.randn_like(parameter), alpha=0.3 / len(parameter) ** 0.5)
    cloud, s, k = lumpy(points, torch.float32), 3, 16
    p, v = cloud[:s], 0.2 * torch.randn(s, k, 3)
    yes = torch.ones(s, k, dtype=torch.bool)
    truth = Truth(p, v, p[:, None] + v, yes, yes, torch.zeros(s, dtype=torch.long))
    surface = field.encode_in_cube(cloud, torch.zeros(points, dtype=torch.long))
    losses = explog_losses(surface, truth, variant.losses)
    assert all(x.isfinite() for x in losses.values()), losses
    losses["total"].backward()
    grads = {name: x.grad for name, x in field.named_parameters()}
    assert all(x is not None and x.isfinite().all() for x in grads.values())
    still = {name for name, x in grads.items() if not x.any()}
    cancel = {f"{h}_head.decoder.out.bias" for h in ("exp", "log")}  # f - f(0)
    assert still <= cancel | {"log_head.joint.count.bias"}  # of all points alike, in a softmax
    torch.optim.AdamW(field.parameters()).step()
    assert all(x.isfinite().all() for x in field.parameters())


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_takes_a_finite_step(name):
    take_a_step(shrunk(VARIANTS[name]), points=300)


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_takes_a_finite_step_in_its_own_size(name):
    take_a_step(VARIANTS[name], points=300)


def test_variants_differ_in_what_their_names_say():
    base = VARIANTS["base"]
    assert VARIANTS["octree_triplane"] == base  # trained once
    different = [x for name, x in VARIANTS.items() if name != "octree_triplane"]
    assert not any(a == b for i, a in enumerate(different) for b in different[:i])
    full = VARIANTS["full"]
    assert (full.losses.geo, full.losses.cyc, full.tau) == (0.01, 0.01, 0.5)
    assert VARIANTS["no_filtering"] == replace(full, tau=math.inf)
    assert VARIANTS["simple_loss"] == replace(full, losses=LossWeights(geo=0, cyc=0))
    for name in ("pointnet_triplane", "octree_siren", "without_anchor", "without_stem"):
        assert VARIANTS[name] == replace(base, config=VARIANTS[name].config)
    assert {x.table for x in VARIANTS.values()} == {"Tab. 3", "Tab. 5", "ours"}


def test_without_the_filter_training_sees_what_validation_does_not(tmp_path, folder):
    for file in folder.glob("*.safetensors"):
        sample = read_sample(file)
        sample["divergence"] = torch.linspace(0, 2, 32).expand(6, -1).clone()
        arrays = {name: x.numpy() for name, x in sample.items()}
        write_sample(tmp_path / file.name, arrays, {"name": file.stem})
    kept = {}
    for tau in (0.5, math.inf):
        data = ExpLogDataModule([str(tmp_path)], sources=3, vectors=32, validation=0.2, tau=tau)
        data.setup("fit")
        kept[tau] = [
            float(part[0, 1].truth.valid.float().mean()) for part in (data.train, data.held)
        ]
    assert kept[0.5] == [0.25, 0.25] and kept[math.inf] == [1.0, 0.25]
