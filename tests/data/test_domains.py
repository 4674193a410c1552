"""The shipped domains to fine-tune to: closed surfaces, the same for the same seed."""

import numpy as np
import pytest
import trimesh

from riemlayer.data.domains import DOMAINS, write_domain


@pytest.mark.parametrize("name", DOMAINS)
def test_shapes_of_a_domain_are_closed_and_vary(name):
    volumes = []
    for seed in range(3):
        vertices, faces = DOMAINS[name](np.random.default_rng(seed))
        mesh = trimesh.Trimesh(vertices, faces)
        assert mesh.is_watertight and mesh.body_count == 1
        volumes.append(mesh.volume)
    assert min(volumes) > 0 and np.ptp(volumes) > 0.05 * max(volumes)


def test_written_meshes_stay_and_depend_on_their_seed_alone(tmp_path):
    first = write_domain("landscapes", 2, tmp_path / "a")
    again = write_domain("landscapes", 3, tmp_path / "b", seed=1)
    assert first[1].read_bytes() == again[0].read_bytes() != first[0].read_bytes()
    first[0].write_text("kept")
    write_domain("landscapes", 2, tmp_path / "a")
    assert first[0].read_text() == "kept"
    with pytest.raises(ValueError, match="one of vessels, landscapes, got 'cars'"):
        write_domain("cars", 1, tmp_path)
