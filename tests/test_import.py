"""`import riemlayer` is light: no training, mesh or plotting library comes with it."""

import subprocess
import sys

HEAVY = ["lightning", "trimesh", "potpourri3d", "gpytoolbox", "scipy", "skimage", "mesh2sdf"]
HEAVY += ["manifold3d", "pyvista", "vtk", "matplotlib", "lightning_modules"]


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_pulls_in_no_heavy_library():
    code = f"import riemlayer, sys; print([x for x in {HEAVY} if x in sys.modules])"
    assert run(code).strip() == "[]"


def test_viz_imports_without_the_plotting_library():
    code = f"import riemlayer.viz, sys; print([x for x in {HEAVY} if x in sys.modules])"
    assert run(code).strip() == "[]"


def test_star_import_gives_every_public_name():
    code = (
        "import riemlayer; from riemlayer import *; "
        "print([n for n in riemlayer.__all__ if n not in globals()], len(riemlayer.__all__))"
    )
    missing, count = run(code).rsplit(maxsplit=1)
    assert missing == "[]"
    assert int(count) > 0
