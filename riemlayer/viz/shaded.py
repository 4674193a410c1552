"""A surface for VTK that is coloured pixel by pixel by `surface.glsl`, as on the pages."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np

from riemlayer.viz import palette
from riemlayer.viz.drawing import Drawing
from riemlayer.viz.html import HUGE
from riemlayer.viz.view import View, tangent_frame

Array = np.ndarray

WIDTHS = {"log": 2, "value": 1, "valid": 1, "tint": 3, "normal": 3, "disc": 4}
"""What the shader reads of every vertex."""
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
BULGE = 0.5
"""Height of the cone that a disc is to the depth test, in its radii."""


def surface_actor(drawing: Drawing, view: View, eye: Array) -> Any:
    """A vtkActor that shows the drawing's surface as seen from `eye` (3,)."""
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    points, faces, values = vertices(drawing)
    mesh = pyvista.PolyData.from_regular_faces(points.astype(np.float32), faces)
    mapper, actor = vtkPolyDataMapper(), vtkActor()
    for name, x in values.items():
        mesh.point_data["r_" + name] = np.ascontiguousarray(x, np.float32)
        mapper.MapDataArrayToVertexAttribute("r_" + name, "r_" + name, 0, -1)
    mapper.SetInputData(mesh)
    mapper.ScalarVisibilityOff()
    actor.SetMapper(mapper)
    _add_shader(actor.GetShaderProperty(), drawing, view, eye)
    return actor


def vertices(drawing: Drawing) -> tuple[Array, Array, dict[str, Array]]:
    """Points (n, 3), faces (m, 3 or 4) and what the shader reads (n, width) of each vertex."""
    canvas, n = drawing.canvas, len(drawing.canvas.points)
    by_point = {
        "log": drawing.log, "value": drawing.values, "valid": drawing.valid, "tint": drawing.colours
    }  # fmt: skip
    values = {
        name: np.full((n, WIDTHS[name]), 1.0 if name == "valid" else 0.0) if x is None
        else x.reshape(n, -1)
        for name, x in by_point.items()
    }  # fmt: skip
    discs = canvas.discs
    if discs is None:
        assert canvas.triangles is not None  # a mesh has them
        values = {name: x[canvas.corner] for name, x in values.items()}
        values["value"] = values["value"] * values["valid"]
        values |= {"normal": canvas.normals, "disc": np.zeros((len(canvas.corner), 4))}
        return canvas.points[canvas.corner], canvas.triangles, values
    offset = np.einsum("n,kc,ncd->nkd", discs.size, SQUARE, tangent_frame(canvas.normals))
    values = {name: np.repeat(x, 4, axis=0) for name, x in values.items()}
    if drawing.slope is not None:
        name = "log" if drawing.values is None else "value"
        values[name] = values[name] + _flat(offset @ drawing.slope.transpose(0, 2, 1))
    values["value"] = values["value"] * values["valid"]
    normals = canvas.normals[:, None] + offset @ discs.bend.transpose(0, 2, 1)
    beyond = np.einsum("nkd,nd->nk", offset, discs.rim)
    disc = np.c_[np.tile(SQUARE, (n, 1)), np.repeat(discs.size, 4), beyond.ravel()]
    values |= {"normal": _flat(normals), "disc": disc}
    faces = np.arange(4 * n).reshape(n, 4)
    return _flat(canvas.points[:, None] + offset), faces, values


def _flat(x: Array) -> Array:
    return x.reshape(-1, x.shape[-1])


def _add_shader(shader: Any, drawing: Drawing, view: View, eye: Array) -> None:
    inputs = "".join(
        f"in {_kind(k)} r_{name}; out {_kind(k)} s_{name};\n" for name, k in WIDTHS.items()
    )
    passed = "".join(f"s_{name} = r_{name};\n" for name in WIDTHS)
    shader.AddVertexShaderReplacement(
        "//VTK::Normal::Dec", True, f"//VTK::Normal::Dec\n{inputs}out vec3 s_place;\n", False
    )
    shader.AddVertexShaderReplacement(
        "//VTK::Normal::Impl",
        True,
        f"//VTK::Normal::Impl\n{passed}s_place = vertexMC.xyz;\n",
        False,
    )
    varyings = "".join(f"in {_kind(k)} s_{name};\n" for name, k in WIDTHS.items())
    text = files("riemlayer.viz").joinpath("surface.glsl").read_text("utf-8")
    declared = (
        f"//VTK::Normal::Dec\n{varyings}in vec3 s_place;\n{_constants(drawing, view, eye)}{text}"
    )
    shader.AddFragmentShaderReplacement("//VTK::Normal::Dec", True, declared, False)
    colour = """//VTK::Light::Impl
  vec3 base = surface_colour(s_log, s_value, s_valid, s_tint, s_place);
  vec3 across = turn * cross(dFdx(s_place), dFdy(s_place));
  vec3 along = normalize(turn * (s_place - eye_at));
  vec3 normal = facing(turn * s_normal, across, along);
  if (outside(s_disc, normal, along)) discard;
  gl_FragData[0] = vec4(base * brightness(normal, along), 1.0);
"""
    shader.AddFragmentShaderReplacement("//VTK::Light::Impl", True, colour, False)
    if drawing.canvas.discs is not None:
        deep = f"{BULGE} * s_disc.z * deeper * dot(s_disc.xy, s_disc.xy)"
        depth = f"gl_FragDepth = gl_FragCoord.z + {deep};"
        shader.AddFragmentShaderReplacement("//VTK::Depth::Impl", True, depth, False)


def _constants(drawing: Drawing, view: View, eye: Array) -> str:
    """The shader's inputs that are the same for all pixels, as text."""
    low, high = drawing.limits or (0.0, 1.0)
    numbers = {
        "radius": min(drawing.radius, HUGE),
        "period": drawing.period,
        "low": low,
        "high": high,
    }
    distance, reach = float(np.linalg.norm(eye - view.centre)), 1.1 * view.extent
    near, far = distance - reach, distance + reach
    numbers["deeper"] = near * far / ((far - near) * distance**2)
    colours = {name: getattr(palette, name.upper()) for name in ("blue", "cream", "plain")}
    colours |= {f"map{i}": palette.MAP[i] for i in range(3)} | {"eye_at": eye}
    text = f"const int pattern = {drawing.pattern};\n"
    text += "".join(f"const float {name} = {float(x)!r};\n" for name, x in numbers.items())
    text += "".join(f"const vec3 {name} = {_vector(x)};\n" for name, x in colours.items())
    return text + f"const mat3 turn = transpose(mat3({', '.join(map(_vector, view.axes))}));\n"


def _vector(x: Any) -> str:
    return f"vec3({', '.join(repr(float(y)) for y in x)})"


def _kind(width: int) -> str:
    return "float" if width == 1 else f"vec{width}"
