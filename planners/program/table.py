"""A plan as tables: one row a sample, for whoever reads neither URScript nor ROS."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

from planners.plan.contacts import InertiaEntry
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.program.schedule import Schedule

COLUMNS = """# The columns

`trajectory.csv`, one row for each sample of the plan; both arms are on one clock.

| column | what it is |
|---|---|
| `time` | from the plan's begin [s] |
| `step` | number of the segment, from 1; `steps.csv` says what is done in it |
| `<joint>` | position [rad], joints from base to flange |
| `<joint>_velocity` | [rad/s]; between two samples the position is the cubic with these values and slopes |
| `<joint>_acceleration` | [rad/s²] |
| `left_width`, `right_width` | distance of the pads' inner faces [m], the first before all motion; empty: no fingers |
| `left_vacuum`, `right_vacuum` | vacuum of the tool, `on` or `off`, whichever hand has it; empty: never switched |
| `left_force`, `right_force`, `cup_force` | size of what hands and cup exert, as planned [N]; empty: not stated here |

`forces.csv`, one row for each contact that bears something, at the samples at which the plan states them.

| column | what it is |
|---|---|
| `time`, `step` | as above |
| `by`, `body` | what exerts the force, and on what |
| `kind`, `finger` | `soft_finger`, `point`, `suction` or `environment`; finger 0 or 1 of a gripper |
| `point_x` … `point_z` | where, in the world [m] |
| `normal_x` … `normal_z` | into the body |
| `force_x` … `force_z` | that `by` exerts on `body`, along the world's axes [N] |
| `torque_x` … `torque_z` | about the point [Nm] |

`steps.csv`, one row for each step.

| column | what it is |
|---|---|
| `step`, `kind`, `begin`, `end` | number, what is done, when [s] |
| `words` | the same for a person |
| `stop_share` | largest share of the planned speed from which a stop in 1/16 s loses nothing; 0: there is none |
| `left_mass`, `right_mass` | payload of each arm, its hand included, the plate of a lift not [kg] |
| `left_com_x` … `right_com_z` | its centre of mass in the flange's frame [m] |
| `left_squeeze`, `right_squeeze` | with which fingers close as the step begins [N]; empty: they do not |
| `left_vacuum`, `right_vacuum` | `on` or `off` as the step begins; empty: as before |

Joints are measured as the arm's maker does; the world's frame and the arms' bases are in the plan document.
"""


def trajectory_table(schedule: Schedule) -> str:
    """Return `trajectory.csv`, see `COLUMNS`."""
    plan = schedule.plan
    joints = plan.joint_names
    header = ["time", "step", *joints, *(f"{name}_velocity" for name in joints)]
    header += [f"{name}_acceleration" for name in joints]
    header += [f"{arm}_{name}" for name in ("width", "vacuum") for arm in ARMS] + [f"{by}_force" for by in _BEARERS]
    rows: list[Sequence[object]] = [header]
    vacuum = {arm: "off" if any(step.arms[arm].vacuum is not None for step in schedule.steps) else "" for arm in ARMS}
    for number, (segment, step) in enumerate(zip(plan.segments, schedule.steps, strict=True), start=1):
        vacuum |= {arm: _VACUUM[does.vacuum] for arm, does in step.arms.items() if does.vacuum is not None}
        forces = _forces(plan, number - 1)
        for i, time in enumerate(segment.time):
            moving = np.concatenate([segment.positions[i], segment.velocities[i], segment.accelerations[i]])
            widths = [segment.gripper_width[arm][i] if arm in segment.gripper_width else "" for arm in ARMS]
            borne = [forces.get((by, i), "") for by in _BEARERS]
            rows.append([time, number, *moving, *widths, *vacuum.values(), *borne])
    return _written(rows)


def steps_table(schedule: Schedule) -> str:
    """Return `steps.csv`, see `COLUMNS`."""
    header = ["step", "kind", "begin", "end", "words", "stop_share"]
    header += [f"{arm}_{name}" for arm in ARMS for name in ("mass", "com_x", "com_y", "com_z", "squeeze", "vacuum")]
    rows: list[Sequence[object]] = [header]
    begin = 0.0
    for step in schedule.steps:
        told: list[object] = [step.number, step.kind.value, begin, begin + step.duration, step.words, step.stop_share]
        for arm in ARMS:
            mine = step.arms[arm]
            squeeze = "" if mine.squeeze is None else mine.squeeze
            told += [mine.load.mass, *mine.load.com, squeeze, _VACUUM[mine.vacuum]]
        rows.append(told)
        begin += step.duration
    return _written(rows)


def forces_table(plan: Plan) -> str:
    """Return `forces.csv`, see `COLUMNS`."""
    header = ["time", "step", "by", "body", "kind", "finger"]
    header += [f"{name}_{axis}" for name in ("point", "normal", "force", "torque") for axis in "xyz"]
    rows: list[Sequence[object]] = [header]
    for number, segment in enumerate(plan.segments, start=1):
        for contact in segment.contacts:
            if not isinstance(contact, InertiaEntry):
                finger = "" if contact.finger is None else contact.finger
                told = [float(segment.time[contact.sample]), number, contact.by, contact.body, contact.kind, finger]
                rows.append([*told, *contact.point, *contact.normal, *contact.wrench])
    return _written(rows)


_BEARERS = (*ARMS, "cup")
_VACUUM = {True: "on", False: "off", None: ""}


def _forces(plan: Plan, index: int) -> dict[tuple[str, int], float]:
    """Return the size of what each bearer exerts at the samples of a segment at which contacts are stated [N]."""
    sums: dict[tuple[str, int], np.ndarray] = {}
    for contact in plan.segments[index].contacts:
        if not isinstance(contact, InertiaEntry) and contact.by in _BEARERS:
            key = contact.by, contact.sample
            sums[key] = sums.get(key, np.zeros(3)) + contact.wrench[:3]
    return {key: float(np.linalg.norm(force)) for key, force in sums.items()}


def _written(rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([[_cell(each) for each in row] for row in rows])
    return text.getvalue()


def _cell(value: object) -> object:
    # The shortest text that gives the same number again.
    return repr(float(value)) if isinstance(value, float) else value
