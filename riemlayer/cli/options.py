"""Options that several subcommands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FORMATS = ".obj .off .ply .stl .glb .gltf .xyz .pts .pcd .npz"

Shape = Annotated[
    Path, typer.Argument(metavar="SHAPE", help=f"Mesh or cloud ({FORMATS}).", show_default=False)
]
Out = Annotated[
    Path,
    typer.Option("--out", "-o", help="File to write: .npz .ply .obj .png .html.", metavar="OUT"),
]
Force = Annotated[bool, typer.Option("--force", help="Replace OUT where it exists.")]
Weights = Annotated[
    str,
    typer.Option(
        help="Packaged name, folder by save_pretrained, or hub id.", rich_help_panel="Field"
    ),
]
Points = Annotated[
    int,
    typer.Option(
        help="Points sampled from a mesh; those of a cloud are kept.",
        min=4,
        rich_help_panel="Field",
    ),
]
Seed = Annotated[int, typer.Option(help="Of the samples.", min=0, rich_help_panel="Field")]
Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:1, ...", rich_help_panel="Field")]
Source = Annotated[
    int | None,
    typer.Option("--source", "-s", help="Index of a vertex or point, from 0.", show_default=False),
]
At = Annotated[
    str | None,
    typer.Option(
        "--at",
        metavar="X,Y,Z",
        help="Coordinates in the file's units; the nearest place on the shape is taken.",
        show_default=False,
    ),
]
