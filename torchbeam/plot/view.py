"""view: a scene, a shape or a motion in three dimensions, in a browser (extra `view`: viser)."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..core.arguments import count, instance
from ..core.files import file_of, folder, reason, write
from ..core.validation import positive, refusal, shown
from ..scene.scene import Scene
from ..state.instant import Instant
from ..state.solution import Solution
from ..state.state import rest
from .canvas import numbers
from .moving_shapes import MovingShapes

FPS = 25.0  # 1/s


def view(
    what: Any,
    *,
    scene: Scene | None = None,
    samples: int = 16,
    speed: float = 1.0,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> View:
    """Show a motion, a shape or a scene in three dimensions, in a browser. A server runs at
    `View.url` until `View.close` or the end of the process. A notebook shows the page if the view
    is the last value of a cell.

    Args:
        what: a `Solution`, with a slider over its instants; a state of any form; or a `Scene`,
            undeformed
        scene: of a solution or a state: for the sizes of sections, obstacles and tendons
        samples: number of samples of a batch, from the first on, each in its own colour; a failed
            sample is red
        speed: of the motion when it plays: 0.1 is ten times slower
        host: address to serve: by default for this machine alone; "0.0.0.0" serves other machines
            too
        port: the next free port is taken

    A beam is a rod of the radius of its contacts, or else the rectangle that has its EI and EA. Its
    sections' axes show twist. A body is its surface, the ball of its contacts, or a small ball.

    Raises:
        ValueError: for another type of `what`, a scene with another number of nodes, or an address
            at which this machine cannot serve.
        ImportError: without viser: pip install 'torchbeam[view]'.

    Examples:
        >>> scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))])
        >>> view = tb.view(tb.simulate(scene, [0.0, 0.1], step=0.01), scene=scene)
        >>> page = view.save("motion.html")  # plays in any browser, without Python
        >>> view.close()
    """
    if not isinstance(what, Instant | Solution | Scene):
        raise ValueError(
            f"{type(what).__name__} was given to view; a Solution, a state or a Scene is wanted"
        )
    if scene is not None:
        instance("scene", scene, Scene)
    positive("speed", torch.as_tensor(float(speed)))
    count("samples", samples)
    count("port", port, 0)
    if not isinstance(host, str) or not host:
        raise refusal(f"host = {shown(host)}", "an address")
    if isinstance(what, Scene):
        what, scene = rest(what), what
    states = what.state if isinstance(what, Solution) else what.map(lambda x: x[None])
    if scene is not None and states.nodes.shape[-2] != scene.beam.node_count:
        raise ValueError(
            f"a state with {states.nodes.shape[-2]} nodes was given to view; the scene has "
            f"{scene.beam.node_count}"
        )
    return View(states, scene, samples, speed, host, port)


class View:
    """Page that `view` has opened: the motion, a slider over its instants, and "play".

    Attributes:
        url: of the page
        t: s, the instants

    Examples:
        >>> scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))])
        >>> with tb.view(scene) as view:
        ...     view.update(tb.equilibrium(scene))
    """

    def __init__(
        self, states: Any, scene: Scene | None, samples: int, speed: float, host: str, port: int
    ) -> None:
        try:
            import viser
        except ImportError:
            raise ImportError("torchbeam.view wants viser: pip install 'torchbeam[view]'") from None
        self._count = samples
        self._states = states
        t = states.t.detach().double().cpu()
        self.t = t.flatten(1)[:, 0] if t.ndim > 1 else t
        port = _free_port(host, port)
        with contextlib.redirect_stdout(io.StringIO()):  # viser's own box; `url` says as much
            self._server = viser.ViserServer(host=host, port=port, label="torchbeam", verbose=False)
        self._drawn: dict[str, Any] = {}
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._shapes = MovingShapes(states[0], scene, samples)
        self._frame_camera()
        last = len(self.t) - 1
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        self._slider = gui.add_slider("instant", 0, max(last, 1), 1, 0, disabled=not last)
        self._clock = gui.add_text("t / s", "", disabled=True)
        self._plays = gui.add_checkbox("play", False, disabled=not last)
        self._speed = gui.add_number("speed", float(speed), min=1e-6)
        self._slider.on_update(lambda event: self.show(int(self._slider.value)))
        self.show(0)
        if last:
            threading.Thread(target=self._play, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def show(self, instant: int) -> None:
        """Show the motion at one of its instants; negative numbers count from the end."""
        k = range(len(self.t))[instant]
        self._draw(self._states[k], self.t[k].item())
        if self._slider.value != k:
            self._slider.value = k

    def update(self, state: Any) -> None:
        """Show another state of the same beams, for instance from a `Stepper`'s loop, or from an
        environment while a controller learns.

        Raises:
            ValueError: for another type than a state, and for another number of nodes.
        """
        instance("a state", state, Instant)
        if state.nodes.shape[-2] != self._states.nodes.shape[-2]:
            raise ValueError(
                f"a state with {state.nodes.shape[-2]} nodes was given; the view has "
                f"{self._states.nodes.shape[-2]}"
            )
        self._plays.value = False
        self._draw(state, state.t.detach().flatten()[0].item())

    def save(self, path: str | Path) -> Path:
        """Write the motion to one file (.html, about 1 MB), which plays in any browser without
        Python or a network. Returns the path.

        Raises:
            ValueError: for another ending, or a folder that is not there.
            NotWritten: (an OSError) where the disk is full.
        """
        path = file_of("path", path, ".html")
        folder(path.parent)
        self._plays.value = False
        self.show(0)
        recorded = self._server.get_scene_serializer()
        for k in range(1, len(self.t)):
            recorded.insert_sleep((self.t[k] - self.t[k - 1]).item() / self._speed.value)
            self.show(k)
        if len(self.t) > 1:
            recorded.insert_sleep(1.0)  # the end is seen before it plays again
        write(path, recorded.as_html())
        self.show(0)
        return path

    def wait(self) -> None:
        """Wait until `close` or a keyboard interrupt, at the end of a script."""
        try:
            self._closed.wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop the server of the page."""
        if not self._closed.is_set():
            self._closed.set()
            with contextlib.redirect_stdout(io.StringIO()):
                self._server.stop()

    def __enter__(self) -> View:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"View({len(self.t)} instants at {self.url})"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="420" frameborder="0"></iframe>'

    def _play(self) -> None:
        """The motion in real time times the speed, again and again, while "play" is on."""
        before = time.monotonic()
        now = 0.0
        while not self._closed.wait(1 / FPS):
            passed, before = time.monotonic() - before, time.monotonic()
            if not self._plays.value:
                now = self.t[int(self._slider.value)].item()
                continue
            now += passed * self._speed.value
            now = self.t[0].item() if now > self.t[-1] else now
            self.show(int(torch.searchsorted(self.t, now, right=True).clamp(1, len(self.t))) - 1)

    def _draw(self, state: Any, t: float) -> None:
        with self._lock, self._server.atomic():
            for name, (kind, static, moving) in self._shapes.at(state, t).items():
                if name not in self._drawn:
                    add = getattr(self._server.scene, f"add_{kind}")
                    self._drawn[name] = add(f"/{name}", **static, **moving)
                    continue
                for key, value in moving.items():
                    if not np.array_equal(getattr(self._drawn[name], key), value):
                        setattr(self._drawn[name], key, value)
            self._clock.value = f"{t:.4g}"

    def _frame_camera(self) -> None:
        """All of the motion in the picture, from the side that shows most of it."""
        position = numbers(self._states.nodes).reshape(-1, 3)
        least, most = position.min(0), position.max(0)
        middle, reach = (least + most) / 2, max(np.linalg.norm(most - least), 1e-9)
        side = np.array([0.45, -1.0, 0.4])
        camera = self._server.initial_camera
        camera.position, camera.look_at = tuple(middle + 0.75 * reach * side), tuple(middle)
        self._server.scene.set_up_direction("+z")


def _free_port(host: str, port: int) -> int:
    """The first free port from this one on: viser would look for one without end where the machine
    cannot serve at an address. Raises ValueError there.
    """
    why = "no port from there on is free"
    for free in range(port, min(port + 1000, 2**16)):
        try:
            for family, kind, protocol, _, address in socket.getaddrinfo(
                host, free, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            ):
                with socket.socket(family, kind, protocol) as sock:
                    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    sock.bind(address)
            return free
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                why = reason(error)
                break
        except UnicodeError:
            why = "it is no name of a machine"
            break
    raise ValueError(
        f"host = {shown(host)}, port = {port} was given to view, where no page can be served "
        f"({why}); an address of this machine and a port below 65536 are wanted"
    )
