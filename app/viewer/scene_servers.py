"""The scenes of all watchers: each a viser server on the loopback interface, reached through the service only.

viser shares one scene among all who look at a server. A server each keeps watchers apart, and a watcher whose
connection drops finds the scene as it was.
"""

from __future__ import annotations

import fcntl
import gzip
import os
import re
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import rich
import viser
from starlette.concurrency import run_in_threadpool

from app.errors import CellNotDrawn, MapNotPainted, TooManyWatchers
from app.resources.cell_collection import CellCollection
from app.resources.followers import counted
from app.resources.plan_collection import PlanCollection
from app.resources.scene_collection import SceneCollection
from app.viewer.description.perceived_description import PerceivedDescription, describe_perceived
from app.viewer.description.plan_description import PlanDescription
from app.viewer.drawing.body_drawing import EmptyCell, Stage
from app.viewer.drawing.camera import DRAFT_VIEW, FIELD_OF_VIEW, NO_OBSTACLES, PERCEIVED_VIEW, VIEWS, RecordedView, View
from app.viewer.drawing.cup_map import cup_places, is_of_study
from app.viewer.drawing.link_meshes import FULL, Detail, LinkMeshes
from app.viewer.drawing.perceived_scene import SceneDrawing
from app.viewer.drawing.plan_scene import PlanScene
from app.viewer.editor.draft_scene import DraftListener, DraftScene
from app.viewer.page import RecordedScene, describe_plan, recorded_page
from app.viewer.playback import Playback, SourceName
from app.work.wanted import StillWanted
from app.work.workbench import Workbench
from planners.cell.cell import Cell
from planners.contract.scene_document import SceneDocument
from planners.contract.task_spec import DEFAULT_CELLS
from planners.geometry.pose import Array
from planners.perception.seen_points import SeenPoints
from planners.plan.plan import Plan
from planners.study.study_map import StudyMap
from workers.stores.plan_store import StoredDocument

MOST_RELAYS = 4
"""So many connections may show one scene [1]: it is its watcher's own, and each is sent all of it."""
PICTURES_PER_SECOND = 30.0
"""Of a recording."""
MOST_PICTURES = 3000
"""A longer plan is recorded with fewer pictures a second."""
STILL = 1e-3
"""A camera that is nearer to where it was put has not been moved [m]."""
LOOPBACK = "127.0.0.1"
KEY = re.compile(r"[A-Za-z0-9_-]{24}")


class SceneServer:
    """A viser server with at most one plan, perceived scene or draft in it.

    Methods block: call them from one thread at a time.
    """

    def __init__(self, owner: str | None = None) -> None:
        self.owner = owner
        """Of the key with which its watcher came."""
        self.key = secrets.token_urlsafe(18)
        """Part of the scene's address; only the watcher knows it."""
        # viser greets on the terminal, which belongs to the log.
        rich.reconfigure(quiet=True)
        self._server = viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.initial_camera.fov = FIELD_OF_VIEW
        self.detail = FULL
        """How much is drawn of what is opened from now on."""
        self._shown: PlanScene | SceneDrawing | DraftScene | EmptyCell | None = None
        self._stage: Stage | None = None
        self._root = ""
        self._opened = 0

    @property
    def address(self) -> str:
        """Where the viser server listens."""
        return f"ws://{LOOPBACK}:{self._server.get_port()}"

    def show_cell(self, cell: Cell, meshes: LinkMeshes) -> None:
        """Show a cell in which nothing is done, where nothing else is shown."""
        if self._shown is None:
            with self._server.atomic():
                self._shown = EmptyCell(self._cleared(cell, meshes), self._root)
            self._look_first(VIEWS["overview"], all_clients=False)

    def open(self, playback: Playback, cell: Cell, meshes: LinkMeshes) -> None:
        """Put a plan into the scene instead of what was there."""
        before, cell_before = self._shown, None if self._stage is None else self._stage.cell
        with self._server.atomic():
            self._shown = PlanScene(self._cleared(cell, meshes), self._root, playback)
        if cell is not cell_before or not isinstance(before, PlanScene | EmptyCell):
            self._look_first(VIEWS["overview"], all_clients=not isinstance(before, EmptyCell))

    def open_perceived(
        self, document: SceneDocument, points: SeenPoints | None, cell: Cell, meshes: LinkMeshes
    ) -> None:
        """Put a perceived scene, with what was measured of it, into the scene instead of what was there."""
        with self._server.atomic():
            self._shown = SceneDrawing(self._cleared(cell, meshes), self._root, document, points)
        self._look_first(PERCEIVED_VIEW)

    def open_draft(self, cell: Cell, meshes: LinkMeshes, told: DraftListener) -> DraftScene:
        """Put a draft, in which there is nothing yet, into the scene instead of what was there.

        Args:
            cell: that the task is for.
            meshes: drawings of its robots.
            told: called with whatever somebody does in the scene, from a thread of viser's.
        """
        with self._server.atomic():
            self._shown = draft = DraftScene(self._cleared(cell, meshes), self._root, told)
        self._look_first(DRAFT_VIEW)
        return draft

    @contextmanager
    def together(self) -> Iterator[None]:
        """Have all that is changed in the scene meanwhile be seen at once."""
        with self._server.atomic():
            yield
        self._server.flush()

    def _look_first(self, view: View, *, all_clients: bool = True) -> None:
        """Have whoever comes see a view first, and whoever is there see it now.

        Args:
            view: of what is shown.
            all_clients: whether that goes for those too whose camera was moved, or who came by an address that tells
                of one.
        """
        first, clients = self._server.initial_camera, self._server.get_clients().values()
        unmoved = [each for each in clients if np.allclose(each.camera.position, first.position, atol=STILL)]
        first.position, first.look_at = self._place(view)
        self._turn(clients if all_clients else unmoved, view)

    def _cleared(self, cell: Cell, meshes: LinkMeshes) -> Stage:
        """Empty the scene down to its stage, which is drawn anew for another cell or in another detail.

        What is drawn next stands under `_root`, a name that was never used before.
        """
        scene, stage = self._server.scene, self._stage
        scene.remove_by_name(self._root)
        self._opened += 1
        self._root = f"/opened_{self._opened}"
        if stage is None or stage.cell is not cell or stage.detail is not self.detail:
            if stage is not None:
                stage.remove()
            stage = self._stage = Stage(scene, f"/stage_{self._opened}", cell, meshes, self.detail)
        return stage

    def show(self, source: SourceName, time: float) -> None:
        """Show the plan or its simulation at a time [s]; without a plan nothing changes."""
        if isinstance(self._shown, PlanScene):
            with self._server.atomic():
                self._shown.show(source, time)
            self._server.flush()

    def paint(self, study: StudyMap, told: Callable[[int], None]) -> int | None:
        """Paint the map of a study onto the plate of the plan that is shown, and return the point that is its plan's.

        Args:
            study: as far as it is known.
            told: called with the number of a point that somebody clicks on, from a thread of viser's.

        Raises:
            MapNotPainted: It is no map of cup places, or of another plate.
        """
        places = cup_places(study)
        if places is None:
            raise MapNotPainted("it does not vary the place of a lifter's cup alone")
        shown = self._shown
        if not isinstance(shown, PlanScene) or not is_of_study(shown.playback.plan, study):
            raise MapNotPainted("what is shown is no plan that lifts its plate from where it lies there")
        with self.together():
            return shown.paint(study, places, told)

    def set_layer(self, layer: str, *, visible: bool) -> None:
        """Show or hide a layer of what is shown, if it has one of that name."""
        if self._shown is not None and layer in self._shown.layers:
            with self._server.atomic():
                self._shown.set_layer(layer, visible)

    def look(self, view: View) -> None:
        """Move the camera of whoever looks at the scene; an empty one has nothing to look at.

        It is what whoever comes sees first, too: in a browser that still reads the scene, the first camera replaces any
        that it was told before.
        """
        if self._shown is not None:
            self._look_first(view)

    def _turn(self, clients: Iterable[viser.ClientHandle], view: View) -> None:
        if self._shown is None or self._stage is None:
            return
        position, target = self._place(view)
        for client in clients:
            with client.atomic():
                client.camera.position, client.camera.look_at = position, target

    def _place(self, view: View) -> tuple[Array, Array]:
        """Return where a camera is and what it looks at (3,), of what is shown [m]."""
        assert self._shown is not None
        assert self._stage is not None
        obstacles = self._shown.obstacles if isinstance(self._shown, PlanScene) else NO_OBSTACLES
        return view.place(self._stage.cell, self._shown.body_position, obstacles)

    @property
    def camera(self) -> tuple[Array, Array] | None:
        """Where the camera of whoever looks is, and what it looks at (3,) [m]; None while nobody does."""
        for client in self._server.get_clients().values():
            return np.array(client.camera.position), np.array(client.camera.look_at)
        return None

    def record(self, durations: Mapping[SourceName, float], step: float) -> RecordedScene:
        """Play the sources of the plan in the scene one after the other, with all layers.

        Args:
            durations: of the sources [s].
            step: time between two pictures [s].
        """
        assert isinstance(self._shown, PlanScene)
        assert self._stage is not None
        gates = self._shown.show_all_layers()
        views = {name: RecordedView.of(view, self._stage.cell, self._shown.obstacles) for name, view in VIEWS.items()}
        serializer = self._server.get_scene_serializer()
        begins: dict[SourceName, float] = {}
        pictures = 0
        for source, duration in durations.items():
            begins[source] = pictures * step
            for index in range(int(duration / step) + 2):
                self.show(source, min(index * step, duration))
                serializer.insert_sleep(step)
                pictures += 1
        return RecordedScene(serializer.as_html(), begins, gates, views, self._shown.moved_nodes)

    def close(self) -> None:
        """Stop the server; whoever still looks sees the last picture."""
        self._server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True)
class WatcherRoom:
    """For how many watchers there is room."""

    scenes: int
    """Of everybody's, each some 10 MB."""
    scenes_of_owner: int
    """Of one owner's, where keys tell owners apart."""


def recording_of(playback: Playback, cell: Cell, meshes: LinkMeshes) -> str:
    """Return a page that plays all sources of a plan without any server. Blocks for some seconds."""
    durations = playback.durations
    step = max(1.0 / PICTURES_PER_SECOND, sum(durations.values()) / MOST_PICTURES)
    with SceneServer() as server:
        server.open(playback, cell, meshes)
        scene = server.record(durations, step)
    return recorded_page(describe_plan(playback.plan, playback.executed), scene)


def recording_of_document(packed: bytes, cell: Cell, drawings: Path) -> str:
    """Return a page that plays the plan of a compressed document, with drawings that are kept in a folder."""
    return recording_of(Playback(Plan.read(gzip.decompress(packed))), cell, LinkMeshes(drawings))


class ToldAddress:
    """Where a scene is served, told to other processes in a file that stays locked for as long as it is served.

    The kernel gives the lock back when this process ends, however it does: the number of a process that is gone may be
    another one's by then.
    """

    def __init__(self, path: Path, address: str) -> None:
        """Tell an address."""
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            os.write(self._descriptor, address.encode())
        except BaseException:
            self.withdraw()
            raise

    def withdraw(self) -> None:
        """Nothing is served there any more."""
        try:
            self._path.unlink(missing_ok=True)
        finally:
            os.close(self._descriptor)

    @staticmethod
    def read(path: Path) -> str | None:
        """Return the address that a file tells; None: there is none, or nobody serves it any more."""
        try:
            with path.open("rb") as told:
                try:
                    fcntl.flock(told, fcntl.LOCK_SH | fcntl.LOCK_NB)
                except BlockingIOError:
                    return told.read().decode() or None
        except FileNotFoundError:
            return None
        return None


class SceneServers:
    """All that watchers share: cells, drawings of their robots; and a server for each who watches."""

    def __init__(
        self, cells: CellCollection, folder: Path, addresses: Path, room: WatcherRoom, bench: Workbench
    ) -> None:
        """Take the cells, and where recordings are made.

        Args:
            cells: of all who watch.
            folder: where drawings of their robots are kept.
            addresses: where all processes of a service find scenes.
            room: for watchers.
            bench: where recordings are made.
        """
        self.cells = cells
        """Everybody's by their ids: whoever sees a plan sees its cell."""
        addresses.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._addresses = addresses
        for left in addresses.iterdir():
            # Of a process that was killed.
            if self.address(left.name) is None:
                left.unlink(missing_ok=True)
        self._drawings, self._bench = folder, bench
        self._meshes = LinkMeshes(folder)
        self._servers: dict[str, SceneServer] = {}
        self._told: dict[str, ToldAddress] = {}
        self._room = room
        self._entered = Counter[str | None]()
        """How many servers each owner has, those included that are being opened."""
        self._relays = Counter[str]()

    async def enter(self, owner: str | None) -> SceneServer:
        """Open a server for somebody of an owner; None: no keys are asked for.

        Raises:
            TooManyWatchers: There are too many, or too many of this owner's.
        """
        if self._entered.total() >= self._room.scenes:
            raise TooManyWatchers(self._room.scenes)
        if owner is not None and self._entered[owner] >= self._room.scenes_of_owner:
            raise TooManyWatchers(self._room.scenes_of_owner, f"of {owner}'s viewers are open")
        self._entered[owner] += 1
        try:
            server = await run_in_threadpool(SceneServer, owner)
        except BaseException:
            self._entered[owner] -= 1
            raise
        self._servers[server.key] = server
        try:
            self._told[server.key] = ToldAddress(self._addresses / server.key, server.address)
        except OSError:
            # Nobody could find the scene, and nobody else would give its place back.
            await self.leave(server)
            raise
        return server

    async def leave(self, server: SceneServer) -> None:
        """Close a server."""
        if self._servers.pop(server.key, None) is not None:
            self._entered[server.owner] -= 1
        try:
            if (told := self._told.pop(server.key, None)) is not None:
                told.withdraw()
        finally:
            await run_in_threadpool(server.close)

    def relay(self, key: str) -> AbstractContextManager[bool]:
        """Count one who looks at a scene for the time of a block, in which it is true unless too many do already."""
        return counted(self._relays, key, admitted=self._relays[key] < MOST_RELAYS)

    def address(self, key: str) -> str | None:
        """Return where the scene of a key is served, by whichever process its watcher came to; None: it is closed."""
        if not KEY.fullmatch(key):
            return None
        return ToldAddress.read(self._addresses / key)

    def set_detail(self, server: SceneServer, detail: Detail) -> None:
        """Have a server draw so much from now on, and a cell at once where it shows nothing yet. Blocks."""
        server.detail = detail
        server.show_cell(self.cells[DEFAULT_CELLS["plate_lift"]], self._meshes)

    def open(self, server: SceneServer, plans: PlanCollection, plan_id: str) -> PlanDescription:
        """Put a plan into a server and return what the page tells of it. Blocks.

        Raises:
            PlanNotFound: There is no plan of that id.
            DocumentNotReady: Its job has not succeeded.
            CellNotDrawn: There are no drawings of its cell.
        """
        playback, cell = self._playback(self.load(plans, plan_id))
        server.open(playback, cell, self._meshes)
        return describe_plan(playback.plan)

    def open_perceived(self, server: SceneServer, scenes: SceneCollection, scene_id: str) -> PerceivedDescription:
        """Put a perceived scene into a server and return what the page tells of it. Blocks.

        Raises:
            SceneNotFound: There is no scene of that id.
            CellNotDrawn: There are no drawings of its cell.
        """
        scene, points = scenes.scene(scene_id), scenes.points(scene_id)
        document = scene.document
        # Of a scene that was made before cells had ids there, its owner's cell of that name.
        cell = _cell_in(self.cells.of_owner(scene.owner), document.cell)
        server.open_perceived(document, points, cell, self._meshes)
        return describe_perceived(scene_id, document, points, cell.name)

    def record(self, document: StoredDocument, wanted: StillWanted) -> str:
        """Return a page that plays a plan without any server, for as long as it is wanted. Blocks for some seconds.

        Raises:
            CellNotDrawn: There are no drawings of its cell.
            NobodyWaits: It is wanted no longer.
            WorkTooLarge, WorkDied: It took too much memory.
        """
        cell = _cell_in(self.cells, _plan_of(document).task.cell)
        return self._bench.do(wanted, recording_of_document, document.gzip, cell, self._drawings)

    async def close(self) -> None:
        """Close all servers."""
        for server in list(self._servers.values()):
            await self.leave(server)

    def open_draft(self, server: SceneServer, cell: Cell, told: DraftListener) -> DraftScene:
        """Put an empty draft into a server. Blocks."""
        return server.open_draft(cell, self._meshes, told)

    def load(self, plans: PlanCollection, plan_id: str) -> Plan:
        """Return a plan. Blocks.

        Raises:
            PlanNotFound: There is no plan of that id.
            DocumentNotReady: Its job has not succeeded.
        """
        return _plan_of(plans.document(plan_id))

    def _playback(self, plan: Plan) -> tuple[Playback, Cell]:
        # One's own cells are named by their ids, which name one version of them.
        return Playback(plan), _cell_in(self.cells, plan.task.cell)


def _cell_in(cells: Mapping[str, Cell], name: str) -> Cell:
    cell = cells.get(name)
    if cell is None:
        raise CellNotDrawn(name, sorted(cells))
    return cell


def _plan_of(document: StoredDocument) -> Plan:
    return Plan.read(gzip.decompress(document.gzip))
