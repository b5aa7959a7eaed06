"""ScanSpec: what the pictures of a scan are, from which cameras, and what is looked for in them."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from planners.contract.problems import NotValid, problems_of
from planners.contract.quantities import Counted, Length, Name, Pose
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import TOOL_CELL

IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
Focal = Annotated[float, Field(strict=True, ge=10.0, le=1e5, allow_inf_nan=False)]
"""[px]"""
Pixel = Annotated[float, Field(strict=True, ge=-1e5, le=1e5, allow_inf_nan=False)]
"""[px]"""
Coefficient = Annotated[float, Field(strict=True, ge=-100.0, le=100.0, allow_inf_nan=False)]
Unit = Annotated[float, Field(strict=True, ge=1e-6, le=1.0, allow_inf_nan=False)]
"""What numbers of a file are multiplied by to be metres [m]."""


class Intrinsics(StrictModel):
    """A pinhole camera as OpenCV describes it; whole numbers are the centres of pixels."""

    fx: Focal
    fy: Focal
    cx: Pixel
    cy: Pixel
    distortion: Annotated[tuple[Coefficient, ...], Counted(0, 8)] = ()
    """k1, k2, p1, p2[, k3[, k4, k5, k6]]; empty: none."""

    @model_validator(mode="after")
    def _has_a_known_number_of_coefficients(self) -> Self:
        if len(self.distortion) not in (0, 4, 5, 8):
            raise PydanticCustomError("distortion", "distortion has 0, 4, 5 or 8 coefficients")
        return self


class ColourSpec(StrictModel):
    """The part `colour`: a PNG or JPEG picture."""

    intrinsics: Intrinsics
    pose: Pose
    """T_world_camera: z forward, x right, y down."""


class DepthSpec(StrictModel):
    """The part `depth`: a 16-bit PNG, or an NPY file with (rows, columns), of distances along the camera's z."""

    intrinsics: Intrinsics
    pose: Pose
    """T_world_camera: z forward, x right, y down."""
    unit: Unit = 0.001


class CloudSpec(StrictModel):
    """The part `cloud`: points in a PLY, PCD or NPY file, as one camera saw them."""

    pose: Pose
    """T_world_camera: z forward, x right, y down."""
    frame: Literal["camera", "world"] = "camera"
    """In which frame the points are."""
    unit: Unit = 1.0


class MarkersSpec(StrictModel):
    """A board of square markers on the tool; its frame is in its middle, x along rows, y up, z out of it."""

    dictionary: Literal["4x4_50", "5x5_50", "6x6_50", "apriltag_36h11"] = "4x4_50"
    ids: Annotated[tuple[Annotated[int, Field(strict=True, ge=0, le=586)], ...], Counted(1, 64)]
    """Row by row from the top, each from the left."""
    columns: Annotated[int, Field(strict=True, ge=1, le=64)]
    marker: Length
    """Side of a marker [m]."""
    gap: Annotated[float, Field(strict=True, ge=0.0, le=1.0, allow_inf_nan=False)] = 0.0
    """Between markers [m]."""
    pose: Pose = IDENTITY
    """T_tool_board."""

    @model_validator(mode="after")
    def _is_a_grid(self) -> Self:
        if len(self.ids) % self.columns or len(set(self.ids)) != len(self.ids):
            raise PydanticCustomError("grid", "ids are all different and fill rows of {n} columns", {"n": self.columns})
        # The smallest family has 50 markers; the largest is the only one with more.
        if max(self.ids) >= 50 and self.dictionary != "apriltag_36h11":
            raise PydanticCustomError("ids", "{name} has the ids 0 to 49", {"name": self.dictionary})
        return self


class NotAScan(NotValid):
    """A description is that of no scan."""


class ScanSpec(StrictModel):
    """The part `scan`: what the other parts of the form are. At least one of them is given."""

    cell: Name = TOOL_CELL
    tool: Name | None = "long_symmetric"
    """Which tool is looked for, a shipped one or one that the cell brings; None: none."""
    markers: MarkersSpec | None = None
    """On the tool; None: its own, if its file states some."""
    colour: ColourSpec | None = None
    depth: DepthSpec | None = None
    cloud: CloudSpec | None = None
    external_id: Annotated[str, Field(max_length=128)] | None = None

    @model_validator(mode="after")
    def _has_something_to_look_at(self) -> Self:
        if self.colour is None and self.depth is None and self.cloud is None:
            raise PydanticCustomError("nothing", "at least one of colour, depth and cloud is needed")
        if self.depth is not None and self.cloud is not None:
            raise PydanticCustomError("both", "give either depth or cloud: both are what one camera measured")
        return self


_ADAPTER: TypeAdapter[ScanSpec] = TypeAdapter(ScanSpec)


def read_scan(body: object) -> ScanSpec:
    """Validate a parsed JSON body.

    Raises:
        NotAScan: It has other members, or values that they may not have.
    """
    try:
        return _ADAPTER.validate_python(body)
    except ValidationError as error:
        raise NotAScan(problems_of(error, ScanSpec)) from error


def scan_schema() -> dict[str, object]:
    """Return the JSON schema (2020-12) of a scan's description."""
    return _ADAPTER.json_schema()
