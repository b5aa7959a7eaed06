"""A study as accepted: which task stands at each of its points."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

from pydantic import JsonValue, ValidationError

from planners.contract.problems import NotValid, Problem, problems_of
from planners.contract.study_spec import StudyAxis, StudySpec
from planners.contract.task_change import CannotBeChanged, PatchOperation, changed
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.errors import LiftwrightError, SceneError

_OF_A_SCENE = ("/scene_id", "/scene_filled")
"""Pointers into tasks."""


class NotAStudy(NotValid):
    """A study cannot be begun."""


@dataclass(frozen=True, eq=False)
class Study:
    """A task and the values of its members that are varied. Points are numbered, the last axis varying fastest."""

    spec: StudySpec
    """Its task has every default but those that take the scene."""

    @classmethod
    def read(cls, body: Any, fill: Callable[[Any], Any] = lambda task: task, most: int | None = None) -> Study:
        """Accept a study.

        Args:
            body: as JSON data.
            fill: puts into the task what it takes from elsewhere, as from a perceived scene.
            most: points it may have; None: as many as it says.

        Raises:
            NotAStudy: It has other members, too many points, or a value that no task may have; or the task is not valid
                whatever is varied.
        """
        try:
            spec = StudySpec.model_validate(body)
        except ValidationError as error:
            raise NotAStudy(problems_of(error, StudySpec)) from error
        count = math.prod(len(axis.places) for axis in spec.axes)
        if most is not None and count > most:
            detail = f"the axes make {count} points; 1 to {most} are allowed, so take fewer values"
            raise NotAStudy([Problem("/axes", detail)])
        try:
            task = write_task(read_task(fill(spec.task)))
        except (ValidationError, SceneError) as error:
            problems = [replace(problem, pointer=f"/task{problem.pointer}") for problem in problems_of(error)]
            raise NotAStudy(problems) from error
        if len({(axis.pointer, axis.part) for axis in spec.axes}) < len(spec.axes):
            raise NotAStudy([Problem("/axes/1", "both axes vary the same; take a list of values, or another member")])
        study = cls(spec.model_copy(update={"task": task}))
        problems = [problem for number in range(len(spec.axes)) for problem in study._strange_values(number)]
        if problems:
            raise NotAStudy(problems)
        return study

    @classmethod
    def of_document(cls, document: Any) -> Study:
        """Return the study that `document` states, which was accepted before."""
        return cls(StudySpec.model_validate(document))

    def document(self) -> dict[str, Any]:
        """Return the study as accepted, as JSON data."""
        return self.spec.model_dump(mode="json", exclude_none=True) | {"task": self.spec.task}

    @property
    def axes(self) -> tuple[StudyAxis, ...]:
        """What is varied."""
        return self.spec.axes

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """How many values each axis has."""
        return tuple(len(axis.places) for axis in self.axes)

    @property
    def count(self) -> int:
        """How many points there are."""
        return math.prod(self.shape)

    def at(self, index: int) -> tuple[int, ...]:
        """Return which value of each axis a point has, counted from 0."""
        return self._places[index]

    @cached_property
    def _places(self) -> list[tuple[int, ...]]:
        return list(product(*map(range, self.shape)))

    def document_at(self, index: int) -> dict[str, Any]:
        """Return the task of a point as JSON data, whichever axis is named first.

        What has the member of the other axis in it is put there first, and poses are turned last: else one axis would
        undo what the other does.

        Raises:
            SceneError: there can be none, since a value of one axis leaves no such member for the other.
        """
        task: dict[str, Any] = self.spec.task
        values = [(axis, axis.places[place]) for axis, place in zip(self.axes, self.at(index), strict=True)]
        for axis, value in sorted(values, key=lambda one: (one[0].part == "yaw", one[0].pointer.count("/"))):
            try:
                task = changed(task, [_operation(task, axis, value)])
            except (CannotBeChanged, _NotAPose) as error:
                raise SceneError(axis.pointer, "is not there with this value of the other axis") from error
        return task

    def task_at(self, index: int) -> PlateLiftTask | SuctionToolTask:
        """Return the task of a point.

        Raises:
            pydantic.ValidationError: there can be none, since values of both axes do not go together.
            SceneError: likewise.
        """
        return read_task(self.document_at(index))

    def with_each_value(self) -> list[dict[str, Any]]:
        """Return the task as JSON data, as it stands and with each value of each axis: all that any point names."""
        task: dict[str, Any] = self.spec.task
        operations = [_operation(task, axis, value) for axis in self.axes for value in axis.places]
        return [task, *(changed(task, [operation]) for operation in operations)]

    def _strange_values(self, number: int) -> list[Problem]:
        """Say which values of an axis no task may have; with two axes, beside the first value of the other."""
        axis, pointer = self.axes[number], f"/axes/{number}"
        if axis.pointer in _OF_A_SCENE:
            detail = "what a scene gives is written into the task before anything is varied: post a study of each scene"
            return [Problem(f"{pointer}/pointer", detail)]
        try:
            operations = [_operation(self.spec.task, axis, value) for value in axis.places]
        except _NotAPose as error:
            return [Problem(f"{pointer}/{error.member}", str(error))]
        problems: list[Problem] = []
        for place, operation in enumerate(operations):
            where = f"{pointer}/values/{place}" if axis.values is not None else pointer
            try:
                read_task(changed(self.spec.task, [operation]))
            except CannotBeChanged:
                allowed = _members_beside(self.spec.task, axis.pointer) or None
                return [Problem(f"{pointer}/pointer", f"the task has no member {axis.pointer}", allowed)]
            except (ValidationError, SceneError) as error:
                first = problems_of(error)[0]
                told = f"{axis.places[place]!r} is not valid there: {first.pointer} {first.detail}"
                problems.append(replace(first, pointer=where, detail=told))
        return problems[:1] if axis.values is None else problems


def _operation(task: Any, axis: StudyAxis, value: JsonValue) -> PatchOperation:
    """Return what gives a task a value of an axis; of a range, whole numbers where the task has one."""
    member = _member(task, axis.pointer)
    if axis.part == "yaw":
        value = _turned(member, value)
    elif axis.values is None and isinstance(member, int) and isinstance(value, float) and value.is_integer():
        value = int(value)
    return PatchOperation(op="replace", path=axis.pointer, value=value)


class _NotAPose(LiftwrightError):
    def __init__(self, member: str, detail: str) -> None:
        super().__init__(detail)
        self.member = member


def _member(task: Any, pointer: str) -> Any:
    """Return what stands at a pointer, None if nothing does."""
    found = task
    for step in pointer.split("/")[1:]:
        name = step.replace("~1", "/").replace("~0", "~")
        if isinstance(found, Mapping):
            found = found.get(name)
        elif isinstance(found, list | tuple) and name.isdecimal() and int(name) < len(found):
            found = found[int(name)]
        else:
            return None
    return found


def _members_beside(task: Any, pointer: str) -> list[str]:
    """Return the pointers that there are where one leads nowhere: those in the last thing on its way that is there."""
    steps = pointer.split("/")[1:]
    for kept in range(len(steps) - 1, -1, -1):
        base = "".join(f"/{step}" for step in steps[:kept])
        found = task if kept == 0 else _member(task, base)
        if isinstance(found, Mapping):
            return [f"{base}/{name}" for name in found]
        if isinstance(found, list | tuple):
            return [f"{base}/{place}" for place in range(len(found))]
    return []


def _turned(pose: Any, angle: JsonValue) -> JsonValue:
    """Return a pose turned about the vertical through its origin, as JSON data."""
    if not isinstance(pose, list | tuple) or len(pose) != 7:
        raise _NotAPose("pointer", "there is no pose [x, y, z, qw, qx, qy, qz] that could be turned")
    if isinstance(angle, bool) or not isinstance(angle, int | float):
        raise _NotAPose("values", "a yaw is a number [rad]")
    x, y, z, *q = (float(each) for each in pose)
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    return [x, y, z, c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]]
