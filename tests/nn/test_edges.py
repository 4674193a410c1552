"""Log-map edges on graphs: PyG's where it is installed, and anything that looks like them."""

import warnings
from types import SimpleNamespace

import pytest
import torch
from references import fibonacci_sphere, packed

from riemlayer import ExpLogField
from riemlayer.nn import LogMapEdges, TangentConv
from riemlayer.ops import local_geometry


@pytest.fixture(scope="module")
def field():
    torch.manual_seed(0)
    return ExpLogField.from_preset("tiny").eval()


@pytest.fixture
def points():
    return fibonacci_sphere(200).float()


def test_a_graph_gets_the_local_geometry_and_gives_it_back(field, points):
    data = LogMapEdges(field, k=6)(SimpleNamespace(pos=points))
    with torch.no_grad():
        expected = local_geometry(field.encode(points), k=6)
    assert torch.equal(data.edge_attr, expected.log)
    for name, x in expected._asdict().items():
        torch.testing.assert_close(getattr(LogMapEdges.geometry(data), name), x)


def test_packed_graphs_do_not_mix_and_the_input_stays(field, points):
    pos, batch = packed(points, 2 * points[:150])
    data = SimpleNamespace(pos=pos, batch=batch)
    out = LogMapEdges(field, k=6)(data)
    assert vars(data).keys() == {"pos", "batch"}
    assert torch.equal(batch[out.edge_index[0]], batch[out.edge_index[1]])


def test_what_is_no_graph_is_refused(field):
    with pytest.raises(ValueError, match="k must be at least 1, got 0"):
        LogMapEdges(field, k=0)
    with pytest.raises(ValueError, match="data must have an attribute `pos`"):
        LogMapEdges(field)(SimpleNamespace(x=torch.zeros(3)))


def test_graphs_of_pyg_through_its_loader(field, points):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # it scripts functions at import
        pyg = pytest.importorskip("torch_geometric.data")
        loader = pytest.importorskip("torch_geometric.loader").DataLoader
    transform, other = LogMapEdges(field, k=6), 2 * points[:150]
    plain = pyg.Data(pos=points, y=torch.zeros(1))
    graphs = [transform(plain), transform(pyg.Data(pos=other, y=torch.ones(1)))]
    assert plain.edge_index is None and graphs[0].validate()
    assert graphs[0].is_directed() and not graphs[0].has_self_loops()

    batch = next(iter(loader(graphs, batch_size=2)))
    together = LogMapEdges.geometry(batch)
    conv, x = TangentConv(3, 4), batch.pos
    alone = [conv(g.pos, LogMapEdges.geometry(g)) for g in graphs]
    torch.testing.assert_close(conv(x, together), torch.cat(alone))
