"""Configurations: presets, round trip, contradictions raise."""

import json
from dataclasses import FrozenInstanceError, fields, replace

import pytest

from riemlayer import BackboneConfig, FieldConfig, HeadConfig
from riemlayer.config import LAYERS


@pytest.mark.parametrize("name", ["base", "paper", "tiny"])
def test_presets_survive_json(name):
    config = FieldConfig.preset(name)
    assert FieldConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_paper_is_appendix_b():
    config = FieldConfig.paper()
    assert config.backbone.encoder == (64, 64, 64, 128) and config.backbone.depth == 6
    assert config.backbone.encoder_blocks == (2, 3, 3)
    assert config.backbone.decoder == (128,) * 4 and config.backbone.decoder_blocks == (2, 2, 2)
    assert config.backbone.embedding == 256 and config.backbone.stem == 0
    head = config.head
    assert (head.resolution, head.channels, LAYERS, head.hidden) == (16, 8, 3, 256)
    assert not head.anchored and not head.narrow and not head.walks


def test_unknown_preset_is_named():
    names = r"\['base', 'base-normals', 'paper', 'tiny'\]"
    with pytest.raises(ValueError, match=f"one of {names}, got 'huge'"):
        FieldConfig.preset("huge")


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"encoder": (8, 8)}, "same number of stages"),
        ({"decoder": (8, 8)}, "same number of stages"),
        ({"encoder_blocks": (1,)}, "same number of stages"),
        ({"decoder_blocks": (1,)}, "decoder_blocks must have 3 entries"),
        ({"depth": 2}, r"depth must lie in \[3, 10\] .* got 2"),
        ({"depth": 11}, "got 11"),
    ],
)
def test_contradictory_backbones_raise(changes, words):
    with pytest.raises(ValueError, match=words):
        replace(BackboneConfig(), **changes)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"anchored": False}, "set anchored=True"),
        ({"anchored": False, "walks": 0}, "set anchored=True"),
        ({"walks": 5}, r"walks must be an integer in \[0, 4\], got 5"),
        ({"walks": -1}, r"integer in \[0, 4\], got -1"),
        ({"walks": 2.5}, r"integer in \[0, 4\], got 2.5"),
        ({"walk_steps": (8, 8)}, r"walk_steps must be an integer.*got \(8, 8\)"),
        ({"walk_steps": 0}, "walk_steps must be an integer of at least 1, got 0"),
    ],
)
def test_contradictory_heads_raise(changes, words):
    with pytest.raises(ValueError, match=words):
        replace(HeadConfig(), **changes)


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"backbone": {}},
        {"backbone": {}, "head": {}, "colour": 1},
        {"backbone": {"width": 3}, "head": {}},
        {"backbone": {}, "head": {"width": 3}},
        {"backbone": {"depth": "5"}, "head": {}},
        {"backbone": [], "head": {}},
        None,
        [],
    ],
)
def test_dictionaries_of_something_else_raise(values):
    with pytest.raises(ValueError, match="not the configuration of an ExpLogField"):
        FieldConfig.from_dict(values)


@pytest.mark.parametrize("config", [BackboneConfig(), HeadConfig(), FieldConfig()])
def test_configurations_are_frozen_and_small(config):
    with pytest.raises(FrozenInstanceError):
        setattr(config, fields(config)[0].name, 1)
    assert len(fields(config)) <= 9
