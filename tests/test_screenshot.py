"""The pictures of a recording: an empty view is found. The viewer needs a Vulkan driver in software."""

import importlib.util
import io
import pathlib
import subprocess
import sys

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image

TOOL = pathlib.Path(__file__).resolve().parent.parent / "tools" / "screenshot.py"
DRIVERS = pathlib.Path("/usr/share/vulkan/icd.d")


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("screenshot", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def png(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def test_of_one_colour_nothing_stands_out(tool):
    assert tool.share_shown(png(np.full((60, 80, 3), 17, np.uint8))) == 0.0


def test_what_is_drawn_stands_out_and_faint_lines_and_the_frame_do_not(tool):
    pixels = np.full((60, 80, 3), 17, np.uint8)
    pixels[30] = 35  # a grid line
    pixels[:3] = pixels[-3:] = 255  # the frame
    assert tool.share_shown(png(pixels)) == 0.0
    pixels[20:31, 20:52] = (255, 84, 84)
    assert tool.share_shown(png(pixels)) == pytest.approx(11 * 32 / (44 * 64))


@pytest.mark.skipif(not list(DRIVERS.glob("lvp_icd*")), reason="needs a Vulkan driver in software")
def test_an_empty_view_is_found(tmp_path):
    with rr.RecordingStream("replay", recording_id="empty") as stream:
        stream.save(tmp_path / "empty.rrd")
        stream.set_time("progress", sequence=0)
        stream.log("words", rr.TextDocument("# Something to read " + 40 * "words "))
        full, empty = rrb.TextDocumentView(origin="/words", name="words"), rrb.Spatial2DView(origin="/no", name="plan")
        tabs = rrb.Tabs(rrb.Horizontal(full, empty, name="Both"), rrb.TextDocumentView(origin="/words", name="Words"))
        stream.send_blueprint(rrb.Blueprint(tabs, collapse_panels=True))
    command = [sys.executable, TOOL, tmp_path / "empty.rrd", tmp_path, "--size", "800x500", "--check"]
    done = subprocess.run([*command, "--tab", "Both"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1, done.stderr
    assert "view plan: only 0." in done.stderr
    assert "view words" not in done.stderr
