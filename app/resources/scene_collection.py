"""Perceived scenes: what the routes ask for, put together from the store and from the plans that name them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping

from app.access.caller import ANYBODY, Caller, Scope
from app.errors import SceneInUse, SceneNotFound
from app.resources.queries import page_of
from app.task_intake import VersionedCells
from planners.cell.cell import Cell
from planners.contract.scan_spec import ScanSpec, read_scan
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_json import parse_json
from planners.errors import SceneError
from planners.perception.perceive import PerceivedScene
from planners.perception.seen_points import SeenPoints
from workers.software import describe_software
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore
from workers.stores.scene_store import SceneStore, StoredScene
from workers.stores.tables import Position

See = Callable[[ScanSpec, Mapping[str, bytes], Cell], PerceivedScene]


class SceneCollection:
    """What one caller sees of all scenes: what belongs to somebody else does not exist.

    All methods block on the database: call them from a thread.
    """

    def __init__(self, store: SceneStore, plans: PlanStore, queue: JobQueue, caller: Caller = ANYBODY) -> None:
        self._store, self._plans, self._queue, self._caller = store, plans, queue, caller

    def seen_by(self, caller: Caller) -> SceneCollection:
        """Return what another caller sees."""
        return SceneCollection(self._store, self._plans, self._queue, caller)

    def perceive(self, description: bytes, files: Mapping[str, bytes], cells: VersionedCells, see: See) -> StoredScene:
        """Perceive a scan, or find the scene that the same scan of the same owner gave before.

        A scene names for good the version of its cell that it was perceived in.

        Args:
            description: of the scan, as it was sent.
            files: of the scan, by their parts.
            cells: that it may name.
            see: perceives it; what it raises besides is not caught.

        Raises:
            NotJson, NotAScan, SceneError, ScanRefused: What is wrong with it.
        """
        scan = read_scan(parse_json(description))
        if scan.cell not in cells:
            raise SceneError("/cell", f"there is no cell {scan.cell}", sorted(cells))
        scan = scan.model_copy(update={"cell": cells.lasting_name(scan.cell)})
        owner = self._caller.owner
        # Another version of the service may see more in the same scan; another owner has a scene of its own.
        digest = hashlib.sha256(f"{describe_software()}{owner or ''}\0{scan.model_dump_json()}".encode())
        for part in sorted(files):
            digest.update(f"{part} {len(files[part])} ".encode() + files[part])
        scene_id = digest.hexdigest()[:32]
        if self._store.get(scene_id) is None:
            self._store.add(scene_id, see(scan, files, cells[scan.cell]), owner)
        else:
            self._store.touch(scene_id)
        return self.scene(scene_id)

    def scene(self, scene_id: str) -> StoredScene:
        """Return one scene.

        Raises:
            SceneNotFound: There is none of that id.
        """
        scene = self._store.get(scene_id)
        if scene is None or not self._caller.may_see(scene.owner):
            raise SceneNotFound(scene_id)
        return scene

    def document(self, scene_id: str) -> SceneDocument | None:
        """Return what was perceived in a scene, for a task that names it; None if there is no such scene."""
        try:
            return self.scene(scene_id).document
        except SceneNotFound:
            return None

    def page(self, size: int, before: Position | None) -> tuple[list[StoredScene], Position | None]:
        """Return `size` scenes, newest first, from behind `before`, and where the next page begins, if there is one."""
        owner = None if self._caller.scope is Scope.ADMIN else self._caller.owner
        return page_of(self._store.newest(size + 1, before, owner), size)

    def preview(self, scene_id: str) -> bytes:
        """Return the PNG picture of a scene.

        Raises:
            SceneNotFound: There is no scene of that id.
        """
        picture = self._store.preview(self.scene(scene_id).id)
        if picture is None:
            raise SceneNotFound(scene_id)
        return picture

    def points(self, scene_id: str) -> SeenPoints | None:
        """Return what was measured in a scene; None where nothing was.

        Raises:
            SceneNotFound: There is no scene of that id.
        """
        return self._store.points(self.scene(scene_id).id)

    def delete(self, scene_id: str) -> None:
        """Remove a scene. Plans that came of it have all of it written out and stay.

        Raises:
            SceneNotFound: There is no scene of that id.
            SceneInUse: A job of a task that names it has not ended.
        """
        scene = self.scene(scene_id)
        jobs = self._queue.jobs(self._plans.naming_scene(scene.id))
        unfinished = [plan_id for plan_id, job in jobs.items() if not job.state.done]
        if unfinished:
            raise SceneInUse(unfinished[0])
        self._store.delete(scene.id)
