"""What each check of a certificate asks, in a sentence for who reads the plan."""

from __future__ import annotations

from typing import Final

CHECK_WORDS: Final[dict[str, str]] = {
    "structure": "The document is complete and of one piece.",
    "cell": "Arms, hands and table are those of the cell that is named.",
    "gripper": "Every opening of the fingers is one that the gripper has.",
    "task_bodies": "Plate, cup, tool and objects are those of the task, in the places that it states.",
    "infeasibility": "What stands in the way is a proof: more is needed than there can be.",
    "time": "Time goes on from sample to sample, with no gap between segments.",
    "rest": "The robot stands still at the start, at the end, and wherever segments meet.",
    "movers": "An arm that is said to rest does rest.",
    "joint_positions": "Every joint stays within its range.",
    "joint_velocities": "No joint turns faster than it may.",
    "joint_accelerations": "No joint speeds up or brakes harder than it may.",
    "velocity_consistency": "Velocities are those of the positions.",
    "acceleration_consistency": "Accelerations are those of the velocities.",
    "joint torque": "No joint needs more torque than its motor has, with a twentieth to spare.",
    "kinds": "Nothing moves in a segment but what its kind allows.",
    "joins": "Each segment begins where the one before ended.",
    "start": "The motion begins where the arms are said to stand.",
    "hands": "Hands take and release the tool in an order that is possible.",
    "vacuum": "The vacuum is on whenever an object hangs on the cup, and comes and goes at rest.",
    "supports": "Objects are put down on what is there at that time.",
    "standing": "What nobody holds stands by itself and does not tip.",
    "attachments": "What is held stays in its place in the hand or on the cup.",
    "attachment_angles": "What is held does not turn in the hand or on the cup.",
    "attachment_rules": "Nothing is held by what cannot hold it.",
    "lifter": "The cup stays on the plate, and its cable hangs plumb.",
    "resting_bodies": "Nothing moves by itself.",
    "grips": "Fingers are where a grip says they are.",
    "grip_angles": "Fingers lie flat on what they grip.",
    "grip_width": "Fingers are as far apart as what they grip is wide.",
    "pushes": "The pushing tip stays on its point.",
    "contact_states": "The plate touches its support with the edge or corner that is said.",
    "unstated_contacts": "The plate touches its support nowhere else.",
    "contact_slip": "The edge or corner that the plate turns on does not slide.",
    "goal_height": "At the end the plate is as high as the task wants it.",
    "goal_hold": "At the end both hands hold the plate, and nothing else touches it but the cup.",
    "goals": "Every object ends where the task wants it.",
    "goal_angles": "Every object ends turned as the task wants it.",
    "balance_force": "All forces on each body add up to nothing over.",
    "balance_moment": "All turning moments on each body add up to nothing over.",
    "inertia": "The force that the motion itself takes was counted.",
    "angular_inertia": "The moment that turning takes was counted.",
    "contact_sets": "Forces are stated often enough along the way.",
    "friction": "No contact is asked for more friction than it has.",
    "suction": "The cup is never asked for more pull than it has.",
    "suction_moment": "The cup is never twisted or bent off.",
    "contact_torque": "Fingertips are not twisted more than friction allows.",
    "normal_force": "Contacts press and never pull, within their limits.",
    "hand_force": "No hand presses harder than its limit.",
    "cup_force": "The cup pulls no harder than its limit.",
    "contact_parameters": "Friction and limits are those of the task.",
    "cup_hold": "The cup holds what hangs on it, by its weight and motion.",
    "cup_hold_moment": "The cup holds the moments of what hangs on it.",
    "carried_force": "No hand carries more than it may, by what hangs on it.",
    "squeeze": "The squeeze that the gripper is told is in its range and is what the forces count on.",
    "payload": "No arm bears more than its payload.",
    "reserve": "The share of all limits that is said to be kept back is kept back.",
    "uncertainty": "It also holds with the heaviest plate the task allows, its centre of mass anywhere it may be.",
    "contact_points": "Each contact lies on both surfaces.",
    "contact_normals": "Each contact points out of the surface that it is on.",
    "collision": "Nothing touches but what is meant to, with a gap everywhere else.",
    "touch_depth": "What touches does not press into one another.",
}
"""By the check's name."""
PROOF: Final = "What was checked is the proof that there is no plan. No motion was checked: there is none."
"""Of a certificate of a plan that is infeasible."""


def words_of_check(name: str) -> str:
    """Return what a check asks; of one that this version does not know, nothing."""
    return CHECK_WORDS.get(name, "")
