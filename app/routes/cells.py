"""/v1/cells and /v1/surveys: describe a cell of one's own, see what it can do, and have tasks name it."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Depends, Request, Response

from app.pictures.survey_picture import draw_survey
from app.resources.cell_collection import CellCollection, examined_upload, look_at
from app.resources.schemas import PROBLEM, CellList, CellResource
from app.routes.dependencies import Bench, Cells, Settings
from app.settings import ServiceSettings
from app.uploads.form import FORM
from app.uploads.uploads import CELL_TYPES, FIELD, UploadLimits, read_cell
from app.work.wanted import StillWanted, while_waited_for
from app.work.workbench import Workbench
from planners.cell.bundle import CellBundle
from planners.survey.survey import SurveyFigures
from workers.stores.cell_store import CellFindings

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {**PROBLEM, "description": "No such cell"}}
REFUSED: dict[int | str, dict[str, Any]] = {
    409: {**PROBLEM, "description": "It is called as a shipped cell is"},
    413: {**PROBLEM, "description": "Too large"},
    415: {**PROBLEM, "description": "Not declared as a cell"},
    422: {**PROBLEM, "description": "A cell in which nothing can be planned: every fault, with its file and member"},
}
BINARY = {"type": "string", "format": "binary"}
CELL_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            FORM: {"schema": {"type": "object", "required": [FIELD], "properties": {FIELD: BINARY}}},
            **{media_type: {"schema": BINARY} for media_type in CELL_TYPES if "json" not in media_type},
            "application/json": {"schema": {"$ref": "#/components/schemas/CellFile"}},
        },
    }
}

router = APIRouter(prefix="/v1", tags=["cells"])


def _limits(request: Request) -> UploadLimits:
    return request.app.state.cell_limits


CellGate = Annotated[UploadLimits, Depends(_limits)]


@router.post(
    "/cells",
    status_code=201,
    response_model=CellResource,
    summary="Add a cell",
    openapi_extra=CELL_BODY,
    responses={**REFUSED, 200: {"model": CellResource, "description": "The same cell was there already"}},
)
async def post_cell(
    request: Request, response: Response, cells: Cells, settings: Settings, bench: Bench, limits: CellGate
) -> CellResource:
    """Take a cell in: a zip of its files, or one document of YAML or JSON in which every part stands itself.

    It becomes the next version of its name. docs/cell.md tells how to describe one.
    """
    async with limits.held:
        bundle, findings = await _examined(request, cells, settings, bench, limits)
        stored, is_new = await to_thread.run_sync(cells.add, bundle, findings)
    resource = CellResource.of(stored, findings)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = resource.links.self
    return resource


@router.post(
    "/surveys", summary="Check a cell without keeping it", openapi_extra=CELL_BODY, responses=REFUSED, status_code=200
)
async def post_survey(
    request: Request, cells: Cells, settings: Settings, bench: Bench, limits: CellGate
) -> SurveyFigures:
    """Return what a cell can do: where its hands reach and what they bear there; and what was noticed in its files."""
    async with limits.held:
        _, findings = await _examined(request, cells, settings, bench, limits)
    return findings


async def _examined(
    request: Request, cells: CellCollection, settings: ServiceSettings, bench: Workbench, limits: UploadLimits
) -> tuple[CellBundle, CellFindings]:
    """Return the cell that a request brings, and what was found in it."""
    content, suffix = await read_cell(request, settings.max_cell_bytes, settings)

    def examine(wanted: StillWanted) -> tuple[CellBundle, CellFindings]:
        return bench.do(wanted, examined_upload, content, suffix, cells.folder, frozenset(cells.shipped))

    return await while_waited_for(request, examine, limits.worked)


@router.get("/cells", summary="List cells")
def list_cells(cells: Cells) -> CellList:
    """Return the shipped cells and one's own."""
    shipped = [CellResource.of_shipped(cell) for _, cell in sorted(cells.shipped.items())]
    return CellList(cells=[*shipped, *(CellResource.of(stored) for stored in cells.own())])


@router.get("/cells/{cell_id}", summary="One cell", responses=NOT_FOUND)
def get_cell(cell_id: str, cells: Cells) -> CellResource:
    """Return what is known of a cell, by id or name."""
    if cell_id in cells.shipped:
        return CellResource.of_shipped(cells.shipped[cell_id])
    stored = cells.stored(cell_id)
    return CellResource.of(stored, cells.findings(stored))


@router.get(
    "/cells/{cell_id}/files.zip",
    summary="Fetch the files of a cell",
    response_class=Response,
    responses={**NOT_FOUND, 200: {"content": {"application/zip": {}}, "description": "All files of the cell"}},
)
def get_files(cell_id: str, cells: Cells) -> Response:
    """Return all files of a cell of one's own, in the layout in which shipped ones are kept."""
    headers = {"Content-Disposition": f'attachment; filename="{cells.stored(cell_id).name}.zip"'}
    return Response(cells.files(cell_id), media_type="application/zip", headers=headers)


@router.get("/cells/{cell_id}/survey", summary="What a cell can do", responses=NOT_FOUND)
async def get_survey(request: Request, cell_id: str, cells: Cells, bench: Bench, limits: CellGate) -> SurveyFigures:
    """Return where the hands of a cell reach and what they bear there, in figures."""

    def figures(wanted: StillWanted) -> SurveyFigures:
        found = cells.survey(cell_id, partial(bench.do, wanted, look_at)).figures()
        return found.model_copy(update={"notes": cells.notes(cell_id)})

    return await while_waited_for(request, figures, limits.worked)


@router.get(
    "/cells/{cell_id}/survey.png",
    summary="What a cell can do, as a picture",
    response_class=Response,
    responses={**NOT_FOUND, 200: {"content": {"image/png": {}}, "description": "Maps of the table, from above"}},
)
async def get_survey_picture(request: Request, cell_id: str, cells: Cells, bench: Bench, limits: CellGate) -> Response:
    """Return maps of the table: which hand reaches where, what it may hold there, how large plates may be."""

    def drawn(wanted: StillWanted) -> bytes:
        return draw_survey(cells.survey(cell_id, partial(bench.do, wanted, look_at)))

    picture = await while_waited_for(request, drawn, limits.worked)
    return Response(picture, media_type="image/png", headers={"Cache-Control": "no-cache"})


@router.delete("/cells/{cell_id}", status_code=204, summary="Delete a cell", responses=NOT_FOUND)
def delete_cell(cell_id: str, cells: Cells) -> None:
    """Have a cell for no more tasks; plans that are in it keep it, whether they have ended or not."""
    cells.delete(cell_id)
