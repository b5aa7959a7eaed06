"""Which hands the kinds of tasks need, and which shipped cells have them: their files tell it without being loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import BaseModel

from assets import assets_folder
from planners.contract.strict_yaml import parse_yaml
from planners.errors import SceneError, nearest


@dataclass(frozen=True)
class NeededHands:
    """How many hands of which kind the arms of a cell must have."""

    grippers: int
    sticks: int
    told: str
    """Says it."""

    def fit(self, grippers: int, sticks: int) -> bool:
        """Tell whether a cell with so many hands of each kind has them."""
        return (grippers, sticks) == (self.grippers, self.sticks)

    def of_shipped(self) -> dict[str, bool]:
        """Return of every shipped cell, by its name, whether it has them; none is loaded for it."""
        kinds = _kinds_of_hands()
        sticks = {name: hands.count("stick") for name, hands in kinds.items()}
        return {name: self.fit(len(hands) - sticks[name], sticks[name]) for name, hands in kinds.items()}

    def refusal(self, name: str, fitting: Sequence[str], *, known: bool) -> SceneError:
        """Return what a task that names a cell without them is refused with.

        Args:
            name: as the task says.
            fitting: the names of the cells that have such hands.
            known: whether there is one of this name.
        """
        return SceneError(
            "/cell", self.told if known else f"there is no cell {name}{nearest(name, fitting)}", list(fitting)
        )


FOR_LIFT = NeededHands(1, 1, "a plate lift needs a cell with one gripper and one stick")
FOR_TOOL = NeededHands(2, 0, "a suction tool needs a cell with two grippers")


def check_shipped(name: str, needed: NeededHands) -> None:
    """Refuse a cell, where there are none but the shipped ones, as whoever places the task in it would.

    Raises:
        SceneError: There is none of this name, or it has other hands; with the names of those that have such.
    """
    shipped = needed.of_shipped()
    fitting = [known for known, fits in shipped.items() if fits]
    if name not in fitting:
        raise needed.refusal(name, fitting, known=name in shipped)


class _Hand(BaseModel):
    """What of the file of a hand says what it is."""

    kind: str


class _Arm(BaseModel):
    """What of an arm in the file of a cell says which hand it has."""

    hand: str


class _ArmsOfCell(BaseModel):
    """What of the file of a cell says which hands it has."""

    name: str
    arms: dict[str, _Arm]


@cache
def _kinds_of_hands() -> dict[str, tuple[str, ...]]:
    """Return the kinds of both hands of every shipped cell, by its name."""
    folder = assets_folder()

    def kind(hand: str) -> str:
        return _Hand.model_validate(_content(folder / "hands" / f"{hand}.yaml")).kind

    cells = [_ArmsOfCell.model_validate(_content(path)) for path in sorted((folder / "cells").glob("*.yaml"))]
    return {cell.name: tuple(kind(arm.hand) for arm in cell.arms.values()) for cell in cells}


def _content(path: Path) -> object:
    content, _ = parse_yaml(path.read_bytes())
    return content
