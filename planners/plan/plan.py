"""The plan of one task: by it the motion can be replayed and every claim be checked."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planners.contract.strict_json import parse_json
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import TaskSpec
from planners.plan.scenery import ARMS, JOINT_NAMES, BodyDocument, CellDocument, GripperDocument
from planners.plan.segment import Segment
from planners.plan.simulation import Simulation
from planners.plan.timeline import Moment, Timeline
from planners.plan.verdicts import Certificate, Explanation, Software, Statistics

SCHEMA_VERSION = "1.0"
Outcome = Literal["solved", "infeasible", "not_found"]


class Plan(StrictModel):
    """The result of one task."""

    schema_version: Literal["1.0"]
    id: str
    task: TaskSpec
    """As accepted, every default filled in."""
    seed: int
    software: Software
    outcome: Outcome
    explanation: Explanation
    cell: CellDocument
    joint_names: Annotated[list[str], Field(min_length=12, max_length=12)]
    bodies: dict[str, BodyDocument]
    segments: list[Segment]
    certificate: Certificate | None
    simulation: Simulation | None
    statistics: Statistics
    digest: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None
    """SHA-256 of what the plan says, see `fingerprint`; None in documents of older software."""

    @model_validator(mode="after")
    def _names_what_there_is(self) -> Self:
        if tuple(self.joint_names) != JOINT_NAMES:
            raise _unknown("joint_names", f"are not {', '.join(JOINT_NAMES)}")
        for arm in ARMS:
            if arm not in self.cell.arms or arm not in self.cell.hands:
                raise _unknown("cell", f"has no {arm} arm with a hand")
        for index, segment in enumerate(self.segments):
            for member, fault in self._strangers(segment):
                raise _unknown(f"segments/{index}/{member}", fault)
        return self

    def _strangers(self, segment: Segment) -> Iterator[tuple[str, str]]:
        """Yield what a segment names that the plan does not have: the member, and what is wrong with it."""
        grippers = {arm for arm, hand in self.cell.hands.items() if isinstance(hand, GripperDocument)}
        if set(segment.gripper_width) != grippers:
            yield "gripper_width", f"must have the grippers {sorted(grippers)}"
        held = [(grip, grip.arm in grippers) for grip in segment.grips]
        held += [] if segment.push is None else [(segment.push, segment.push.arm not in grippers)]
        yield from (("hold", f"the {hold.arm} hand cannot hold so") for hold, fits in held if not fits)
        state = segment.contact_state
        named: dict[str, list[str | None]] = {
            "hold": [hold.body for hold, _ in held],
            "body_poses": [*segment.body_poses],
            "attached": [*segment.attached],
            "contacts": [contact.body for contact in segment.contacts],
            "contact_state": [] if state is None or state.element == "none" else [state.with_],
        }
        for member, names in named.items():
            yield from ((member, f"names no body of the plan: {name!r}") for name in names if name not in self.bodies)
        yield from self._strange_bearers(segment)

    def _strange_bearers(self, segment: Segment) -> Iterator[tuple[str, str]]:
        carriers = {*ARMS, *self.bodies}
        off = [ride.to for name, ride in segment.rides if ride.to not in carriers - {name}]
        yield from (("attached", f"{to!r} is no arm and no other body") for to in off)
        strange = [contact.by for contact in segment.contacts if contact.by not in carriers | {"cup", "tool", None}]
        yield from (("contacts", f"{by!r} is no arm, cup, tool or body") for by in strange)

    @classmethod
    def read(cls, source: bytes | str | Path) -> Self:
        """Read a plan from bytes, or from a file by its path.

        >>> from pathlib import Path
        >>> from planners import Plan, read_task, solve
        >>> solved = solve(read_task(Path("assets/tasks/pb1_weak_cup.json")))
        >>> plan = Plan.read(solved.write())
        >>> plan.outcome, plan.software.name, plan.bodies["plate"].pose.shape
        ('infeasible', 'liftwright', (7,))
        >>> [check.name for check in plan.certificate.checks]
        ['structure', 'cell', 'gripper', 'task_bodies', 'infeasibility']

        Raises:
            pydantic.ValidationError: a member is missing, of the wrong type, size or range, or names something unknown.
        """
        return cls.model_validate(parse_json(source if isinstance(source, bytes) else Path(source).read_bytes()))

    @cached_property
    def timeline(self) -> Timeline:
        """The plan between its samples."""
        return Timeline(self.segments, self.bodies, self.task.start_positions)

    @property
    def duration(self) -> float:
        """When the last segment ends [s]; 0 for a plan without segments."""
        return self.timeline.duration

    def at(self, time: float) -> Moment:
        """Return where everything is at a time from the plan's begin [s], between its samples too.

        Times before the begin and after the end are taken to the nearer one:

        >>> plan = Plan.read("plan.json")
        >>> moment = plan.at(0.5 * plan.duration)
        >>> moment.positions.shape  # of both arms, in the order of JOINT_NAMES [rad]
        (12,)
        >>> sorted(plan.at(plan.duration + 1.0).body_poses) == sorted(plan.bodies)
        True
        """
        return self.timeline.at(time)

    def document(self) -> dict[str, Any]:
        """Return it as JSON data: what was set, no defaults."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)

    def fingerprint(self) -> str:
        """Return the SHA-256 of all that it says, as hexadecimal digits, but for its id, digest and statistics.

        The same task gives the same one; a plan of which one digit was changed gives another.
        """
        said = self.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude=_NOT_OF_THE_MOTION)
        return sha256(json.dumps(said, allow_nan=False, sort_keys=True, separators=(",", ":")).encode()).hexdigest()

    def sealed(self) -> Self:
        """Return it with its digest, by which a change is noticed afterwards."""
        return self.model_copy(update={"digest": self.fingerprint()})

    def write(self) -> bytes:
        """Return it as JSON; every number is written so that reading it gives the same number."""
        return json.dumps(self.document(), allow_nan=False, separators=(",", ":")).encode()


_NOT_OF_THE_MOTION = {"id", "digest", "statistics"}


def _unknown(member: str, fault: str) -> PydanticCustomError:
    return PydanticCustomError("unknown", "{member}: {fault}", {"member": member, "fault": fault})


def plan_schema() -> dict[str, Any]:
    """Return the JSON schema (2020-12) of a plan document."""
    return Plan.model_json_schema()
