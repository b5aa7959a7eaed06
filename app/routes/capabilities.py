"""/v1/capabilities: what this service can plan, with which limits."""

from __future__ import annotations

from typing import get_args

from fastapi import APIRouter

from app.example_tasks import example_tasks
from app.resources.schemas import Resource
from app.routes.dependencies import Authentication, Cells, Settings
from planners.cell.asset_shelf import known_meshes
from planners.contract.task_spec import DEFAULT_CELLS, LifterModel
from planners.plan.verdicts import Software
from planners.scene.scene import PLANNED_KINDS
from planners.scene.shape_source import PLANNED_SHAPES
from planners.scene.suction_tool import known_tools
from planners.survey.cell_limits import CellLimits
from workers.software import describe_software

SCHEMA_VERSION = "1.0"


class Limits(Resource):
    """What is let in."""

    max_body_bytes: int
    max_mesh_bytes: int
    max_queued: int
    max_delayed: int
    """Of one owner's jobs, that wait for their start."""
    max_studies: int
    """Unfinished ones, of all owners."""
    max_study_points: int
    """Of one study."""
    max_webhooks: int
    """Of one owner."""
    max_wait_seconds: float
    requests_per_second: float
    """With one key, at each process of the service."""
    worker_slots: int


class Capabilities(Resource):
    """What this service can plan."""

    kinds: list[str]
    cells: list[str]
    cell_limits: dict[str, CellLimits]
    """By name of the cell: its table, and reach, payload and gripper of its arms. A cell of one's own that this version
    cannot load is left out."""
    default_cells: dict[str, str]
    """By kind: the cell of a task that names none."""
    lifter_models: list[str]
    """Of plate lifts."""
    tools: list[str]
    """Shipped suction tools by name; a task may also name one that its cell brings, see `cell_limits`, or describe one
    of its own."""
    shapes: list[str]
    """Of objects, tools and obstacles; a plate and its support are no mesh."""
    meshes: list[str]
    """Shipped ones by name; others are uploaded to /v1/meshes."""
    example_tasks: dict[str, list[str]]
    """Names of shipped tasks, by kind: files assets/tasks/NAME.json."""
    limits: Limits
    needs_key: bool
    """Whether requests need a key, as the header `Authorization: Bearer KEY`."""
    schema_versions: list[str]
    """Of plan documents."""
    software: Software


router = APIRouter(prefix="/v1", tags=["capabilities"])


@router.get("/capabilities", summary="What this service can plan")
def get_capabilities(cells: Cells, settings: Settings, authenticator: Authentication) -> Capabilities:
    """Return kinds of tasks, cells with what they reach and bear, tools, lifter models, shapes, limits and versions."""
    return Capabilities(
        kinds=list(PLANNED_KINDS),
        cells=sorted(cells),
        cell_limits=cells.limits(),
        default_cells=DEFAULT_CELLS,
        lifter_models=list(get_args(LifterModel)),
        tools=known_tools(),
        shapes=list(PLANNED_SHAPES),
        meshes=known_meshes(),
        example_tasks=example_tasks(),
        limits=Limits(
            max_body_bytes=settings.max_body_bytes,
            max_mesh_bytes=settings.max_mesh_bytes,
            max_queued=settings.max_queued,
            max_delayed=settings.max_delayed,
            max_studies=settings.max_studies,
            max_study_points=settings.max_study_points,
            max_webhooks=settings.max_webhooks,
            max_wait_seconds=settings.max_wait_seconds,
            requests_per_second=settings.requests_per_second,
            worker_slots=settings.worker_slots,
        ),
        needs_key=not authenticator.open,
        schema_versions=[SCHEMA_VERSION],
        software=describe_software(),
    )
