"""What the service answers with, as JSON."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Literal, Self

from pydantic import Field

from planners.cell.cell import Cell
from planners.contract.problems import doubts_of
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_model import DescribedModel
from planners.plan.plan import Outcome
from planners.plan.simulation import Physics
from planners.survey.survey import SurveyFigures
from workers.stores.cell_store import CellFindings, StoredCell
from workers.stores.jobs import Job, JobState
from workers.stores.plan_store import PlanRecord
from workers.stores.scene_store import StoredScene
from workers.stores.study_store import StudyRecord

JOB_ORDER_STATES = {
    JobState.QUEUED: "AllowedToStart",
    JobState.RUNNING: "Running",
    JobState.SUCCEEDED: "Ended",
    JobState.FAILED: "Aborted",
    JobState.CANCELLED: "Aborted",
}


PlanState = Literal["queued", "running", "succeeded", "failed", "cancelled"]


class Resource(DescribedModel):
    """Base of all answers."""


class MeshLinks(Resource):
    """Where to find it again."""

    self: str


class MeshResource(Resource):
    """An uploaded mesh, as tasks can name it."""

    id: str
    """Of the file's content: the same file has the same id."""
    triangles: int
    size: tuple[float, float, float]
    """Full lengths, in the unit of the file."""
    centroid: tuple[float, float, float]
    """Centre of mass where a task states none: that of the solid, evenly filled. In the frame and the unit of the file,
    that is before `scale`."""
    convex_parts: int
    """How many convex parts stand for it where collision is checked."""
    excess: float
    """How far these reach beyond it at most, in the unit of the file."""
    hint: str | None
    """What to mind when it is used."""
    links: MeshLinks


class CellLinks(Resource):
    """Where to go from here."""

    self: str
    files: str | None
    """All files of the cell as a zip; null: it is shipped with the service."""
    survey: str
    picture: str
    view: str


class CellResource(Resource):
    """A cell, as tasks can name it."""

    id: str
    """Of owner and content: the same cell of the same owner has the same id. A shipped cell's is its name."""
    name: str
    """A task may give it in place of the id; then the version that was posted last is meant."""
    version: int | None
    """Of all that its owner posted under its name, from 1; null: it is shipped."""
    created_at: datetime | None
    """When it was posted last; null: it is shipped."""
    hash: str
    """Of its content; plan documents state it as `cell.hash`."""
    figures: SurveyFigures | None
    """What it can do. null in lists, and of shipped cells: fetch `links.survey`."""
    notes: list[str] | None = None
    """What was taken otherwise than written, left out, or most likely was not meant. null in lists, and of shipped
    cells."""
    links: CellLinks

    @classmethod
    def of(cls, stored: StoredCell, findings: CellFindings | None = None) -> Self:
        """Return a cell of one's own."""
        return cls(
            id=stored.id,
            name=stored.name,
            version=stored.version,
            created_at=moment(stored.created_us),
            hash=stored.hash,
            figures=findings,
            notes=None if findings is None else list(findings.notes),
            links=_cell_links(stored.id, shipped=False),
        )

    @classmethod
    def of_shipped(cls, cell: Cell) -> Self:
        """Return a cell that is shipped."""
        links = _cell_links(cell.name, shipped=True)
        return cls(
            id=cell.name, name=cell.name, version=None, created_at=None, hash=cell.hash, figures=None, links=links
        )


class CellList(Resource):
    """All cells that the caller's tasks may name."""

    cells: list[CellResource]
    """The shipped ones first, then one's own by name, newest version first."""


class SceneLinks(Resource):
    """Where to go from here."""

    self: str
    preview: str
    view: str


class SceneResource(Resource):
    """What was perceived, as tasks can name it."""

    id: str
    """Of the scan: the same scan has the same id."""
    created_at: datetime
    scene: SceneDocument
    links: SceneLinks


class SceneSummary(Resource):
    """A perceived scene as a list has it."""

    id: str
    created_at: datetime
    external_id: str | None
    """The caller's own name for it."""
    cell: str
    tool: str | None
    """The tool that was seen."""
    objects: int
    unrecognised: int
    links: SceneLinks


class SceneList(Resource):
    """One page of scenes, newest first."""

    scenes: list[SceneSummary]
    next_page_token: str | None
    """Give it as `page_token` for the next page; None on the last one."""


class PlanProgress(Resource):
    """How far a job is."""

    stage: str | None
    fraction: float
    """0 … 1; never falls."""


class PlanError(Resource):
    """Why a job failed. The fault is ours: a task without a solution is a success with a document."""

    detail: str


class PlanLinks(Resource):
    """Where to go from here."""

    self: str
    document: str
    events: str
    cancel: str
    view: str
    recording: str


class ProblemItem(Resource):
    """One thing that is wrong with a body."""

    pointer: str
    """RFC 6901, from the body's root."""
    detail: str
    allowed: list[str] | None = None
    """The valid choices, where they can be listed."""


class PlanResource(Resource):
    """A plan: a task that was accepted, its job, and what came of it."""

    id: str
    kind: str
    external_id: str | None
    """The caller's own name for it; ISA-95's JobOrderID."""
    work_master: str | None
    """The recipe by which the caller made the task; ISA-95's WorkMasterID."""
    priority: int
    """0 … 9; of its owner's jobs the highest goes first."""
    start_time: datetime | None
    """The job is not begun before."""
    end_time: datetime | None
    """A job that has not ended by then is cancelled."""
    state: PlanState
    queue_position: int | None = None
    """Of a job that waits for a worker: 1 if it is the next to begin. None: it does not wait, or for its start."""
    expected_start: datetime | None = None
    """When it most likely begins, after how long jobs took of late and how many run at a time. None: it does not wait
    for a worker, or no job has run yet to tell from."""
    done: bool
    """Whether it will never change again."""
    job_order_state: Literal["AllowedToStart", "Running", "Ended", "Aborted"]
    """The state as an MES names it (ISA-95, OPC 10031-4)."""
    outcome: Outcome | None
    """Once succeeded."""
    verdict: Outcome | None = None
    """The outcome as soon as it is known: from then on the document can be fetched, at first without its simulation, or
    without changes that would help, and stays valid whatever becomes of those."""
    physics: Physics | None = None
    """How the plan fared when it was simulated: a certified plan may still fail, and its document says how and what
    helps. None: it was not simulated, or not yet, or by software that did not keep this."""
    progress: PlanProgress
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    certified_at: datetime | None = None
    """When a plan was found and had passed its certificate. None where nothing was found."""
    attempts: int
    """How often a solver process began."""
    study_id: str | None = None
    """Of the study of which it plans a point. None: of none, or of one that was deleted."""
    error: PlanError | None
    cancelled_by: Literal["request", "end_time"] | None
    """Why a job was cancelled: somebody asked for it, or it had not ended by its `end_time`."""
    links: PlanLinks


class PostedPlan(PlanResource):
    """A plan that was just posted, and what of its task was most probably not meant."""

    warnings: list[ProblemItem]
    """What was taken and is most probably not meant, as a quaternion 0, 0, 0, 1: that is half a turn, w comes first."""


class PlanList(Resource):
    """One page of plans, newest first."""

    plans: list[PlanResource]
    next_page_token: str | None
    """Give it as `page_token` for the next page; None on the last one."""


class StudyLinks(Resource):
    """Where to go from here."""

    self: str
    map: str
    picture: str
    events: str
    cancel: str
    points: str
    """`POST` to `…/{index}/plan` has a point planned and certified."""
    view: str


class StudyResource(Resource):
    """A study: a task with up to two members that are varied, and how far it is."""

    id: str
    kind: str
    external_id: str | None
    """The caller's own name for it."""
    state: PlanState
    done: bool
    """Whether it will never change again."""
    count: int
    """How many points it has."""
    known: int
    """How many of them are known."""
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    best_plan: str | None
    """Address of the plan of the best point, once all points are known and one is solved: that plan is certified."""
    error: PlanError | None
    links: StudyLinks


class StudyList(Resource):
    """One page of studies, newest first."""

    studies: list[StudyResource]
    next_page_token: str | None
    """Give it as `page_token` for the next page; None on the last one."""


def warnings_of(sent: Any) -> list[ProblemItem]:
    """Return what of a task, as JSON data as it came, was most probably not meant."""
    return [ProblemItem.model_validate(doubt, from_attributes=True) for doubt in doubts_of(sent)]


class ProblemDocument(Resource):
    """An error, by RFC 9457."""

    type: str
    title: str
    status: int
    detail: str
    errors: list[ProblemItem] = Field(default=[])


PROBLEM: dict[str, Any] = {"model": ProblemDocument, "content": {"application/problem+json": {}}}
"""An answer that is an error, as the description of an operation has it."""


def scene_resource(scene: StoredScene) -> SceneResource:
    """Return the resource of a perceived scene."""
    return SceneResource(
        id=scene.id, created_at=moment(scene.created_us), scene=scene.document, links=_scene_links(scene.id)
    )


def scene_summary(scene: StoredScene) -> SceneSummary:
    """Return a perceived scene as a list has it."""
    document = scene.document
    return SceneSummary(
        id=scene.id,
        created_at=moment(scene.created_us),
        external_id=document.external_id,
        cell=document.cell,
        tool=None if document.tool is None else document.tool.name,
        objects=len(document.objects),
        unrecognised=len(document.unrecognised),
        links=_scene_links(scene.id),
    )


def _cell_links(cell_id: str, *, shipped: bool) -> CellLinks:
    address = f"/v1/cells/{cell_id}"
    return CellLinks(
        self=address,
        files=None if shipped else f"{address}/files.zip",
        survey=f"{address}/survey",
        picture=f"{address}/survey.png",
        view=f"/viewer/cells?cell={cell_id}",
    )


def _scene_links(scene_id: str) -> SceneLinks:
    address = f"/v1/scenes/{scene_id}"
    return SceneLinks(self=address, preview=f"{address}/preview.png", view=f"{address}/view")


def plan_address(plan_id: str) -> str:
    """Return where a plan is."""
    return f"/v1/plans/{plan_id}"


def plan_resource(
    record: PlanRecord, job: Job, queue_position: int | None = None, expected_us: int | None = None
) -> PlanResource:
    """Return the resource of a plan and its job.

    Args:
        record: the plan.
        job: its job.
        queue_position: see `PlanResource`.
        expected_us: when it likely begins [microseconds since 1970, UTC].
    """
    address = plan_address(record.id)
    succeeded = job.state is JobState.SUCCEEDED
    return PlanResource.model_validate(
        {
            "id": record.id,
            "kind": record.kind,
            "external_id": record.external_id,
            "work_master": record.work_master,
            "priority": record.priority,
            "start_time": _time(record.start_us),
            "end_time": _time(record.end_us),
            "state": job.state.value,
            "queue_position": queue_position,
            "expected_start": _time(expected_us),
            "job_order_state": JOB_ORDER_STATES[job.state],
            "done": job.state.done,
            "outcome": record.outcome if succeeded else None,
            "verdict": record.outcome,
            "physics": record.physics,
            "progress": {"stage": record.stage, "fraction": 1.0 if succeeded else record.fraction},
            "created_at": _time(record.created_us),
            "started_at": _time(record.started_us),
            "finished_at": _time(_finished_us(record, job)),
            "certified_at": _time(record.certified_us),
            "attempts": record.attempts,
            "study_id": record.study_id,
            "error": None if job.error is None else {"detail": job.error},
            "cancelled_by": _cancelled_by(record, job),
            "links": {
                "self": address,
                "document": f"{address}/document",
                "events": f"{address}/events",
                "cancel": f"{address}/cancel",
                "view": f"{address}/view",
                "recording": f"{address}/recording.html",
            },
        }
    )


def study_resource(record: StudyRecord, job: Job, known: int) -> StudyResource:
    """Return the resource of a study, of which so many points are known."""
    address = f"/v1/studies/{record.id}"
    ended = record.finished_us or job.ended_us
    return StudyResource(
        id=record.id,
        kind=record.kind,
        external_id=record.external_id,
        state=job.state.value,
        done=job.state.done,
        count=record.count,
        known=known,
        created_at=moment(record.created_us),
        started_at=_time(record.started_us),
        finished_at=_time(ended if job.state.done else None),
        best_plan=None if record.best_plan_id is None else f"/v1/plans/{record.best_plan_id}",
        error=None if job.error is None else PlanError(detail=job.error),
        links=StudyLinks(
            self=address,
            map=f"{address}/map",
            picture=f"{address}/map.png",
            events=f"{address}/events",
            cancel=f"{address}/cancel",
            points=f"{address}/points",
            view=f"{address}/view",
        ),
    )


def _cancelled_by(record: PlanRecord, job: Job) -> str | None:
    if job.state is not JobState.CANCELLED:
        return None
    ended = _finished_us(record, job)
    return "end_time" if ended is not None and record.end_us is not None and ended >= record.end_us else "request"


def _finished_us(record: PlanRecord, job: Job) -> int | None:
    """Return when a job ended: our own time, or the engine's where we had no chance to note it."""
    if not job.state.done or record.finished_us is not None or job.ended_us is None:
        return record.finished_us if job.state.done else None
    # The engine's is in whole seconds on SQLite.
    return max(job.ended_us, record.started_us or record.created_us)


def _time(microseconds: int | None) -> datetime | None:
    return None if microseconds is None else moment(microseconds)


def moment(microseconds: int) -> datetime:
    """Return a time of our tables [microseconds since 1970, UTC]."""
    return datetime.fromtimestamp(microseconds / 1e6, UTC)
