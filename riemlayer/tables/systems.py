"""The systems that have a row, and what was tried to make each as good as it can be."""

from __future__ import annotations

from collections.abc import Callable

from riemlayer.baselines import Heat, MeshHeat, MeshTracer, Neural, Projection, TrueLog, Walking

VIEWS = 4
"""Orientations that the rows of averaged answers take."""
RIVALS: dict[str, Callable[[], object]] = {
    "heat": Heat,
    "projection": Projection,
    "tracing": Walking,
    "floor": TrueLog,
    "mesh-affine": MeshHeat,
    "mesh-heat": lambda: MeshHeat("VectorHeat"),
    "mesh-tracer": MeshTracer,
}
TITLES = {
    "base": "riemlayer base",
    "base-views": f"riemlayer base, mean of {VIEWS} views",
    "paper": "riemlayer paper preset",
    "heat": "Heat (point cloud)",
    "projection": "Projection (Exp: and snap)",
    "tracing": "Tracing (heuristic walking)",
    "mesh-affine": "mesh: AffineLocal",
    "mesh-heat": "mesh: VectorHeat",
    "mesh-tracer": "mesh: GeodesicTracer",
    "floor": "the truth (floor)",
}
ORACLES = ("floor", "mesh-affine", "mesh-heat", "mesh-tracer")
"""Rows that see more than the cloud: the answer itself, or the mesh it was made from."""
UNRANKED = (*ORACLES, "base-views")
"""Rows that are not compared with the others: oracles, and what asks a field several times."""
NOTES = (
    "Heat is potpourri3d's PointCloudHeatSolver with its default t_coef = 1; 0.5 is better at "
    "traced end points and worse in angle, 2 the reverse. Where the cloud is not the mesh's "
    "vertices its answer is carried over by an affine fit over 12 points (6 and 8 are worse).",
    "Projection uses PCA normals of 16 neighbours; its Exp snaps as appendix D says.",
    "Tracing walks in steps of half the mean edge length, as in appendix D.",
    "The mesh rows see the very mesh that the truth was computed on, and AffineLocal and "
    "GeodesicTracer are the solvers that computed it: their distance from 0 is what carrying "
    "values between vertices costs.",
    "E_MDD as printed is an unbounded ratio that a few collapsed edges decide (an edge of no "
    "length counts as 1,000 here); beside it each edge is clipped at 1.",
    "Log end: mean |Log_p(Exp_p v) - v| at traced end points. It ranks methods where curvature "
    "makes the angles and distances of the true log map itself bad.",
    f"The mean of {VIEWS} views (`riemlayer.ops.encode_views`) takes {VIEWS} times as long as one. "
    "It is not ranked with the others.",
    "Differentials at the source are difference quotients over 0.02, on which curvature leaves "
    "0.04 even in the truth; the derivative of our maps at the source is the identity by "
    "construction.",
    "Times are medians, and compare only within one run. Paper's numbers are for other shapes, "
    "another machine, and times per query there.",
)


def systems(names: list[str], weights: dict[str, str]) -> dict[str, object]:
    """Methods by the names of their rows.

    Args:
        names: of `RIVALS` or of `weights`.
        weights: packaged name or folder of each field that has a row, and one with "-views".

    Raises:
        ValueError: a name is neither.
    """
    fields = {
        name: lambda path=path: Neural.from_pretrained(path) for name, path in weights.items()
    }
    views = {
        f"{name}-views": lambda path=path: Neural.from_pretrained(path, VIEWS)
        for name, path in weights.items()
    }
    known = RIVALS | fields | views
    if unknown := [name for name in names if name not in known]:
        raise ValueError(f"methods must be among {', '.join(known)}; got {', '.join(unknown)}")
    return {name: known[name]() for name in names}
