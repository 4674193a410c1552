"""Sample files as a data set, and what augmentation may and may not change."""

from dataclasses import replace

import pytest
import torch
import trimesh

from riemlayer.data.augment import (
    Augmentation,
    depth_noise,
    half_way,
    noise_like,
    rotation,
    sample_surface,
    seen,
    thin_out,
    training_sample,
    uneven,
)
from riemlayer.data.closed_form import Sphere
from riemlayer.data.dataset import ShapeDataset, read_sample, sample_files, split
from riemlayer.data.sample_file import write_sample

ALWAYS = Augmentation(as_meshed=0.3, soup=1, uneven=1, noise=1, cut=1)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def sphere():
    """A prepared sphere: a sample whose Exp is known exactly."""
    mesh = trimesh.creation.icosphere(4)
    g, surface = generator(), Sphere()
    vertices = torch.tensor(mesh.vertices)
    p = vertices[torch.randperm(len(vertices), generator=g)[:16]]
    v = surface.project_to_tangent(p[:, None], torch.randn(16, 400, 3, generator=g).double() / 4)
    v = v / v.norm(dim=-1, keepdim=True) * 0.5 * torch.rand(16, 400, 1, generator=g).double()
    sample = dict(vertices=vertices, p=p, normal=p, v=v, q=surface.exp(p[:, None], v))
    sample = {name: x.float() for name, x in sample.items()}
    return sample | {
        "faces": torch.tensor(mesh.faces, dtype=torch.int32),
        "divergence": torch.rand(16, 400, generator=g),
        "complete": torch.rand(16, 400, generator=g) > 0.1,
    }


def save(path, sample):
    write_sample(path, {name: x.numpy() for name, x in sample.items()}, {"name": path.stem})


# Augmentation


@pytest.mark.parametrize("how", [Augmentation.none(), Augmentation(), ALWAYS], ids=range(3))
@pytest.mark.parametrize("seed", range(6))
def test_a_turned_and_scaled_sphere_is_a_sphere_with_its_exp(sphere, how, seed):
    """Centre and radius can be read off p and q; in that frame q = Exp_p(v) of the sphere."""
    truth = training_sample(sphere, how, generator(seed), sources=8, vectors=100).truth
    on = torch.cat([truth.p[:, None], truth.q], 1).flatten(0, 1).double()
    system = torch.cat([2 * on, torch.ones(len(on), 1).double()], 1)  # |x|^2 = 2 c.x + (r^2 - c^2)
    solution = torch.linalg.lstsq(system, on.square().sum(1, keepdim=True)).solution.squeeze(1)
    centre = solution[:3]
    radius = (solution[3] + centre.square().sum()).sqrt().item()
    p, q, v = truth.p.double() - centre, truth.q.double() - centre, truth.v.double()
    torch.testing.assert_close(Sphere(radius).exp(p[:, None], v), q, rtol=0, atol=1e-4)
    assert (p[:, None] * v).sum(-1).abs().max() < 1e-4


def test_clean_clouds_stay_on_the_shape_that_p_and_q_lie_on(sphere):
    how = Augmentation(noise=0, uneven=0.5, cut=0.5)
    for seed in range(6):
        item = training_sample(sphere, how, generator(seed), sources=8, vectors=100)
        known = item.truth.q[item.truth.known]
        gap = torch.cdist(known, item.points).amin(1)
        assert gap.mean() < 0.1  # the spacing of 2562 points, 10:1 density included
        assert gap.max() < 0.35


def test_every_cloud_lies_in_the_cube_and_fills_it(sphere):
    for seed in range(10):
        points = training_sample(sphere, ALWAYS, generator(seed)).points
        side = (points.amax(0) - points.amin(0)).max()
        assert points.abs().max() <= 1 + 1e-6
        assert 2 * ALWAYS.smallest - 1e-5 <= side <= 2 + 1e-5


def test_pairs_stay_pairs(sphere):
    paired = dict(sphere)
    half = 200
    paired["v"] = torch.cat([sphere["v"][:, :half], sphere["v"][:, :half] * 1.01], 1)
    v = training_sample(paired, ALWAYS, generator(), vectors=120).truth.v
    first, second = v.chunk(2, dim=1)
    torch.testing.assert_close(second, first * 1.01, rtol=1e-3, atol=1e-5)


def test_masks_follow_the_vectors_they_belong_to(sphere):
    marked = dict(sphere)
    long = sphere["v"].norm(dim=-1) > 0.25
    marked |= {"divergence": long.float(), "complete": ~long}
    truth = training_sample(marked, Augmentation.none(), generator(), vectors=200).truth
    long = truth.v.norm(dim=-1) > 0.25
    assert (truth.valid == ~long).all()
    assert (truth.known == ~long).all()


def test_the_same_generator_draws_the_same_sample(sphere):
    one, same, other = (training_sample(sphere, ALWAYS, generator(s)) for s in (1, 1, 2))
    torch.testing.assert_close(one.points, same.points, rtol=0, atol=0)
    torch.testing.assert_close(one.truth.v, same.truth.v, rtol=0, atol=0)
    assert one.points.shape != other.points.shape or (one.points != other.points).any()


def test_the_prepared_tensors_are_never_written_to(sphere):
    before = {name: x.clone() for name, x in sphere.items()}
    for seed in range(5):
        training_sample(sphere, ALWAYS, generator(seed))
    assert all((before[name] == sphere[name]).all() for name in before)


def test_without_augmentation_nothing_moves(sphere):
    item = training_sample(sphere, Augmentation.none(), generator())
    torch.testing.assert_close(item.points, sphere["vertices"], rtol=0, atol=1e-6)


@pytest.mark.parametrize("freely", [0.0, 1.0])
def test_rotations_are_rotations(freely):
    for seed in range(20):
        turn = rotation(freely, generator(seed))
        torch.testing.assert_close(turn @ turn.T, torch.eye(3), rtol=0, atol=1e-5)
        assert torch.linalg.det(turn) == pytest.approx(1, abs=1e-5)


def test_free_rotations_have_no_preferred_direction():
    turned = torch.stack([rotation(1.0, generator(seed)) for seed in range(3000)])
    assert turned.mean(0).abs().max() < 0.06
    torch.testing.assert_close(
        turned.square().mean(0), torch.full((3, 3), 1 / 3), rtol=0, atol=0.03
    )


def test_thinning_keeps_about_n_points_apart(sphere):
    points = sample_surface(sphere["vertices"], sphere["faces"], 9000, generator())
    for n in (1000, 3000):
        kept = thin_out(points, n)
        assert len(kept) == pytest.approx(n, rel=0.25)
        apart, apart_random = (
            torch.cdist(x, x).fill_diagonal_(9).amin(1) for x in (kept, points[: len(kept)])
        )
        assert apart.std() / apart.mean() < 0.8 * apart_random.std() / apart_random.mean()


def test_density_varies_by_about_ten_to_one(sphere):
    points = sample_surface(sphere["vertices"], sphere["faces"], 60_000, generator())
    share = torch.zeros(8)
    for seed in range(4):
        kept = torch.zeros(len(points), dtype=torch.bool)
        kept[uneven(points, generator(seed))] = True
        octant = ((points > 0).long() * torch.tensor([1, 2, 4])).sum(1)
        share = torch.stack([kept[octant == i].float().mean() for i in range(8)])
        assert kept.float().mean() == pytest.approx(0.39, abs=0.03)  # of 10^-u, u uniform
        assert 1.5 < share.max() / share.min() < 10


def test_noise_is_as_large_as_said(sphere):
    points = sample_surface(sphere["vertices"], sphere["faces"], 20_000, generator())
    kinds = set()
    for seed in range(12):
        noise = noise_like(points, 0.02, generator(seed))
        length, along = noise.norm(dim=1), torch.linalg.svdvals(noise) / len(points) ** 0.5
        if along[1] < 1e-6:  # one direction: a depth camera
            assert along[0] == pytest.approx(0.02 / 3, rel=0.05)
        elif length.max() <= 0.02 + 1e-6:
            assert length.mean() == pytest.approx(0.01, rel=0.02)
        else:
            assert along.numpy() == pytest.approx(0.02 / 3, rel=0.03)
        kinds.add((bool(along[1] < 1e-6), bool(length.max() <= 0.02 + 1e-6)))
    assert {(True, False), (False, True), (False, False)} <= kinds


def test_errors_of_a_depth_camera_are_alike_among_neighbours(sphere):
    """By less than they are large, and by the more the larger the share of what patches share."""
    points = sample_surface(sphere["vertices"], sphere["faces"], 8_000, generator())
    nearest = torch.cdist(points, points).fill_diagonal_(9).argmin(1)
    pairs = [(generator(seed), generator(seed)) for seed in range(8)]
    drawn = [depth_noise(points, g) @ rotation(1.0, h)[2] for g, h in pairs]
    assert all(noise.square().mean() == pytest.approx(1, rel=0.05) for noise in drawn)
    alike = [float((noise * noise[nearest]).mean()) for noise in drawn]
    assert min(alike) > -0.05 and min(alike) < 0.4 and 0.5 < max(alike) < 1.02


def test_a_camera_sees_the_near_half_of_a_sphere(sphere):
    points = sample_surface(sphere["vertices"], sphere["faces"], 15_000, generator())
    camera = rotation(1.0, generator(3))
    keep, kept = seen(points, points, camera)
    assert (keep == kept).all()
    towards = points @ camera[2]
    assert keep[towards > 0.6].all()
    assert not keep[towards < -0.15].any()


@pytest.mark.parametrize("how", [replace(x, normals=True) for x in (Augmentation(), ALWAYS)])
def test_normals_go_with_their_points(sphere, how):
    """On a sphere the outward normal is the direction from the centre, which scale and shift move;
    so the points along their normals meet in one point."""
    sphere = sphere | {"soup": torch.zeros(900, 3)}
    for seed in range(12):
        item = training_sample(sphere, replace(how, noise=0), generator(seed))
        assert item.normals is not None and item.normals.shape == item.points.shape
        radius = torch.linalg.lstsq(
            (item.normals - item.normals.mean(0)).reshape(-1, 1),
            (item.points - item.points.mean(0)).reshape(-1, 1),
        ).solution
        centre = item.points - radius * item.normals
        assert radius > 0.5
        assert (centre - centre.mean(0)).norm(dim=-1).max() < 0.01


def test_without_normals_none_are_made_and_nothing_else_changes(sphere):
    for seed in range(6):
        plain = training_sample(sphere, Augmentation(), generator(seed))
        told = training_sample(sphere, Augmentation(normals=True), generator(seed))
        assert plain.normals is None
        torch.testing.assert_close(plain.points, told.points)


def test_half_way_points_are_half_way(sphere):
    p, v, q = (sphere[name] for name in ("p", "v", "q"))
    exact = Sphere().exp(p[:, None].double(), v.double() / 2).float()
    off = (half_way(v, q) - exact).norm(dim=-1)
    assert off.mean() < 0.06  # the spacing of a hundred vectors in a disk of radius 0.5
    assert off.max() < 0.25


def test_queries_across_what_was_cut_are_not_known(sphere):
    how = Augmentation(as_meshed=1, soup=0, uneven=0, noise=0, cut=1)
    for seed in range(12):
        item = training_sample(sphere, how, generator(seed), sources=16, vectors=400)
        near = torch.cdist(item.truth.q.flatten(0, 1), item.points).amin(1).view(16, 400)
        gone = near > 0.2
        assert not item.truth.known[gone].any()


# Files


def test_read_sample_returns_what_was_written(tmp_path, sphere):
    path = tmp_path / "sphere.safetensors"
    save(path, sphere)
    read = read_sample(path)
    assert all((read[name] == sphere[name]).all() for name in sphere)


@pytest.mark.parametrize("length", [0, 5, 1000, -1])
def test_a_truncated_file_is_named(tmp_path, sphere, length):
    path = tmp_path / "torn.safetensors"
    save(path, sphere)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(ValueError, match=r"torn\.safetensors is truncated or corrupt"):
        read_sample(path)


def test_garbage_and_incomplete_samples_are_named(tmp_path, sphere):
    path = tmp_path / "junk.safetensors"
    path.write_bytes(b"\xff" * 4096)
    with pytest.raises(ValueError, match=r"junk\.safetensors is truncated or corrupt"):
        read_sample(path)
    save(path, {name: x for name, x in sphere.items() if name != "q"})
    with pytest.raises(ValueError, match=r"junk\.safetensors lacks \['q'\]"):
        read_sample(path)


def test_unfinished_files_are_not_listed(tmp_path, sphere):
    save(tmp_path / "a.safetensors", sphere)
    (tmp_path / ".b.safetensors.123.tmp").write_bytes(b"half")
    assert [f.name for f in sample_files(tmp_path)] == ["a.safetensors"]
    with pytest.raises(FileNotFoundError, match=r"no .* samples"):
        sample_files(tmp_path / "nowhere")


def test_a_split_does_not_change_when_shapes_are_added(tmp_path):
    files = [tmp_path / f"procedural-{i:06d}.safetensors" for i in range(2000)]
    train, held = split(files, 0.1)
    assert 150 < len(held) < 250
    assert sorted(train + held) == files
    fewer_train, fewer_held = split(files[::3], 0.1)
    assert set(fewer_train) <= set(train)
    assert set(fewer_held) <= set(held)


def test_items_depend_on_index_and_seed_alone(tmp_path, sphere):
    save(tmp_path / "a.safetensors", sphere)
    data = ShapeDataset(sample_files(tmp_path), Augmentation(), sources=4, vectors=20)
    one, _, same = data[(0, 7)], data[(0, 8)], data[(0, 7)]
    assert len(data) == 1
    assert one.truth.v.shape == (4, 20, 3)
    assert (one.points == same.points).all()
