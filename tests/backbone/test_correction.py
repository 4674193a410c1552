"""Corrected planes: PCA's until trained, lawful whatever the weights, taught by walks."""

from typing import NamedTuple

import torch
from references import fibonacci_sphere, lumpy
from torch import Tensor

from riemlayer.backbone import PlaneCorrection
from riemlayer.backbone.correction import REACH
from riemlayer.geometry import LocalPlanes, planes_at_scales, walk
from riemlayer.octree import Level, build_octree

DEPTH = 4


class Case(NamedTuple):
    planes: LocalPlanes
    leaves: Level
    z: Tensor


def case_of(points: Tensor) -> Case:
    octree = build_octree(points, torch.zeros(len(points), dtype=torch.long), DEPTH + 1)
    planes = planes_at_scales(points, octree, 1)[0]
    leaves = octree.level(DEPTH - 1)
    return Case(planes, leaves, torch.randn(len(leaves), 6, dtype=points.dtype))


def shaken(width: int = 8) -> PlaneCorrection:
    correction = PlaneCorrection(6, width).double()
    for parameter in correction.parameters():
        torch.nn.init.normal_(parameter, std=0.5)
    return correction


def corrected(correction: PlaneCorrection, case: Case) -> LocalPlanes:
    return case.planes._replace(fine=correction(case.z, case.leaves, case.planes))


def test_untrained_planes_are_those_of_pca():
    case = case_of(lumpy(2000))
    planes = corrected(PlaneCorrection(6, 8).double(), case)
    torch.testing.assert_close(planes.fine.plane, case.planes.fine.plane, rtol=0, atol=1e-12)


def test_whatever_the_weights_planes_stay_planes():
    """Unit normals, centroids within reach, weights from 0 to 2; no node beyond the last."""
    case = case_of(lumpy(2000))
    former, level = case.planes.fine.plane, case.planes.fine.level
    plane = corrected(shaken(), case).fine.plane
    centroid, normal, weight = plane[:3, :-1], plane[3:6, :-1], plane[6, :-1]
    torch.testing.assert_close(normal.norm(dim=0), torch.ones_like(weight))
    assert ((centroid - former[:3, :-1]).abs() <= REACH * level.cell_size).all()
    assert (weight > 0).all() and (weight < 2).all() and weight.std() > 0.1
    assert (normal - former[3:6, :-1]).abs().mean() > 0.1  # the weights do have a say
    assert (plane[:, -1] == 0).all()


def test_signs_of_pca_have_no_say():
    case, correction = case_of(lumpy(1500)), shaken()
    sign = torch.randint(0, 2, (case.planes.fine.plane.shape[1],)) * 2.0 - 1
    flip = torch.ones(7, len(sign), dtype=torch.float64)
    flip[3:6] = sign
    fine = case.planes.fine
    other = case._replace(planes=case.planes._replace(fine=fine._replace(plane=fine.plane * flip)))
    one, two = (corrected(correction, x).fine.plane for x in (case, other))
    torch.testing.assert_close(one * flip, two, rtol=0, atol=1e-12)


def test_walks_teach_it_what_the_embedding_knows():
    """A sphere whose points are noise around it: walks come nearer to its great circles."""
    clean = 0.6 * fibonacci_sphere(3000).double()
    points = clean + 0.02 * torch.randn_like(clean)
    case = case_of(points)
    case = case._replace(z=case.leaves.centres().double().repeat(1, 2))  # tells where the centre is
    correction, (p, v, q) = PlaneCorrection(6, 16).double(), great_circles(300)
    optimiser = torch.optim.Adam(correction.parameters(), 1e-2)
    errors = []
    for _ in range(40):
        end = walk(corrected(correction, case), p, v, torch.zeros(300, dtype=torch.long), 4)
        loss = (end.point - q).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        errors.append(float(loss.detach()))
    assert errors[-1] < 0.7 * errors[0], (errors[0], errors[-1])


def great_circles(n: int, radius: float = 0.6, length: float = 0.4) -> tuple[Tensor, ...]:
    """Sources, tangent vectors and end points (n, 3) on a sphere."""
    p = torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1)
    v = torch.linalg.cross(p, torch.randn(n, 3, dtype=torch.float64))
    v = torch.nn.functional.normalize(v, dim=-1)
    angle = torch.tensor(length / radius, dtype=torch.float64)
    return radius * p, length * v, radius * (angle.cos() * p + angle.sin() * v)
