"""A lid on the suction tool passes from hand to hand: our plan of the whole task, and HPP on that stretch."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import trimesh

from planners.cell.cell import Cell
from planners.collision.model import Attached, CollisionQuery, Riding
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import Array, Transform, inverse, transform
from planners.geometry.surface import hull_with_faces
from planners.kinematics.forward import flange_pose
from planners.motion.joint_metric import JointMetric
from planners.plan.segment import SegmentKind
from planners.program.cell_description import CellDescription, roll_pitch_yaw
from planners.progress import silent
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_segment import ToolHold, ToolSegment
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_workcell import ToolClearance, ToolWorkcell
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from tests.benchmarks.bench_collision import PinocchioScene
from tests.benchmarks.peers.contest import Contest, Entry, NotMeasured, Peer, told
from tests.benchmarks.tasks import Note
from workers.stores.handover_store import HandoverStore

TASK = {
    "kind": "suction_tool",
    "objects": [
        {"name": "lid", "shape": {"type": "box", "size": [0.13, 0.07, 0.02]}, "mass": 0.1,
         "pose": [0.3, 0.4, 1.104, 1, 0, 0, 0], "goal_pose": [0.3, -0.4, 1.104, 1, 0, 0, 0],
         "goal_symmetry": "shape"}
    ],
}  # fmt: skip
"""That of the README: only the left arm reaches the lid, and only the right arm its goal."""
CLEARANCE = 0.08
"""From pregrasp to grasp [m]."""
SECONDS = 60.0
"""That HPP may search."""
STEP = 0.01
"""Between samples of a path of HPP, in its own measure of length."""
LARGEST_STEP = 0.02
"""Between configurations at which coal is asked [rad]."""
SLIPPED = 2e-3
"""Most that any entry of the tool's pose in the hand may change [m, 1]."""
TEXT = (
    "The README's lid: the left hand has lifted it with the tool, the right one is to have it above its goal. Ours is "
    "the time of the whole task, in which places of the cup, grasps, the pair of them that hands over, all motion and "
    "all forces are found, with the tool's handovers known from the disk. *HPP* gets the stretch from lifted to "
    "above the goal alone, with the two grasps that ours chose and both hands' fingers as open as they come and go: a "
    "constraint graph of three states (given, in both hands, taken) by its factory, with pregrasps, its manipulation "
    "planner (M-RRT), then random shortcuts; stating it is not in its time. Continuous validation and security margins "
    "of 3 mm are asked for as its examples do it; leaving out either changed none of its answers. It may search for "
    "60 s. Solved: the tool stays in one of both hands all along, by our forward kinematics, and coal finds no contact "
    "every 0.02 rad. Length: of both arms' way in that stretch, in rad of the slowest joint."
)
_WORKER = Path(__file__).with_name("hpp_worker.py")


@dataclass(frozen=True, eq=False)
class HandoverStretch:
    """What of a plan lies between lifted and above the goal."""

    scene: SuctionToolScene
    plan: ToolPlan

    @cached_property
    def _ends(self) -> tuple[int, int]:
        """The giver's last motion with the tool before the handover, and the receiver's first after it."""
        segments = self.plan.segments
        middle = next(i for i, each in enumerate(segments) if each.kind is SegmentKind.HANDOVER)
        moves = [i for i, each in enumerate(segments) if each.kind is SegmentKind.TRANSFER]
        return max(i for i in moves if i < middle), min(i for i in moves if i > middle)

    @property
    def segments(self) -> Sequence[ToolSegment]:
        """From there to there."""
        first, last = self._ends
        return self.plan.segments[first : last + 1]

    @property
    def giver(self) -> ToolHold:
        """How the tool is held at the start."""
        return self.segments[0].holds[0]

    @property
    def receiver(self) -> ToolHold:
        """How the tool is held at the end."""
        return self.segments[-1].holds[0]

    @cached_property
    def path(self) -> Array:
        """(n, 12) of both arms [rad]."""
        return np.vstack([each.trajectory.positions for each in self.segments])

    @cached_property
    def open_widths(self) -> dict[str, float]:
        """How far the receiver's hand is open when it comes, and the giver's when it goes [m]."""
        closing, opening = (
            next(each for each in self.segments if each.kind is kind)
            for kind in (SegmentKind.GRIP, SegmentKind.RELEASE)
        )
        taking, giving = self.receiver.arm, self.giver.arm
        return {taking: float(closing.widths[taking][0]), giving: float(opening.widths[giving][-1])}

    @cached_property
    def T_tool_lid(self) -> Transform:
        """The lid on the cup."""
        sucked = self.segments[0].sucked
        assert sucked is not None
        return sucked.T_tool_object

    def hold(self, arm: str) -> ToolHold:
        """Return how an arm holds the tool."""
        return self.giver if arm == self.giver.arm else self.receiver

    def T_world_tool(self, arm: str, q: Array) -> Transform:
        """Return where the tool is if an arm has it, at (12,) [rad]."""
        joints = q[:6] if list(self.scene.cell.arms).index(arm) == 0 else q[6:]
        described = self.scene.cell.arms[arm]
        return flange_pose(described.dh, described.T_world_base, joints) @ self.hold(arm).T_flange_tool

    @cached_property
    def coal(self) -> Mapping[str, PinocchioScene]:
        """The scene in coal, with the tool on either arm."""
        return {arm: self._in_coal(arm) for arm in (self.giver.arm, self.receiver.arm)}

    def _in_coal(self, arm: str) -> PinocchioScene:
        T_flange_tool = self.hold(arm).T_flange_tool
        query = self._query(arm)
        frames = {"tool": (f"{arm}/6", T_flange_tool), "lid": (f"{arm}/6", T_flange_tool @ self.T_tool_lid)}
        return PinocchioScene(self.scene.cell, query, frames)

    def _query(self, arm: str) -> CollisionQuery:
        both = (self.giver.arm, self.receiver.arm)
        return ToolWorkcell.of(self.scene).query(
            self.open_widths,
            {"tool": Attached(arm, self.hold(arm).T_flange_tool), "lid": Riding("tool", self.T_tool_lid)},
            holding=both,
            only=lambda a, b: {a.name, b.name} != {"tool", "lid"},
        )

    def valid(self, path: Array, tools: Array | None = None) -> bool:
        """Whether a path (n, 12) is free, and a hand has the tool all along: that at (n, 4, 4), or where a hand is."""
        arm, handed = self.giver.arm, False
        for i, q in enumerate(path):
            held = [self.T_world_tool(each, q) for each in (self.giver.arm, self.receiver.arm)]
            if tools is not None:
                off = [float(np.abs(T - tools[i]).max()) for T in held]
                if min(off) > SLIPPED:
                    return False
                arm = (self.giver.arm, self.receiver.arm)[int(np.argmin(off))]
            elif not handed and float(np.abs(held[0] - held[1]).max()) < SLIPPED:
                handed, arm = True, self.receiver.arm
            if i and not self._free(arm, path[i - 1], q):
                return False
        return True

    def _free(self, arm: str, q_from: Array, q_to: Array) -> bool:
        steps = max(1, int(np.ceil(np.abs(q_to - q_from).max() / LARGEST_STEP)))
        return not any(self.coal[arm].broadphase(q_from + s * (q_to - q_from)) for s in np.linspace(0, 1, steps + 1))

    def length(self, path: Array) -> float:
        """Return the length of the way of both arms."""
        speeds = np.concatenate([arm.velocity_max for arm in self.scene.cell.arms.values()])
        return JointMetric.from_velocity_limits(speeds, speeds.size).length(path)


def handover_contest(runs: int, note: Note, databases: Path) -> Contest:
    """Plan the task, and have HPP plan the stretch, as often."""
    note("peers: the handover, ours")
    task = read_task(TASK)
    assert isinstance(task, SuctionToolTask)
    scene, settings = build_tool_scene(task), ToolPlannerSettings()
    database = HandoverStore(databases).get(scene.cell, scene.tool, settings.handovers)
    plan = SuctionToolPlanner(scene, settings, database, silent).plan()
    taken, solved, lengths = [], [], []
    for _ in range(runs):
        begun = process_time()
        plan = SuctionToolPlanner(scene, settings, database, silent).plan()
        taken.append(process_time() - begun)
        stretch = HandoverStretch(scene, plan)
        solved.append(stretch.valid(stretch.path))
        lengths.append(stretch.length(stretch.path) if solved[-1] else np.nan)
    note("peers: the handover, HPP")
    ours = Entry("ours", taken, solved, lengths, [True] * runs)
    return Contest(f"handover ({runs})", ours, [_hpp(HandoverStretch(scene, plan), runs)], "length", text=TEXT)


def _hpp(stretch: HandoverStretch, runs: int) -> Peer:
    found = find_spec("pyhpp")
    if found is None or not found.submodule_search_locations:
        return NotMeasured("HPP", "it is not installed; the extra `peers` has it")
    libraries = Path(found.submodule_search_locations[0]).parents[2]
    with TemporaryDirectory() as name:
        request = _request(stretch, Path(name)) | {"runs": runs, "planning_time": SECONDS}
        environment = {**os.environ, "LD_LIBRARY_PATH": str(libraries), "ROS_PACKAGE_PATH": name}
        try:
            done = subprocess.run(
                [sys.executable, str(_WORKER)], input=json.dumps(request), capture_output=True, text=True, check=False,
                env=environment, timeout=60.0 + 3.0 * runs * SECONDS,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return NotMeasured("HPP", f"its search does not heed the {SECONDS:g} s that it is given")
    if done.returncode:
        why = told(RuntimeError(done.stderr.strip() or "nothing is said"))
        return NotMeasured("HPP", f"its process ends with code {done.returncode} ({why})")
    answers = json.loads(done.stdout)["answers"]
    paths = [None if each["samples"] is None else np.array(each["samples"]) for each in answers]
    solved = [path is not None and _hpp_valid(stretch, path) for path in paths]
    lengths = [
        stretch.length(path[:, :12]) if path is not None and ok else np.nan
        for path, ok in zip(paths, solved, strict=True)
    ]
    return Entry("HPP", [each["seconds"] for each in answers], solved, lengths, [path is not None for path in paths])


def _hpp_valid(stretch: HandoverStretch, samples: Array) -> bool:
    tools = np.array([pin.XYZQUATToSE3(row[12:] / _norm(row)).homogeneous for row in samples])
    q = samples[:, :12]
    ends = np.abs(q[[0, -1]] - stretch.path[[0, -1]]).max() < SLIPPED
    return bool(ends) and stretch.valid(q, tools)


def _norm(row: Array) -> Array:
    return np.array([1.0, 1.0, 1.0, *[float(np.linalg.norm(row[15:]))] * 4])


def _request(stretch: HandoverStretch, folder: Path) -> dict[str, object]:
    """Write the meshes and return what HPP is asked."""
    cell = stretch.scene.cell
    description = CellDescription(cell, "cell")
    for path, content in description.meshes.items():
        file = folder / "cell" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    (folder / "cell" / "package.xml").write_text("<package><name>cell</name></package>")
    joints = [name for arm in cell.arms.values() for name in arm.joint_names]
    return {
        "urdf": with_fixed_fingers(description, cell, stretch.open_widths),
        "srdf": description.srdf,
        "tool_urdf": _tool_urdf(stretch, folder),
        "joints": joints,
        "clearance": CLEARANCE,
        "margin": ToolClearance().margin,
        "step": STEP,
        "start": {
            "q": stretch.path[0].tolist(),
            "tool": _pose(stretch.T_world_tool(stretch.giver.arm, stretch.path[0])),
        },
        "goal": {
            "q": stretch.path[-1].tolist(),
            "tool": _pose(stretch.T_world_tool(stretch.receiver.arm, stretch.path[-1])),
        },
        "giver": _grasp(stretch.giver),
        "receiver": _grasp(stretch.receiver),
    }


def _grasp(hold: ToolHold) -> dict[str, object]:
    """Return where gripper and handle are. A gripper comes along its x axis, which is the flange's z."""
    T_flange_tcp = hold.T_flange_tool @ hold.T_tool_tcp
    T_flange_gripper = transform(np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), T_flange_tcp[:3, 3])
    return {
        "link": f"{hold.arm}_flange",
        "T_link_gripper": T_flange_gripper.tolist(),
        "T_tool_handle": (inverse(hold.T_flange_tool) @ T_flange_gripper).tolist(),
    }


def _pose(T: Transform) -> list[float]:
    return pin.SE3ToXYZQUAT(pin.SE3(T)).tolist()


def _tool_urdf(stretch: HandoverStretch, folder: Path) -> str:
    """Return the tool with the lid on its cup, one link of convex meshes."""
    tool = stretch.scene.tool.body.collision_body().shapes
    lid = next(each.body for each in stretch.scene.objects).collision_body().shapes
    shapes = [*tool, *(shape.placed(stretch.T_tool_lid) for shape in lid)]
    robot = ElementTree.Element("robot", name="tool")
    link = ElementTree.SubElement(robot, "link", name="tool")
    for i, shape in enumerate(shapes):
        file = f"meshes/tool_{i}.stl"
        exported = trimesh.Trimesh(*hull_with_faces(shape.vertices), process=False).export(file_type="stl")
        assert isinstance(exported, bytes)
        (folder / "cell" / file).write_bytes(exported)
        collision = ElementTree.SubElement(link, "collision", name=f"tool_{i}")
        geometry = ElementTree.SubElement(collision, "geometry")
        ElementTree.SubElement(geometry, "mesh", filename=f"package://cell/{file}")
    _as_convex(link)
    return ElementTree.tostring(robot, encoding="unicode")


def with_fixed_fingers(description: CellDescription, cell: Cell, widths: Mapping[str, float]) -> str:
    """Return the URDF with fingers that stay at openings by arm [m], and meshes that are taken for convex."""
    robot = ElementTree.fromstring(description.urdf)
    arm_joints = {name for arm in cell.arms.values() for name in arm.joint_names}
    master = {joint.name: joint.position(widths[arm]) for arm, joint in description.finger_joints.items()}
    for joint in robot.findall("joint"):
        if joint.get("type") == "fixed" or joint.attrib["name"] in arm_joints:
            continue
        mimic = joint.find("mimic")
        value = (
            master[joint.attrib["name"]]
            if mimic is None
            else float(mimic.attrib["multiplier"]) * master[mimic.attrib["joint"]]
        )
        _fix(joint, value)
    for link in robot.findall("link"):
        for i, collision in enumerate(link.findall("collision")):
            collision.set("name", f"{link.attrib['name']}_{i}")
        for visual in link.findall("visual"):
            link.remove(visual)
        _as_convex(link)
    return ElementTree.tostring(robot, encoding="unicode")


def _fix(joint: ElementTree.Element, value: float) -> None:
    origin, axis = joint.find("origin"), joint.find("axis")
    assert origin is not None
    assert axis is not None
    along = np.array([float(x) for x in axis.attrib["xyz"].split()])
    roll, pitch, yaw = (float(x) for x in origin.attrib["rpy"].split())
    T = transform(pin.rpy.rpyToMatrix(roll, pitch, yaw), [float(x) for x in origin.attrib["xyz"].split()])
    turns = joint.get("type") == "revolute"
    moved = T @ (transform(pin.exp3(value * along)) if turns else transform(None, value * along))
    origin.set("xyz", " ".join(map(repr, moved[:3, 3].tolist())))
    origin.set("rpy", " ".join(map(repr, roll_pitch_yaw(moved[:3, :3]).tolist())))
    joint.set("type", "fixed")
    for name in ("axis", "limit", "mimic"):
        for child in joint.findall(name):
            joint.remove(child)


def _as_convex(link: ElementTree.Element) -> None:
    """Say that the meshes of a link are convex, as pinocchio's reader of URDF understands it."""
    checking = ElementTree.SubElement(link, "collision_checking")
    for collision in link.findall("collision"):
        ElementTree.SubElement(checking, "convex", name=collision.attrib["name"])
