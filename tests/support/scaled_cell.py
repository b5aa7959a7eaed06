"""Shipped cells and tasks in another size: every length a number of times as long, all else as gravity then asks.

Gravity stays what it is, so forces grow as masses do. With lengths times s, masses are taken times s² (twice the
lengths, four times the masses), which makes forces grow with s², torques with s³, moments of inertia with s⁴. What
falls or swings takes √s times as long: joints turn 1/√s times as fast and take up speed 1/s times as quickly, so that
inertia keeps its share of the weight. Angles, frictions and shares stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from planners.cell.asset_files import LifterFile
from planners.cell.asset_shelf import (
    read_cell_file,
    read_hand_file,
    read_mount_file,
    read_robot_file,
    read_sensor_file,
    read_tool_file,
    shipped_shelf,
)
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.hands.workcell import Clearance

from .own_cell import written

_NAMES: Mapping[float, str] = {
    1.0: "a bodies cable_length cable_radius center clearance columns com com_tolerance cup_height d end eps "
    "goal_height height inner_finger inner_knuckle length outer_finger outer_knuckle outline pad pad_height pad_size "
    "pieces position profile radius reach scale size start stick_radius thickness tip_distance tip_length tip_radius "
    "width_max",
    2.0: "carry_force_limit force_max force_noise force_range grip_force_limit kappa mass max_force net normal payload "
    "squeeze",
    3.0: "torque torque_max torque_noise",
    -0.5: "velocity_deg",
    -1.0: "acceleration",
}
POWERS: Mapping[str, float] = {name: power for power, names in _NAMES.items() for name in names.split()}
"""The power of lengths with which a member of a cell, its parts or a task grows; what is not here stays."""
OWN = "in_another_size"
"""The name of a shipped cell in another size."""
_POSES = frozenset({"pose", "goal_pose", "plate_pose", "tool_pose"})


def scaled(said: Any, times: float, power: float = 0.0) -> Any:
    """Return what a cell or task says, with lengths so many times as long.

    Args:
        said: what it says, as JSON.
        times: how many times as long.
        power: of lengths with which numbers in it grow.
    """
    if isinstance(said, Mapping):
        return {
            name: [*scaled(member[:3], times, 1.0), *member[3:]]
            if name in _POSES and member is not None
            else scaled(member, times, POWERS.get(name, 0.0))
            for name, member in said.items()
        }
    if isinstance(said, list):
        return [scaled(each, times, power) for each in said]
    return times**power * said if power and isinstance(said, float | int) else said


def scaled_cell(name: str, times: float, folder: Path, *, tool: str | None = None) -> Cell:
    """Return a shipped cell in another size; its name is its own, and its files are in a folder.

    With `tool`, it brings that shipped tool in its size, under the tool's name.
    """
    shelf = shipped_shelf()
    cell = _said(read_cell_file(shelf.find("cells", name)))
    cell["mount"] = _said(read_mount_file(shelf.find("mounts", cell["mount"])))
    for arm in cell["arms"].values():
        arm["robot"] = _said(read_robot_file(shelf.find("robots", arm["robot"])))
        hand = _said(read_hand_file(shelf.find("hands", arm["hand"])))
        hand["sensor"] = _said(read_sensor_file(shelf.find("sensors", hand["sensor"])))
        arm["hand"] = hand
    if tool is None:
        cell["lifter"] = _said(LifterFile())
    else:
        cell["tools"] = {tool: {"tool": _said(read_tool_file(shelf.find("tools", tool)))["tool"]}}
    cell["margins"] = {"bodies": Clearance().margin}
    return CellBundle.of_text(written({**scaled(cell, times), "name": OWN})).load(folder)


def scaled_task(body: Mapping[str, Any], times: float) -> PlateLiftTask | SuctionToolTask:
    """Return a task in such a cell; what it leaves to defaults is in its size too."""
    task = read_task(dict(body))
    # What tasks say of fingers only where it is not the default.
    said = {**write_task(task), "friction": task.friction.model_dump() | {"eps": task.friction.eps}}
    return read_task({**scaled(said, times), "cell": OWN})


def _said(file: BaseModel) -> dict[str, Any]:
    return file.model_dump(mode="json", exclude_none=True)
