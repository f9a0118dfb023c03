"""A run as a film: the car on its lane beside the car without compensation, or another plant."""

import json
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path as File
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.transforms import Bbox, IdentityTransform
from PIL import Image

from can_rig.drawing import bench
from can_rig.errors import LogError, one_line, require

WIDTH, HEIGHT = 760, 250
MIXED: Final = ("paper", "asphalt", "card")
"""Grounds whose mixtures with each colour smooth the edges in a GIF."""
FORMATS: Final = (".gif", ".mp4")
BEFORE_S, AFTER_S = 2.0, 6.0  # shown around the first fault


@cache
def palette() -> dict[str, str]:
    """The light colours of ``bench.css`` by name."""
    light = bench.text("bench.css").partition("@media")[0]
    return dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", light))


def refuse_film(path: File) -> None:
    """Refuse an impossible format of a film.

    Raises:
        LogError: another format than GIF and MP4, or an MP4 without ffmpeg.
    """
    if path.suffix.lower() not in FORMATS:
        raise LogError(f"{path}: a film must be FILE.gif or FILE.mp4")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise LogError(f"{path}: an MP4 needs ffmpeg, which is not installed; FILE.gif needs none")


def write_film(path: File, suffix: str, drawn: Iterable[Image.Image], frames_per_s: float) -> None:
    """Write the pictures as GIF or MP4.

    Args:
        path: the file.
        suffix: the format, of ``FORMATS``.
        drawn: the pictures.
        frames_per_s: pictures a second.

    Raises:
        LogError: ffmpeg fails.
    """
    if suffix == ".mp4":
        size = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{WIDTH}x{HEIGHT}"]
        rate, out = ["-r", f"{frames_per_s:g}"], ["-pix_fmt", "yuv420p", "-f", "mp4", str(path)]
        words = ["ffmpeg", "-y", "-loglevel", "error", *size, *rate, "-i", "-", *out]
        content = b"".join(picture.tobytes() for picture in drawn)
        done = subprocess.run(words, input=content, capture_output=True, check=False)
        if done.returncode:
            raise LogError(f"ffmpeg: {one_line(RuntimeError(done.stderr.decode()))}")
        return
    first, *rest = (
        picture.quantize(palette=_few_colours(), dither=Image.Dither.NONE) for picture in drawn
    )
    first.save(
        path, "GIF", save_all=True, append_images=rest, loop=0, optimize=True,
        duration=round(1000.0 / frames_per_s),
    )  # fmt: skip


@cache
def _few_colours() -> Image.Image:
    """The palette of a GIF: each colour, and half of each colour on each ground."""
    named = {
        name: np.array([int(code[at : at + 2], 16) for at in (1, 3, 5)])
        for name, code in palette().items()
    }
    colours = [*named.values()]
    colours += [(each + named[ground]) // 2 for ground in MIXED for each in named.values()]
    image = Image.new("P", (1, 1))
    image.putpalette(np.array(colours, dtype=np.uint8).tobytes())
    return image


def pictures(
    scene: dict[str, Any], begin_s: float, end_s: float, frames_per_s: float, speed: float
) -> Iterator[Image.Image]:
    """The pictures of a film.

    Args:
        scene: see ``results.motion.scene``.
        begin_s: time of the run at the first picture.
        end_s: time of the run at the last picture.
        frames_per_s: pictures a second.
        speed: seconds of the run in a second of the film.
    """
    drawing = Drawing(scene)
    step_s = speed / frames_per_s
    for time_s in np.arange(begin_s, end_s + 0.5 * step_s, step_s).tolist():
        yield drawing.at(time_s)


def span_of(scene: dict[str, Any]) -> tuple[float, float]:
    """The time around the first fault; the whole run if no fault begins."""
    time_s = scene["columns"]["time"]
    first, last = float(time_s[0]), float(time_s[-1])
    begins = [each["begin"] for each in scene["dead"] if each["begin"] < last]
    if not begins:
        return first, last
    return max(first, min(begins) - BEFORE_S), min(last, min(begins) + AFTER_S)


class Drawing:
    """Draws a scene at any time, as ``scene.js`` draws the scene on a page.

    Args:
        scene: see ``results.motion.scene``.

    Raises:
        RigError: the extra ``film`` is not installed.
    """

    def __init__(self, scene: dict[str, Any]) -> None:
        require("py_mini_racer", "film")
        from py_mini_racer import MiniRacer  # noqa: PLC0415

        told = {name: each for name, each in scene.items() if name != "columns"}
        columns = {
            name: [float(value) if np.isfinite(value) else None for value in values]
            for name, values in scene["columns"].items()
        }
        self._time_s = scene["columns"]["time"]
        self._scripts = MiniRacer()
        for name in ("paper.js", "charts.js", "scene.js"):
            self._scripts.eval(bench.text(name))
        self._scripts.eval(
            f"const paper = new Paper({WIDTH}, {HEIGHT}), scene = new Scene(paper);"
            f"const told = {json.dumps(told)}, columns = {json.dumps(columns)};"
            "scene.describe(told, told.dead)"
        )

    def at(self, time_s: float) -> Image.Image:
        """The picture at ``time_s``."""
        row = int(np.searchsorted(self._time_s, time_s + 1e-9)) - 1
        row = min(max(row, 0), len(self._time_s) - 1)
        drawn = self._scripts.eval(f"scene.show(columns, {row}); JSON.stringify(paper.pen.drawn)")
        canvas: Any = FigureCanvasAgg(Figure((WIDTH / DPI, HEIGHT / DPI), DPI))
        renderer = canvas.get_renderer()
        page = [(0.0, 0.0), (WIDTH, 0.0), (WIDTH, HEIGHT), (0.0, HEIGHT)]
        _draw(renderer, {"points": page, "colour": "--card", "width": 0, "box": None})
        for each in json.loads(str(drawn)):
            _draw(renderer, each)
        return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


DPI: Final = 72
"""A point is a pixel, as in a browser."""


def _draw(renderer: Any, part: dict[str, Any]) -> None:
    """Draw an area, a line or a text of ``paper.js``."""
    pen, colour = renderer.new_gc(), to_rgb(palette()[part["colour"].removeprefix("--")])
    pen.set_foreground(colour)
    if "text" in part:
        ((x, y),) = part["points"]
        renderer.draw_text(pen, x, y, part["text"], FontProperties(size=12), 0.0)
        return
    if part["box"] is not None:
        low, high = part["box"]
        pen.set_clip_rectangle(Bbox([[low, 0.0], [high, HEIGHT]]))
    pen.set_linewidth(part["width"])
    if part.get("dash"):
        pen.set_dashes(0, part["dash"])
    pen.set_joinstyle("round")
    pen.set_capstyle("round")
    points = [(x, HEIGHT - y) for x, y in part["points"]]
    area = None if part["width"] else colour
    renderer.draw_path(pen, Path(points), IdentityTransform(), area)
