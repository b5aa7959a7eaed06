"""What a cell can do, in figures: where hands reach and what they bear, which plates fit, where hands meet."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, computed_field

from planners.cell.cell import Cell
from planners.cell.hand import Gripper, Pusher
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import Array
from planners.hands.workcell import Clearance
from planners.progress import Progress, silent
from planners.survey.reach_map import HandLooker, ReachMap, ReachMapSettings, map_reach, turns_about

_RIMS: tuple[tuple[int, int, str], ...] = ((1, 0, "back"), (-1, 0, "forward"), (0, 1, "right"), (0, -1, "left"))
"""Of a level plate: where its middle is from the plate's, in sides, and how a hand points that comes to it."""
_HANDOVER_PLACES = (13, 9, 13)
"""Places along each side of the box in which handovers are looked for."""


class ArmFigures(StrictModel):
    """What one arm does above the table."""

    hand: str
    """Its name."""
    kind: Literal["gripper", "stick"]
    """Of the hand."""
    reached: float
    """Share of the table that its hand reaches, pointing any way [1]."""
    reached_downwards: float
    """Share of the table that its hand reaches pointing straight down [1]."""
    largest_mass: float
    """That its hand may hold where that is most [kg]."""
    least_mass: float
    """That its hand may hold where that is least, of all it reaches [kg]."""


class PlateFigures(StrictModel):
    """The largest level square plate that gripper and stick come to from two of its sides."""

    side: float
    """About, to twice the distance of two places of the map [m]."""
    position: tuple[float, float]
    """Of its middle [m]."""


class HandoverFigures(StrictModel):
    """Where both grippers come to one point from opposite sides."""

    low: tuple[float, float, float]
    """Corner of the box around all such points [m]."""
    high: tuple[float, float, float]
    """[m]"""
    volume: float
    """Of all such points [m^3]."""


class SurveyFigures(StrictModel):
    """What a cell can do, in figures."""

    # What is written says it in words too, and is read again.
    model_config = ConfigDict(extra="ignore")

    cell: str
    hash: str
    table: tuple[float, float]
    """Its sides along x and y [m]."""
    height: float
    """Of all places that hands were sent to, above the table [m]."""
    arms: dict[str, ArmFigures]
    common: float
    """Share of the table that both hands reach [1]."""
    dead: float
    """Share of the table that no hand reaches [1]."""
    plate: PlateFigures | None
    """None: the cell does not have one gripper and one stick, or they reach no plate together."""
    handover: HandoverFigures | None
    """None: the cell does not have two grippers, or they never meet."""
    tools: tuple[str, ...] = ()
    """Suction tools that the cell brings beside the shipped ones."""
    margin: float = Clearance().margin
    """That planning keeps between bodies that have nothing to do with one another [m]."""
    notes: tuple[str, ...] = ()
    """What of the cell's files was taken otherwise than written, left out, or most likely was not meant."""

    @computed_field
    @property
    def sentences(self) -> list[str]:
        """What all of this says, in words."""
        x, y = self.table
        said = [f"Table {x:g} × {y:g} m; hands were sent to places {1e3 * self.height:.0f} mm above it."]
        for name, arm in self.arms.items():
            least, most = f"{arm.least_mass:.1f}", f"{arm.largest_mass:.1f}"
            masses = (most if least == most else f"{least} to {most}") + " kg" if arm.reached else "nothing"
            said.append(
                f"The {name} arm ({arm.hand}) reaches {100 * arm.reached:.0f} % of it, pointing down "
                f"{100 * arm.reached_downwards:.0f} %, and may hold {masses} there."
            )
        said.append(f"Both reach {100 * self.common:.0f} %; {100 * self.dead:.0f} % is reached by none.")
        if self.plate is not None:
            at = ", ".join(f"{each:.2f}" for each in self.plate.position)
            said.append(
                f"Gripper and stick come to a level square plate of about {self.plate.side:.2f} m, at ({at}) m."
            )
        if self.handover is not None:
            low, high = (
                ", ".join(f"{each:.2f}" for each in corner) for corner in (self.handover.low, self.handover.high)
            )
            litres = 1e3 * self.handover.volume
            said.append(f"The grippers meet in {litres:.0f} litres, between ({low}) and ({high}) m.")
        said.append(f"Planning keeps bodies {1e3 * self.margin:g} mm apart.")
        if self.tools:
            said.append(f"Suction tools of its own: {', '.join(self.tools)}.")
        return said


@dataclass(frozen=True, eq=False)
class CellSurvey:
    """A cell, looked at."""

    cell: Cell
    reach: ReachMap
    handovers: Array
    """(k, 3) places where both grippers meet [m]; none without two grippers."""
    handover_step: Array
    """(3,) between two of them [m]."""

    @classmethod
    def of(cls, cell: Cell, settings: ReachMapSettings | None = None, progress: Progress = silent) -> CellSurvey:
        """Look at a cell; takes some seconds. `progress` is told, and may raise `PlanningCancelled`."""
        reach = map_reach(cell, settings, progress)
        handovers, step = _handovers(cell, reach) if len(cell.gripper_arms) == 2 else (np.empty((0, 3)), np.zeros(3))
        return cls(cell, reach, handovers, step)

    @cached_property
    def plate_sides(self) -> Array:
        """(n, m): side of the largest level square plate about each place of the map, 0 where there is none [m]."""
        cell, reach = self.cell, self.reach
        sides = np.zeros(reach.common.shape)
        if not (cell.gripper_arms and cell.pusher_arms):
            return sides
        gripper, pusher = cell.gripper_arms[0], cell.pusher_arms[0]
        step = np.sqrt(reach.area_of_place)
        n, m = len(reach.x), len(reach.y)
        for half in range(1, (min(n, m) + 1) // 2):
            pairs = itertools.permutations(_RIMS, 2)
            held = [_at_rim(reach, gripper, one, half) & _at_rim(reach, pusher, other, half) for one, other in pairs]
            # All of the plate is above the table.
            inner = slice(half, n - half), slice(half, m - half)
            sides[inner][np.logical_or.reduce(held)[inner]] = 2.0 * half * step
        return sides

    def figures(self) -> SurveyFigures:
        """Return it in figures."""
        cell, reach = self.cell, self.reach
        size = cell.boxes[0].size
        return SurveyFigures(
            cell=cell.name,
            hash=cell.hash,
            table=(float(size[0]), float(size[1])),
            height=round(reach.z - cell.table_top, 6),
            arms={name: _arm_figures(reach, name, arm.hand) for name, arm in cell.arms.items()},
            common=_share(reach.common),
            dead=_share(reach.dead),
            plate=self._largest_plate(),
            handover=self._handover(),
            tools=tuple(sorted(cell.tools)),
            margin=Clearance.of(cell).margin,
        )

    def _largest_plate(self) -> PlateFigures | None:
        sides = self.plate_sides
        i, j = np.unravel_index(int(np.argmax(sides)), sides.shape)
        if sides[i, j] == 0.0:
            return None
        position = float(self.reach.x[i]), float(self.reach.y[j])
        return PlateFigures(side=round(float(sides[i, j]), 4), position=position)

    def _handover(self) -> HandoverFigures | None:
        if not len(self.handovers):
            return None
        (ax, ay, az), (bx, by, bz) = self.handovers.min(axis=0).tolist(), self.handovers.max(axis=0).tolist()
        volume = len(self.handovers) * float(np.prod(self.handover_step))
        return HandoverFigures(low=(ax, ay, az), high=(bx, by, bz), volume=round(volume, 6))


def _arm_figures(reach: ReachMap, arm: str, hand: Gripper | Pusher) -> ArmFigures:
    masses = reach.mass[arm][reach.anyhow[arm]]
    return ArmFigures(
        hand=hand.name,
        kind=hand.kind,
        reached=_share(reach.anyhow[arm]),
        reached_downwards=_share(reach.from_way(arm, "down")),
        largest_mass=round(float(masses.max(initial=0.0)), 3),
        least_mass=round(float(masses.min()), 3) if len(masses) else 0.0,
    )


def _share(places: NDArray[np.bool_]) -> float:
    return round(float(places.mean()), 4)


def _at_rim(reach: ReachMap, arm: str, rim: tuple[int, int, str], half: int) -> NDArray[np.bool_]:
    """(n, m): whether an arm comes to the rim of a plate about each place; `half` is half its side, in places."""
    di, dj, way = half * rim[0], half * rim[1], rim[2]
    found = reach.from_way(arm, way)
    n, m = found.shape
    shifted = np.zeros_like(found)
    shifted[max(0, -di) : n - max(0, di), max(0, -dj) : m - max(0, dj)] = found[
        max(0, di) : n - max(0, -di), max(0, dj) : m - max(0, -dj)
    ]
    return shifted


def _handovers(cell: Cell, reach: ReachMap) -> tuple[Array, Array]:
    """Return places (k, 3) where the hands meet, one pointing along the line between the bases and one against it."""
    bases = {name: arm.T_world_base[:3, 3] for name, arm in cell.arms.items()}
    across = bases["right"] - bases["left"]
    across = np.array([across[0], across[1], 0.0])
    length = float(np.linalg.norm(across))
    across = across / length if length > 0.0 else np.array([0.0, -1.0, 0.0])
    table = cell.boxes[0]
    low = table.center - 0.5 * table.size
    high = table.center + 0.5 * table.size
    low[2], high[2] = cell.table_top, cell.table_top + max(arm.robot.reach for arm in cell.arms.values())
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, _HANDOVER_PLACES, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    met = np.ones(len(places), dtype=np.bool_)
    for arm, way in (("left", across), ("right", -across)):
        found, _ = HandLooker(cell, turns_about([way], 8)).look(arm, places)
        met &= found[:, 0]
    return places[met], (high - low) / (np.array(_HANDOVER_PLACES) - 1)
