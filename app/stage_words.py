"""What a stage of a job is called to a person who watches it."""

from __future__ import annotations

from types import MappingProxyType

STAGES = MappingProxyType(
    {
        "scene": "building the scene",
        "cup places": "trying places of the cup",
        "sample": "sampling poses of the plate",
        "reach": "finding what the hands reach",
        "merge": "building the graph",
        "examine": "balancing forces of all holds",
        "search": "searching a path",
        "motion": "planning arm motions",
        "denser": "searching again, more poses and holds",
        "reserve": "searching for the largest reserve",
        "tolerances": "looking at tolerances of the plate",
        "handovers": "computing handovers of the tool",
        "suction": "finding suction poses",
        "first regrasp": "grasps for taking up",
        "second regrasp": "grasps for putting down",
        "regrasp graph": "searching regrasps",
        "first motion": "planning motions for taking up",
        "second motion": "planning motions for putting down",
        "forces": "computing contact forces",
        "remedies": "trying changes that would help",
        "certify": "checking the plan independently",
        "simulate": "simulating the plan",
    }
)
"""By name of the stage."""


def stage_words(name: str) -> str:
    """Return words for a stage as reports and plans name it, with the object it is about if it has one.

    A stage of another version, which is not known here, is called as it is.
    """
    if name in STAGES:
        return STAGES[name]
    stage, _, about = name.rpartition(" ")
    return f"{STAGES[stage]} ({about})" if stage in STAGES else name
