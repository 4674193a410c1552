"""Saving and loading: the same bits back, and files that are not whole or not ours raise."""

import json

import pytest
import torch
from references import lumpy, shaken
from safetensors.torch import load_file, save_file

from riemlayer import ExpLogField
from riemlayer.storage import CARD, WEIGHTS, save_field


@pytest.fixture
def field() -> ExpLogField:
    return shaken("tiny", torch.float32)


@pytest.fixture
def folder(field, tmp_path):
    field.save_pretrained(tmp_path / "saved")
    return tmp_path / "saved"


@pytest.mark.parametrize("kind", [str, lambda x: x], ids=["str", "path"])
def test_saved_and_loaded_weights_are_the_same_bits(field, folder, kind):
    loaded = ExpLogField.from_pretrained(kind(folder))
    assert loaded.config == field.config and not loaded.training
    theirs = loaded.state_dict()
    assert theirs.keys() == field.state_dict().keys()
    for name, x in field.state_dict().items():
        assert torch.equal(theirs[name], x) and theirs[name].dtype == x.dtype, name


def test_a_loaded_field_answers_the_same_bits(field, folder):
    points = lumpy(100, torch.float32)
    p, v = points[:5], 0.2 * points[5:10]
    mine, theirs = (f.encode(points) for f in (field, ExpLogField.from_pretrained(folder)))
    assert torch.equal(mine.exp(p, v), theirs.exp(p, v))
    assert torch.equal(mine.log(p, p + v), theirs.log(p, p + v))


def test_every_preset_is_stored_with_its_configuration(tmp_path):
    for name in ("tiny", "paper"):
        saved = ExpLogField.from_preset(name)
        saved.save_pretrained(tmp_path / name)
        assert ExpLogField.from_pretrained(tmp_path / name).config == saved.config


def test_weights_in_half_precision_are_loaded_in_single(field, tmp_path):
    facts = {"steps": 12, "data": "procedural"}
    save_field(field, tmp_path / WEIGHTS, tmp_path / CARD, dtype=torch.bfloat16, **facts)
    loaded = ExpLogField.from_pretrained(tmp_path)
    for name, x in loaded.state_dict().items():
        assert torch.equal(x, field.state_dict()[name].bfloat16().float())
    card = json.loads((tmp_path / CARD).read_text())
    assert card == {"config": json.loads(json.dumps(field.config.to_dict())), **facts}


def test_a_double_field_comes_back_double(field, tmp_path):
    twin = type(field)(field.config).double()
    twin.save_pretrained(tmp_path)
    loaded = type(field).from_pretrained(tmp_path)
    for name, x in twin.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], x)


def test_saving_leaves_the_field_as_it_was(field, tmp_path):
    field.train()
    before = {name: x.clone() for name, x in field.state_dict().items()}
    field.save_pretrained(tmp_path)
    assert field.training
    for name, x in field.state_dict().items():
        assert torch.equal(x, before[name])


@pytest.mark.parametrize("keep", [0, 5, 100, -1], ids=["empty", "start", "header", "last byte"])
def test_truncated_weights_raise(folder, keep):
    file = folder / WEIGHTS
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"model\.safetensors is truncated or corrupt"):
        ExpLogField.from_pretrained(folder)


def test_weights_that_are_something_else_raise(folder):
    (folder / WEIGHTS).write_bytes(b"not a tensor in sight" * 100)
    with pytest.raises(ValueError, match="truncated or corrupt"):
        ExpLogField.from_pretrained(folder)


def test_weights_of_another_configuration_raise(folder, tmp_path):
    ExpLogField.from_preset("paper").save_pretrained(tmp_path / "paper")
    (tmp_path / "paper" / WEIGHTS).replace(folder / WEIGHTS)
    with pytest.raises(ValueError, match=r"model\.safetensors do not fit .*config\.json") as raised:
        ExpLogField.from_pretrained(folder)
    assert len(str(raised.value)) < 500


@pytest.mark.parametrize("change", ["missing", "extra"])
def test_loading_is_strict(folder, change):
    state = load_file(folder / WEIGHTS)
    if change == "missing":
        del state["narrow.weight"]
    else:
        state["colour"] = torch.zeros(3)
    save_file(state, folder / WEIGHTS)
    with pytest.raises(ValueError, match="narrow.weight" if change == "missing" else "colour"):
        ExpLogField.from_pretrained(folder)


@pytest.mark.parametrize(
    "card, words",
    [
        ({}, "holds no `config`"),
        ({"config": {"backbone": {}}}, "not the configuration of an ExpLogField"),
        ({"config": {"backbone": {"width": 3}, "head": {}}}, "width"),
    ],
)
def test_cards_of_something_else_raise(folder, card, words):
    (folder / CARD).write_text(json.dumps(card))
    with pytest.raises(ValueError, match=words):
        ExpLogField.from_pretrained(folder)


@pytest.mark.parametrize("name", [WEIGHTS, CARD])
def test_a_folder_without_a_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"holds no {name}"):
        ExpLogField.from_pretrained(folder)


def test_a_file_beside_the_folder_is_not_taken_for_it(folder):
    (folder.parent / "saved.safetensors").write_bytes(b"of another library")
    ExpLogField.from_pretrained(folder)


def test_an_unknown_name_raises_without_a_network():
    with pytest.raises(OSError, match="cannot find the requested files in the local cache"):
        ExpLogField.from_pretrained("nobody/no-such-field")
