"""The heat method on point clouds (section 4, appendix D) through potpourri3d."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riemlayer.baselines.cloud import Array, carry_over


@dataclass
class Heat:
    """Log map of `PointCloudHeatSolver` from the cloud's point nearest to p, as ambient vectors.

    The solver knows the cloud's points alone. Other queries get the answer by a local affine fit
    over their neighbours: taking the nearest point's answer makes edges collapse.

    Args:
        t_coef: diffusion time in squared mean edge lengths (potpourri3d's default is 1).
        k: neighbours of the affine fit.
    """

    t_coef: float = 1.0
    k: int = 12

    def prepare(self, points: Array) -> None:
        """Build the solver: local triangulations, Laplacians and tangent frames."""
        import potpourri3d
        from scipy.spatial import cKDTree

        self._points = np.ascontiguousarray(points, dtype=np.float64)
        self._tree = cKDTree(self._points)
        self._solver = potpourri3d.PointCloudHeatSolver(self._points, self.t_coef)
        self._frames = self._solver.get_tangent_frames()[:2]

    def log(self, p: Array, q: Array) -> Array:
        """Log_p(q) by one vector heat solve over the whole cloud."""
        source = int(self._tree.query(np.asarray(p))[1])
        local = self._solver.compute_log_map(source)
        axes = np.stack([axis[source] for axis in self._frames])
        values = np.asarray(local) @ axes
        return carry_over(self._points, values, self._tree, np.asarray(q, np.float64), self.k)
