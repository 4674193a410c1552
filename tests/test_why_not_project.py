"""Why not project: shapes, edges and network are what the benchmark says, and it runs."""

import json

import numpy as np
import pytest
import torch
from references import flat_grid, shaken

from benchmarks import why_not_project
from benchmarks.labelled import Labelled, labelled
from benchmarks.log_edges import (
    Logs,
    at_random,
    by_field,
    by_mesh_heat,
    by_projection,
    cloud_normals,
    mesh_normals,
    on_one_side,
)
from benchmarks.segmenter import (
    ANGLES,
    KNOWN,
    RADIUS,
    RINGS,
    PatchConv,
    Patches,
    geometry,
    graph,
    question,
    upright,
)
from riemlayer.data.meshes import is_watertight_manifold
from riemlayer.nn import TangentConv


@pytest.fixture(scope="module", params=["figure", "sheet"])
def shape(request) -> Labelled:
    return labelled(request.param, 0, 600)


@pytest.fixture(scope="module")
def flat() -> Labelled:
    """A square in the plane z = 0, 0.05 between the points."""
    vertices, faces = flat_grid(21)
    return Labelled(0.5 * vertices, faces, np.zeros(len(vertices), int), "square")


def test_shapes_are_closed_meshes_with_every_label(shape):
    assert is_watertight_manifold(shape.vertices, shape.faces)
    assert 400 < len(shape.vertices) < 900 and np.abs(shape.vertices).max() == pytest.approx(1)
    assert sorted(set(shape.label.tolist())) == [0, 1, 2, 3]
    with pytest.raises(ValueError, match="kind must be 'figure' or 'sheet', got 'cup'"):
        labelled("cup", 0)


def test_near_in_space_is_not_near_on_the_surface(shape):
    own = graph(shape, 0)
    far = by_mesh_heat(shape, own.edge_index).vector.norm(dim=-1) > RADIUS
    other = own.label[own.edge_index[0]] != own.label[own.edge_index[1]]
    assert float(far.float().mean()) > 0.1
    assert float(other[far].float().mean()) > 2 * float(other[~far].float().mean())


def test_edges_join_points_within_the_radius_once(shape):
    own = graph(shape, 0)
    sender, receiver = own.edge_index
    assert bool(((own.points[sender] - own.points[receiver]).norm(dim=-1) < RADIUS).all())
    assert bool((sender != receiver).all()) and bool((receiver.diff() >= 0).all())
    assert len(own.edge_index.unique(dim=1).T) == len(sender)
    assert torch.equal(graph(shape, 0).edge_index, own.edge_index)


def test_frames_are_right_handed_and_upright():
    normal = torch.nn.functional.normalize(torch.randn(100, 3), dim=-1)
    frame = upright(torch.cat((normal, torch.tensor([[0.0, 0, 1], [0, 0, -1]]))))
    eye = torch.eye(3).expand_as(frame)
    torch.testing.assert_close(frame.mT @ frame, eye, rtol=0, atol=1e-5)
    torch.testing.assert_close(torch.linalg.det(frame), torch.ones(102))
    assert bool((frame[:100, 2, 1] > 0).all()) and bool((frame[:, 2, 0].abs() < 1e-5)[:100].all())


def test_on_a_plane_every_rival_answers_with_the_offset(flat):
    own = graph(flat, 0)
    sender, receiver = own.edge_index
    offset = own.points[sender] - own.points[receiver]
    for logs in (
        by_projection(flat, own.edge_index),
        by_projection(flat, own.edge_index, chord=True),
        on_one_side(flat, own.edge_index, by_projection, cloud_normals),
        by_mesh_heat(flat, own.edge_index),
    ):
        inner = (own.points[own.edge_index].abs() < 0.3).all(-1).all(0)
        gap = (logs.vector - offset).norm(dim=-1)[inner]
        assert bool(logs.valid.all()) and float(gap.max()) < 0.02


def test_one_side_takes_the_normals_that_it_is_given(shape):
    own = graph(shape, 0)
    sender, receiver = own.edge_index
    every = by_projection(shape, own.edge_index)
    logs = on_one_side(shape, own.edge_index, by_projection, mesh_normals)
    assert torch.equal(logs.vector, every.vector) and bool(every.valid.all())
    normal = mesh_normals(shape)
    cosine = (normal[sender] * normal[receiver]).sum(-1)
    assert torch.equal(logs.valid, cosine > 0) and 0.3 < float(logs.valid.float().mean()) < 0.9


def test_through_a_plate_normals_tell_what_is_near_on_the_surface():
    shape = labelled("sheet", 0, 600)
    own = graph(shape, 0)
    far = by_mesh_heat(shape, own.edge_index).vector.norm(dim=-1) > RADIUS
    valid = on_one_side(shape, own.edge_index, by_projection, mesh_normals).valid
    assert float(valid[far].float().mean()) < 0.1 < 0.9 < float(valid[~far].float().mean())


def test_the_control_keeps_lengths_and_planes_and_loses_directions(shape):
    own = graph(shape, 0)
    logs = by_projection(shape, own.edge_index)
    control = at_random(shape, own.edge_index, by_projection)
    length = logs.vector.norm(dim=-1)
    torch.testing.assert_close(control.vector.norm(dim=-1), length, rtol=1e-3, atol=1e-4)
    cosine = torch.nn.functional.cosine_similarity(control.vector, logs.vector, dim=-1)
    assert abs(float(cosine.mean())) < 0.02 and float(cosine.abs().mean()) > 0.5
    assert torch.equal(control.valid, logs.valid)


def test_normals_of_a_flat_cloud_are_upright(flat):
    up = torch.tensor([[0.0, 0, 1]], dtype=torch.float64).expand(441, 3)
    torch.testing.assert_close(cloud_normals(flat), up)
    torch.testing.assert_close(mesh_normals(flat).abs(), up)


def test_the_field_answers_along_each_edge(shape):
    own, field = graph(shape, 0), shaken("tiny", torch.float32)
    logs = by_field(shape, own.edge_index, field)
    pick = torch.arange(0, own.edge_index.shape[1], 97)
    sender, receiver = own.edge_index[:, pick]
    with torch.inference_mode():
        v = field.encode(own.points).log(own.points[receiver], own.points[sender])
    torch.testing.assert_close(logs.vector[pick], v, rtol=1e-3, atol=1e-3)
    confirmed = by_field(shape, own.edge_index, field, confirmed=True)
    assert bool((logs.valid | ~confirmed.valid).all())
    torch.testing.assert_close(confirmed.vector, logs.vector)


def test_edges_that_are_too_long_or_not_valid_do_not_count(shape):
    own = graph(shape, 0)
    logs = by_projection(shape, own.edge_index)
    lost = torch.rand(len(logs.valid)) < 0.3
    vector = torch.where(torch.rand(len(lost), 1) < 0.2, 5 * logs.vector, logs.vector)
    edges = geometry(own, Logs(vector, ~lost))
    out = lost | (vector.norm(dim=-1) >= RADIUS)
    assert torch.equal(edges.valid, ~out) and bool((edges.weight[out] == 0).all())
    total = torch.zeros(len(own.points)).index_add(0, edges.edge_index[1], edges.weight)
    torch.testing.assert_close(total[total > 0], torch.ones(int((total > 0).sum())))
    length = vector.norm(dim=-1)
    torch.testing.assert_close(edges.log.norm(dim=-1)[length > 1e-3], length[length > 1e-3])


def test_prepared_patches_are_tangent_convolution(shape):
    own = graph(shape, 0)
    edges = geometry(own, by_projection(shape, own.edge_index))
    conv = PatchConv(5, 7, RINGS, ANGLES)
    x = torch.randn(len(own.points), 5, requires_grad=True)
    y = x.detach().clone().requires_grad_()
    fast, plain = conv(x, Patches.of(edges)), TangentConv.forward(conv, y, edges)
    torch.testing.assert_close(fast, plain, rtol=1e-4, atol=1e-4)
    fast.square().sum().backward()
    plain.square().sum().backward()
    torch.testing.assert_close(x.grad, y.grad, rtol=1e-3, atol=1e-3)


def test_a_few_labels_are_told_and_the_rest_are_asked_for(shape):
    own = graph(shape, 0)
    told = question("few labels", own, torch.Generator().manual_seed(0))
    assert bool((told.x[told.asked] == 0).all()) and bool((told.x[~told.asked].sum(-1) == 2).all())
    assert abs(float((~told.asked).float().mean()) - KNOWN) < 0.03
    pairs = torch.stack((own.label, told.label)).unique(dim=1)
    assert len(pairs.T) == 4  # another name for each label, the same for all points
    turned = question("coordinates", own, torch.Generator().manual_seed(0))
    torch.testing.assert_close(turned.x[:, 2], own.points[:, 2])
    torch.testing.assert_close(turned.x.norm(dim=-1), own.points.norm(dim=-1))


@pytest.mark.slow
def test_it_writes_accuracies_and_takes_times_again(tmp_path):
    options = ["--fast", "--weights", "preset:tiny", "--output", str(tmp_path)]
    why_not_project.main(options)
    path = tmp_path / "why_not_project.json"
    before = json.loads(path.read_text())
    assert len(before["rows"]) == 10
    for row in before["rows"].values():
        assert all(len(x) == 2 and 0 <= min(x) <= max(x) <= 1 for x in row["accuracy"].values())
        assert len(row["seconds"]) == 4 and min(row["seconds"]) > 0
    lost = before["rows"].pop("projection")
    path.write_text(json.dumps(before))
    why_not_project.main([*options, "--resume"])
    again = json.loads(path.read_text())["rows"]
    assert again["projection"]["accuracy"] == lost["accuracy"]
    assert all(again[name] == row for name, row in before["rows"].items())
    why_not_project.main([*options, "--timing-only"])
    for name, row in json.loads(path.read_text())["rows"].items():
        assert row["accuracy"] == again[name]["accuracy"]
        assert row["seconds"] != again[name]["seconds"]
    assert "| projection |" in (tmp_path / "why_not_project.md").read_text()
