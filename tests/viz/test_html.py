"""Pages as files: they stand alone and hold the data."""

import base64
import json
import re

import numpy as np
import pytest
from flat import flat_canvas, flat_drawing, from_above

from riemlayer.viz import Drawing, write_html


def scene_of(page: str) -> dict:
    found = re.search(r'id="scene">(.*?)</script>', page, re.S)
    assert found
    return json.loads(found[1])


def test_page_stands_alone_and_holds_the_data(tmp_path):
    line = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    mesh = flat_drawing(mesh=True, paths=[line], title="</script>{{shader}}")
    cloud = flat_drawing(mesh=False)
    page = write_html(tmp_path / "page.html", mesh, cloud, view=from_above()).read_text("utf-8")
    assert not re.search(r"https?:|src=|@import|<link(?! rel=.icon. href=.data:)", page)
    assert page.count("</script>") == 3 and "{{script}}" not in page
    scene = scene_of(page)

    def array(index, dtype, width):
        return np.frombuffer(base64.b64decode(scene["arrays"][index]), dtype).reshape(-1, width)

    first, second = scene["drawings"]
    assert first["title"] == "</script>{{shader}}"
    corner = mesh.canvas.corner
    assert np.array_equal(array(first["point"], np.float32, 3), mesh.points[corner].astype("f4"))
    assert np.array_equal(array(first["log"], np.float32, 2), mesh.log[corner].astype("f4"))
    assert np.array_equal(array(first["faces"], np.uint32, 3), mesh.canvas.triangles)
    assert np.allclose(array(first["paths"], np.float32, 6)[1], [0.1, 0, 0, 0.2, 0, 0])
    assert second["faces"] is None and array(second["paths"], np.float32, 6).shape == (0, 6)


def test_an_array_that_drawings_share_is_stored_once(tmp_path):
    canvas = flat_canvas(mesh=False)
    one = Drawing(canvas, values=canvas.points[:, 0])
    pages = [write_html(tmp_path / f"{n}.html", *[one] * n, view=from_above()) for n in (1, 5)]
    arrays = [scene_of(page.read_text("utf-8"))["arrays"] for page in pages]
    assert arrays[0] == arrays[1]


def test_endless_tiles_are_written(tmp_path):
    drawing = flat_drawing(mesh=True, radius=np.inf)
    page = write_html(tmp_path / "page.html", drawing, view=from_above()).read_text("utf-8")
    assert scene_of(page)["drawings"][0]["radius"] > 1e20


def test_a_page_is_complete_or_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_html(tmp_path / "none" / "a.html", flat_drawing(True), view=from_above())
    with pytest.raises(ValueError, match="`drawings` must be one or more"):
        write_html(tmp_path / "a.html", view=from_above())
    assert list(tmp_path.iterdir()) == []
