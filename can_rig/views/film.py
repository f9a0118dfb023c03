"""A run as a film: the car on its lane beside the car without compensation, or another plant."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from can_rig.drawing import bench
from can_rig.errors import LogError, one_line
from can_rig.results.motion import ROWS_PER_S
from firmware_model.law.structs import FloatArray

WIDTH, HEIGHT = 760, 250
FINE: Final = 2
"""Pixels of a drawing for each pixel of the film, along each side: smooth edges."""
MIXED: Final = ("paper", "asphalt", "card")
"""Grounds whose mixtures with each colour smooth the edges in a GIF."""
LANE_M, BEHIND_M, AHEAD_M = 3.5, 16.0, 30.0
STEERING_SHOWN: Final = 5.0
"""How often larger the steering angle is drawn."""
FORMATS: Final = (".gif", ".mp4")

Point = tuple[float, float]


@cache
def palette() -> dict[str, str]:
    """The light colours of ``bench.css`` by name."""
    light = bench.text("bench.css").partition("@media")[0]
    return dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", light))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    path = Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
    return ImageFont.truetype(str(path), size * FINE)


def refuse_film(path: Path) -> None:
    """Refuse an impossible format of a film.

    Raises:
        LogError: another format than GIF and MP4, or an MP4 without ffmpeg.
    """
    if path.suffix.lower() not in FORMATS:
        raise LogError(f"{path}: a film must be FILE.gif or FILE.mp4")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise LogError(f"{path}: an MP4 needs ffmpeg, which is not installed; FILE.gif needs none")


def write_film(path: Path, suffix: str, drawn: Iterable[Image.Image], frames_per_s: float) -> None:
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


def span_of(scene: dict[str, Any], before_s: float = 2.0, after_s: float = 6.0) -> Point:
    """The time around the first fault; the whole run if no fault begins."""
    time_s = scene["columns"]["time"]
    first, last = float(time_s[0]), float(time_s[-1])
    begins = [each["begin"] for each in scene["dead"] if each["begin"] < last]
    if not begins:
        return first, last
    return max(first, min(begins) - before_s), min(last, min(begins) + after_s)


@dataclass
class Drawing:
    """Draws a scene at any time."""

    scene: dict[str, Any]

    def at(self, time_s: float) -> Image.Image:
        """The picture at ``time_s``."""
        self._columns: dict[str, FloatArray] = self.scene["columns"]
        times = self._columns["time"]
        self._row = int(np.clip(np.searchsorted(times, time_s + 1e-9) - 1, 0, len(times) - 1))
        self._dead = [
            each for each in self.scene["dead"]
            if each["begin"] <= time_s and (each["end"] is None or time_s < each["end"])
        ]  # fmt: skip
        size = WIDTH * FINE, HEIGHT * FINE
        self._image = Image.new("RGB", size, palette()["paper"])
        self._draw = ImageDraw.Draw(self._image)
        words = {"car": self._car, "angle": self._angle, "position": self._position}[
            self.scene["kind"]
        ]()
        for line, (text, colour) in enumerate([(f"{time_s:.2f} s", "ink"), *words]):
            self._draw.text((16, 12 + 40 * line), text, palette()[colour], font=_font(14))
        failed = " and ".join(each["words"] for each in self._dead)
        if failed:
            width = self._draw.textlength(failed, font=_font(16))
            self._draw.text((size[0] - width - 16, 12), failed, palette()["warn"], font=_font(16))
        return self._image.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)

    def _now(self, name: str) -> float:
        return float(self._columns[name][self._row])

    def _fails(self, place: str) -> bool:
        return any(each["place"] == place for each in self._dead)

    def _line(self, points: list[Point], colour: str, width: float) -> None:
        if len(points) > 1:
            self._draw.line(points, palette()[colour], round(width), joint="curve")

    def _dashes(self, points: list[Point], colour: str, width: float, dash: float = 24.0) -> None:
        """A dashed line; the dashes keep their places on the road."""
        ends = np.array(points)
        at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ends, axis=0).T))])
        marks = np.arange(0.0, at[-1], dash)
        xs, ys = (np.interp(marks, at, ends[:, axis]) for axis in (0, 1))
        for n in range(0, len(marks) - 1, 2):
            self._line([(xs[n], ys[n]), (xs[n + 1], ys[n + 1])], colour, width)

    def _arrow(self, begin: Point, along: Point, colour: str) -> None:
        size = float(np.hypot(*along))
        if size < 4.0:
            return
        (x, y), (ex, ey) = begin, (along[0] / size, along[1] / size)
        tip = x + along[0], y + along[1]
        self._line([begin, tip], colour, 7)
        head = [(tip[0] + 16 * ex, tip[1] + 16 * ey)]
        head += [(tip[0] - 10 * s * ey, tip[1] + 10 * s * ex) for s in (1, -1)]
        self._draw.polygon(head, palette()[colour])

    def _car(self) -> list[tuple[str, str]]:
        """The camera keeps the lane level."""
        columns, lane = self._columns, "lane_" if "lane_x" in self._columns else ""
        scale = WIDTH * FINE / (BEHIND_M + AHEAD_M)
        x, y, turn = (self._now(f"{lane}{name}") for name in ("x", "y", "heading"))
        cos, sin = np.cos(turn), np.sin(turn)

        def placed(xs: FloatArray, ys: FloatArray) -> list[Point]:
            along, across = (xs - x) * cos + (ys - y) * sin, (ys - y) * cos - (xs - x) * sin
            shown = (along > -2 * BEHIND_M) & (along < 2 * AHEAD_M)
            places = zip(along[shown], across[shown], strict=True)
            return [
                (scale * (BEHIND_M + a), HEIGHT * FINE / 2 - scale * b)
                for a, b in ((float(a), float(b)) for a, b in places)
            ]

        near = slice(max(self._row - 20 * ROWS_PER_S, 0), self._row + 20 * ROWS_PER_S)
        self._road(placed(columns[f"{lane}x"][near], columns[f"{lane}y"][near]), scale)
        words = []
        past = slice(near.start, self._row + 1)
        if "without_x" in columns:
            trail = placed(columns["without_x"][past], columns["without_y"][past])
            self._dashes(trail, "orange", 5, 14.0)
            self._body(trail[-1:], self._now("without_heading") - turn, scale, ghost=True)
            words = [
                (
                    f"without compensation: {self._off('without_')}",
                    "orange",
                )
            ]
        trail = placed(columns["x"][past], columns["y"][past])
        self._line(trail, "blue", 6)
        self._body(trail[-1:], self._now("heading") - turn, scale, ghost=False)
        own = [(f"with compensation: {self._off('')}", "blue")] if lane else []
        return [*own, *words]

    def _road(self, points: list[Point], scale: float) -> None:
        """The lane around its middle; straight on beyond the recorded part."""
        line = np.array(points)
        if len(line) < 3:
            return
        for at, beside in ((0, 2), (-1, -3)):
            on = line[at] + (line[at] - line[beside]) * WIDTH * FINE / np.hypot(
                *(line[at] - line[beside]) + 1e-9
            )
            line = np.vstack([on, line] if at == 0 else [line, on])
        along = np.gradient(line, axis=0)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        across *= 0.5 * LANE_M * scale / np.maximum(np.hypot(*across.T), 1e-9)[:, None]
        left, right = ([(float(x), float(y)) for x, y in line + s * across] for s in (1.0, -1.0))
        self._draw.polygon([*left, *right[::-1]], palette()["asphalt"])
        for edge in (left, right):
            self._line(edge, "soft", 4)
        self._dashes([(float(x), float(y)) for x, y in line], "paper", 5)

    def _off(self, prefix: str) -> str:
        """How far a car is from the middle of the lane."""
        turn = self._now("lane_heading")
        dx, dy = (self._now(f"{prefix}{n}") - self._now(f"lane_{n}") for n in ("x", "y"))
        off_m = abs(dy * float(np.cos(turn)) - dx * float(np.sin(turn)))
        return f"{off_m:.2f} m off the lane's middle"

    def _body(self, at: list[Point], turn: float, scale: float, ghost: bool) -> None:
        for x, y in at:
            front, rear, track = self.scene["sizes"]
            cos, sin = float(np.cos(turn)), float(np.sin(turn))

            def place(along: float, left: float) -> Point:
                dx, dy = scale * along, scale * left
                return x + dx * cos - dy * sin, y - dx * sin - dy * cos  # noqa: B023

            def box(along: float, left: float, length: float, broad: float, angle: float) -> Any:
                c, s = float(np.cos(angle)), float(np.sin(angle))
                corners = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
                ends = [(a * length, b * broad) for a, b in corners]
                return [place(along + c * a - s * b, left + s * a + c * b) for a, b in ends]

            middle, half = 0.5 * (front - rear), 0.5 * (front + rear) + 0.8
            outline = box(middle, 0.0, half, 0.5 * track + 0.13, 0.0)
            if ghost:
                self._line([*outline, outline[0], outline[1]], "orange", 4)
                return
            wheels = [("torque", front, STEERING_SHOWN * self._now("steering"))]
            wheels.append(("force-difference", -rear, 0.0))
            self._draw.polygon(outline, palette()["card"], palette()["ink"], 4)
            self._draw.polygon(box(front - 0.5, 0.0, 0.22, 0.6, 0.0), palette()["pale-blue"])
            most = self.scene["limits"][1] or 4000.0
            for side in (-1.0, 1.0):
                for part, along, angle in wheels:
                    colour = palette()["warn" if self._fails(part) else "ink"]
                    self._draw.polygon(box(along, 0.5 * side * track, 0.34, 0.12, angle), colour)
                push = -side * 2.5 * scale * self._now("applied_2") / most
                begin = place(-rear, 0.5 * side * track)
                self._arrow(begin, (push * cos, -push * sin), "green")
            motor, r = place(front, 0.0), 0.3 * scale
            disc = motor[0] - r, motor[1] - r, motor[0] + r, motor[1] + r
            dead = self._fails("torque")
            self._draw.ellipse(disc, palette()["warn" if dead else "good"])
            for s in (1.0, -1.0) if dead else ():
                ends = [(motor[0] - 0.6 * r, motor[1] - 0.6 * s * r),
                        (motor[0] + 0.6 * r, motor[1] + 0.6 * s * r)]  # fmt: skip
                self._line(ends, "paper", 5)

    def _shares(self) -> list[float]:
        """Both inputs as shares of their largest values."""
        names = "applied_1", "applied_2"
        return [self._now(n) / max(float(np.nanmax(np.abs(self._columns[n]))), 1e-9) for n in names]

    def _values(self) -> list[tuple[str, str]]:
        named = zip(("output", "applied_1", "applied_2"), self.scene["names"], self.scene["units"],
                    strict=True)  # fmt: skip
        return [
            (f"{name} {round(self._now(key), 6):.3g} {unit}", "ink") for key, name, unit in named
        ]

    def _angle(self) -> list[tuple[str, str]]:
        """A rod; the first input at its pivot, the second at its tip."""
        pivot, long = (WIDTH * FINE / 2, HEIGHT * FINE - 50.0), HEIGHT * FINE * 0.72

        def tip(angle: float) -> Point:
            return pivot[0] + long * float(np.sin(angle)), pivot[1] - long * float(np.cos(angle))

        turn, shares = self._now("output"), self._shares()
        self._line([(pivot[0] - 140, pivot[1] + 24), (pivot[0] + 140, pivot[1] + 24)], "rule", 6)
        self._dashes([pivot, tip(self._now("reference"))], "soft", 4)
        self._line([pivot, tip(turn)], "blue", 18)
        disc = pivot[0] - 22, pivot[1] - 22, pivot[0] + 22, pivot[1] + 22
        self._draw.ellipse(disc, palette()["warn" if self._fails("torque") else "good"])
        push = 180.0 * shares[1]
        self._arrow(tip(turn), (push * float(np.cos(turn)), push * float(np.sin(turn))), "green")
        self._arrow((pivot[0], pivot[1] - 44), (180.0 * shares[0], 0.0), "green")
        return self._values()

    def _position(self) -> list[tuple[str, str]]:
        """A block on a line, beside the place that the reference asks for."""
        most = 1.5 * max(float(np.nanmax(np.abs(self._columns["reference"]))), 1e-9)
        y = HEIGHT * FINE * 0.6
        at, goal = (
            WIDTH * FINE * (0.5 + 0.35 * self._now(n) / most) for n in ("output", "reference")
        )
        self._line([(120, y + 44), (WIDTH * FINE - 120, y + 44)], "rule", 6)
        self._dashes([(goal, y - 110), (goal, y + 40)], "soft", 4)
        self._draw.rectangle((at - 60, y - 40, at + 60, y + 40), palette()["blue"])
        for n, share in enumerate(self._shares()):
            self._arrow((at, y - 20 + 40 * n), (280.0 * share, 0.0), "green")
        return self._values()
