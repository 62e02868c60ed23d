"""Renderer: episodes as pictures, with pygame."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbeam.extend import quaternions as quat

from .actuators import TipForce
from .episodes import Episodes
from .task import Task

TILES = 16  # sub-envs in a tiled picture at most
WIDTH = 1280  # px of a tiled picture at most, HEIGHT likewise
HEIGHT = 960
VIEW = 480  # px, width of one view of a single env
FINE = 3  # drawn so many times larger, then smoothed
TRACE = 60  # instants of the tip's path that are shown
PARTS = 8  # straight pieces of an element's curve
ARROW = 0.2  # of the length, for the full force
BACK, INK, PALE, FRAME = (255, 255, 255), (40, 44, 52), (150, 155, 165), (222, 225, 230)
BEAM, FAILED, TARGET, FORCE = (31, 84, 148), (200, 30, 30), (20, 140, 70), (214, 107, 10)
TIP, PATH = (160, 190, 225), (165, 215, 180)


class Renderer:
    """Draws `count` sub-envs of a task whose usual beam starts with its nodes at `start` (N+1, 3)
    m: each in two views that hold the beam's main direction (of a beam along x: from above, x-y,
    and from the side, x-z), or in the one view of a motion in a plane; small enough for 16 of them
    to be tiled.

    Shown are the supports, the beam, the way of its tip, the force on it, and what the task's
    `render_data(now)` names:
        target  (n, 3) m;  path (n, points, 3) m, on which the target moves;  payload (n,), over the
                usual one
        thrust  (n,), a follower force against the beam's end
        solid  (n, boxes, 2, 3) m: opposite corners of what is solid, drawn as a box in each view
        balls  (n, balls, 4) m: centre and radius;  bars (n, bars, 2, 3) m: ends of straight ones
    In the heading: the time, and what the task measures. A beam whose solve failed is red. The part
    of space that is seen is the task's VIEW, or where it is None the box around the beam unloaded
    and at the start, and a third of its length more.

    Raises ImportError where pygame is not installed.
    """

    def __init__(self, task: Task, start: Tensor, count: int, title: str) -> None:
        try:
            import pygame
        except ImportError:
            raise ImportError("rendering wants pygame: pip install 'torchbeam[render]'") from None
        self.pygame, self.task, self.title = pygame, task, title
        pygame.font.init()
        usual = task.usual
        self.rest = _array(usual.nodes.reshape(-1, *usual.nodes.shape[-2:])[0])
        low, high = _box(np.concatenate((self.rest, _array(start))), task.VIEW, task.length)
        main = int(np.ptp(self.rest, axis=0).argmax())
        planes = (
            [(0, 1), (0, 2)] if main == 0 else [(0, 2), (1, 2)] if main == 2 else [(0, 1), (2, 1)]
        )
        self.views = (
            planes if task.plane is None else [tuple("xyz".index(axis) for axis in task.plane)]
        )
        wide, tall = (max((high - low)[view[k]] for view in self.views) for k in (0, 1))  # m
        aspect, best = tall / wide, 0.0
        self.tiles = min(count, TILES)
        for columns in range(1, self.tiles + 1):  # the largest views that fit
            width = min(
                VIEW,
                WIDTH / (columns * len(self.views)),
                HEIGHT / math.ceil(self.tiles / columns) / (aspect + 0.1),
            )
            if width > best:
                best, self.columns = width, columns
        self.width, self.height = 2 * int(best / 2), 2 * int(best * aspect / 2)
        self.head = 2 * int(max(18, 0.08 * self.width) / 2)
        self.size = (len(self.views) * self.width, self.height + self.head)
        self.scale = FINE * self.width / wide  # px/m
        self.middle, self.centre = (
            (low + high) / 2,
            np.array([FINE * self.width / 2, FINE * self.height / 2]),
        )
        self.font = pygame.font.Font(None, int(FINE * max(13, 0.75 * self.head)))
        strongest = [
            drive.gain.abs().max().item() for drive in task.drives if isinstance(drive, TipForce)
        ]
        self.full = max(strongest, default=1.0)  # N, of the longest arrow
        self.supports = task.drawn_supports()
        self.traces: list[list[np.ndarray]] = [[] for _ in range(count)]
        self.window = None

    def follow(self, now: Episodes, fresh: Tensor) -> None:
        """Note where the tips are; the traces of episodes that have just begun, (n,) bool, begin
        here.
        """
        for trace, tip, new in zip(
            self.traces, _array(now.beam.position[:, -1]), fresh.tolist(), strict=True
        ):
            if new:
                trace.clear()
            trace.append(tip)
            del trace[:-TRACE]

    def frames(self, now: Episodes, count: int) -> tuple[np.ndarray, ...]:
        """A picture of each of the first sub-envs: (height, width, 3) uint8."""
        curves, failed = _array(curve(now.beam, count)), now.failed.tolist()
        headings = self._headings(now, count)
        force = self.task.tip_force(now)
        data = {**({} if force is None else {"force": force}), **self.task.render_data(now)}
        data = {name: _array(value[:count]) for name, value in data.items()}
        shown = ({name: value[i] for name, value in data.items()} for i in range(count))
        return tuple(
            self._frame(*one)
            for one in zip(curves, self.traces, failed, headings, shown, strict=False)
        )

    def tiled(self, now: Episodes) -> np.ndarray:
        """The first 16 in one picture, (height, width, 3) uint8."""
        frames = list(self.frames(now, self.tiles))
        frames += [np.full_like(frames[0], 255)] * (-len(frames) % self.columns)
        rows = [
            np.concatenate(frames[k : k + self.columns], 1)
            for k in range(0, len(frames), self.columns)
        ]
        return np.concatenate(rows, 0)

    def show(self, now: Episodes) -> None:
        """The tiled picture in a window, at the env's own pace."""
        pygame, picture = self.pygame, np.transpose(self.tiled(now), (1, 0, 2))
        if self.window is None:
            pygame.display.init()
            self.window, self.clock = (
                pygame.display.set_mode(picture.shape[:2]),
                pygame.time.Clock(),
            )
            pygame.display.set_caption(self.title)
        pygame.event.pump()
        pygame.surfarray.blit_array(self.window, picture)
        pygame.display.flip()
        self.clock.tick(round(1 / self.task.config.control_interval))

    def close(self) -> None:
        if self.window is not None:
            self.pygame.display.quit()
            self.window = None

    def _headings(self, now: Episodes, count: int) -> list[str]:
        """Time and measures of each sub-env; of as many as there is room for."""
        texts = [
            f"{t:.2f} s" for t in (now.steps[:count] * self.task.config.control_interval).tolist()
        ]
        for name, values in now.measures.items():
            if not values.is_floating_point():
                continue
            unit = self.task.UNITS.get(name, "")
            longer = [
                f"{text}   {name} {v:.3f} {unit}"
                for text, v in zip(texts, values[:count].tolist(), strict=True)
            ]
            if all(self.font.size(text)[0] < FINE * (self.size[0] - 10) for text in longer):
                texts = longer
        return texts

    def _frame(
        self,
        line: np.ndarray,
        trace: list[np.ndarray],
        failed: bool,
        heading: str,
        shown: dict[str, Any],
    ) -> np.ndarray:
        pygame = self.pygame
        canvas = pygame.Surface([FINE * x for x in self.size])
        canvas.fill(BACK)
        for k, view in enumerate(self.views):
            area = pygame.Rect(
                FINE * k * self.width, FINE * self.head, FINE * self.width, FINE * self.height
            )
            self._view(canvas.subsurface(area), list(view), line, trace, failed, shown)
            label = self.font.render("xyz"[view[0]] + "-" + "xyz"[view[1]], True, PALE)
            canvas.blit(label, (area.left + 5 * FINE, area.top + 3 * FINE))
            pygame.draw.rect(canvas, FRAME, area, FINE)
        text = self.font.render(heading, True, FAILED if failed else INK)
        canvas.blit(text, (5 * FINE, (FINE * self.head - text.get_height()) // 2))
        picture = pygame.surfarray.array3d(pygame.transform.smoothscale(canvas, self.size))
        return np.ascontiguousarray(np.transpose(picture, (1, 0, 2)))

    def _view(
        self,
        surface: Any,
        axes: list[int],
        line: np.ndarray,
        trace: list[np.ndarray],
        failed: bool,
        shown: dict[str, Any],
    ) -> None:
        pygame, unit = self.pygame, FINE * self.width / 240  # px

        def at(points: Any) -> np.ndarray:
            return self.centre + (np.asarray(points) - self.middle)[..., axes] * (
                self.scale,
                -self.scale,
            )

        tip, parts = at(line[-1]), (len(line) - 1) // (len(self.rest) - 1)
        for rows in self.task.drawn_curves():
            rest = self.rest[rows]
            for a, b in pairwise(at(rest[:: len(rest) - 1] if self.task.straight else rest)):
                self._dashes(surface, a, b)
        for corners in shown.get("solid", ()):
            low, high = np.sort(at(corners), axis=0)
            pygame.draw.rect(surface, FRAME, pygame.Rect(low, high - low))
        for *centre, radius in shown.get("balls", ()):
            pygame.draw.circle(surface, PATH, at(centre), self.scale * radius)
        for bar in shown.get("bars", ()):
            self._stroke(surface, PALE, at(bar), 4 * unit)
        if "path" in shown:
            self._stroke(surface, PATH, at(shown["path"]), 0.8 * unit)
        if len(trace) > 1:
            self._stroke(surface, TIP, at(trace), unit)
        for node, hinge in self.supports:
            k = node % len(self.rest)
            along = at(self.rest[min(k + 1, len(self.rest) - 1)]) - at(self.rest[max(k - 1, 0)])
            self._support(surface, at(line[k * parts]), along, unit, hinge)
        for rows in self.task.drawn_curves():
            k = rows.indices(len(self.rest))
            of_part = line[k[0] * parts : (k[1] - 1) * parts + 1]
            self._stroke(surface, FAILED if failed else BEAM, at(of_part), 2 * unit)
        if "thrust" in shown:
            along = at(line[-2]) - tip
            along = along / max(np.hypot(*along), 1e-9) * ARROW * self.scale * self.task.length
            self._arrow(surface, INK, tip - along, tip, unit)
        if "payload" in shown:
            pygame.draw.circle(
                surface, INK, tip, (2 + 4 * min(1.0, shown["payload"] ** (1 / 3))) * unit
            )
        if "force" in shown:
            push = (
                shown["force"][axes]
                / self.full
                * (self.scale, -self.scale)
                * ARROW
                * self.task.length
            )
            self._arrow(surface, FORCE, tip, tip + push, unit)
        if "target" in shown:
            target = at(shown["target"])
            pygame.draw.circle(surface, TARGET, target, 5 * unit, max(1, round(unit)))
            pygame.draw.circle(surface, TARGET, target, 1.2 * unit)

    def _support(
        self, surface: Any, at: np.ndarray, along: np.ndarray, unit: float, hinge: bool
    ) -> None:
        """A wall across the beam, which goes along (2,) px there, or a hinge."""
        pygame = self.pygame
        if hinge:
            pygame.draw.circle(surface, PALE, at, 8 * unit)
            pygame.draw.circle(surface, INK, at, 8 * unit, max(1, round(0.8 * unit)))
            return
        size = np.hypot(*along)
        along = along / size if size > 0 else np.array([1.0, 0.0])
        across = np.array([-along[1], along[0]])
        for k in range(-3, 4):
            start = at + 4 * k * unit * across
            pygame.draw.line(
                surface, PALE, start, start + (5 * across - 6 * along) * unit, max(1, round(unit))
            )
        half = 14 * unit * across
        pygame.draw.line(surface, INK, at - half, at + half, max(2, round(2 * unit)))

    def _stroke(self, surface: Any, color: tuple, points: np.ndarray, width: float) -> None:
        """A line of round joints."""
        for a, b in pairwise(points):
            self.pygame.draw.line(surface, color, a, b, max(1, round(width)))
        for point in points:
            self.pygame.draw.circle(surface, color, point, width / 2)

    def _arrow(
        self, surface: Any, color: tuple, start: np.ndarray, end: np.ndarray, unit: float
    ) -> None:
        along = end - start
        size = np.hypot(*along)
        if size < 2 * unit:
            return
        along = along / size
        head, across = min(6 * unit, size), np.array([-along[1], along[0]])
        neck = end - head * along
        self.pygame.draw.line(surface, color, start, neck, max(1, round(1.5 * unit)))
        self.pygame.draw.polygon(
            surface, color, [end, neck + head / 2 * across, neck - head / 2 * across]
        )

    def _dashes(self, surface: Any, start: np.ndarray, end: np.ndarray) -> None:
        for a in np.arange(0, 1, 0.04):
            self.pygame.draw.line(
                surface, FRAME, start + a * (end - start), start + (a + 0.02) * (end - start), FINE
            )


def curve(beam: Any, count: int) -> Tensor:
    """(count, points, 3) m: the axis of the first beams, by Hermite's cubics between the nodes and
    their tangents.
    """
    p = beam.position[:count].detach()
    R = beam.rotation[:count].detach()
    tangent = (quat.matrix(R) if R.shape[-1] == 4 and R.ndim == 3 else R)[..., 0]
    chord = torch.linalg.vector_norm(p.diff(dim=1), dim=-1)[..., None, None]
    s = torch.linspace(0, 1, PARTS + 1, dtype=p.dtype, device=p.device)[:-1, None]
    a, b, m, n = (x[:, :, None] for x in (p[:, :-1], p[:, 1:], tangent[:, :-1], tangent[:, 1:]))
    inner = (
        (1 + 2 * s) * (1 - s) ** 2 * a
        + s**2 * (3 - 2 * s) * b
        + chord * (s * (1 - s) ** 2 * m - s**2 * (1 - s) * n)
    )
    return torch.cat((inner.flatten(1, 2), p[:, -1:]), 1)


def _box(
    nodes: np.ndarray, view: tuple[float, float, float] | None, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) m of what is seen."""
    if view is not None:
        left, right, across = view
        return np.array([left, -across, -across]) * length, np.array(
            [right, across, across]
        ) * length
    return nodes.min(0) - length / 3, nodes.max(0) + length / 3


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().double().numpy()
